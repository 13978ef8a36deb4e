"""A level ground: the points where rays that meet no surface meet a plane below them, and their receivers."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from .diffuse import RayPass
from .gbuffer import GBuffer
from .receivers import NOTHING, SHIFT

_FAR = 40.0  # radii of the scene that the ground reaches
_FADES = 0.5  # share of this distance from which shadows fade, so that the ground has no border


class Plane(NamedTuple):
    """A level plane in the recentred frame of a scene, seen from above and up to a distance."""

    axis: int  # that points up: 1 or 2
    height: float
    x: float  # the middle of the scene, on the two level axes
    y: float
    radius: float


class SeenGround(NamedTuple):
    """The ground that rays meet."""

    gbuffer: GBuffer  # without faces; its side is 1 where the ground is seen
    origins: np.ndarray  # (H, W, 3) float32: receivers, as from `point_receivers`
    kept: np.ndarray  # (H, W) float32: share of shadows that is shown: 1 near the scene, 0 where the ground ends


def plane_below(box: np.ndarray, up: str, height: float) -> Plane:
    """The plane of a ground; box : (2, 3), bounds of the scene, and `height`, both in its recentred frame."""
    lower, upper = box.astype(np.float64)
    radius = max(float(np.linalg.norm(upper - lower)) / 2.0, float(np.finfo(np.float32).tiny))
    axis = "xyz".index(up)
    x, y = np.delete((lower + upper) / 2.0, axis).tolist()
    return Plane(axis, float(np.float32(height)), x, y, _FAR * radius)


@kernel
def _meet(ticket, plane, rays, pixels, position, normal, depth, side, origins, kept):
    """Worker: write what rays see of the plane to their pixels; arrays have a row for each pixel."""
    up = plane.axis
    a, b = (0, 3 - up) if up != 0 else (1, 2)
    for i in items(ticket):
        above, falls = np.float64(rays.origins[i, up]) - plane.height, -np.float64(rays.directions[i, up])
        if not (above > 0.0 and falls > 0.0):
            continue
        t, k = above / falls, pixels[i]
        p = np.float32(np.float64(rays.origins[i, a]) + t * np.float64(rays.directions[i, a]))
        q = np.float32(np.float64(rays.origins[i, b]) + t * np.float64(rays.directions[i, b]))
        away = np.hypot(np.float64(p) - plane.x, np.float64(q) - plane.y) / plane.radius
        if not away < 1.0:
            continue
        height = np.float32(plane.height)
        position[k, a], position[k, b], position[k, up] = p, q, height
        # Eq. (2) of docs/design/receivers.md
        shift = SHIFT * np.float64(max(abs(p), abs(q), abs(height)))
        origins[k, a], origins[k, b], origins[k, up] = p, q, np.float32(np.float64(height) + shift)
        normal[k, up], depth[k], side[k] = np.float32(1.0), np.float32(t), np.int8(1)
        x = max((away - _FADES) / (1.0 - _FADES), 0.0)
        kept[k] = np.float32(1.0 - x * x * (3.0 - 2.0 * x))


def seen_ground(plane: Plane, rays: RayPass, wanted: np.ndarray, origin: np.ndarray, threads=None) -> SeenGround:
    """The ground that rays meet.

    rays : those of the pixels that are True in `wanted`, (H, W) bool; they meet no surface
    origin : (3,) float64, world position of the frame's origin
    """
    shape = wanted.shape
    position, normal, origins = (np.zeros((*shape, 3), np.float32) for _ in range(3))
    depth, side = np.full(shape, np.inf, np.float32), np.full(shape, NOTHING, np.int8)
    kept = np.zeros(shape, np.float32)
    ticket, pixels = new_ticket(len(rays.origins), 4096), np.flatnonzero(wanted)
    rows = (each.reshape(-1, 3) for each in (position, normal))
    args = *rows, depth.reshape(-1), side.reshape(-1), origins.reshape(-1, 3), kept.reshape(-1)
    run(_meet, thread_count(threads), ticket, plane, rays, pixels, *args)
    return SeenGround(GBuffer(position, normal, np.full(shape, -1, np.int32), depth, side, origin), origins, kept)
