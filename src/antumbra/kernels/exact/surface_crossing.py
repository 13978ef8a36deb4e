"""Whether a ray that meets a triangle crosses the surface there, so that common edges and vertices count once.

By the contract, edges and vertices belong to a triangle, so a ray through an edge meets both triangles beside it. To
count surfaces instead of triangles, the ray is displaced infinitesimally [Edelsbrunner and Muecke 1990, "Simulation of
simplicity"]: it then meets no edge and no vertex. Through a surface that goes on behind an edge it crosses one of the
two triangles, and at the rim of a body it crosses both or none. Only the coordinates decide, in exact arithmetic, so
neither the order of triangles nor their neighbours matter, and soups with equal corners work like meshes.

The direction d becomes d + x + y + z and the origin o becomes o + x' + y' + z', along the axes, where each
displacement is infinitely smaller than the one before. A determinant e = det(d, b, c) of `predicate` that is 0 has the
sign of the first of these numbers that is not:

    det(x, b, c)   det(y, b, c)   det(z, b, c)   det(d, x', b - c)   det(d, y', b - c)   det(d, z', b - c)

All are 0 only if the ray lies along the edge, and thus in the triangle's plane. Such a ray meets no triangle.
"""

import numpy as np

from ..jit import kernel
from ..simd import get, put, stack_f64
from .filters import UNSURE, line_verdict, volumes64
from .predicate import (
    CAPACITY,
    PRODUCT,
    ExpansionMemory,
    add_determinant,
    edge_sign,
    ray_along,
    set_difference,
    set_direction,
    sign_of,
)

_EMPTY = np.int64(0)  # the length of an empty expansion


@kernel
def _set_axis(rows, row, axis):
    """Set a row to the unit vector of an axis."""
    for k in range(6):
        put(rows, 6 * row + k, np.float64(k == 2 * axis))


@kernel
def _turned_sign(work, ray, corners, i, edge):
    """The sign of e_k after the direction is displaced from 0; 0 if the origin is on the edge's line."""
    for axis in range(3):
        x, y, z = np.float64(axis == 0), np.float64(axis == 1), np.float64(axis == 2)
        turned = ray_along(ray.ox, ray.oy, ray.oz, x, y, z, ray.tmin, ray.tmax)
        sign = edge_sign(work, turned, corners, i, edge)
        if sign != 0:
            return sign
    return 0


@kernel
def _shifted_sign(work, ray, corners, i, edge):
    """The sign of e_k after the origin is displaced; 0 if the ray lies along the edge."""
    b, c = 9 * i + 3 * ((edge + 1) % 3), 9 * i + 3 * ((edge + 2) % 3)
    p = np.float64(get(corners, c)), np.float64(get(corners, c + 1)), np.float64(get(corners, c + 2))
    for axis in range(3):
        set_direction(work.rows, ray)
        _set_axis(work.rows, np.int64(1), axis)
        set_difference(work.rows, np.int64(2), p, corners, b)
        sign = sign_of(work.sum_, add_determinant(work.sum_, _EMPTY, work.rows, work.product, 1.0))
        if sign != 0:
            return sign
    return 0


@kernel
def _crosses_exactly(ray, corners, i):
    """`crosses_surface` by exact arithmetic. Not inlined, because it is rarely needed."""
    work, side = ExpansionMemory(stack_f64(CAPACITY), stack_f64(18), stack_f64(PRODUCT)), 0
    for edge in range(3):
        sign = edge_sign(work, ray, corners, i, edge)
        if sign == 0:
            sign = _turned_sign(work, ray, corners, i, edge)
        if sign == 0:
            sign = _shifted_sign(work, ray, corners, i, edge)
        if sign * side < 0 or sign == 0:
            return False
        side = sign
    return True


@kernel
def crosses_surface(ray, corners, i):
    """Whether a ray that meets triangle i still meets it after an infinitesimal displacement."""
    return line_verdict(volumes64(ray, corners, i)) != UNSURE or _crosses_exactly(ray, corners, i)
