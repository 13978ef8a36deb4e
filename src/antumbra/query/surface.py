"""Do two pixels see one smooth surface? The question of the filter, of penumbrae and of silhouettes."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.simd import get, ptr
from .receivers import NOTHING

COSINE = np.float32(np.cos(np.radians(20.0)))
"""Normals of one smooth surface differ by less than 20 degrees."""

APART = np.float32(0.5)
"""Each of two points of one smooth surface is this near to the other's tangent plane, in widths of a pixel there."""


class PictureSurfaces(NamedTuple):
    """The surfaces in a G-buffer, as `same_surface` asks about them; (H, W, ...) arrays of `query.gbuffer.GBuffer`."""

    position: np.ndarray
    normal: np.ndarray
    face: np.ndarray
    depth: np.ndarray
    side: np.ndarray
    pixel: float  # float32, width of a pixel at depth 1


def seen_by(gbuffer, rays) -> PictureSurfaces:
    """What the camera of these `CameraRays` sees."""
    pixel = np.float32(np.linalg.norm(rays.dy))
    return PictureSurfaces(gbuffer.position, gbuffer.normal, gbuffer.face, gbuffer.depth, gbuffer.side, pixel)


class Points(NamedTuple):
    """Pointers to the arrays of a `PictureSurfaces`, for hot kernels; pixel (y, x) is element y w + x."""

    position: object  # float32 *, 3 a pixel
    normal: object  # float32 *, 3 a pixel
    face: object  # int32 *
    depth: object  # float32 *
    side: object  # int8 *
    h: int
    w: int
    pixel: float


@inlined
def points_of(seen):
    """The pointers of a `PictureSurfaces`, which must outlive them."""
    h, w = seen.face.shape
    return Points(
        ptr(seen.position), ptr(seen.normal), ptr(seen.face), ptr(seen.depth), ptr(seen.side), h, w, seen.pixel
    )


@inlined
def at(points, values, y, x):
    """Pixel (y, x) of another (H, W) array, by its pointer."""
    return get(values, y * points.w + x)


@inlined
def _vector(pointer, i):
    return get(pointer, 3 * i), get(pointer, 3 * i + 1), get(pointer, 3 * i + 2)


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def same_surface(points, y, x, v, u):
    """Does pixel (v, u), which may lie outside the picture, see the surface that pixel (y, x) sees, and smoothly on?

    The same face is the same surface. Another one is if its normal is nearly the same and each of the two points lies
    near the other's tangent plane. Distance to a plane does not grow with the angle of sight, as difference of depth
    does; nor do finely tessellated surfaces, where every pixel sees another face, fall apart.
    """
    if v < 0 or u < 0 or v >= points.h or u >= points.w:
        return False
    i, k = y * points.w + x, v * points.w + u
    if get(points.side, i) == NOTHING or get(points.side, k) == NOTHING:
        return False
    if get(points.face, i) == get(points.face, k):
        return True
    n, m = _vector(points.normal, i), _vector(points.normal, k)
    if _dot(n, m) < COSINE:
        return False
    p, q = _vector(points.position, i), _vector(points.position, k)
    d = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    a, b = get(points.depth, i), get(points.depth, k)
    limit = APART * points.pixel * (a if a < b else b)
    return abs(_dot(n, d)) <= limit and abs(_dot(m, d)) <= limit
