"""A block of triangles against the frusta and pixels of a tile of primary rays.

`pixelsetup` writes the block's edge functions and depth keys. They are linear over the tile, and lanes are the 16
triangles. With the same lanes the block is culled against cells, halves of frusta. A linear function over a frustum is
largest at a corner [Benthin and Wald 2009, Sec. 4.2]. The triangles left are tested one by one, and lanes are then a
cell's 16 pixels.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.links import block_leaf, slot_at
from ...kernels.fields import F32Ptr, I32Ptr
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
    bits,
    broadcast16,
    fma,
    get,
    iota16,
    load16,
    lowest_bit,
    minimum,
    popcount,
    prefetch,
    put,
    reduce_min,
    select,
    splat16,
    store,
    to_f32,
)
from ...kernels.vec import broadcasts
from ..counters import CANDIDATES, TRIANGLE_TESTS, TRIANGLES, count
from .pixelsetup import BOX, EDGES, KEY, KEY_ERROR, TOPS, set_up_block

_F = np.float32
CELLS = 32  # cells of 4 x 4 pixels in a tile: cell f is the left half of frustum f, cell 16 + f the right half
PIXELS = 16 * CELLS
DEFERRED = 2 + 2 * 16 * PIXELS  # int32: a block leaves at most 16 triangles for each pixel


class Pixels(NamedTuple):
    """Pointers to the state of a tile's pixels, see `pixelstate`: cell c has elements 16 c to 16 c + 15."""

    low: F32Ptr  # float32: lower bound of the visible triangle's depth key; -inf if none, inf beyond the picture
    high: F32Ptr  # float32: upper bound of the depth key; -inf if there is no triangle
    slot: I32Ptr  # int32: the triangle's slot in the current tree; NOTHING, or KNOWN
    least: F32Ptr  # (CELLS,) float32: the least `low` of each cell
    far: F32Ptr  # (16,) float32: t beyond which nothing is visible in each frustum
    part: I32Ptr  # int32: for KNOWN, the number of the triangle's tree; -1: see the picture
    kept: I32Ptr  # int32: for KNOWN, the triangle's slot in that tree
    deferred: I32Ptr  # int32: number of deferred pixels, an unused word; then slot, 2 * pixel + (1 if surely covered)


@inlined
def first_pixel(cell):
    """(x, y) of the first pixel of a cell, in the tile."""
    return 8 * (cell & 3) + (cell >> 2 & 4), cell & 12


@inlined
def _over(work, edge, top, x, y):
    """Largest value of a linear function over a cell whose first pixel is (x, y), lanes = triangles."""
    return fma(load16(work, edge), x, fma(load16(work, edge + 16), y, load16(work, top)))


@inlined
def cull_cell(work, left, fx, fy, least):
    """Bits of the triangles of `left` that some pixel of the cell with first pixel (fx, fy) may see."""
    x, y, end_x, end_y = splat16(fx), splat16(fy), splat16(fx + _F(3.0)), splat16(fy + _F(3.0))
    inside = (load16(work, BOX) <= end_x) & (load16(work, BOX + 16) >= x)
    inside &= (load16(work, BOX + 32) <= end_y) & (load16(work, BOX + 48) >= y)
    edges = minimum(_over(work, EDGES, TOPS, x, y), _over(work, EDGES + 48, TOPS + 16, x, y))
    edges = minimum(edges, _over(work, EDGES + 96, TOPS + 32, x, y))
    inside &= (edges >= _F(-2.0)) & (_over(work, KEY, TOPS + 48, x, y) >= least)
    return bits(inside) & left


@inlined
def _value(work, at, i, x, y):
    """A linear function of triangle i at 16 pixels."""
    c = broadcasts(work, at + i, 16)
    return fma(x, c.x, fma(y, c.y, c.z))


@inlined
def defer(deferred, slot, cell, unsure, sure):
    """Defer the pixels of a cell in `unsure` (bits), in which a triangle may be in front."""
    n = np.int64(get(deferred, 0))
    while unsure != 0:
        lane = lowest_bit(unsure)
        unsure &= unsure - 1
        put(deferred, 2 + 2 * n, slot)
        put(deferred, 3 + 2 * n, 2 * (16 * cell + lane) + (sure >> lane & 1))
        n += 1
    put(deferred, 0, n)


@inlined
def _test_cell(work, tree, block, tests, x, y, pixels, cell):
    """Test triangles (bits) against the pixels of a cell. Return bits of triangles that some pixel saw for a while."""
    at, winners = 16 * cell, np.int64(0)
    low, high, slot = load16(pixels.low, at), load16(pixels.high, at), load16(pixels.slot, at)
    while tests != 0:
        i = lowest_bit(tests)
        tests &= tests - 1
        inside = minimum(_value(work, EDGES, i, x, y), _value(work, EDGES + 48, i, x, y))
        inside = minimum(inside, _value(work, EDGES + 96, i, x, y))
        key, error = _value(work, KEY, i, x, y), broadcast16(work, KEY_ERROR + i)
        key_low, key_high, covers = key - error, key + error, inside > _F(1.0)
        candidate = (inside >= _F(-1.0)) & (key_high >= low)
        wins = candidate & covers & (key_low > high)
        unsure = bits(candidate & ~wins)
        if unsure != 0:
            defer(pixels.deferred, get(tree.slots, slot_at(block, i)), cell, unsure, bits(covers))
        low, high = select(wins, key_low, low), select(wins, key_high, high)
        slot = select(wins, broadcast16(tree.slots, slot_at(block, i)), slot)
        winners |= np.int64(bits(wins) != 0) << i
    if winners != 0:
        store(pixels.low, at, low)
        store(pixels.high, at, high)
        store(pixels.slot, at, slot)
        put(pixels.least, cell, reduce_min(low))
    return winners


@kernel
def trace_block(frame, tree, link, frusta, pixels, work, counters):
    """Test a block against some frusta (bits) of a tile. Return whether some pixel sees one of its triangles."""
    (block, triangles), winners, tested = block_leaf(link), np.int64(0), np.int64(0)
    left = set_up_block(frame, tree, block, triangles, work)
    count(counters, TRIANGLES, triangles)
    if left == 0:
        return False
    across, down = to_f32(iota16() & 3), to_f32(iota16() >> 2)
    while frusta != 0:
        f = lowest_bit(frusta)
        frusta &= frusta - 1
        for cell in (f, f + 16):
            x, y = first_pixel(cell)
            x, y = _F(x), _F(y)
            tests = cull_cell(work, left, x, y, get(pixels.least, cell))
            if tests != 0:
                tested |= tests
                count(counters, TRIANGLE_TESTS, popcount(tests))
                winners |= _test_cell(work, tree, block, tests, across + x, down + y, pixels, cell)
    count(counters, CANDIDATES, popcount(tested))
    seen = winners != 0
    while winners != 0:  # prefetch the corners for the float64 t
        slot = np.int64(get(tree.slots, slot_at(block, lowest_bit(winners))))
        winners &= winners - 1
        prefetch(tree.corners, 9 * slot)
        prefetch(tree.corners, 9 * slot + 8)
        prefetch(tree.prim_ids, slot)
    return seen
