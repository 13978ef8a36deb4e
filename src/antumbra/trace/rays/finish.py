"""What sixteen rays report of their nearest hits: t and weights. LLVM computes them side by side."""

from typing import NamedTuple

import numpy as np

from ...kernels.fields import F32Ptr, F64Ptr
from ...kernels.jit import inlined
from ...kernels.predicate.hits import UNKNOWN, are_differences, quick_t, quick_weights, rounded_t, share, single_weights
from ...kernels.simd import get, put
from .rayblock import DX, LANES, OX, ray_of
from .wide import slot_of

CORNER_WORDS = 9 * LANES
REPORT_WORDS = 3 * LANES
_T, _U, _V = 0, LANES, 2 * LANES


class Report(NamedTuple):
    """Pointers to scratch memory."""

    corners: F32Ptr  # float32 *, CORNER_WORDS: rows of 16, the corners of the triangle that each ray meets
    numbers: F64Ptr  # float64 *, REPORT_WORDS: rows of 16: t, u, v, or UNKNOWN for t or u


@inlined
def _vector(rows, at):
    f = np.float64
    return f(get(rows, at)), f(get(rows, at + LANES)), f(get(rows, at + 2 * LANES))


@inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _fill(rows, report):
    """Compute the numbers of all sixteen rays. LLVM vectorises this."""
    corners, out = report.corners, report.numbers
    for i in range(LANES):
        o, d = _vector(rows, OX + i), _vector(rows, DX + i)
        v0, v1, v2 = _vector(corners, i), _vector(corners, 3 * LANES + i), _vector(corners, 6 * LANES + i)
        a, p, q = _minus(v0, o), _minus(v1, v0), _minus(v2, v0)
        t, (u, v) = quick_t(d, a, p, q), quick_weights(d, a, p, q)
        put(out, _T + i, t if are_differences(o, v0, v1, v2, a, p, q) else UNKNOWN)
        put(out, _U + i, u)
        put(out, _V + i, v)


@inlined
def _write(tree, rays, found, i, report, out, at):
    """Write the nearest hit of ray i of a block to element `at` of the arrays."""
    slot, numbers = slot_of(tree, found, i), report.numbers
    if slot < 0:
        out.face[at], out.t[at], out.u[at], out.v[at] = -1, np.inf, 0.0, 0.0
        return
    t, u, v = get(numbers, _T + i), share(get(numbers, _U + i)), share(get(numbers, _V + i))
    if t == UNKNOWN:
        t = rounded_t(ray_of(rays, i), tree.corners, slot)
    if get(numbers, _U + i) == UNKNOWN:
        u, v = single_weights(ray_of(rays, i), tree.corners, slot)
    out.face[at], out.t[at], out.u[at], out.v[at] = get(found.prim, i), t, u, v


@inlined
def write_nearest(tree, rays, found, n, report, out, first):
    """Write the nearest hits of the first n rays of a block from element `first` of the arrays on."""
    for i in range(n):
        slot = slot_of(tree, found, i)
        at = 9 * (slot if slot >= 0 else np.int64(0))
        for k in range(9):
            put(report.corners, LANES * k + i, get(tree.corners, at + k))
    _fill(rays.rows, report)
    for i in range(n):
        _write(tree, rays, found, i, report, out, first + i)
