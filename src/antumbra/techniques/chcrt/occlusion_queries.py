"""Occlusion queries: count the rays of a screen tile that may enter a box before their hits so far.

Sources. A *source* holds the rays of an image: `PassRays`, `CameraBundles` or `SegmentBundles`. Each class of sources
overloads `load_bundle` and `bundles_in`.

Cells. A *cell* is a group of 16 receivers. Its rays lie in one shaft (`trace.descent`), from the box of the receivers
to the box of the rays' ends. A ray is *active* while it still needs a blocker or a nearer hit, and its *limit* is the
parameter up to which it does, as a fraction of its length. The limit of a cell is the largest limit of its rays, or
negative if none is active. These limits are the *depth buffer* of [Mattausch et al. 2015, Sec. 4.1]. The first rows of
a region's cells have the layout that `trace.frusta.bundle.shafts_of` loads.

The receivers of a cell are 4 x 4 adjacent pixels, or 16 receivers of a row. In *spread* images they are every fourth
pixel of a square of 16 x 16 pixels: these pixels take the same sample of each set, so their directions are similar
(Sec. 5.3).

Queries [Mattausch et al. 2015, Sec. 4.1]. The paper uses graphics hardware. Here a query first tests the shafts of a
tile's cells, 16 at a time. Where a shaft meets the box, the rays of the cell are tested in parallel lanes, each up to
its own limit, and counted. Counting stops as soon as the count exceeds the threshold.

All queries of one tile are answered together while its rays are in the cache: the paper's *multi-query* (Sec. 5.1).
Unlike the paper's, it has an answer for each box, so no box is queried again separately. A query tests the boxes of a
node's two children instead of the node's own box: the paper's *tighter bounds*.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import box_at
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overloaded
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import (
    bits,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    minimum,
    popcount,
    ptr,
    ptr_at,
    put,
    reduce_min,
    select,
    splat16,
    stack_f32,
)
from ...kernels.vec3 import rows
from ...trace.descent import entry, rays_as_shafts, slabs_of
from ...trace.frusta.bundle import shafts_of
from ...trace.frusta.tile_clusters import RegionLayout, layout_of
from ...trace.tile import TileShape

# --- Bundles: 16 rays of a cell, as occlusion queries and tracers load them -------------------------------------------


BUNDLE_FLOATS = 128


class RayBundle(NamedTuple):
    """16 rays: pointers to BUNDLE_FLOATS float32 of scratch memory."""

    rays: F32Ptr  # rows ox oy oz, then x y z of the vectors from origin to end
    lengths: F32Ptr  # the end of a ray is this multiple of its direction away
    limits: F32Ptr  # limit of each ray, as a fraction of its length; -1: no ray


@inlined
def bundle_in(memory):
    """The `RayBundle` in BUNDLE_FLOATS float32."""
    return RayBundle(memory, ptr_at(memory, 96), ptr_at(memory, 112))


@inlined
def slabs_in(bundle, live):
    """The rays of a bundle, prepared for slab tests; `live`: bits of the active rays."""
    return slabs_of(rays_as_shafts(rows(bundle.rays, 0, 16), rows(bundle.rays, 48, 16)), live)


@overloaded("ray_bundles")
def bundles_in(source):
    """In kernels: the number of bundles per cell."""


@overloaded("ray_bundles")
def load_bundle(source, picture, corner, s, k, bundle):
    """In kernels: fill bundle k of a cell, in ray set s. Return bits of the active rays.

    corner : (y, x) of the first receiver of the cell
    """


# --- Cells of 16 receivers, and regions of 16 cells -------------------------------------------------------------------

_F = np.float32
FAR = 12  # the row after the shafts: limits
ROWS = 13
NONE = _F(-1.0)  # the limit of a cell without active rays
WORDS = ROWS * 16  # float32 numbers per region
CELL = 4  # side of an image's cell in pixels


class PictureCells(NamedTuple):
    """Partition of an image's receivers into cells and regions."""

    shape: TileShape
    layout: RegionLayout
    h: int  # rows of receivers
    w: int  # receivers in a row
    spread: bool  # a cell has every fourth receiver along both axes, instead of adjacent ones


def cells_of_query(shape: TileShape, h: int, w: int) -> PictureCells:
    """The `PictureCells` of (h, w) receivers whose cells are the tiles of a query."""
    return PictureCells(shape, layout_of(shape), h, w, False)


def cells_of_pixels(h: int, w: int, spread: bool = False) -> PictureCells:
    """The `PictureCells` of (h, w) pixels; a single row also has cells of 4 x 4 pixels."""
    shape = TileShape(CELL, CELL, -(-w // CELL), -(-h // CELL))
    return PictureCells(shape, layout_of(shape), h, w, spread)


def new_cells(picture: PictureCells, sets: int) -> NDArray[np.float32]:
    """(sets, regions, ROWS, 16) float32: uninitialized memory for the cells of some ray sets."""
    return np.empty((sets, picture.layout.rows * picture.layout.columns, ROWS, 16), np.float32)


@inlined
def first_receiver(picture, region, g):
    """(y, x) of the first receiver of cell g of a region."""
    layout, shape = picture.layout, picture.shape
    y, x = region // layout.columns * layout.down, region % layout.columns * layout.across
    row, column = g // layout.across, g % layout.across
    if picture.spread:
        return y * shape.height + row, x * shape.width + column
    return (y + row) * shape.height, (x + column) * shape.width


@inlined
def receiver_in(picture, corner, lane):
    """(y, x, whether it is inside the image) of a receiver of the cell whose first receiver is `corner`, (y, x)."""
    row, column = lane // picture.shape.width, lane % picture.shape.width
    if picture.spread:
        row, column = row * picture.layout.down, column * picture.layout.across
    y, x = corner[0] + row, corner[1] + column
    return y, x, y < picture.h and x < picture.w


@inlined
def regions_in(span):
    """The number of regions in a tile; `span`: its row of `Tiles.spans`."""
    return (span[1] - span[0]) * (span[3] - span[2])


@inlined
def region_in(span, j, columns):
    """The index of a tile's j-th region; `columns`: regions per row of the image."""
    across = span[1] - span[0]
    return (span[2] + j // across) * columns + span[0] + j % across


@inlined
def put_cell(cells, g, o_low, o_high, d_low, d_high, far):
    """Write cell g.

    o_low, o_high : box of the rays' origins
    d_low, d_high : vectors from its lower and upper corner to the corners of the box of the rays' ends
    far : limit of the rays
    """
    for k in range(3):
        put(cells, 16 * k + g, o_low[k])
        put(cells, 48 + 16 * k + g, o_high[k])
        put(cells, 96 + 16 * k + g, d_low[k])
        put(cells, 144 + 16 * k + g, d_high[k])
    put(cells, FAR * 16 + g, far)


@inlined
def no_cell(cells, g):
    """Write cell g as a cell without rays."""
    zero, one = (_F(0.0), _F(0.0), _F(0.0)), (_F(1.0), _F(1.0), _F(1.0))
    put_cell(cells, g, zero, zero, one, one, NONE)


@inlined
def wider(low, high, p):
    """The box from `low` to `high`, extended by a point."""
    return (
        (min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2])),
        (max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2])),
    )


@inlined
def nothing_yet():
    """The empty box."""
    inf = _F(np.inf)
    return (inf, inf, inf), (-inf, -inf, -inf)


# --- Hierarchy over the rays: a quadtree of screen tiles [Mattausch et al. 2015, Sec. 4.3] ----------------------------


class Tiles(NamedTuple):
    """The t tiles of all levels, smallest first, row by row. The last tile is the whole screen."""

    spans: np.ndarray  # (t, 4) int32: first and end column of a tile's regions, then first and end row
    children: np.ndarray  # (t, 4) int32: tiles; -1 where there is none, and for the smallest tiles
    share: np.ndarray  # (t,) float64: share of the screen's area
    pixels: int  # side of the smallest tile in pixels
    across: int  # smallest tiles in a row
    smallest: int  # number of smallest tiles
    columns: int  # regions in a row


@lru_cache(maxsize=16)
def tiles_of(shape: TileShape, pixels: int) -> Tiles:
    """The quadtree over a query that `trace.tile.tile_shape` has cut into tiles of 16 receivers.

    pixels : side of the smallest tile; multiplied by 64 if the receivers form one row
    """
    layout = layout_of(shape)
    width, height = layout.across * shape.width, layout.down * shape.height  # pixels of a region
    pixels = pixels if shape.height > 1 else 64 * pixels
    step = pixels // width, max(pixels // height, 1)  # regions in a smallest tile
    spans, children, first, level = [], [], 0, 0
    across, down = -(-layout.columns // step[0]), -(-layout.rows // step[1])
    grid = smallest = across, down
    below = None
    while True:
        y, x = np.divmod(np.arange(grid[0] * grid[1]), grid[0])
        size = step[0] << level, step[1] << level
        spans.append(np.stack([x, x + 1, y, y + 1], 1) * [size[0], size[0], size[1], size[1]])
        kids = np.full((len(x), 4), -1)
        if below is not None:
            (nx, ny), start = below
            for k in range(4):
                cx, cy = 2 * x + (k & 1), 2 * y + (k >> 1)
                kids[:, k] = np.where((cx < nx) & (cy < ny), start + cy * nx + cx, -1)
        children.append(kids)
        if grid == (1, 1):
            break
        below, first = (grid, first), first + len(x)
        grid, level = ((grid[0] + 1) // 2, (grid[1] + 1) // 2), level + 1
    spans = np.minimum(np.concatenate(spans), [layout.columns] * 2 + [layout.rows] * 2).astype(np.int32)
    area = (spans[:, 1] - spans[:, 0]) * (spans[:, 3] - spans[:, 2])
    return Tiles(
        spans, np.concatenate(children).astype(np.int32), area / area[-1], pixels, smallest[0],
        smallest[0] * smallest[1], layout.columns,
    )  # fmt: skip


# --- Occlusion queries ------------------------------------------------------------------------------------------------


class ScreenRays(NamedTuple):
    """The rays of an image, as input of occlusion queries."""

    source: Any  # `PassRays`, `CameraBundles` or `SegmentBundles`
    picture: PictureCells
    tiles: Tiles
    cells: np.ndarray  # (sets, regions, ROWS, 16) float32, see `new_cells`


class Pairs(NamedTuple):
    """Some query pairs, (n,) each."""

    tile: np.ndarray  # int32: a tile of `Tiles`
    set: np.ndarray  # int32: a ray set
    row: np.ndarray  # int32: a row of `TreeParts`


class Answers(NamedTuple):
    """The answers to n queries."""

    counts: np.ndarray  # (n,) int32: rays that may enter the box; counting stops beyond the threshold
    keys: np.ndarray  # (n,) float32: lower bound of the parameter at which rays enter the box, in [0, 1]
    groups: int  # number of multi-queries


class MultiQuery(NamedTuple):
    """Pointers to the pairs of one set and tile, from `first` to `end`, and to their answers."""

    rows: I32Ptr  # int32: row of `lines`
    counts: I32Ptr  # int32: rays counted so far
    keys: F32Ptr  # float32: see `Answers`
    met: I32Ptr  # int32: bits of the cells of a region whose shafts meet the box
    first: int
    end: int
    threshold: int  # counting stops beyond it


@inlined
def _entered_children(lines, row, slabs, far):
    """(bits of the lanes that may enter a child's box of a row before `far`, parameter where each enters)."""
    entered_left, a = entry(lines, box_at(row, 0), slabs, far)
    entered_right, b = entry(lines, box_at(row, 1), slabs, far)
    return entered_left | entered_right, minimum(a, b)


@inlined
def _is_open(pairs, i):
    return get(pairs.counts, i) <= pairs.threshold


@kernel
def _test_shafts(cells, lines, pairs):
    """Test the shafts of a region's cells, and write `pairs.met` and keys. Return bits of the cells that meet a box."""
    far, any_ = load16(cells, FAR * 16), 0
    live = bits(far >= _F(0.0))
    if live == 0:
        return any_
    slabs = slabs_of(shafts_of(cells), live)
    for i in range(pairs.first, pairs.end):
        met = 0
        if _is_open(pairs, i):
            met, enters = _entered_children(lines, get(pairs.rows, i), slabs, far)
            met &= live
            if met != 0:
                key = reduce_min(select(mask_from_bits16(met), enters, splat16(_F(1.0))))
                put(pairs.keys, i, min(get(pairs.keys, i), key))
        put(pairs.met, i, met)
        any_ |= met
    return any_


@kernel
def _count_bundle(bundle, live, lines, pairs, g):
    """Count the rays of a bundle of cell g. Return the number of pairs that met the cell's shaft and are still open."""
    slabs, far, n_open = slabs_in(bundle, live), load16(bundle.limits, 0), 0
    for i in range(pairs.first, pairs.end):
        if get(pairs.met, i) >> g & 1 != 0 and _is_open(pairs, i):
            met = _entered_children(lines, get(pairs.rows, i), slabs, far)[0] & live
            put(pairs.counts, i, get(pairs.counts, i) + popcount(met))
            n_open += np.int64(_is_open(pairs, i))
    return n_open


@kernel
def _count_region(source, picture, region, set_, cells, lines, pairs, bundle):
    """Add the rays of a region to the counts of the pairs. Return whether all counts exceed the threshold."""
    # In: source, picture, region, set_, cells, lines. Out: pairs. Scratch: bundle.
    met, n = _test_shafts(cells, lines, pairs), bundles_in(source)
    while met != 0:
        g = lowest_bit(met)
        met &= met - 1
        corner = first_receiver(picture, region, g)
        for k in range(n):
            live = load_bundle(source, picture, corner, set_, k, bundle)
            if live != 0 and _count_bundle(bundle, live, lines, pairs, g) == 0:
                break
    for i in range(pairs.first, pairs.end):
        if _is_open(pairs, i):
            return False
    return True


@kernel
def _ask(ticket, groups, tiles, sets, spans, source, picture, cells, lines, rows, threshold, counts, keys, met):
    """Worker: answer groups of pairs of the same set and tile."""
    # In: the arguments before `counts`. Out: counts, keys, met.
    bundle, columns, regions = bundle_in(stack_f32(BUNDLE_FLOATS)), picture.layout.columns, cells.shape[1]
    for group in items(ticket):
        first, end = np.int64(groups[group]), np.int64(groups[group + 1])
        pairs = MultiQuery(ptr(rows), ptr(counts), ptr(keys), ptr(met), first, end, threshold)
        span, set_ = spans[tiles[first]], np.int64(sets[first])
        for j in range(regions_in(span)):
            region = region_in(span, j, columns)
            place = ptr_at(ptr(cells), (set_ * regions + region) * WORDS)
            if _count_region(source, picture, region, set_, place, ptr(lines), pairs, bundle):
                break


def answer_queries(rays: ScreenRays, lines: NDArray[np.float32], pairs: Pairs, threshold: int, threads: int) -> Answers:
    """Answer the queries of n pairs of a tile and a row of `lines`.

    threshold : counting stops beyond it
    """
    n = len(pairs.tile)
    counts, keys = np.zeros(n, np.int32), np.ones(n, np.float32)
    if n == 0:
        return Answers(counts, keys, 0)
    group = pairs.set.astype(np.int64) * len(rays.tiles.spans) + pairs.tile
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1], [True]])).astype(np.int32)
    group_counts, group_keys, met = np.zeros(n, np.int32), np.ones(n, np.float32), np.zeros(n, np.int32)
    tile, set_, row = (np.ascontiguousarray(a[order], np.int32) for a in pairs)
    arrays = starts, tile, set_, rays.tiles.spans, rays.source, rays.picture, rays.cells, lines, row
    run(_ask, threads, new_ticket(len(starts) - 1, 1), *arrays, threshold, group_counts, group_keys, met)
    counts[order], keys[order] = group_counts, group_keys
    return Answers(counts, keys, len(starts) - 1)
