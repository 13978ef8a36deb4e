"""Tests of a block of triangles against a tile of primary rays: setup in pixel coordinates, then cells and pixels.

Setup. As in the rasteriser (`query.raster_setup`), a vector from the eye has pixel coordinates (x, y, z) relative to
the tile's first pixel. The ray of the tile's pixel (i, j) is g = (i, j, 1), apart from the rounding of its direction.
With a = v0 - eye and the edges p and q, the edge functions and the depth key 1 / t are linear over the tile:

    e1 = g . (q x a)    e2 = g . (a x p)    e0 = D - e1 - e2    D = g . (p x q)    1 / t = D / (a . (p x q))

So they are set up once per block and tile, with 16 triangles as lanes.

Errors. Let u = 2**-24. Let n and m be the largest sums of magnitudes in the rows (x, y) and z of the matrix to pixel
coordinates.

- The entries of the matrix, a, p and q are rounded once, and products are summed by fma. If no component of a vector
  exceeds r, the errors of its x and y are at most 6 u n r, and that of its z at most 6 u m r.
- Let A be the largest |x| or |y| of a plus 32 times its |z|, and dA the error of A. Let P and dP be the same for p and
  q. The errors of the coefficients change e1 and e2 by at most 2 (A dP + P dA). The later roundings, up to the value at
  a pixel, add 12 u A P.
- For D, replace A by P. The error of e0 is the error of D, plus the errors of e1 and e2, plus two roundings.
- Rounding a direction moves g by at most (sx, sy, sz), and so changes c . g by at most |c| . (sx, sy, sz).

Edge functions are divided by these bounds. A pixel is surely inside above 1, and surely outside below -1.

Lengths are scaled by a power of two, so that no product overflows or underflows. If no such scale exists, all tests are
uncertain.

Tests. The setup writes the block's edge functions and depth keys, which are linear over the tile, with triangles as
lanes. With the same lanes, the block is culled against cells, the halves of frusta: a linear function over a frustum is
largest at a corner [Benthin and Wald 2009, Sec. 4.2]. The remaining triangles are tested one by one, with a cell's 16
pixels as lanes.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import block_leaf, rows_at, slot_at
from ...kernels.exact.filters import plane_side
from ...kernels.jit import F32Ptr, F32x16, I32Ptr, inlined, kernel
from ...kernels.simd import (
    absolute,
    bits,
    broadcast16,
    fma,
    get,
    iota16,
    load16,
    lowest_bit,
    maximum,
    minimum,
    popcount,
    prefetch,
    ptr_at,
    put,
    reduce_min,
    select,
    splat16,
    store,
    to_f32,
    to_i32,
)
from ...kernels.vec3 import Vec3, broadcasts, cross, dot, dots, largest, rows, scale3, store3, subtract3
from ..counters import CANDIDATES, TRIANGLE_TESTS, TRIANGLES, count

# --- Setup of a block for a tile --------------------------------------------------------------------------------------


_F, _F64 = np.float32, np.float64
_U = 2.0**-24
_ZERO, _INFINITE = _F(0.0), _F(np.inf)
_MORE = _F(1.01)  # second order terms and the rounding of the bounds
_FLOOR = _F(1e-32)  # more than the underflow error of an edge function or a volume
_SURE = _F(1e-3)  # largest relative error of a volume for which a depth key is computed
_HUGE = _F(1e28)
WIDTH, HEIGHT = 32, 16  # pixels of a tile
EDGES, KEY, KEY_ERROR, TOPS, BOX, SIGN = 0, 9 * 16, 12 * 16, 13 * 16, 17 * 16, 21 * 16
WORK = 22 * 16  # float32 of scratch memory


class TileFrame(NamedTuple):
    """Pixel coordinates relative to a tile; float32 scalars but `turn`."""

    eye: Vec3
    x: Vec3  # rows of the matrix
    y: Vec3
    z: Vec3
    error: float  # error of x and y, per unit of a vector's largest component
    z_error: float
    shift: Vec3  # how far rounding moves the direction g of a pixel
    floor: float  # infinite: all tests are uncertain
    turn: int  # sign of the determinant of the inverse matrix


@inlined
def _row(x, y, z, scale):
    return Vec3(_F(x * scale), _F(y * scale), _F(z * scale))


@inlined
def frame_of(view, x0, y0, scale):
    """The `TileFrame` of the tile at pixel (x0, y0); scale: a power of two; 0: all tests are uncertain."""
    fx, fy = _F64(x0), _F64(y0)
    x = _row(view.xx - fx * view.zx, view.xy - fx * view.zy, view.xz - fx * view.zz, scale)
    y = _row(view.yx - fy * view.zx, view.yy - fy * view.zy, view.yz - fy * view.zz, scale)
    z = _row(view.zx, view.zy, view.zz, scale)
    nx, ny = abs(x.x) + abs(x.y) + abs(x.z), abs(y.x) + abs(y.y) + abs(y.z)
    n = _F64(nx if nx > ny else ny) + 2.0**-26 * scale * (view.norm_x + view.norm_y)
    m = _F64(abs(z.x) + abs(z.y) + abs(z.z))
    more = 1.001
    return TileFrame(
        Vec3(_F(view.eye_x), _F(view.eye_y), _F(view.eye_z)),
        x,
        y,
        z,
        _F(6 * more * _U * n),
        _F(6 * more * _U * m),
        Vec3(_F(more * view.shift_x), _F(more * view.shift_y), _F(more * view.shift_z)),
        _FLOOR if scale > 0.0 else _INFINITE,
        view.turn,
    )


class Sizes(NamedTuple):
    """Bounds of the pixel coordinates of vectors, and of their errors; f32x16."""

    xy: F32x16  # |x|, |y|
    z: F32x16
    xy_error: F32x16
    z_error: F32x16


@inlined
def _to_pixels(frame, v):
    return Vec3(dots(v, frame.x), dots(v, frame.y), dots(v, frame.z))


@inlined
def _sizes(frame, xy, z, length):
    """`Sizes` of vectors with computed coordinates of at most xy and z, and components of at most `length`."""
    xy_error, z_error = length * frame.error, length * frame.z_error
    return Sizes(xy + xy_error, z + z_error, xy_error, z_error)


@inlined
def _reach(s):
    """(A, dA) of the module docstring, for any pixel of the tile."""
    return fma(s.z, splat16(_F(WIDTH)), s.xy), fma(s.z_error, splat16(_F(WIDTH)), s.xy_error)


@inlined
def _range(a, b, c):
    return minimum(minimum(a, b), c), maximum(maximum(a, b), c)


@inlined
def _pixel_range(low, high, pad, clear, size, work, at):
    """Write the first and last pixel along one axis whose centre a triangle may cover. Return mask16: one exists."""
    low = select(clear, minimum(maximum(low - pad, _ZERO), splat16(_F(size))), splat16(_ZERO))
    high = select(clear, minimum(high + pad, _F(size - 1)), splat16(_F(size - 1)))
    first = to_f32(to_i32(low))
    first = select(first < low, first + _F(1.0), first)
    store(work, at, first)
    store(work, at + 16, high)
    return first <= high


@inlined
def _keep_boxes(frame, a, p, q, a_size, p_size, work):
    """Write the triangles' pixel ranges (`_pixel_range`): the whole tile if a corner is not clearly in front.

    If the error of x is below z / 8, and so the error of z far below, then a coordinate x / z beyond 64 is surely
    beyond the tile. Up to 64, the error of the coordinate is at most 4 error / z.
    """
    _, slip = _reach(Sizes(a_size.xy, a_size.z, a_size.xy_error + p_size.xy_error, a_size.z_error + p_size.z_error))
    zb, zc = a.z + p.z, a.z + q.z
    nearest = minimum(minimum(a.z, zb), zc)
    clear = nearest > slip * _F(8.0)
    ia, ib, ic = _F(1.0) / a.z, _F(1.0) / zb, _F(1.0) / zc
    pad = slip * _F(8.0) / nearest + _F(1e-4)
    x_low, x_high = _range(a.x * ia, (a.x + p.x) * ib, (a.x + q.x) * ic)
    y_low, y_high = _range(a.y * ia, (a.y + p.y) * ib, (a.y + q.y) * ic)
    x_pad, y_pad = pad + frame.shift.x * _F(4.0), pad + frame.shift.y * _F(4.0)
    clear &= splat16(frame.shift.z) < _F(0.25)
    across = _pixel_range(x_low, x_high, x_pad, clear, WIDTH, work, BOX)
    return across & _pixel_range(y_low, y_high, y_pad, clear, HEIGHT, work, BOX + 32)


@inlined
def _moved(frame, c):
    """How much the rounding of a direction changes a linear function."""
    s = frame.shift
    return fma(absolute(c.x), splat16(s.x), fma(absolute(c.y), splat16(s.y), absolute(c.z) * s.z))


@inlined
def _top(c, right, down):
    """The s for which c.x x + c.y y + s is the maximum of c over pixels (x, y) to (x + right, y + down)."""
    return fma(maximum(c.x, _ZERO), splat16(_F(right)), fma(maximum(c.y, _ZERO), splat16(_F(down)), c.z))


@inlined
def _keep_edge(frame, k, c, sign, error, work):
    """Write an edge function divided by its error bound. Return bits of the triangles that miss the whole tile."""
    scaled = scale3(c, sign / ((error + _moved(frame, c) + frame.floor) * _MORE))
    store3(work, EDGES + 48 * k, 16, scaled)
    store(work, TOPS + 16 * k, _top(scaled, 3, 3))
    return bits(_top(scaled, WIDTH - 1, HEIGHT - 1) < _F(-2.0))


@inlined
def _keep_key(frame, c, error, volume, volume_error, work):
    """Write the depth key and its error bound. The bound is infinite where float32 cannot represent the key."""
    size = absolute(volume)
    total = fma(absolute(c.x) + absolute(c.y), splat16(_F(WIDTH)), absolute(c.z))
    good = (volume_error < size * _SURE) & (total < size * _HUGE)
    inverse = _F(1.0) / select(good, volume, splat16(_F(1.0)))
    # Roundings in float32, and 2**-28 since `hit_t` itself is within 2**-30 of the truth
    relative = fma(volume_error, absolute(inverse), splat16(_F(8 * _U + 2.0**-28)))
    bound = (error + _moved(frame, c) + total * relative + frame.floor) * absolute(inverse) * _MORE
    scaled = scale3(c, select(good, inverse, splat16(_ZERO)))
    bound = select(good, bound, splat16(_INFINITE))
    store3(work, KEY, 16, scaled)
    store(work, KEY_ERROR, bound)
    store(work, TOPS + 48, _top(scaled, 3, 3) + bound * _F(2.0))


@inlined
def _volume_error(frame, d, a_size, p_size):
    """Error bound of a . d, with d = p x q."""
    dz = p_size.xy * (p_size.xy_error * _F(4.0) + p_size.xy * _F(4 * _U))
    dxy = (p_size.z * p_size.xy_error + p_size.xy * p_size.z_error) * _F(2.0) + p_size.xy * p_size.z * _F(4 * _U)
    xy, z = absolute(d.x) + absolute(d.y), absolute(d.z)
    error = a_size.z * dz + a_size.xy * dxy * _F(2.0) + z * a_size.z_error + xy * a_size.xy_error
    return (error + (a_size.z * z + a_size.xy * xy) * _F(4 * _U)) * _MORE + frame.floor


@kernel
def _settle_turns(frame, tree, block, flat, work):
    """Write the exact signs of the volumes in `flat` (bits), undecided in float32. Return bits of the zero volumes."""
    none, e = 0, frame.eye
    while flat != 0:
        i = lowest_bit(flat)
        flat &= flat - 1
        turn = -frame.turn * plane_side(e.x, e.y, e.z, tree.corners, get(tree.slots, slot_at(block, i)))
        put(work, SIGN + i, turn)
        if turn == 0:
            none |= 1 << i
    return none


@kernel
def set_up_block(frame, tree, block, triangles, work):
    """Set up a block's triangles for their tests. Return bits of the triangles that may be visible in the tile."""
    numbers = ptr_at(tree.blocks, rows_at(block))
    a3, p3, q3 = rows(numbers, 0, 16), rows(numbers, 48, 16), rows(numbers, 96, 16)
    e = frame.eye
    a3 = Vec3(a3.x - e.x, a3.y - e.y, a3.z - e.z)
    a, p, q = _to_pixels(frame, a3), _to_pixels(frame, p3), _to_pixels(frame, q3)
    a_size = _sizes(frame, maximum(absolute(a.x), absolute(a.y)), absolute(a.z), largest(a3))
    xy = maximum(maximum(absolute(p.x), absolute(p.y)), maximum(absolute(q.x), absolute(q.y)))
    p_size = _sizes(frame, xy, maximum(absolute(p.z), absolute(q.z)), maximum(largest(p3), largest(q3)))
    remaining = bits(_keep_boxes(frame, a, p, q, a_size, p_size, work)) & ((1 << triangles) - 1)
    if remaining == 0:
        return remaining
    d, e1, e2 = cross(p, q), cross(q, a), cross(a, p)
    e0 = subtract3(d, Vec3(e1.x + e2.x, e1.y + e2.y, e1.z + e2.z))
    volume, volume_error = dot(a, d), _volume_error(frame, d, a_size, p_size)
    store(work, SIGN, select(volume > _ZERO, splat16(_F(1.0)), splat16(_F(-1.0))))
    flat = bits(absolute(volume) <= volume_error) & remaining
    if flat != 0:
        remaining &= ~_settle_turns(frame, tree, block, flat, work)
    sign = load16(work, SIGN)
    (wide, slip), (long, slip_p) = _reach(a_size), _reach(p_size)
    mixed = (wide * slip_p + long * slip) * _F(2.02) + wide * long * _F(20 * _U)
    pure = long * (slip_p * _F(4.04) + long * _F(20 * _U))
    remaining &= ~_keep_edge(frame, 1, e1, sign, mixed, work)
    remaining &= ~_keep_edge(frame, 2, e2, sign, mixed, work)
    remaining &= ~_keep_edge(frame, 0, e0, sign, pure + mixed * _F(2.0), work)
    _keep_key(frame, d, pure, volume, volume_error, work)
    return remaining


# --- Tests of a block against cells and pixels ------------------------------------------------------------------------


CELLS = 32  # cells of 4 x 4 pixels in a tile: cell f is the left half of frustum f, cell 16 + f the right half
PIXELS = 16 * CELLS
DEFERRED = 2 + 2 * 16 * PIXELS  # int32: a block defers at most 16 tests per pixel


class Pixels(NamedTuple):
    """Pointers to the state of a tile's pixels, see `pixel_hits`: cell c has elements 16 c to 16 c + 15."""

    low: F32Ptr  # float32: lower bound of the visible triangle's depth key; -inf if none, inf beyond the picture
    high: F32Ptr  # float32: upper bound of the depth key; -inf if none
    slot: I32Ptr  # int32: the triangle's slot in the current tree; NOTHING, or KNOWN
    least: F32Ptr  # (CELLS,) float32: the least `low` of each cell
    far: F32Ptr  # (16,) float32: t beyond which nothing is visible in each frustum
    part: I32Ptr  # int32: for KNOWN, the number of the triangle's tree; -1: see the picture
    known_slot: I32Ptr  # int32: for KNOWN, the triangle's slot in that tree
    deferred: I32Ptr  # int32: number of deferred pixels, an unused word; then slot, 2 * pixel + (1 if surely covered)


@inlined
def first_pixel(cell):
    """(x, y) of the first pixel of a cell, in the tile."""
    return 8 * (cell & 3) + (cell >> 2 & 4), cell & 12


@inlined
def _over(work, edge, top, x, y):
    """Maximum of a linear function over a cell whose first pixel is (x, y); lanes are triangles."""
    return fma(load16(work, edge), x, fma(load16(work, edge + 16), y, load16(work, top)))


@inlined
def cull_cell(work, candidates, fx, fy, least):
    """Bits of the triangles in `candidates` that may be visible in the cell with first pixel (fx, fy)."""
    x, y, end_x, end_y = splat16(fx), splat16(fy), splat16(fx + _F(3.0)), splat16(fy + _F(3.0))
    inside = (load16(work, BOX) <= end_x) & (load16(work, BOX + 16) >= x)
    inside &= (load16(work, BOX + 32) <= end_y) & (load16(work, BOX + 48) >= y)
    edges = minimum(_over(work, EDGES, TOPS, x, y), _over(work, EDGES + 48, TOPS + 16, x, y))
    edges = minimum(edges, _over(work, EDGES + 96, TOPS + 32, x, y))
    inside &= (edges >= _F(-2.0)) & (_over(work, KEY, TOPS + 48, x, y) >= least)
    return bits(inside) & candidates


@inlined
def _value(work, at, i, x, y):
    """A linear function of triangle i at 16 pixels."""
    c = broadcasts(work, at + i, 16)
    return fma(x, c.x, fma(y, c.y, c.z))


@inlined
def defer(deferred, slot, cell, unsure, sure):
    """Defer the tests of a triangle against the pixels of a cell in `unsure` (bits)."""
    n = get(deferred, 0)
    while unsure != 0:
        lane = lowest_bit(unsure)
        unsure &= unsure - 1
        put(deferred, 2 + 2 * n, slot)
        put(deferred, 3 + 2 * n, 2 * (16 * cell + lane) + (sure >> lane & 1))
        n += 1
    put(deferred, 0, n)


@inlined
def _test_cell(work, tree, block, tests, x, y, pixels, cell):
    """Test triangles (bits) against the pixels of a cell. Return bits of triangles that became some pixel's hit."""
    at, winners = 16 * cell, 0
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
    """Test a block against some frusta (bits) of a tile. Return whether the hit of some pixel has changed."""
    (block, triangles), winners, tested = block_leaf(link), 0, 0
    candidates = set_up_block(frame, tree, block, triangles, work)
    count(counters, TRIANGLES, triangles)
    if candidates == 0:
        return False
    across, down = to_f32(iota16() & 3), to_f32(iota16() >> 2)
    while frusta != 0:
        f = lowest_bit(frusta)
        frusta &= frusta - 1
        for cell in (f, f + 16):
            x, y = first_pixel(cell)
            x, y = _F(x), _F(y)
            tests = cull_cell(work, candidates, x, y, get(pixels.least, cell))
            if tests != 0:
                tested |= tests
                count(counters, TRIANGLE_TESTS, popcount(tests))
                winners |= _test_cell(work, tree, block, tests, across + x, down + y, pixels, cell)
    count(counters, CANDIDATES, popcount(tested))
    changed = winners != 0
    while winners != 0:  # prefetch the corners for the float64 t
        slot = get(tree.slots, slot_at(block, lowest_bit(winners)))
        winners &= winners - 1
        prefetch(tree.corners, 9 * slot)
        prefetch(tree.corners, 9 * slot + 8)
        prefetch(tree.prim_ids, slot)
    return changed
