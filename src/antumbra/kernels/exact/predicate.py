"""The exact ray-triangle predicate, decided in real arithmetic on float32 coordinates (docs/design/exactness.md).

A ray is the set of points o + t d with tmin < t < tmax. o and the triangle's corners are float32. d is a sum of two
float64: a float32 direction, or the exact difference of a light sample and a receiver. A ray meets a triangle if its
*line* meets the closed triangle, including edges and vertices, and the t of that point lies strictly inside the
interval. For segments this is the real t, and for rays the reported t, rounded to the nearest float64. A line in the
triangle's own plane does not meet it, so a triangle without area never blocks.

With the corners a, b, c relative to o and the triangle's normal n, the signs of 3 x 3 determinants decide:

    e0 = det(d, b, c)   e1 = det(d, c, a)   e2 = det(d, a, b)        e0 + e1 + e2 = d . n

    t = det(a, b, c) / (d . n)

The line meets the triangle if all e >= 0 or all e <= 0, and not all are zero. The signs are exact, so triangles that
share an edge or a vertex agree on which side of it a line passes: closed meshes cannot leak.

Here and in `filters`, `corners` is an (n, 9) float32 array or a pointer to its first number (`simd.ptr`). Hot kernels
prefer the pointer, since passing an array costs a reference count.

Expansions. Exact signs are computed by expansion arithmetic [Shewchuk 1997, "Adaptive precision floating-point
arithmetic"]. An expansion is an unevaluated sum of non-overlapping float64 numbers, smallest first. All inputs are
float32 coordinates, so no product of up to four of them leaves float64's range, and every step below is exact.

This code runs only for the few triangles that `filters` cannot decide, but it is part of every kernel that uses them.
Each function has one call site, which keeps the code short for LLVM; otherwise it would take two thirds of the time to
compile kernels.

Expansions, vectors and products are pointers to float64 (`simd.stack_f64`).
"""

from typing import NamedTuple

import numpy as np

from ..jit import F64Ptr, inlined, kernel
from ..simd import get, put, stack_f64

# --- Expansion arithmetic [Shewchuk 1997] -----------------------------------------------------------------------------


PRODUCT = 64  # float64 numbers in the product of a scale and three two-part factors
CAPACITY = 18 * PRODUCT  # components of an expansion: three determinants of 6 products
_SPLITTER = np.float64(134217729.0)  # 2**27 + 1


@kernel
def two_diff(a, b):
    """(hi, lo): hi = fl(a - b) and hi + lo == a - b exactly."""
    hi = a - b
    virtual = a - hi
    return hi, (a - (hi + virtual)) + (virtual - b)


@kernel
def two_product(a, b):
    """(hi, lo): hi = fl(a * b) and hi + lo == a * b exactly (Dekker's split; no fused multiply-add needed)."""
    hi = a * b
    c = _SPLITTER * a
    a1 = c - (c - a)
    a2 = a - a1
    c = _SPLITTER * b
    b1 = c - (c - b)
    b2 = b - b1
    return hi, a2 * b2 - (((hi - a1 * b1) - a2 * b1) - a1 * b2)


@kernel
def grow(sum_, n, x):
    """Add the number x to the expansion of n components in place, drop zeros, and return the new length."""
    m = 0
    for i in range(n):
        y = get(sum_, i)
        s = x + y
        virtual = s - x
        low = (x - (s - virtual)) + (y - virtual)
        if low != 0.0:
            put(sum_, m, low)
            m += 1
        x = s
    if x != 0.0:
        put(sum_, m, x)
        m += 1
    return m


@kernel
def _multiply(product, n, hi, lo):
    """Multiply a sum of n numbers by hi + lo in place, and return the new length."""
    step = 2 if lo == 0.0 else 4
    for i in range(n - 1, -1, -1):
        x, at = get(product, i), step * i
        for half in range(0, step, 2):
            p1, p0 = two_product(x, hi if half == 0 else lo)
            put(product, at + half, p0)
            put(product, at + half + 1, p1)
    return step * n


@kernel
def add_determinant(sum_, n, rows, product, scale):
    """Add scale * det(rows) to the expansion, and return the new length.

    rows : three vectors, each of three sums hi + lo
    product : scratch memory of PRODUCT numbers
    """
    for term in range(6):
        i, odd = term % 3, term // 3
        j = (i + 1 + odd) % 3
        put(product, 0, -scale if odd else scale)
        m = 1
        for row in range(3):
            at = 6 * row + 2 * (i if row == 0 else j if row == 1 else 3 - i - j)
            m = _multiply(product, m, get(rows, at), get(rows, at + 1))
        for k in range(m):
            x = get(product, k)
            if x != 0.0:  # three of four are zero for float32 factors
                n = grow(sum_, n, x)
    return n


@kernel
def sign_of(sum_, n):
    """Sign of an expansion: -1, 0 or 1. The last component is the largest and decides the sign."""
    if n == 0:
        return 0
    return 1 if get(sum_, n - 1) > 0.0 else -1


@kernel
def value_of(sum_, n):
    """The expansion rounded to float64, within one unit in the last place."""
    total = 0.0
    for i in range(n):
        total += get(sum_, i)
    return total


# --- The predicate ----------------------------------------------------------------------------------------------------


class Ray(NamedTuple):
    """One ray in float64, equal to the float32 input. All fields are float64 scalars."""

    ox: np.float64  # origin
    oy: np.float64
    oz: np.float64
    dx: np.float64  # direction, leading part
    dy: np.float64
    dz: np.float64
    rx: np.float64  # direction, exact remainder (zero for a float32 direction)
    ry: np.float64
    rz: np.float64
    tmin: np.float64
    tmax: np.float64
    real: np.float64  # 1: tmin and tmax bound the real t, for segments; 0: they bound t rounded to float64


@inlined
def ray_along(ox, oy, oz, dx, dy, dz, tmin, tmax):
    """The ray of a float32 origin and direction, with the open interval (tmin, tmax) in lengths of the direction."""
    f = np.float64
    return Ray(f(ox), f(oy), f(oz), f(dx), f(dy), f(dz), 0.0, 0.0, 0.0, f(tmin), f(tmax), 0.0)


@inlined
def segment(ox, oy, oz, lx, ly, lz):
    """The ray from the float32 point o to the float32 point l, excluding both ends."""
    f = np.float64
    dx, rx = two_diff(f(lx), f(ox))
    dy, ry = two_diff(f(ly), f(oy))
    dz, rz = two_diff(f(lz), f(oz))
    return Ray(f(ox), f(oy), f(oz), dx, dy, dz, rx, ry, rz, 0.0, 1.0, 1.0)


class ExpansionMemory(NamedTuple):
    """Scratch memory for exact arithmetic."""

    sum_: F64Ptr  # an expansion of up to CAPACITY components
    rows: F64Ptr  # three vectors, each of three sums hi + lo
    product: F64Ptr  # PRODUCT numbers


# Kinds of determinants for `_add`; row k belongs to corner (kind + k) % 3. These constants and the length of an empty
# expansion are NumPy integers, because Numba would compile a callee anew for each literal.
_EDGE, _VOLUME, _NORMAL = np.arange(0, 9, 3)
_EMPTY = np.int64(0)

_SMALL, _LARGE = np.float64(2.0**-400), np.float64(2.0**400)  # the product of such a t with D stays in float64's range
_NEXT = np.float64(2.0**-53 * (1.0 + 2.0**-52))  # x + |x| times this is the next float64
_SURE = np.float64(1.0 - 2.0**-40)


@kernel
def set_direction(rows, ray):
    """Set row 0 to the ray's direction."""
    put(rows, 0, ray.dx)
    put(rows, 1, ray.rx)
    put(rows, 2, ray.dy)
    put(rows, 3, ray.ry)
    put(rows, 4, ray.dz)
    put(rows, 5, ray.rz)


@kernel
def set_difference(rows, row, p, corners, at):
    """Set a row to corner - p, exactly."""
    for axis in range(3):
        hi, lo = two_diff(np.float64(get(corners, at + axis)), p[axis])
        put(rows, 6 * row + 2 * axis, hi)
        put(rows, 6 * row + 2 * axis + 1, lo)


@kernel
def _add(work, n, ray, corners, i, what, scale):
    """Add `scale` times a determinant to the sum, and return the new length.

    what : _EDGE + k for e_k, _VOLUME for det(a, b, c), _NORMAL for d . n = det(d, v1 - v0, v2 - v0)
    """
    f, k = np.float64, 9 * i
    p = ray.ox, ray.oy, ray.oz
    if what == _NORMAL:
        p = f(get(corners, k)), f(get(corners, k + 1)), f(get(corners, k + 2))
    for row in range(3):
        if row == 0 and what != _VOLUME:
            set_direction(work.rows, ray)
        else:
            set_difference(work.rows, row, p, corners, k + 3 * ((what + row) % 3))
    return add_determinant(work.sum_, n, work.rows, work.product, scale)


@kernel
def edge_sign(work, ray, corners, i, edge):
    """The sign of e_k for k = `edge`."""
    return sign_of(work.sum_, _add(work, _EMPTY, ray, corners, i, _EDGE + edge, 1.0))


@kernel
def exact_line_side(ray, corners, i):
    """Sign of d . n if the line meets triangle i, else 0."""
    work = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT))
    side = 0
    for edge in range(3):
        s = edge_sign(work, ray, corners, i, edge)
        if s * side < 0:
            return 0
        if s != 0:
            side = s
    return side


@inlined
def _is_end(ray, corners, at):
    """Whether a corner is the ray's origin, or its point at t = 1."""
    x, y, z = (np.float64(get(corners, at)), np.float64(get(corners, at + 1)), np.float64(get(corners, at + 2)))
    (dx, rx), (dy, ry), (dz, rz) = two_diff(x, ray.ox), two_diff(y, ray.oy), two_diff(z, ray.oz)
    begin = dx == 0.0 and dy == 0.0 and dz == 0.0
    end = dx == ray.dx and dy == ray.dy and dz == ray.dz and rx == ray.rx and ry == ray.ry and rz == ray.rz
    return begin or (end and ray.tmax == 1.0)


@inlined
def _in_plane(o, d, r, corners, at):
    """Whether a triangle and a ray have one common, constant coordinate on an axis."""
    x = get(corners, at)
    return d == 0.0 and r == 0.0 and x == o and get(corners, at + 3) == x and get(corners, at + 6) == x


@inlined
def trivially_misses(ray, corners, i):
    """Whether a ray misses triangle i for one of the two simple reasons that are the most common in scenes.

    A corner is an end of the ray: the line meets the triangle's plane there, outside the open interval, or lies in it.
    Or the triangle and the ray lie in the same axis-aligned plane.
    """
    k = 9 * i
    ends = _is_end(ray, corners, k) or _is_end(ray, corners, k + 3) or _is_end(ray, corners, k + 6)
    return (
        ends
        or _in_plane(ray.ox, ray.dx, ray.rx, corners, k)
        or _in_plane(ray.oy, ray.dy, ray.ry, corners, k + 1)
        or _in_plane(ray.oz, ray.dz, ray.rz, corners, k + 2)
    )


_WIDEN = np.float64(2.0**-48)  # more than the relative error of a quotient, and of t rounded to float64
_NEVER = np.float64(np.inf), np.float64(-np.inf)  # an empty interval of t


@inlined
def _narrowed(near, far, o, d, corners, at):
    """The interval (near, far) of t, narrowed to a triangle's bounds along an axis. Empty: near > far."""
    a, b, c = np.float64(get(corners, at)), np.float64(get(corners, at + 3)), np.float64(get(corners, at + 6))
    low, high = min(a, min(b, c)) - o, max(a, max(b, c)) - o
    if d == 0.0:  # exact, as the signs of `low` and `high` are
        return (near, far) if low <= 0.0 and high >= 0.0 else _NEVER
    first, last = (low / d, high / d) if d > 0.0 else (high / d, low / d)
    return max(near, first - abs(first) * _WIDEN), min(far, last + abs(last) * _WIDEN)


@inlined
def misses_bounds(ray, corners, i):
    """Whether a ray surely misses the bounds of triangle i. This takes float64 divisions, and no exact arithmetic."""
    k = 9 * i
    near, far = _narrowed(ray.tmin, ray.tmax, ray.ox, ray.dx, corners, k)
    near, far = _narrowed(near, far, ray.oy, ray.dy, corners, k + 1)
    near, far = _narrowed(near, far, ray.oz, ray.dz, corners, k + 2)
    return near > far


@kernel
def _set_t_difference(work, ray, corners, i, t, t_low):
    """Set the sum to T - (t + t_low) D, and return its length. Its sign, times that of D, shows which t is smaller."""
    n = _EMPTY
    for step in range(3):
        scale = 1.0 if step == 0 else -t if step == 1 else -t_low
        if scale != 0.0:
            n = _add(work, n, ray, corners, i, _VOLUME if step == 0 else _NORMAL, scale)
    return n


@kernel
def exact_meets(ray, corners, i):
    """Sign of d . n if the ray meets triangle i inside its open interval, else 0."""
    if trivially_misses(ray, corners, i):
        return 0
    side = exact_line_side(ray, corners, i)
    if side == 0:
        return 0
    if ray.real == 0.0:
        t = exact_t(ray, corners, i)
        return side if ray.tmin < t and t < ray.tmax else 0
    work = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT))
    for end in range(2):
        t, sign = (ray.tmin, 1) if end == 0 else (ray.tmax, -1)
        if sign * sign_of(work.sum_, _set_t_difference(work, ray, corners, i, t, 0.0)) * side <= 0:
            return 0
    return side


@kernel
def exact_t(ray, corners, i):
    """t where the line meets the plane of triangle i, rounded to the nearest float64, with ties to even."""
    work = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT))
    normal = value_of(work.sum_, _add(work, _EMPTY, ray, corners, i, _NORMAL, 1.0))
    t, remainder = np.float64(0.0), np.float64(0.0)
    for _ in range(2):  # the first remainder is the quotient, the second its error
        t += remainder
        remainder = value_of(work.sum_, _set_t_difference(work, ray, corners, i, t, 0.0)) / normal
    if not (abs(t) > _SMALL and abs(t) < _LARGE):
        return t
    # Eq. (16) of docs/design/exactness.md
    nearest = t + remainder
    excess = remainder - (nearest - t)
    other = nearest + abs(nearest) * (_NEXT if excess > 0.0 else -_NEXT)
    gap = (other - nearest) / 2.0
    if abs(excess) <= abs(gap) * _SURE:
        return nearest
    beyond = sign_of(work.sum_, _set_t_difference(work, ray, corners, i, nearest, gap)) * normal * gap
    return nearest + gap if beyond == 0.0 else other if beyond > 0.0 else nearest


@kernel
def exact_weights(ray, corners, i):
    """Weights of the second and third corner where the line meets triangle i, accurate to float64's last digits."""
    work = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT))
    second = third = total = np.float64(0.0)
    for edge in range(3):
        value = value_of(work.sum_, _add(work, _EMPTY, ray, corners, i, _EDGE + edge, 1.0))
        second, third, total = value if edge == 1 else second, value if edge == 2 else third, total + value
    return second / total, third / total


@kernel
def exact_has_area(corners, i):
    """Whether triangle i has an area: whether a component of its normal is nonzero."""
    work = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT))
    for axis in range(3):
        x, y, z = np.float64(axis == 0), np.float64(axis == 1), np.float64(axis == 2)
        ray = ray_along(0.0, 0.0, 0.0, x, y, z, 0.0, 0.0)
        if sign_of(work.sum_, _add(work, _EMPTY, ray, corners, i, _NORMAL, 1.0)) != 0:
            return True
    return False


@kernel
def exact_plane_side(x, y, z, corners, i):
    """The side of triangle i's plane that a point is on: 1 if the normal points there, -1 behind, 0 on the plane.

    A triangle without area has no plane: the side is 0 everywhere.
    """
    work = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT))
    ray = ray_along(x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0)
    return -sign_of(work.sum_, _add(work, _EMPTY, ray, corners, i, _VOLUME, 1.0))


@kernel
def exact_touches(x, y, z, corners, i):
    """Whether a float32 point is on the closed triangle i. A triangle without area holds no point."""
    if exact_plane_side(x, y, z, corners, i) != 0:
        return False
    for axis in range(3):  # the line along at least one axis is not in the triangle's plane
        dx, dy, dz = np.float64(axis == 0), np.float64(axis == 1), np.float64(axis == 2)
        if exact_line_side(ray_along(x, y, z, dx, dy, dz, 0.0, 0.0), corners, i) != 0:
            return True
    return False
