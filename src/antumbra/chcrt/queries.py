"""Occlusion queries: how many rays of a screen tile may meet a box before their hits so far?

[Mattausch et al. 2015, Sec. 4.1]. The paper uses the graphics hardware. Here a query is a SIMD count over the tile's
cells. All queries of one tile are answered together, while its cells are in the cache: the paper's *multi-query* (Sec.
5.1). Unlike the paper's, it answers for each box, so no box is queried again by itself. A query tests the boxes of a
node's two children instead of the node's own: the paper's *tighter bounds*.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, take
from ..kernels.simd import (
    bits,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_min,
    select,
    splat16,
)
from ..trace.descent import entry, slabs_of
from ..trace.multifrusta.bundle import shafts_of
from .cells import ALL, BLOCKED, COUNT, FAR, WORDS
from .tiles import Tiles

_F = np.float32


class Answers(NamedTuple):
    """The answers to n queries."""

    counts: np.ndarray  # (n,) int32: rays that may meet the box; counting ends beyond the threshold
    keys: np.ndarray  # (n,) float32: least parameter at which a ray enters the box, in [0, 1]
    groups: int  # number of multi-queries


@inlined
def _rays_in(cells, counts, met):
    """The number of rays of the cells in `met` (bits), by a row of counts."""
    n = _F(0.0)
    while met != 0:
        n += get(cells, counts * 16 + lowest_bit(met))
        met &= met - 1
    return np.int64(n)


@kernel
def _ask_region(cells, lines, rows, first, end, threshold, blind, counts, keys):
    """Add a region's rays to the counts of the pairs first .. end. Return how many pairs this decides."""
    # In: cells, lines, rows, first, end, threshold, blind. Out: counts, keys.
    far, decided, row = load16(cells, FAR * 16), np.int64(0), COUNT
    if blind:
        far, row = select(far >= BLOCKED, splat16(_F(1.0)), far), ALL
    live = bits(far >= _F(0.0))
    if live == 0:
        return decided
    slabs = slabs_of(shafts_of(cells), live)
    for i in range(first, end):
        n = np.int64(get(counts, i))
        if n > threshold:
            continue
        at = np.int64(get(rows, i)) * 16
        left, a = entry(lines, at, slabs, far)
        right, b = entry(lines, at + 1, slabs, far)
        met = (left | right) & live
        if met != 0:
            near = reduce_min(select(mask_from_bits16(met), minimum(a, b), splat16(_F(1.0))))
            n += _rays_in(cells, row, met)
            put(counts, i, n)
            put(keys, i, min(get(keys, i), near))
            decided += np.int64(n > threshold)
    return decided


@kernel
def _ask(ticket, groups, tiles, sets, rows, spans, columns, cells, lines, threshold, blind, counts, keys):
    """Worker: answer groups of pairs of the same set and tile."""
    # In: groups, tiles, sets, rows, spans, columns, cells, lines, threshold, blind. Out: counts, keys.
    regions, c, l, r = cells.shape[1], ptr(cells), ptr(lines), ptr(rows)
    k, n = ptr(counts), ptr(keys)
    group = take(ticket)
    while group >= 0:
        first, end = np.int64(groups[group]), np.int64(groups[group + 1])
        x0, x1, y0, y1 = spans[tiles[first]]
        base, left = sets[first] * regions, end - first
        for y in range(y0, y1):
            for x in range(x0, x1):
                if left > 0:
                    region = ptr_at(c, (base + y * columns + x) * WORDS)
                    left -= _ask_region(region, l, r, first, end, threshold, blind, k, n)
        group = take(ticket)


def ask(tiles: Tiles, cells, lines, tile, set_, row, threshold: int, blind: bool, threads: int) -> Answers:
    """Answer the queries of n pairs, given by their tiles, ray sets and rows of `lines`, (n,) int32 each.

    threshold : counting ends beyond it
    blind : also count rays that are blocked
    """
    n = len(tile)
    counts, keys = np.zeros(n, np.int32), np.ones(n, np.float32)
    if n == 0:
        return Answers(counts, keys, 0)
    group = set_.astype(np.int64) * len(tiles.spans) + tile
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1], [True]])).astype(np.int32)
    found, near = np.zeros(n, np.int32), np.ones(n, np.float32)
    sorted_ = (np.ascontiguousarray(a[order], np.int32) for a in (tile, set_, row))
    ticket = new_ticket(len(starts) - 1, 1)
    arrays = starts, *sorted_, tiles.spans, tiles.columns, cells, lines, threshold, blind, found, near
    run(_ask, threads, ticket, *arrays)
    counts[order], keys[order] = found, near
    return Answers(counts, keys, len(starts) - 1)
