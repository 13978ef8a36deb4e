"""Morton codes of triangles: the interleaved bits of a centroid's cell on x, y and z [Lauterbach et al. 2009].

A code has 10 bits for each axis in an int32, or 21 in an int64. Cells are cubes, so a flat scene is not cut across its
short side before its long sides.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items
from ..kernels.simd import extract, load4, maximum, minimum, ptr, put, to_i32
from .bounds import double_centroid_of

_TEN = np.int32(1023)


class Grid(NamedTuple):
    """Maps twice a centroid to its cell: truncate((c - origin) * factor)."""

    origin: np.ndarray  # (4,) float32
    factor: np.float32  # 0 where all centroids are (nearly) the same
    last: np.int32  # the last cell on each axis


def grid_of(centroids, bits: int) -> Grid:
    """The grid over a centroid box, with 2 ** bits cubes along its longest side."""
    lower, upper = centroids[:4], -centroids[4:]
    with np.errstate(over="ignore", divide="ignore"):
        factor = np.float32(2**bits) / (upper - lower)[:3].max()
    return Grid(lower.copy(), factor if np.isfinite(factor) else np.float32(0.0), np.int32(2**bits - 1))


@inlined
def _interleave(cells):
    """The lowest ten bits of each of three lanes, interleaved: 30 bits."""
    x = cells & _TEN
    x = (x | (x << 16)) & 0x030000FF
    x = (x | (x << 8)) & 0x0300F00F
    x = (x | (x << 4)) & 0x030C30C3
    x = (x | (x << 2)) & 0x09249249
    return np.int64(extract(x, 0) << 2 | extract(x, 1) << 1 | extract(x, 2))


@inlined
def _code(cells, last):
    """The code of a cell: 30 bits, or 63 if cells have more than ten bits on each axis."""
    code = _interleave(cells)
    if last > _TEN:
        code |= _interleave(cells >> 10) << 30 | _interleave(cells >> 20) << 60
    return code


@kernel
def write_codes(ticket, vertices, grid, codes, ids):
    """Worker: write the code of each triangle, and its index."""
    v, out, out_ids = ptr(vertices), ptr(codes), ptr(ids)
    origin, factor, last = load4(grid.origin, 0), grid.factor, grid.last
    for i in items(ticket):
        cells = to_i32((double_centroid_of(v, i) - origin) * factor)
        put(out, i, _code(minimum(maximum(cells, np.int32(0)), last), last))
        put(out_ids, i, i)
