"""Sixteen rays side by side, with the numbers that box and triangle tests need, computed once for all sixteen.

A *block* is scratch memory of 20 rows of 16 float32, with a column for each ray. The caller fills origins, directions,
tmin and tmax, rounded to nearest. `prepare` fills the rest. A ray reaches a plane x = c at t = c * inverse + offset, in
one instruction. Its error is absolute: a share of the largest coordinate in play. So the offsets move the planes
outwards by more than this error, both where a ray enters and where it leaves. docs/design/wide.md has the proof.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.fields import F32Ptr, F64Ptr, I32Ptr
from ...kernels.jit import inlined
from ...kernels.predicate.exact import Ray, ray_along
from ...kernels.predicate.vector_filters import FilterRays, error_unit
from ...kernels.simd import absolute, broadcast8, get, load16, lowest_bit, maximum, ptr_at, select, splat16, store

LANES = 16
BLOCKS = 4  # blocks that lie one after the other
OX, OY, OZ, DX, DY, DZ, TMIN, TMAX = (LANES * k for k in range(8))  # filled by the caller
INVERSE, NEAR, FAR = 8 * LANES, 11 * LANES, 14 * LANES  # three rows each: x, y, z
LIMIT, UNIT, FLOOR = 17 * LANES, 18 * LANES, 19 * LANES
BLOCK_WORDS = 20 * LANES
ENDS, WAY, REST = 0, 2 * LANES, 5 * LANES  # float64 rows of `RayBlock.precise`: tmin, tmax; three rows each: x, y, z
PRECISE_WORDS = 8 * LANES

_SMALL, LARGE = np.float32(2.0**-40), np.float32(2.0**40)
_ALONG = np.float32(2.0**-40)  # a direction's component below this share of the largest one counts as this share
_PAD = np.float32(2.0**-20)  # planes are moved outwards by this share of the largest coordinate in play
_INF = np.float32(np.inf)


class RayBlock(NamedTuple):
    """A block of rays: pointers to scratch memory."""

    rows: F32Ptr  # float32 *, BLOCK_WORDS
    precise: F64Ptr  # float64 *, PRECISE_WORDS: tmin and tmax; for segments also the direction and its remainder
    skip: I32Ptr  # int32 *, 16: a triangle index that does not count, or -1
    segments: bool  # the rays are segments between float32 points; False: the float32 direction is exact


@inlined
def block_of(rays, j):
    """Block j of a `RayBlock` that holds several blocks, one after the other."""
    rows, precise = ptr_at(rays.rows, j * BLOCK_WORDS), ptr_at(rays.precise, j * PRECISE_WORDS)
    return RayBlock(rows, precise, ptr_at(rays.skip, j * LANES), rays.segments)


@inlined
def first_block(rays):
    """The block of the first of some rays (bits) of several blocks."""
    return lowest_bit(rays) // LANES


@inlined
def rays_of_block(j):
    """Bits of the rays of block j among several blocks."""
    return np.int64((1 << LANES) - 1) << (j * LANES)


@inlined
def rays_in(rays, j):
    """Those of some rays (bits) of several blocks that are in block j, as bits of this block."""
    return (rays >> (j * LANES)) & ((1 << LANES) - 1)


@inlined
def ray_of(rays, i):
    """Ray i in float64."""
    f, b, p = np.float64, rays.rows, rays.precise
    ox, oy, oz, tmin, tmax = get(b, OX + i), get(b, OY + i), get(b, OZ + i), get(p, ENDS + i), get(p, ENDS + LANES + i)
    if not rays.segments:
        return ray_along(ox, oy, oz, get(b, DX + i), get(b, DY + i), get(b, DZ + i), tmin, tmax)
    return Ray(
        f(ox), f(oy), f(oz), get(p, WAY + i), get(p, WAY + LANES + i), get(p, WAY + 2 * LANES + i),
        get(p, REST + i), get(p, REST + LANES + i), get(p, REST + 2 * LANES + i), tmin, tmax, 1.0,
    )  # fmt: skip


@inlined
def prepare(block, tree_reach):
    """Fill the rows from INVERSE on. Rays too long, short or far for float32's range enter every box."""
    ox, oy, oz = load16(block, OX), load16(block, OY), load16(block, OZ)
    dx, dy, dz = load16(block, DX), load16(block, DY), load16(block, DZ)
    largest = maximum(maximum(absolute(dx), absolute(dy)), absolute(dz))
    reach = maximum(maximum(maximum(absolute(ox), absolute(oy)), absolute(oz)), splat16(tree_reach))
    tame = (largest > _SMALL) & (largest < LARGE) & (reach > _SMALL) & (reach < LARGE)
    along, pad = largest * _ALONG, reach * _PAD
    for k in range(3):
        o, d = load16(block, OX + LANES * k), load16(block, DX + LANES * k)
        steep = select(absolute(d) > along, d, along)
        inverse = splat16(np.float32(1.0)) / steep
        offset, grow = -(o * inverse), pad * absolute(inverse)
        store(block, INVERSE + LANES * k, select(tame, inverse, np.float32(0.0)))
        store(block, NEAR + LANES * k, select(tame, offset - grow, -_INF))
        store(block, FAR + LANES * k, select(tame, offset + grow, _INF))
    unit, floor = error_unit(tame, dx, dy, dz, reach)
    store(block, UNIT, unit)
    store(block, FLOOR, floor)
    store(block, LIMIT, load16(block, TMAX))


@inlined
def filter_ray8(block, lane):
    """`FilterRays` of one ray of a block, in eight lanes; its tmax is the limit of the search."""
    b = lane
    return FilterRays(
        broadcast8(block, OX + b), broadcast8(block, OY + b), broadcast8(block, OZ + b),
        broadcast8(block, DX + b), broadcast8(block, DY + b), broadcast8(block, DZ + b),
        broadcast8(block, TMIN + b), broadcast8(block, LIMIT + b), broadcast8(block, UNIT + b),
        broadcast8(block, FLOOR + b),
    )  # fmt: skip


@inlined
def filter_rays16(block):
    """`FilterRays` of all rays of a block."""
    return FilterRays(
        load16(block, OX), load16(block, OY), load16(block, OZ), load16(block, DX), load16(block, DY),
        load16(block, DZ), load16(block, TMIN), load16(block, LIMIT), load16(block, UNIT), load16(block, FLOOR),
    )  # fmt: skip
