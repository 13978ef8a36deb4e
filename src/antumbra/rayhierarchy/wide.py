"""Wide lights, as large as the lit surfaces: estimate the cost of one traversal for all samples, or use shafts.

A hierarchy around one apex culls nothing if the light is wide: every triangle would be tested against every ray. So a
few triangles are traced first, and their tests counted. If the estimate for all triangles is too high, a second sample
goes through `shafts` as `clusters`; the leaves of shafts have one sample each. The remaining triangles take the cheaper
way. Only counts decide, and no triangle is traced twice.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..bvh.lbvh import by_codes
from ..kernels.parallel import new_ticket, run
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
"""Triangles that are traced to tell what the others cost."""

LEAST = 16 * PROBE
"""No fewer triangles are probed: they cost little in any case."""

TEST, NODE, BOX = 70.0, 5.0, 30.0
"""Nanoseconds of one thread, by which counts are compared; measured on AVX-512, and only proportions matter."""

ROW, CLUSTERED = 400.0, 150.0
"""What a triangle costs besides: its row, or its share of the clusters and of their order."""

CHEAP = 2000.0
"""A triangle that costs less stays: its place in the clusters' order is not worth it."""

LEAF, WORTH = 1000.0, 32.0
"""What making a leaf of 16 rays costs; shafts are made if all triangles cost so many times as much."""

SHARE = 16
"""One in so many triangles tells what shafts cost, and at least 4 batches."""


_NONE = np.float32(0.0)


class Traced(NamedTuple):
    """What is traced, and how."""

    soup: Soup
    query: object
    beam: Beam
    how: How
    threads: int
    counters: np.ndarray
    progress: Callable | None


def traverse(traced: Traced, tree: RayTree, rays: LeafRays, picks: np.ndarray, unit: np.float32 = _NONE) -> float:
    """Trace the picked triangles through a hierarchy, of shafts if there is a unit; what one of them cost."""
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
    """A power of two by which no segment of a new hierarchy of shafts is longer than 1 along an axis."""
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
    """Trace a few triangles, or all if that is better done by shafts; those that are left."""
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
    """(n runs of that length, evenly spread; the others)."""
    runs = -(-len(picks) // run)
    few = np.zeros(runs, bool)
    few[np.linspace(0, runs - 1, min(n, runs)).astype(np.int64)] = True
    few = np.repeat(few, run)[: len(picks)]
    return picks[few], picks[~few]
