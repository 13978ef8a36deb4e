"""The test whether two pixels see the same smooth surface, for the filter, penumbrae and silhouettes."""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F32Ptr, I8Ptr, I32Ptr
from ..kernels.jit import inlined
from ..kernels.simd import get, ptr
from ..scene.listed_rays import ListedRays
from .receivers import NOTHING

COSINE = np.float32(np.cos(np.radians(20.0)))
"""Normals of one smooth surface differ by less than 20 degrees."""

APART = np.float32(0.5)
"""Largest distance of a point from the other's tangent plane on one smooth surface, in pixel widths at that depth."""


class PictureSurfaces(NamedTuple):
    """The surfaces in a G-buffer, as input of `same_surface`; the arrays are those of `query.gbuffer.GBuffer`."""

    position: np.ndarray  # (H, W, 3) float32
    normal: np.ndarray  # (H, W, 3) float32
    face: np.ndarray  # (H, W) int32
    depth: np.ndarray  # (H, W) float32; 1 everywhere in an orthographic picture, whose pixels have one width
    side: np.ndarray  # (H, W) int8
    pixel: float  # float32, width of a pixel at depth 1


def seen_by(gbuffer, rays) -> PictureSurfaces:
    """The surfaces of a G-buffer that was made with these `CameraRays` or `ListedRays`."""
    depth = gbuffer.depth
    if not isinstance(rays, ListedRays):
        pixel = np.linalg.norm(rays.dy)
    elif rays.extent is None:
        pixel = np.pi / rays.height
    else:
        pixel, depth = rays.extent / rays.height, np.ones_like(depth)
    return PictureSurfaces(gbuffer.position, gbuffer.normal, gbuffer.face, depth, gbuffer.side, np.float32(pixel))


class Points(NamedTuple):
    """Pointers to the arrays of a `PictureSurfaces`, for hot kernels; pixel (y, x) is element y w + x."""

    position: F32Ptr  # float32 *, 3 a pixel
    normal: F32Ptr  # float32 *, 3 a pixel
    face: I32Ptr  # int32 *
    depth: F32Ptr  # float32 *
    side: I8Ptr  # int8 *
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
    """Pixel (y, x) of another (H, W) array, given by its pointer."""
    return get(values, y * points.w + x)


@inlined
def _vector(pointer, i):
    return get(pointer, 3 * i), get(pointer, 3 * i + 1), get(pointer, 3 * i + 2)


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def same_surface(points, y, x, v, u):
    """True if pixels (y, x) and (v, u) see the same smooth surface; (v, u) may lie outside the picture.

    The same face is the same surface. Two faces belong to one surface if their normals are nearly equal and each point
    lies near the other's tangent plane. Unlike a difference of depth, the distance to a plane does not grow at grazing
    angles. Finely tessellated surfaces, where every pixel sees another face, also stay connected.
    """
    if v < 0 or u < 0 or v >= points.h or u >= points.w:
        return False
    i, k = y * points.w + x, v * points.w + u
    if get(points.side, i) == NOTHING or get(points.side, k) == NOTHING:
        return False
    if get(points.face, i) == get(points.face, k):
        return True
    n, m = _vector(points.normal, i), _vector(points.normal, k)
    if _dot(n, m) < COSINE:  # Eq. (2) of docs/design/filter.md
        return False
    p, q = _vector(points.position, i), _vector(points.position, k)
    d = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    a, b = get(points.depth, i), get(points.depth, k)
    limit = APART * points.pixel * (a if a < b else b)
    return abs(_dot(n, d)) <= limit and abs(_dot(m, d)) <= limit
