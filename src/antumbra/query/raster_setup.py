"""Triangle setup of the rasteriser: edge functions and depth keys, with proven bounds on all rounding errors.

Also the terms of a ray's `t` that do not depend on its direction, computed once per triangle (`EyePlane`).

A vector v from the eye is written h = (z, x, y) in *pixel coordinates*: v = z c + x r + y d, where c points to the
centre of the upper left pixel and r, d step one pixel right and down. The ray of pixel (i, j) is then g = (1, i, j),
apart from the rounding of its direction to float32, and the contract's determinants (`predicate.exact`) become, up to
the common factor det(c, r, d),

    e0 = det(g, h1, h2)   e1 = det(g, h2, h0)   e2 = det(g, h0, h1)   t = det(h0, h1, h2) / (e0 + e1 + e2)

These are homogeneous edge functions [Olano and Greer 1997]. They are linear over the screen, and correct without
clipping for triangles that cross the camera's plane. The triangle covers a pixel if each e is 0 or has the sign of
det(h0, h1, h2). The contract's other case, all signs opposite, cannot occur with t > 0. The depth key 1 / t is linear
as well.

Errors. Rounding the direction moves g by at most (`shift_z`, `shift_x`, `shift_y`). This moves e = C + A i + B j by at
most |C| shift_z + |A| shift_x + |B| shift_y. Let u = 2**-53, and let v be a vector whose components do not exceed r.
The components of its h then have errors of at most 8 u r (`norm_z`, `norm_x`, `norm_y`), from three inputs, products
and sums, and the move to a tile's origin. A 2 x 2 determinant of two such vectors has an error of at most 36 u norm
norm r r. All functions are computed from a = v0 - eye, p = v1 - v0, q = v2 - v0, so errors shrink with the triangle:

    |error e1|, |error e2| <= K r s    |error (e0 + e1 + e2)| <= K s s    |error det| <= V r s s

with r the largest component of a, s of p and q.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.exact.filters import hit_t, max_magnitude, plane
from ..kernels.jit import inlined, kernel
from ..kernels.simd import get
from ..scene.camera import CameraRays

# --- Edge functions and depth keys ------------------------------------------------------------------------------------


TILE = 64  # pixels; tiles are square
STRIDE = TILE + 8  # row stride of a tile: a vector of pixels may start anywhere and extend past the right edge

_U = 2.0**-53
_F = np.float32
_EPSILON = 2.0**-24  # of float32
_SLACK = 1.001  # for second order terms, and for the rounding of the bounds themselves
_TINY = 1e-37  # above the underflow error of float32
_HUGE = 1e30  # below the overflow limit of float32, with room for sums


class RasterView(NamedTuple):
    """A camera in pixel coordinates. Scalars, because threads would contend for the reference counts of arrays."""

    eye_x: float
    eye_y: float
    eye_z: float
    zx: float  # the matrix from v - eye to h, each entry correctly rounded: row z
    zy: float
    zz: float
    xx: float  # row x
    xy: float
    xz: float
    yx: float  # row y
    yy: float
    yz: float
    turn: int  # sign of det(c, r, d)
    width: int
    height: int
    norm_z: float  # |h| is at most norm * |v - eye|_inf per component, also relative to any pixel of the screen
    norm_x: float
    norm_y: float
    shift_z: float  # bound on the movement of a ray when its direction is rounded to float32
    shift_x: float
    shift_y: float
    slope_error: float  # K above: error of the edge function of two vectors of length 1, up to STRIDE from its origin
    volume_error: float  # V above


def make_view(rays: CameraRays) -> RasterView:
    """The `RasterView` of `CameraRays`; InputError if its pixels are too close for float64's range."""
    rows, turn = _inverse(rays.corner + 0.5 * rays.dx + 0.5 * rays.dy, rays.dx, rays.dy)
    norm = np.abs(rows).sum(1) * _SLACK
    if not norm.max() < _HUGE:
        raise InputError(f"camera: directions of neighbouring pixels differ by less than {1 / _HUGE:g}; widen the vfov")
    z, x, y = norm[0], norm[1] + rays.width * norm[0], norm[2] + rays.height * norm[0]
    shift = np.abs(rows) @ direction_error(rays) * _SLACK
    shift_x, shift_y = shift[1] + rays.width * shift[0], shift[2] + rays.height * shift[0]
    slope_error = 48 * _U * (x * y + STRIDE * z * (x + y))
    bounds = (z, x, y, shift[0], shift_x, shift_y, slope_error, 200 * _U * x * y * z)
    eye = rays.origin.tolist()
    size = int(rays.width), int(rays.height)
    return RasterView._make((*eye, *rows.ravel().tolist(), turn, *size, *map(float, bounds)))


def _inverse(*columns: np.ndarray) -> tuple[NDArray[np.float64], int]:
    """(inverse of the matrix of three columns, (3, 3) float64, correctly rounded; sign of its determinant)."""
    c, r, d = ([Fraction(float(x)) for x in column] for column in columns)
    rows = [_cross(r, d), _cross(d, c), _cross(c, r)]
    det = sum(x * y for x, y in zip(c, rows[0]))
    return np.array([[float(x / det) for x in row] for row in rows]), 1 if det > 0 else -1


def _cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    return [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]


def direction_error(rays: CameraRays) -> NDArray[np.float64]:
    """Bound on the difference of a pixel's direction from c + i r + j d in real arithmetic: (3,) float64."""
    right, down = rays.width * rays.dx, rays.height * rays.dy
    ends = [rays.corner, rays.corner + right, rays.corner + down, rays.corner + right + down]
    float64 = 16 * _U * (np.abs(rays.corner) + np.abs(right) + np.abs(down))
    error: NDArray[np.float64] = _EPSILON * np.abs(ends).max(0) + float64 + 2.0**-149
    return error


class EdgeFunctions(NamedTuple):
    """Three edge functions and the depth key over the pixels (i, j) from an origin: value = c + a i + b j, all float32.

    Each edge function is divided by its error bound: a pixel is surely inside above 1, and surely outside below -1. The
    depth key is 1 / t, with an error of at most ``key_error``.
    """

    a0: float
    b0: float
    c0: float
    a1: float
    b1: float
    c1: float
    a2: float
    b2: float
    c2: float
    key_a: float
    key_b: float
    key_c: float
    key_error: float


@inlined
def corner_from(corners, i, k, o):
    """Corner k of triangle i minus the point o, in float64; `corners` is a pointer."""
    f, at = np.float64, 9 * i + 3 * k
    return f(get(corners, at)) - o[0], f(get(corners, at + 1)) - o[1], f(get(corners, at + 2)) - o[2]


@inlined
def pixel_vector(view, v):
    """h = (z, x, y) of the vector v."""
    x, y, z = v
    return (
        view.zx * x + view.zy * y + view.zz * z,
        view.xx * x + view.xy * y + view.xz * z,
        view.yx * x + view.yy * y + view.yz * z,
    )


@inlined
def _relative(h, x0, y0):
    """h in the pixel coordinates whose origin is pixel (x0, y0)."""
    return h[0], h[1] - x0 * h[0], h[2] - y0 * h[0]


@inlined
def _linear(v, w):
    """det(g, v, w) as (a, b, c): c + a i + b j for g = (1, i, j)."""
    return v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0], v[1] * w[2] - v[2] * w[1]


@inlined
def _scaled(f, view, x_reach, y_reach, error, sign):
    """An edge function divided by its error bound, in float32; the bound includes the five roundings in float32."""
    a, b, c = abs(f[0]), abs(f[1]), abs(f[2])
    error += (
        a * (view.shift_x + 5 * _EPSILON * x_reach)
        + b * (view.shift_y + 5 * _EPSILON * y_reach)
        + c * (view.shift_z + 5 * _EPSILON)
    )
    scale = sign / (error * _SLACK)
    return _F(f[0] * scale), _F(f[1] * scale), _F(f[2] * scale)


@inlined
def _depth_key(f, view, x_reach, y_reach, error, volume, volume_error):
    """(a, b, c, error) of 1 / t in float32; the error is infinite if float32 cannot represent it."""
    a, b, c = abs(f[0]), abs(f[1]), abs(f[2])
    moved = error + a * view.shift_x + b * view.shift_y + c * view.shift_z
    size, inverse, total = abs(volume), 1.0 / volume, a * x_reach + b * y_reach + c
    # Roundings in float32, and 2**-28 since `hit_t` itself is within 2**-30 of the truth
    relative = volume_error / size + 6 * _EPSILON + 2.0**-28
    bound = (moved + total * relative) * _SLACK / size + _TINY
    if volume_error < 1e-3 * size and total < _HUGE * size and bound < _HUGE:
        return _F(f[0] * inverse), _F(f[1] * inverse), _F(f[2] * inverse), _F(bound)
    return _F(0.0), _F(0.0), _F(0.0), _F(np.inf)


@kernel
def edge_functions(view, corners, i, x0, y0, x_reach, y_reach):
    """(turn, `EdgeFunctions`) of triangle i with origin at pixel (x0, y0), for pixels up to x_reach, y_reach from it.

    turn: the sign of det(h0, h1, h2), by which the edge functions are multiplied. 0: undecided in float64; the edge
    functions keep their sign.
    """
    v0 = corner_from(corners, i, 0, (0.0, 0.0, 0.0))
    a = (v0[0] - view.eye_x, v0[1] - view.eye_y, v0[2] - view.eye_z)
    p, q = corner_from(corners, i, 1, v0), corner_from(corners, i, 2, v0)
    r, longest_p, longest_q = max_magnitude(a), max_magnitude(p), max_magnitude(q)
    s = longest_p if longest_p > longest_q else longest_q
    fx, fy, w, h = np.float64(x0), np.float64(y0), np.float64(x_reach), np.float64(y_reach)
    ha = _relative(pixel_vector(view, a), fx, fy)
    hp = _relative(pixel_vector(view, p), fx, fy)
    hq = _relative(pixel_vector(view, q), fx, fy)
    total, e1, e2 = _linear(hp, hq), _linear(hq, ha), _linear(ha, hp)
    e0 = (total[0] - e1[0] - e2[0], total[1] - e1[1] - e2[1], total[2] - e1[2] - e2[2])
    volume = ha[0] * total[2] + ha[1] * total[0] + ha[2] * total[1]
    volume_error = view.volume_error * r * s * s
    turn = (1 if volume > 0.0 else -1) if abs(volume) > volume_error else 0
    sign, error = -1.0 if turn < 0 else 1.0, view.slope_error * s * (s + r + r)
    f0 = _scaled(e0, view, w, h, error, sign)
    f1 = _scaled(e1, view, w, h, error, sign)
    f2 = _scaled(e2, view, w, h, error, sign)
    key = _depth_key(total, view, w, h, view.slope_error * s * s, volume, volume_error)
    return turn, EdgeFunctions(*f0, *f1, *f2, *key)


@inlined
def negated(f):
    """The edge functions multiplied by -1, with the same depth key."""
    return EdgeFunctions(
        -f.a0, -f.b0, -f.c0, -f.a1, -f.b1, -f.c1, -f.a2, -f.b2, -f.c2, f.key_a, f.key_b, f.key_c, f.key_error
    )


# --- `hits.hit_t` for many rays from one eye --------------------------------------------------------------------------


_ACCURACY = 2.0**-31  # half the error up to which `hit_t` returns its float64 expression
_FLOOR = 1e-250  # far above any underflow error


class EyePlane(NamedTuple):
    """A triangle's plane relative to the eye. All float64 but `triangle`, an int64 (-1: none yet)."""

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
    accurate = error * max_magnitude(a) + _FLOOR <= _ACCURACY * abs(volume)
    return EyePlane(np.int64(i), n[0], n[1], n[2], volume, error / _ACCURACY if accurate else np.inf)


@inlined
def quick_t(p, ray):
    """`plane_t` where float64 is surely accurate, else -1."""
    det = ray.dx * p.nx + ray.dy * p.ny + ray.dz * p.nz
    size = abs(ray.dx) + abs(ray.dy) + abs(ray.dz)
    return p.volume / det if abs(det) > p.least * size + _FLOOR else -1.0


@inlined
def plane_t(p, ray, corners):
    """The bits of ``hit_t(ray, corners, p.triangle)``, for a ray from the eye that meets the triangle."""
    t = quick_t(p, ray)
    return t if t > 0.0 else hit_t(ray, corners, p.triangle)
