"""The image layers of a data set: names and values, and blocker ids, the first face on the way to a light's centre.

Names are LAYER.PASS.CHANNEL, as Blender writes them to multi-layer EXR; OpenEXR groups channels by the names before the
last dot. The layer ``ViewLayer`` contains the surfaces that the camera sees, and each light has its own layer.
"""

from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..engine.scene import AnyScene
from ..picture.frame import Frame
from ..picture.image_files import exr_values
from ..query.gbuffer import GBuffer
from ..query.receivers import point_receivers
from ..scene.lights import DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight

# --- Blocker ids ------------------------------------------------------------------------------------------------------


def has_centre(light: Light) -> bool:
    """Whether a light has a centre, to which rays can be traced. Ambient lights and light lists have none."""
    return isinstance(light, PointLight | QuadLight | DiskLight | SphereLight | DirectionalLight)


def towards_centre(light: Light, world: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """(directions, tmax) of rays from (m, 3) points to the light's centre; rays to a distant light are unbounded."""
    if isinstance(light, DirectionalLight):
        return np.broadcast_to(-light.direction, world.shape), np.inf
    if isinstance(light, QuadLight):
        return light.corner + 0.5 * (light.u + light.v) - world, 1.0
    centre = light.position if isinstance(light, PointLight) else cast(DiskLight | SphereLight, light).center
    return centre - world, 1.0


def blockers(scene: AnyScene, gbuffer: GBuffer, light: Light, time: float, threads: int | None) -> NDArray[np.int32]:
    """(H, W) int32: the face that hides a light's centre from each pixel; -1 where none does.

    Where the surface faces away from the centre, this is the pixel's own face. Elsewhere it is the face of the nearest
    hit, by `Scene.closest_hit`, of a ray to the centre. The ray skips the pixel's own face and starts at the pixel's
    position, moved along the normal by 2^-21 of its largest coordinate; position and normal are those of the `GBuffer`.
    """
    out = np.full(gbuffer.face.shape, -1, gbuffer.face.dtype)
    covered = gbuffer.face >= 0
    if not covered.any():
        return out
    pixel_face, position = gbuffer.face[covered], gbuffer.position[covered].astype(np.float64)
    normal = gbuffer.normal[covered].astype(np.float64)
    world = point_receivers(position, normal, position, single=False) + gbuffer.origin
    directions, tmax = towards_centre(light, world)
    x, y, z = (normal * directions).T
    hit = scene.closest_hit(world, directions, 0.0, tmax, pixel_face, time, threads=threads)
    out[covered] = np.where(x + y + z > 0.0, hit.face, pixel_face)
    return out


# --- Layers -----------------------------------------------------------------------------------------------------------


VIEW = "ViewLayer"


class Objects(NamedTuple):
    """The object of each face, and the instance of each object."""

    of_face: np.ndarray  # (n,) int32
    instance: np.ndarray  # (k,) int32


def check_faces(scene: AnyScene) -> None:
    """Raise an InputError if the ids of a scene's faces do not fit into the layers."""
    if scene.n_triangles > np.iinfo(np.int32).max:
        raise InputError(f"{scene.name}: the layers of data sets number at most 2^31 - 1 faces; use one of its tiles")


def objects_of(scene: AnyScene) -> Objects:
    """The `Objects` of a scene."""
    return Objects(scene.object_of_face, np.array([o.instance for o in scene.objects], np.int32))


def light_layer(k: int) -> str:
    """The name of the layer of light k."""
    return f"Light{k:03d}"


def channels(frame: Frame, objects: Objects, blocked: list[np.ndarray | None]) -> dict[str, np.ndarray]:
    """All channels of a picture: name -> (H, W) float32, or uint32 with the bits of an int32 id.

    blocked : the `blockers` of each light, or None
    """
    gbuffer = frame.gbuffer
    covered = gbuffer.face >= 0
    object_id = np.where(covered, objects.of_face[np.where(covered, gbuffer.face, 0)], -1).astype(np.int32)
    instance = np.where(covered, objects.instance[np.where(covered, object_id, 0)], -1).astype(np.int32)
    passes = {
        **{f"{VIEW}.Combined.{c}": frame.image[..., k] for k, c in enumerate("RGB")},
        f"{VIEW}.Combined.A": covered.astype(np.float32),
        f"{VIEW}.Depth.Z": gbuffer.depth,
        **{f"{VIEW}.Position.{c}": gbuffer.position[..., k] for k, c in enumerate("XYZ")},
        **{f"{VIEW}.Normal.{c}": gbuffer.normal[..., k] for k, c in enumerate("XYZ")},
        f"{VIEW}.IndexOB.X": object_id,
        f"{VIEW}.Instance.X": instance,
        f"{VIEW}.Triangle.X": gbuffer.face,
    }
    for k, (visibility, blocker) in enumerate(zip(frame.visibility, blocked)):
        passes[f"{light_layer(k)}.Visibility.X"] = visibility
        if blocker is not None:
            blocks, layer = blocker >= 0, light_layer(k)
            of = np.where(blocks, objects.of_face[np.where(blocks, blocker, 0)], -1).astype(np.int32)
            passes[f"{layer}.Blocker.X"], passes[f"{layer}.BlockerIndexOB.X"] = blocker, of
            passes[f"{layer}.BlockerInstance.X"] = np.where(blocks, objects.instance[of], -1).astype(np.int32)
    return {name: exr_values(values) for name, values in passes.items()}


def light_blockers(
    scene: AnyScene, frame: Frame, lights: list[Light], time: float, threads: int | None
) -> list[NDArray[np.int32] | None]:
    """The `blockers` of each light; None for lights without a centre."""
    return [blockers(scene, frame.gbuffer, s, time, threads) if has_centre(s) else None for s in lights]


def masks(frame: Frame) -> list[NDArray[np.uint8]]:
    """For each light, (H, W) uint8: its hidden share, 255 for all of it; 0 in the background."""
    return [np.rint(255.0 * (1.0 - v.astype(np.float64))).astype(np.uint8) for v in frame.visibility]
