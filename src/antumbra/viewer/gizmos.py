"""Gizmos over the pictures: light handles, and sightlines from a clicked point to the lights and their blockers."""

from collections.abc import Awaitable, Callable
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..datasets.dataset_layers import has_centre, towards_centre
from ..engine.point_visibility import visibility
from ..query.receivers import point_receivers
from ..scene.light_lists import DirectionalLights
from ..scene.lights import DirectionalLight, Light
from ..scene.sky import Sky, sky_directions
from .viewer_model import FAR, EditableLight, Model, handle_position, light_outline

# --- Visibility of each light from a surface point --------------------------------------------------------------------


_SPP = 256  # rays per light


class Face(NamedTuple):
    """A triangle of the scene."""

    index: int  # type: ignore[assignment]  # hides tuple.index
    object: str  # its name
    corners: NDArray[np.float64]  # (3, 3), world


class Sight(NamedTuple):
    """Visibility of one light from a point."""

    name: str
    share: float  # visible share of the samples, in [0, 1]; of a sky, `Probe.sky`
    samples: int
    end: NDArray[np.float64] | None  # (3,), world: the centre of the light; None: no centre
    blocker: Face | None  # the first triangle towards the centre
    at: NDArray[np.float64] | None  # (3,), world: the point on the blocker


class Probe(NamedTuple):
    """Visibility of the lights from a surface point."""

    position: NDArray[np.float64]  # (3,), world
    normal: NDArray[np.float64]  # (3,), unit, towards the viewer
    face: Face
    sights: list[Sight]  # one for each light that is on
    sky: float  # visible share of the sky above the horizon, all directions alike
    sun: Sight | None  # that of the sun; None: it is off or below the horizon


def probe(model: Model, origin: NDArray[np.float64], direction: NDArray[np.float64]) -> Probe | None:
    """Visibility of the lights from the first point on a ray; None if the ray hits nothing.

    origin, direction : (3,) float64, world
    """
    scene, time = model.scene, model.time
    hit = scene.closest_hit(origin, direction, time=time, threads=model.threads)
    if not hit.mask:
        return None
    normal = hit.normal * (-1.0 if hit.normal @ direction > 0.0 else 1.0)
    position, lamps = hit.position, model.active_lights
    dome = DirectionalLights(-sky_directions(_SPP, scene.up))
    result = visibility(
        scene,
        position,
        [*(lamp.light for lamp in lamps), dome],
        normal,
        spp=_SPP,
        plan=model.plan,
        time=time,
        threads=model.threads,
    )
    face = _face(model, int(hit.face), hit.corners, int(hit.object))
    sights = []
    fractions, sky = result.fraction.tolist(), float(result.fraction[-1])
    for lamp, fraction, samples in zip(lamps, fractions, result.samples.tolist()):
        share = sky if isinstance(lamp.light, Sky) else fraction  # of its half above the horizon
        sight = Sight(lamp.name, share, samples, None, None, None)
        sights.append(
            _with_blocker(model, sight, lamp.light, position, normal, face) if has_centre(lamp.light) else sight
        )
    name = None if model.sun is None else model.sun.name
    sun = next((sight for sight in sights if sight.name == name), None)
    return Probe(position, normal, face, sights, sky, sun)


def _with_blocker(
    model: Model, sight: Sight, light: Light, position: NDArray[np.float64], normal: NDArray[np.float64], face: Face
) -> Sight:
    """The sight with the light's centre, and the first triangle towards it."""
    local = (position - model.scene.origin)[None]
    world = point_receivers(local, normal[None], position[None], single=False) + model.scene.origin
    (direction,), end = towards_centre(light, world)
    reach = FAR / model.page_frame.scale if isinstance(light, DirectionalLight) else 1.0
    sight = sight._replace(end=world[0] + reach * direction)
    if normal @ direction <= 0.0:
        return sight._replace(blocker=face, at=position)
    hit = model.scene.closest_hit(world[0], direction, 0.0, end, face.index, model.time, threads=model.threads)
    if not hit.mask:
        return sight
    return sight._replace(blocker=_face(model, int(hit.face), hit.corners, int(hit.object)), at=hit.position)


def _face(model: Model, index: int, corners: np.ndarray, owner: int) -> Face:
    """A triangle with the name of its object and, in a city, the type of its surface."""
    scene = model.scene
    name = scene.objects[owner].name if 0 <= owner < len(scene.objects) else ""
    if scene.city is not None:
        kind = str(scene.city.surface_types(index))
        name += f", {kind}" if kind else ""
    return Face(index, name, corners)


ANSWERS = {
    "inSun": "In the sun.",
    "inShadow": "In the shade.",
    "inShadowOf": "In the shade of {blocker}.",
    "behind": "Faces away from the sun.",
    "sky": "Sees {share} % of the sky.",
}
"""Sentences about a point, in the words of the page that `antumbra page` writes."""


def answer_of(point: Probe) -> str:
    """What a point sees, in one or two sentences."""
    sky, sun = ANSWERS["sky"].format(share=f"{100.0 * point.sky:.0f}"), point.sun
    if sun is None:
        return sky
    if sun.share == 1.0:
        now = ANSWERS["inSun"]
    elif sun.share > 0.0:
        now = f"In penumbra: sees {100.0 * sun.share:.0f} % of the sun."
    elif sun.blocker == point.face:
        now = ANSWERS["behind"]
    elif sun.blocker is not None and sun.blocker.object:
        now = ANSWERS["inShadowOf"].format(blocker=sun.blocker.object)
    else:
        now = ANSWERS["inShadow"]
    return f"{now} {sky}"


# --- Gizmos in the page -----------------------------------------------------------------------------------------------


_LIGHT, _SEEN, _BLOCKED, _BEYOND = (255, 196, 60), (255, 214, 64), (255, 64, 64), (150, 40, 60)
_HANDLE = 0.9  # page units: length of a handle's arrows
_POINT = 0.03  # page units: radius of a clicked point


class Gizmos:
    """Light handles, and the sightlines of the clicked point.

    Parameters
    ----------
    page : Page
        Its `changed` is called after a handle has moved.
    """

    def __init__(self, page: Any):
        self._page, self._scene = page, page.server.scene
        self._model: Model = page.model
        self._handles: dict[str, Any] = {}
        self._shown, self._lock = True, Lock()
        self.refresh()

    def show_handles(self, visible: bool) -> None:
        """Show or hide the handles of all lights."""
        self._shown = visible
        self.refresh()

    def refresh(self) -> None:
        """Move the handles to the lights."""
        with self._lock:
            for lamp in self._model.editable_lights:
                place = handle_position(lamp.light, self._model.page_frame)
                if place is not None:
                    self._put(lamp, place)

    def point_at(self, point: Probe | None) -> None:
        """Show the answer at a point, its sightlines, red up to a blocker, and the blocking triangles."""
        for name in "/point", "/answer", "/sights", "/blockers":
            self._scene.remove_by_name(name)
        if point is None:
            return
        to_page = self._model.page_frame.to_page
        self._scene.add_icosphere("/point", _POINT, color=_SEEN, position=to_page(point.position))
        text = answer_of(point).replace(". ", ".\n")
        self._scene.add_label("/answer", text, position=to_page(point.position), anchor="top-center")
        lines, colours = sight_lines(point)
        if len(lines):
            self._draw("/sights", to_page(lines), colours, 2.5)
        rings = [sight.blocker.corners for sight in point.sights if sight.blocker is not None]
        if rings:
            edges = np.concatenate([np.stack([ring, np.roll(ring, -1, 0)], 1) for ring in rings])
            self._scene.add_line_segments(
                "/blockers", to_page(edges), _BLOCKED, thickness=4.0, thickness_units="screen"
            )

    def _put(self, lamp: EditableLight, place: np.ndarray) -> None:
        on = self._shown and lamp.on and not self._model.has_set(lamp)
        path = f"/lights/{lamp.name}"
        if lamp.name not in self._handles:
            handle = self._handles[lamp.name] = self._scene.add_transform_controls(
                path, scale=_HANDLE, disable_rotations=True, depth_test=False, position=place
            )
            self._scene.add_label(f"{path}/name", lamp.name)
            handle.on_update(self._page.listener(self._mover(lamp.name)))
        handle = self._handles[lamp.name]
        handle.visible = on
        if not np.allclose(handle.position, place, atol=1e-5):
            handle.position = place
        lines = light_outline(lamp.light, self._model.page_frame)
        if len(lines):
            self._scene.add_line_segments(
                f"/outlines/{lamp.name}", lines, _LIGHT, thickness=2.0, thickness_units="screen", visible=on
            )

    def _draw(self, name: str, lines: np.ndarray, colours: Any, pixels: float, visible: bool = True) -> None:
        self._scene.add_line_segments(name, lines, colours, thickness=pixels, thickness_units="screen", visible=visible)

    def _mover(self, name: str) -> Callable[[Any], Awaitable[None]]:
        async def moved(event: Any) -> None:
            self._model.move(name, np.array(event.target.position, np.float64))
            self._page.changed()

        return moved


def sight_lines(point: Probe) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Lines from a point to the lights, (k, 2, 3) float64, world, and their colours, (k, 2, 3) uint8."""
    lines: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
    colours = []
    for sight in point.sights:
        if sight.end is None:
            continue
        if sight.at is None:
            lines.append((point.position, sight.end))
            colours.append(_SEEN)
            continue
        lines += [(point.position, sight.at), (sight.at, sight.end)]
        colours += [_BLOCKED, _BEYOND]
    line_colours = np.repeat(np.array(colours, np.uint8).reshape(-1, 1, 3), 2, 1)
    return np.array(lines, np.float64).reshape(-1, 2, 3), line_colours
