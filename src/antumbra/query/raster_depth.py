"""`hits.hit_t` of many rays from one eye: terms independent of the direction are computed once per triangle."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.predicate.filters import plane, widest
from ..kernels.predicate.hits import hit_t

_ACCURACY = 2.0**-31  # half the error that `hit_t` accepts: within it, `hit_t` returns its float64 expression
_FLOOR = 1e-250  # far above any loss by underflow


class EyePlane(NamedTuple):
    """A triangle's plane seen from the eye. All float64 but `triangle`, an int64 (-1: none yet)."""

    triangle: int
    nx: float
    ny: float
    nz: float
    volume: float  # det(a, b, c) of the corners relative to the eye
    least: float  # least |d . n| / |d|_1 with an accurate float64 result; inf if the volume is inaccurate


NO_PLANE = EyePlane(-1, 0.0, 0.0, 0.0, 0.0, np.inf)


@inlined
def eye_plane(corners, i, o):
    """The `EyePlane` of triangle i from the point o."""
    f = np.float64
    a, n, error = plane(corners, i, f(o[0]), f(o[1]), f(o[2]))
    volume = a[0] * n[0] + a[1] * n[1] + a[2] * n[2]
    accurate = error * widest(a) + _FLOOR <= _ACCURACY * abs(volume)
    return EyePlane(np.int64(i), n[0], n[1], n[2], volume, error / _ACCURACY if accurate else np.inf)


@inlined
def quick_t(p, ray):
    """`plane_t` if float64 is surely accurate, else -1."""
    det = ray.dx * p.nx + ray.dy * p.ny + ray.dz * p.nz
    size = abs(ray.dx) + abs(ray.dy) + abs(ray.dz)
    return p.volume / det if abs(det) > p.least * size + _FLOOR else -1.0


@inlined
def plane_t(p, ray, corners):
    """The bits of ``hit_t(ray, corners, p.triangle)``, for a ray from the eye that meets the triangle."""
    t = quick_t(p, ray)
    return t if t > 0.0 else hit_t(ray, corners, p.triangle)
