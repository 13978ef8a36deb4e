"""Blocker ids: for each pixel the first face on the way to the centre of a light."""

import numpy as np

from ...engine.scene import AnyScene
from ...query.gbuffer import GBuffer
from ...query.receivers import point_receivers
from ...scene.lights import DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight


def has_centre(light: Light) -> bool:
    """Whether rays can be sent to the light's centre. Ambient light and lists of lights have none."""
    return isinstance(light, PointLight | QuadLight | DiskLight | SphereLight | DirectionalLight)


def towards_centre(light: Light, world: np.ndarray) -> tuple[np.ndarray, float]:
    """(directions, tmax) of rays from (m, 3) points to the light's centre; a distant light's rays have no end."""
    if isinstance(light, DirectionalLight):
        return np.broadcast_to(-light.direction, world.shape), np.inf
    if isinstance(light, QuadLight):
        return light.corner + 0.5 * (light.u + light.v) - world, 1.0
    centre = light.position if isinstance(light, PointLight) else light.center  # type: ignore[attr-defined]
    return centre - world, 1.0


def blockers(scene: AnyScene, gbuffer: GBuffer, light: Light, time: float, threads: int | None) -> np.ndarray:
    """(H, W) int32: the face that keeps the centre of a light from each pixel; -1 where none does.

    It is the pixel's own face where the surface faces away from the centre. Elsewhere it is the face of the nearest
    hit, by `Scene.closest_hit`, of a ray to the centre. The ray skips the pixel's own face. It starts at the pixel's
    position, moved by 2^-21 of its largest coordinate along the normal, both as `GBuffer` gives them.
    """
    out = np.full(gbuffer.face.shape, -1, np.int32)
    seen = gbuffer.face >= 0
    if not seen.any():
        return out
    own, position = gbuffer.face[seen], gbuffer.position[seen].astype(np.float64)
    normal = gbuffer.normal[seen].astype(np.float64)
    world = point_receivers(position, normal, position, single=False) + gbuffer.origin
    directions, tmax = towards_centre(light, world)
    x, y, z = (normal * directions).T
    hit = scene.closest_hit(world, directions, 0.0, tmax, own, time, threads=threads)
    out[seen] = np.where(x + y + z > 0.0, hit.face, own)
    return out
