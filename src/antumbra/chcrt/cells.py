"""Cells: the rays of a screen as occlusion queries test them, 16 cells of 4 x 4 receivers side by side.

The rays of a *cell* lie in one shaft (`trace.slabs`), from the box of its receivers to the box of the rays' ends. Each
cell keeps the largest parameter up to which one of its rays still looks for a blocker, or for a nearer hit. These
numbers are the *depth buffer* of [Mattausch et al. 2015, Sec. 4.1]. They are shares of the rays' whole length, and
negative once no ray of the cell looks any more. The first rows of a region's cells are the rows that
`trace.multifrusta.bundle.shafts_of` loads.
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, take
from ..kernels.simd import (
    fma,
    get,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr,
    ptr_at,
    put,
    select,
    splat16,
    stack_f32,
    store,
)
from ..kernels.vec import rows
from ..query.receivers import NOTHING
from ..query.shadow import ShadowQuery, patch_of, query_pointers, set_of
from ..scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from ..trace.multifrusta.region import Layout, layout_of
from ..trace.querychunk import TileShape

_F = np.float32
FAR, COUNT, ALL = 12, 13, 14  # rows after the shafts: how far rays look, number of rays that look, number of rays
ROWS = 15
NONE, BLOCKED = _F(-1.0), _F(-0.5)  # values of row FAR: a cell without rays, a cell whose rays are all blocked
WORDS = ROWS * 16  # float32 of a region
_BOXES = 96
_MORE = np.float32(2.0**-20)  # of the largest coordinate: more than rounding a box of light samples loses


class Ends(NamedTuple):
    """The box in which the rays of all receivers end. It may move with the receiver."""

    low: np.ndarray  # (3,) float32
    high: np.ndarray  # (3,) float32
    moves: bool  # the box is relative to the receiver


class Picture(NamedTuple):
    """How receivers are cut into cells and regions."""

    shape: TileShape
    layout: Layout
    h: int  # rows of receivers
    w: int  # receivers in a row


def picture_of(shape: TileShape, h: int, w: int) -> Picture:
    """The `Picture` of (h, w) receivers."""
    return Picture(shape, layout_of(shape), h, w)


def new_cells(picture: Picture, sets: int) -> np.ndarray:
    """(sets, regions, ROWS, 16) float32: memory for the cells of some ray sets."""
    return np.empty((sets, picture.layout.rows * picture.layout.columns, ROWS, 16), np.float32)


def ends_of(query: ShadowQuery, first: int, count: int) -> Ends:
    """The `Ends` of a query's segments to `count` of its samples, from the `first` on."""
    light = query.light
    if light.kind == SPHERE:
        low, high = light.base - light.radius, light.base + light.radius
    elif light.kind == AMBIENT:
        low, high = np.full(3, -light.radius), np.full(3, light.radius)
    else:
        points = light.base + query.samples[:, first : first + count] @ np.stack([light.u, light.v, light.w])
        low, high = points.min((0, 1)), points.max((0, 1))
    pad = _MORE * np.maximum(np.abs(low), np.abs(high)).max() + 1e-30
    return Ends((low - pad).astype(_F), (high + pad).astype(_F), light.kind in (DIRECTIONAL, AMBIENT))


@inlined
def first_receiver(picture, region, g):
    """(y, x) of the first receiver of cell g of a region."""
    layout, shape = picture.layout, picture.shape
    y = region // layout.columns * layout.down + g // layout.across
    x = region % layout.columns * layout.across + g % layout.across
    return y * shape.height, x * shape.width


@inlined
def regions_in(span):
    """The number of regions in a tile; `span`: its row of `Tiles.spans`."""
    return (span[1] - span[0]) * (span[3] - span[2])


@inlined
def region_in(span, j, columns):
    """The index of a tile's j-th region; `columns`: regions in a row of the picture."""
    across = span[1] - span[0]
    return (span[2] + j // across) * columns + span[0] + j % across


@inlined
def put_cell(cells, g, o_low, o_high, d_low, d_high, far, n):
    """Write cell g.

    o_low, o_high : box of the rays' origins
    d_low, d_high : vectors from its lower and upper corner to the corners of the box of the rays' ends
    far, n : how far the rays look, and how many rays look
    """
    for k in range(3):
        put(cells, 16 * k + g, o_low[k])
        put(cells, 48 + 16 * k + g, o_high[k])
        put(cells, 96 + 16 * k + g, d_low[k])
        put(cells, 144 + 16 * k + g, d_high[k])
    put(cells, FAR * 16 + g, far)
    put(cells, COUNT * 16 + g, n)
    put(cells, ALL * 16 + g, n)


@inlined
def no_cell(cells, g):
    """Write a cell g that has no rays."""
    zero, one = (_F(0.0), _F(0.0), _F(0.0)), (_F(1.0), _F(1.0), _F(1.0))
    put_cell(cells, g, zero, zero, one, one, NONE, _F(0.0))


@inlined
def wider(low, high, p):
    """The box from `low` to `high`, widened by a point."""
    return (
        (min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2])),
        (max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2])),
    )


@inlined
def nothing_yet():
    """The box of no points."""
    inf = _F(np.inf)
    return (inf, inf, inf), (-inf, -inf, -inf)


@kernel
def _bound_receivers(query, picture, y0, x0):
    """The box of a cell's receivers, and their number."""
    (low, high), n = nothing_yet(), np.int64(0)
    for y in range(y0, min(y0 + picture.shape.height, picture.h)):
        for x in range(x0, min(x0 + picture.shape.width, picture.w)):
            if query.sides[y, x] != NOTHING:
                o = query.origins[y, x]
                low, high = wider(low, high, (o[0], o[1], o[2]))
                n += 1
    return low, high, n


@kernel
def _bound_ends(query, picture, y0, x0, samples, ends):
    """Write, for each of 16 directions of the hemisphere, the box of the points that a cell's receivers look at.

    samples : pointer to (16, 3, 16) float32
    ends : pointer to six rows of 16 float32: low x, y, z and high x, y, z, rounded by less than `_MORE`
    """
    asked, inf = query_pointers(query), splat16(_F(np.inf))
    lows, highs = (inf, inf, inf), (-inf, -inf, -inf)
    for y in range(y0, min(y0 + picture.shape.height, picture.h)):
        for x in range(x0, min(x0 + picture.shape.width, picture.w)):
            if query.sides[y, x] != NOTHING:
                i = y * asked.w + x
                p, abc = patch_of(asked, i), rows(samples, 48 * set_of(asked, i), 16)
                ex = _end(abc, p.bx, p.ux, p.vx, p.wx)
                ey = _end(abc, p.by, p.uy, p.vy, p.wy)
                ez = _end(abc, p.bz, p.uz, p.vz, p.wz)
                lows = minimum(lows[0], ex), minimum(lows[1], ey), minimum(lows[2], ez)
                highs = maximum(highs[0], ex), maximum(highs[1], ey), maximum(highs[2], ez)
    for k in range(3):
        store(ends, 16 * k, lows[k])
        store(ends, 48 + 16 * k, highs[k])


@inlined
def _end(abc, base, u, v, w):
    """One coordinate of 16 points of a patch."""
    return fma(abc.x, splat16(_F(u)), fma(abc.y, splat16(_F(v)), fma(abc.z, splat16(_F(w)), splat16(_F(base)))))


@kernel
def _bound(ticket, query, picture, ends, pad, samples, spp, cells):
    """Worker: write the cells of regions, for each set of `cells`."""
    # In: query, picture, ends, pad, samples, spp. Out: cells.
    sets, regions, boxes = cells.shape[0], cells.shape[1], stack_f32(_BOXES)
    region = take(ticket)
    while region >= 0:
        for g in range(16):
            y, x = first_receiver(picture, region, g)
            o_low, o_high, n = _bound_receivers(query, picture, y, x)
            if sets > 1 and n > 0:
                _bound_ends(query, picture, y, x, ptr(samples), boxes)
            for s in range(sets):
                out = ptr_at(ptr(cells), (s * regions + region) * WORDS)
                if n == 0:
                    no_cell(out, g)
                    continue
                low, high = (ends.low[0], ends.low[1], ends.low[2]), (ends.high[0], ends.high[1], ends.high[2])
                if sets > 1:
                    low = get(boxes, s) - pad, get(boxes, 16 + s) - pad, get(boxes, 32 + s) - pad
                    high = get(boxes, 48 + s) + pad, get(boxes, 64 + s) + pad, get(boxes, 80 + s) + pad
                if not ends.moves or sets > 1:
                    low = low[0] - o_low[0], low[1] - o_low[1], low[2] - o_low[2]
                    high = high[0] - o_high[0], high[1] - o_high[1], high[2] - o_high[2]
                put_cell(out, g, o_low, o_high, low, high, _F(1.0), _F(n if sets > 1 else n * spp))
        region = take(ticket)


def bound_cells(query: ShadowQuery, picture: Picture, first: int, count: int, sets: int, threads: int) -> np.ndarray:
    """The cells of a query's segments to `count` samples from the `first` on.

    sets : 1, or one for each sample; then there are at most 16 samples, all of them directions of the hemisphere
    """
    cells, ends, pad = new_cells(picture, sets), ends_of(query, first, count), 0.0
    if ends.moves:  # sums with receivers are rounded
        pad = _MORE * (np.abs(query.origins).max(initial=0.0) + (query.light.radius if sets > 1 else 0.0))
        ends = Ends(ends.low - _F(pad), ends.high + _F(pad), True)
    samples = np.zeros((16, 3, 16), _F)
    if sets > 1:
        samples[..., :count] = query.samples[:, first : first + count].swapaxes(1, 2)
    run(_bound, threads, new_ticket(cells.shape[1], 1), query, picture, ends, _F(pad), samples, count, cells)
    return cells


@inlined
def _blocked(bits, at, words, first, count):
    """The number of blocked samples of receiver `at`, among `count` samples from the `first` on."""
    n = np.int64(0)
    while count > 0:
        here = min(count, 64 - (first & 63))
        word = get(bits, at * words + (first >> 6)) >> np.uint64(first & 63)
        n += popcount(word & (~np.uint64(0) >> np.uint64(64 - here)))
        first, count = first + here, count - here
    return n


@inlined
def _put_left(out, g, n):
    """Note that n rays of cell g still look."""
    put(out, COUNT * 16 + g, n)
    if n == _F(0.0):
        put(out, FAR * 16 + g, BLOCKED)


@kernel
def _count_left(query, picture, y0, x0, bits, words, first, left):
    """Write the number of a cell's unblocked receivers for each of 16 samples, side by side; 16 divides `first`."""
    counts = splat16(_F(0.0))
    for y in range(y0, min(y0 + picture.shape.height, picture.h)):
        for x in range(x0, min(x0 + picture.shape.width, picture.w)):
            if query.sides[y, x] != NOTHING:
                word = get(bits, (y * picture.w + x) * words + (first >> 6)) >> np.uint64(first & 63)
                blocked = mask_from_bits16(np.int64(word & np.uint64(0xFFFF)))
                counts += select(blocked, splat16(_F(0.0)), splat16(_F(1.0)))
    store(left, 0, counts)


@kernel
def _shorten(ticket, spans, tiles, columns, query, picture, first, spp, bits, cells):
    """Worker: update the numbers of unblocked rays of all cells of some tiles."""
    # In: spans, tiles, columns, query, picture, first, spp, bits. Out: cells.
    sets, regions, p, words, left = cells.shape[0], cells.shape[1], ptr(bits), bits.shape[2], stack_f32(16)
    t = take(ticket)
    while t >= 0:
        span = spans[tiles[t]]
        for k in range(regions_in(span)):
            region = region_in(span, k, columns)
            for g in range(16):
                y, x = first_receiver(picture, region, g)
                if sets > 1:
                    _count_left(query, picture, y, x, p, words, first, left)
                    for s in range(sets):
                        out = ptr_at(ptr(cells), (s * regions + region) * WORDS)
                        if get(out, FAR * 16 + g) >= _F(0.0):
                            _put_left(out, g, get(left, s))
                    continue
                out, n = ptr_at(ptr(cells), region * WORDS), np.int64(0)
                if get(out, FAR * 16 + g) < _F(0.0):
                    continue
                for v in range(y, min(y + picture.shape.height, picture.h)):
                    for u in range(x, min(x + picture.shape.width, picture.w)):
                        if query.sides[v, u] != NOTHING:
                            n += spp - _blocked(p, v * picture.w + u, words, first, spp)
                _put_left(out, g, _F(n))
        t = take(ticket)


def shorten(cells, spans, tiles, query: ShadowQuery, picture: Picture, first, count, bits, threads: int) -> None:
    """Update the cells of some tiles. A ray that is blocked by `bits` looks no further.

    first, count : the samples, as for `bound_cells`
    """
    ticket, columns = new_ticket(len(tiles), 1), picture.layout.columns
    run(_shorten, threads, ticket, spans, tiles, columns, query, picture, first, count, bits, cells)
