"""What a point of a surface sees of each light, and what blocks it."""

from typing import NamedTuple

import numpy as np

from ..engine.point_visibility import visibility
from ..jobs.dataset.dataset_layers import has_centre, towards_centre
from ..query.receivers import point_receivers
from ..scene.lights import DirectionalLight
from .lamps import FAR
from .model import Model

_SPP = 256  # rays to each light


class Face(NamedTuple):
    """A triangle of the scene."""

    index: int
    object: str  # its name
    corners: np.ndarray  # (3, 3) float64, world


class Sight(NamedTuple):
    """What a point sees of one light."""

    name: str
    share: float  # of the samples, in [0, 1]
    samples: int
    end: np.ndarray | None  # (3,) float64, world: the centre of the light; None: it has none
    blocker: Face | None  # the first triangle on the way to the centre
    at: np.ndarray | None  # (3,) float64, world: where the blocker is met


class Probe(NamedTuple):
    """What a point of a surface sees."""

    position: np.ndarray  # (3,) float64, world
    normal: np.ndarray  # (3,) float64, unit, towards the viewer
    face: Face
    sights: list[Sight]  # one for each light that is on


def probe(model: Model, origin: np.ndarray, direction: np.ndarray) -> Probe | None:
    """What the first point on a ray sees of the lights; None if the ray meets nothing.

    origin, direction : (3,) float64, world
    """
    scene, time = model.scene, model.time
    hit = scene.closest_hit(origin, direction, time=time, threads=model.threads)
    if not hit.mask:
        return None
    normal = hit.normal * (-1.0 if hit.normal @ direction > 0.0 else 1.0)
    position, lamps = hit.position, model.shining
    found = visibility(
        scene, position, [lamp.light for lamp in lamps], normal, spp=_SPP, plan=model.plan, time=time,
        threads=model.threads,
    )  # fmt: skip
    face = _face(model, int(hit.face), hit.corners, int(hit.object))
    sights = []
    for lamp, share, samples in zip(lamps, found.fraction.tolist(), found.samples.tolist()):
        seen = Sight(lamp.name, share, samples, None, None, None)
        sights.append(
            _with_blocker(model, seen, lamp.light, position, normal, face) if has_centre(lamp.light) else seen
        )
    return Probe(position, normal, face, sights)


def _with_blocker(model: Model, sight: Sight, light, position, normal, own: Face) -> Sight:
    """The sight with the light's centre, and the first triangle on the way there."""
    local = (position - model.scene.origin)[None]
    world = point_receivers(local, normal[None], position[None], single=False) + model.scene.origin
    (direction,), end = towards_centre(light, world)
    reach = FAR / model.stage.scale if isinstance(light, DirectionalLight) else 1.0
    sight = sight._replace(end=world[0] + reach * direction)
    if normal @ direction <= 0.0:
        return sight._replace(blocker=own, at=position)
    hit = model.scene.closest_hit(world[0], direction, 0.0, end, own.index, model.time, threads=model.threads)
    if not hit.mask:
        return sight
    return sight._replace(blocker=_face(model, int(hit.face), hit.corners, int(hit.object)), at=hit.position)


def _face(model: Model, index: int, corners: np.ndarray, owner: int) -> Face:
    """A triangle with the name of its object; of a city, with the type of its surface too."""
    scene = model.scene
    name = scene.objects[owner].name if 0 <= owner < len(scene.objects) else ""
    if scene.city is not None:
        kind = str(scene.city.surface_types(index))
        name += f", {kind}" if kind else ""
    return Face(index, name, corners)
