"""Wide lights, as large as the lit surfaces: choose between one traversal for all samples and shafts.

A hierarchy around one apex culls nothing if the light is wide: every triangle would be tested against every ray. So a
few triangles are traced first, and their tests are counted. If the estimate for all triangles is too high, a second
set of triangles is traced through `shafts` as `clusters`. Leaves of shafts have one light sample each. The remaining
triangles take the cheaper way. Only counts decide, and no triangle is traced twice.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..bvh.lbvh import by_codes
from ..kernels.parallel import new_ticket, run
from ..query.shadow_query import ShadowQuery
from ..trace.counters import BOX_TESTS, N_COUNTERS, NODES, TRIANGLE_TESTS
from . import clusters
from .beams import Beam
from .memory import Empty
from .rays import LeafRays, write_bits
from .shaftrays import receivers_of, shafts_of
from .shafts import ROWS, ShaftNodes
from .soup import Soup
from .traverse import BATCH, How, memory_for, trace_triangles
from .tree import RayTree, tree_of

PROBE = 128
"""Number of triangles traced to estimate the cost of the others."""

LEAST = 16 * PROBE
"""Minimum number of triangles for an estimate; fewer cost little in any case."""

TEST, NODE, BOX = 70.0, 5.0, 30.0
"""Cost of a triangle test, node test and box test, in ns of one thread with AVX-512; only the ratios matter."""

ROW, CLUSTERED = 400.0, 150.0
"""Extra cost of a triangle in ns: its row, or its share of making and sorting clusters."""

CHEAP = 2000.0
"""Cost in ns below which triangles do not use shafts: sorting them into clusters would not pay off."""

LEAF, WORTH = 1000.0, 32.0
"""Cost of making a leaf of 16 rays in ns; shafts are made if all triangles cost WORTH times as much."""

SHARE = 16
"""One in SHARE triangles, and at least 4 batches, estimate the cost of shafts."""


_NONE = np.float32(0.0)


class Traced(NamedTuple):
    """The inputs of a traversal, and its options."""

    soup: Soup
    query: ShadowQuery
    beam: Beam
    how: How
    threads: int
    counters: np.ndarray
    progress: Callable | None


def traverse(traced: Traced, tree: RayTree, rays: LeafRays, picks: np.ndarray, unit: np.float32 = _NONE) -> float:
    """Trace the picked triangles through a hierarchy, of shafts if `unit` is not 0; return the cost per triangle."""
    mine, soup, progress = np.zeros(N_COUNTERS, np.int64), traced.soup, traced.progress
    ticket = new_ticket(len(picks), BATCH)
    if unit:
        ticket = new_ticket(len(picks), clusters.BATCH)
        shafts = soup, picks, tree, rays, traced.how.facing, unit, mine
        run(clusters.trace_clusters, traced.threads, ticket, *shafts, progress=progress)
    else:
        nodes = soup, picks, traced.beam, tree, rays, traced.how, mine
        own = lambda: (memory_for(len(tree.faces), traced.how),)
        run(trace_triangles, traced.threads, ticket, *nodes, own=own, progress=progress)
    np.add(traced.counters, mine, out=traced.counters)
    return (TEST * mine[TRIANGLE_TESTS] + NODE * mine[NODES] + BOX * mine[BOX_TESTS]) / max(len(picks), 1)


def _unit(tree: RayTree) -> np.float32:
    """A power of two that scales all segments of a new hierarchy of shafts to at most 1 along each axis."""
    top = int(tree.groups[0, tree.heights[0] - 1])
    there = tree.alive[top] >> np.arange(tree.ways) & 1 != 0
    numbers = tree.numbers[top * ROWS * tree.ways :][: ROWS * tree.ways].reshape(2, 3, 2, tree.ways)
    low, high = numbers[:, :, 0, there].min((0, 2)), numbers[:, :, 1, there].max((0, 2))
    longest = float((high.astype(np.float64) - low).max())
    return np.float32(2.0 ** -min(max(int(np.frexp(longest)[1]), -100), 126))


def may_be_wide(traced: Traced, triangles: int) -> bool:
    """True if leaves of shafts could pay off."""
    return traced.beam.radius > 0.0 and triangles >= LEAST


def trace_wide(
    traced: Traced, rays: LeafRays, tree: RayTree, picks: np.ndarray, bits: np.ndarray, empty: Empty
) -> np.ndarray:
    """Trace a few triangles, or all triangles if shafts are cheaper; return the remaining triangles."""
    quiet, (few, picks) = traced._replace(progress=None), _some(picks, 16, PROBE // 16)
    cost = traverse(quiet, tree, rays, few) + ROW
    write_bits(rays, bits, traced.threads)
    if cost < CHEAP or cost * len(picks) < WORTH * LEAF * rays.dead.size:
        return picks
    packed = receivers_of(traced.query, traced.beam, rays, bits, traced.threads, empty)
    leaves, places = shafts_of(traced.query, traced.beam, packed)
    if not len(leaves.blocks):
        return picks[:0]
    shafts = tree_of(ShaftNodes, traced.beam, leaves, traced.threads, empty)
    unit = _unit(shafts)
    step = clusters.BATCH
    few, others = _some(_near_each_other(traced, picks), step, max(len(picks) // (SHARE * step), 4))
    if traverse(quiet, shafts, leaves, few, unit) + CLUSTERED < cost:
        traverse(traced, shafts, leaves, others, unit)
        others = picks[:0]
    packed.dead.reshape(-1)[places] |= leaves.dead[:, 0]
    write_bits(packed, bits, traced.threads)
    return np.sort(others)


def _near_each_other(traced: Traced, picks: np.ndarray) -> np.ndarray:
    """The picked triangles in Morton order."""
    order = by_codes(traced.soup.corners, 10, traced.threads)[1]
    if len(picks) == len(order):
        return order
    picked = np.zeros(len(order), bool)
    picked[picks] = True
    return order[picked[order]]


def _some(picks: np.ndarray, run: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(n evenly spread runs of `run` triangles, all others)."""
    runs = -(-len(picks) // run)
    few = np.zeros(runs, bool)
    few[np.linspace(0, runs - 1, min(n, runs)).astype(np.int64)] = True
    few = np.repeat(few, run)[: len(picks)]
    return picks[few], picks[~few]
