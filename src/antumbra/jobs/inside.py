"""Points inside solids, such as the buildings of a city, by exact rays towards the sky.

Along a ray that leaves a closed surface, faces seen from behind outnumber those seen from the front. Their difference
is the winding number, which overlapping solids and shared walls do not upset. Real models have holes, missing floors,
and sheets such as canopies. So several rays vote, all of them upwards: missing floors and hillsides then do no harm.
Level rays that count walls alone find roofs of buildings that have neither a floor nor ground below them.
"""

import numpy as np

from ..engine.paged_scene import PagedScene
from ..engine.scene import AnyScene
from ..query.receivers import Receivers
from ..trace.rays.ray_hits import intersections
from .sensors import LOW

_PLAN = "bsah+wide"
_RAYS = 16
_SHARE = 0.75  # of the rays, which must leave a solid
_LOWEST = 0.2  # height of the lowest ray's unit vector
_DEPTHS = 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0, 40.0  # world units below a roof, for level rays
_STEEP = 0.5  # height of a unit normal: steeper faces are walls
_AT_A_TIME = 1 << 12  # points


def covered_by_solids(scene: AnyScene, points: np.ndarray, threads: int | None = None) -> np.ndarray:
    """(n,) bool: whether points of the ground, or points `LOW` above them, lie inside solids.

    Floors of buildings often lie a little above or below the ground, hence the second test.

    points : (n, 3) float64, world
    """
    up = np.eye(3)["xyz".index(scene.up)]
    return inside(scene, points, threads) | inside(scene, points + LOW * up, threads)


def inside(scene: AnyScene, points: np.ndarray, threads: int | None = None) -> np.ndarray:
    """(n,) bool: whether points lie inside closed surfaces. Points of surfaces that look up lie above them.

    Faces that alpha cuts are not counted: they are leaves and fences.

    points : (n, 3) float64, world

    Raises
    ------
    InputError
        If the scene is in a store.
    """
    begin = Receivers.on_surface(points, np.eye(3)["xyz".index(scene.up)], scene.origin)
    return _left_by(scene, begin.origins[0], _rays(scene.up, _LOWEST, 1.0), False, threads)


def below_roofs(scene: AnyScene, points: np.ndarray, floor: np.ndarray, threads: int | None = None) -> np.ndarray:
    """(n,) bool: whether surfaces are roofs of buildings that have no floor, and no ground below them.

    Of such buildings, the roof is the lowest surface. But somewhere below it, walls are all around.

    points : (n, 3) float64, world, on the surfaces
    floor : (n,) float64, the height of the lowest ground around
    """
    up = "xyz".index(scene.up)
    found, rays = np.zeros(len(points), bool), _rays(scene.up, 0.01, 0.05)
    for depth in _DEPTHS:
        at = points.copy()
        at[:, up] = np.maximum(points[:, up] - depth, floor + LOW)
        high = np.flatnonzero((points[:, up] > floor + LOW) & ~found)
        if len(high):
            found[high] = _left_by(scene, Receivers.in_space(at[high], scene.origin).origins[0], rays, True, threads)
    return found


def _left_by(scene: AnyScene, begin: np.ndarray, rays: np.ndarray, walls: bool, threads: int | None) -> np.ndarray:
    """(n,) bool: whether most rays from points leave a solid.

    begin : (n, 3) float32, recentred
    rays : (_RAYS, 3) float64, unit vectors
    walls : whether only steep faces count
    """
    if isinstance(scene, PagedScene):
        raise scene.refusal()
    ready = scene.engine.with_options(_PLAN, threads, None).accelerated(0.0)
    assert ready.bvh is not None
    corners = ready.triangles.vertices.astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if walls:
        flat = np.abs(normals[:, "xyz".index(scene.up)]) > _STEEP * np.linalg.norm(normals, axis=1)
        normals[flat] = 0.0
    reach = 2.0 * float(np.linalg.norm(np.ptp(scene.bounds, axis=0))) + 1.0
    found = np.zeros(len(begin), bool)
    for first in range(0, len(begin), _AT_A_TIME):
        some = begin[first : first + _AT_A_TIME]
        origins = np.repeat(some, _RAYS, 0)
        ends = (origins + np.tile(reach * rays, (len(some), 1))).astype(np.float32)
        met = intersections(ready.bvh, origins, ends, np.full(len(origins), -1, np.int32), threads)
        ray = np.repeat(np.arange(len(origins)), np.diff(met.first))
        signs = np.sign((normals[met.prims] * (ends.astype(np.float64) - origins)[ray]).sum(1))
        winding = np.bincount(ray, signs, len(origins)).reshape(-1, _RAYS)
        found[first : first + _AT_A_TIME] = (winding != 0.0).mean(1) >= _SHARE
    return found


def _rays(up: str, lowest: float, highest: float) -> np.ndarray:
    """(_RAYS, 3) float64: unit vectors on a spiral, none of them along an axis, as edges of models often are."""
    i = np.arange(_RAYS)
    height, angle = lowest + (highest - lowest) * (i + 0.5) / _RAYS, 0.3 + i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height * height)
    east, north = width * np.cos(angle), width * np.sin(angle)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=1)
