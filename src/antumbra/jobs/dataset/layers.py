"""The layers of a picture of a data set: their names, and their values.

Names are LAYER.PASS.CHANNEL, as Blender writes them to a multi-layer EXR. OpenEXR groups channels by the names before
the last dot. The layer ``ViewLayer`` has the surfaces that the camera sees, and each light has a layer of its own.
"""

from typing import NamedTuple

import numpy as np

from ...engine.scene import AnyScene
from ...picture.frame import Frame
from ...picture.image_files import stored
from ...scene.lights import Light
from .blockers import blockers, has_centre

VIEW = "ViewLayer"


class Objects(NamedTuple):
    """The object of each face, and the instance of each object."""

    of_face: np.ndarray  # (n,) int32
    instance: np.ndarray  # (k,) int32


def objects_of(scene: AnyScene) -> Objects:
    """The `Objects` of a scene."""
    return Objects(scene.object_of_face, np.array([o.instance for o in scene.objects], np.int32))


def light_layer(k: int) -> str:
    """The name of the layer of light k."""
    return f"Light{k:03d}"


def channels(frame: Frame, objects: Objects, blocked: list[np.ndarray | None]) -> dict[str, np.ndarray]:
    """All channels of a picture: name -> (H, W) float32, or uint32 with the bits of an int32 id.

    blocked : for each light its `blockers`, or None
    """
    g = frame.gbuffer
    seen = g.face >= 0
    thing = np.where(seen, objects.of_face[np.where(seen, g.face, 0)], -1).astype(np.int32)
    instance = np.where(seen, objects.instance[np.where(seen, thing, 0)], -1).astype(np.int32)
    passes = {
        **{f"{VIEW}.Combined.{c}": frame.image[..., k] for k, c in enumerate("RGB")},
        f"{VIEW}.Combined.A": seen.astype(np.float32),
        f"{VIEW}.Depth.Z": g.depth,
        **{f"{VIEW}.Position.{c}": g.position[..., k] for k, c in enumerate("XYZ")},
        **{f"{VIEW}.Normal.{c}": g.normal[..., k] for k, c in enumerate("XYZ")},
        f"{VIEW}.IndexOB.X": thing,
        f"{VIEW}.Instance.X": instance,
        f"{VIEW}.Triangle.X": g.face,
    }
    for k, (visibility, blocker) in enumerate(zip(frame.visibility, blocked)):
        passes[f"{light_layer(k)}.Visibility.X"] = visibility
        if blocker is not None:
            passes[f"{light_layer(k)}.Blocker.X"] = blocker
    return {name: stored(values) for name, values in passes.items()}


def blocked_by(scene: AnyScene, frame: Frame, lights: list[Light], time: float, threads) -> list[np.ndarray | None]:
    """For each light its `blockers`; None if it has no centre."""
    return [blockers(scene, frame.gbuffer, s, time, threads) if has_centre(s) else None for s in lights]


def masks(frame: Frame) -> list[np.ndarray]:
    """For each light (H, W) uint8: the share of it that is hidden, 255 for all of it; 0 in the background."""
    return [np.rint(255.0 * (1.0 - v.astype(np.float64))).astype(np.uint8) for v in frame.visibility]
