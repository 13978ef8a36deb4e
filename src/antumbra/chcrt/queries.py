"""Occlusion queries: how many rays of a screen tile may meet a box before their hits so far?

[Mattausch et al. 2015, Sec. 4.1]. The paper uses the graphics hardware. Here a query first tests the shafts of the
tile's cells, 16 side by side. Where a shaft meets the box, the single rays of the cell are tested side by side, each up
to its own limit, and counted. Counting ends when the answer is known.

All queries of one tile are answered together, while its rays are in the cache: the paper's *multi-query* (Sec. 5.1).
Unlike the paper's, it answers for each box, so no box is queried again by itself. A query tests the boxes of a node's
two children instead of the node's own: the paper's *tighter bounds*.
"""

from typing import Any, NamedTuple

import numpy as np

from ..bvh.links import box_at
from ..kernels.fields import F32Ptr, I32Ptr
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import (
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
from ..trace.descent import entry, slabs_of
from ..trace.frusta.bundle import shafts_of
from .bundles import BUNDLE_FLOATS, bundle_in, bundles_in, load_bundle, slabs_in
from .cells import ALL, BLOCKED, COUNT, FAR, WORDS, Picture, first_receiver, region_in, regions_in
from .tiles import Tiles

_F = np.float32


class Rays(NamedTuple):
    """The rays of a screen, as queries see them."""

    source: Any  # see `bundles`
    picture: Picture
    tiles: Tiles
    cells: np.ndarray  # (sets, regions, ROWS, 16) float32, see `cells.new_cells`


class Pairs(NamedTuple):
    """Some query pairs, (n,) each."""

    tile: np.ndarray  # int32: a tile of `Tiles`
    set: np.ndarray  # int32: a ray set
    row: np.ndarray  # int32: a row of `Parts`


class Answers(NamedTuple):
    """The answers to n queries."""

    counts: np.ndarray  # (n,) int32: rays that may meet the box; counting ends beyond the threshold
    keys: np.ndarray  # (n,) float32: a parameter before which no ray enters the box, in [0, 1]
    groups: int  # number of multi-queries


class Asked(NamedTuple):
    """Some pairs of one set and tile, and their answers: pointers, from `first` to `end`."""

    rows: I32Ptr  # int32: row of `lines`
    counts: I32Ptr  # int32: rays found so far
    keys: F32Ptr  # float32: see `Answers`
    met: I32Ptr  # int32: bits of the cells of a region whose shafts meet the box
    first: int
    end: int
    threshold: int  # counting ends beyond it


@inlined
def _entered(lines, row, slabs, far):
    """(bits of the lanes that may enter a child's box of a row before `far`, where each enters)."""
    left, a = entry(lines, box_at(row, 0), slabs, far)
    right, b = entry(lines, box_at(row, 1), slabs, far)
    return left | right, minimum(a, b)


@inlined
def _is_open(pairs, i):
    return np.int64(get(pairs.counts, i)) <= pairs.threshold


@kernel
def _ask_shafts(cells, lines, pairs, blind):
    """Test the shafts of a region's cells, and write `pairs.met` and keys. Return bits of the cells that meet a box."""
    far, any_ = load16(cells, FAR * 16), np.int64(0)
    if blind:
        far = select(far >= BLOCKED, splat16(_F(1.0)), far)
    live = bits(far >= _F(0.0))
    if live == 0:
        return any_
    slabs = slabs_of(shafts_of(cells), live)
    for i in range(pairs.first, pairs.end):
        met = np.int64(0)
        if _is_open(pairs, i):
            met, enters = _entered(lines, np.int64(get(pairs.rows, i)), slabs, far)
            met &= live
            if met != 0:
                near = reduce_min(select(mask_from_bits16(met), enters, splat16(_F(1.0))))
                put(pairs.keys, i, min(get(pairs.keys, i), near))
        put(pairs.met, i, met)
        any_ |= met
    return any_


@kernel
def _ask_bundle(bundle, live, lines, pairs, g):
    """Count the rays of a bundle of cell g. Return how many pairs that met the cell's shaft are still open."""
    slabs, far, left = slabs_in(bundle, live), load16(bundle.limits, 0), np.int64(0)
    for i in range(pairs.first, pairs.end):
        if np.int64(get(pairs.met, i)) >> g & 1 != 0 and _is_open(pairs, i):
            met = _entered(lines, np.int64(get(pairs.rows, i)), slabs, far)[0] & live
            put(pairs.counts, i, np.int64(get(pairs.counts, i)) + popcount(met))
            left += np.int64(_is_open(pairs, i))
    return left


@kernel
def _count_cell(pairs, g, n):
    """Count all n rays of cell g for the pairs that meet its shaft."""
    for i in range(pairs.first, pairs.end):
        if np.int64(get(pairs.met, i)) >> g & 1 != 0 and _is_open(pairs, i):
            put(pairs.counts, i, np.int64(get(pairs.counts, i)) + n)


@kernel
def _ask_region(source, picture, region, set_, cells, lines, pairs, blind, bundle):
    """Add the rays of a region to the counts of the pairs. Return whether all counts exceed the threshold."""
    # In: source, picture, region, set_, cells, lines, blind. Out: pairs. Scratch: bundle.
    met, n = _ask_shafts(cells, lines, pairs, blind), bundles_in(source)
    while met != 0:
        g = lowest_bit(met)
        met &= met - 1
        if n == 0:
            _count_cell(pairs, g, np.int64(get(cells, (ALL if blind else COUNT) * 16 + g)))
        y, x = first_receiver(picture, region, g)
        for k in range(n):
            live = load_bundle(source, picture, y, x, set_, k, blind, bundle)
            if live != 0 and _ask_bundle(bundle, live, lines, pairs, g) == 0:
                break
    for i in range(pairs.first, pairs.end):
        if _is_open(pairs, i):
            return False
    return True


@kernel
def _ask(ticket, groups, tiles, sets, spans, source, picture, cells, lines, rows, threshold, blind, counts, keys, met):
    """Worker: answer groups of pairs of the same set and tile."""
    # In: groups, tiles, sets, spans, source, picture, cells, lines, rows, threshold, blind. Out: counts, keys, met.
    bundle, columns, regions = bundle_in(stack_f32(BUNDLE_FLOATS)), picture.layout.columns, cells.shape[1]
    for group in items(ticket):
        first, end = np.int64(groups[group]), np.int64(groups[group + 1])
        pairs = Asked(ptr(rows), ptr(counts), ptr(keys), ptr(met), first, end, threshold)
        span, set_ = spans[tiles[first]], np.int64(sets[first])
        for j in range(regions_in(span)):
            region = region_in(span, j, columns)
            place = ptr_at(ptr(cells), (set_ * regions + region) * WORDS)
            if _ask_region(source, picture, region, set_, place, ptr(lines), pairs, blind, bundle):
                break


def ask(rays: Rays, lines, pairs: Pairs, threshold: int, blind: bool, threads: int) -> Answers:
    """Answer the queries of n pairs of a tile and a row of `lines`.

    threshold : counting ends beyond it
    blind : also count rays that are blocked
    """
    n = len(pairs.tile)
    counts, keys = np.zeros(n, np.int32), np.ones(n, np.float32)
    if n == 0:
        return Answers(counts, keys, 0)
    group = pairs.set.astype(np.int64) * len(rays.tiles.spans) + pairs.tile
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1], [True]])).astype(np.int32)
    found, near, met = np.zeros(n, np.int32), np.ones(n, np.float32), np.zeros(n, np.int32)
    tile, set_, row = (np.ascontiguousarray(a[order], np.int32) for a in pairs)
    arrays = starts, tile, set_, rays.tiles.spans, rays.source, rays.picture, rays.cells, lines, row
    run(_ask, threads, new_ticket(len(starts) - 1, 1), *arrays, threshold, blind, found, near, met)
    counts[order], keys[order] = found, near
    return Answers(counts, keys, len(starts) - 1)
