"""Shadow queries by ray hierarchies [Olsson and Assarsson 2011, Sec. 3.1].

Steps. Receivers and lights form beams (`light_beams`). The receivers of a beam are sorted (`receiver_order`) and packed
(`leaf_packing`) into leaves (`ray_leaves`) of a hierarchy (`ray_tree`). The triangles traverse the hierarchy
(`triangle_traversal`), and the bits of blocked segments are set.

Wide lights, as large as the lit surfaces. A hierarchy around one apex then culls nothing: every triangle would be
tested against every ray. Therefore a few triangles are traced first, and their tests are counted. If the estimate for
all triangles is too high, a second set of triangles is traced as clusters through shafts (`shaft_hierarchy`), whose
leaves have one light sample each. The remaining triangles use the cheaper traversal. The choice depends on counts
only, and no triangle is traced twice.
"""

from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.lbvh import sort_by_codes
from ...kernels.parallel import new_ticket, run, thread_count
from ...query.shadow_query import ShadowQuery, with_receivers
from ...scene.lights import FIXED, LIST
from ...trace.counters import BOX_TESTS, N_COUNTERS, NODES, TRIANGLE_TESTS, new_counters
from ..culling.pre_bvh_culling import Soup, indices_of
from ..tracer_options import RayHierarchyOptions
from . import shaft_hierarchy
from .box_nodes import Boxes
from .leaf_packing import rays_of, receivers_of, shafts_of, unfinished_rays
from .light_beams import AROUND, PERSPECTIVE, Beam, beams_of
from .pixel_blocks import rays_by_blocks
from .ray_leaves import Empty, LeafRays, borrowed, finished_share, write_bits
from .ray_tree import RayTree, tree_of
from .receiver_order import order_of
from .shaft_hierarchy import ROWS, ShaftNodes
from .triangle_traversal import BATCH, FINISHED, PAIRS, TraversalOptions, memory_for, occluders_first, trace_triangles

# --- Wide lights: the choice between one traversal for all samples and shafts -----------------------------------------

PROBE = 128
"""Number of triangles traced to estimate the cost of the others."""

LEAST = 16 * PROBE
"""Minimum number of triangles for an estimate; fewer cost little in any case."""

TEST, NODE, BOX = 70.0, 5.0, 30.0
"""Cost of a triangle test, node test and box test, in ns of one thread with AVX-512; only the ratios matter."""

ROW, CLUSTERED = 400.0, 150.0
"""Extra cost of a triangle in ns: its row, or its share of building and sorting clusters."""

CHEAP = 2000.0
"""Cost per triangle in ns below which shafts are not tried: sorting triangles into clusters would not pay off."""

LEAF, WORTH = 1000.0, 32.0
"""Cost of making a leaf of 16 rays in ns; shafts are tried if tracing all triangles costs WORTH times as much."""

SHARE = 16
"""One in SHARE triangles, but at least 4 batches, are traced to estimate the cost of shafts."""


_NONE = np.float32(0.0)


class TraversalInputs(NamedTuple):
    """The inputs of a traversal, and its options."""

    soup: Soup
    query: ShadowQuery
    beam: Beam
    how: TraversalOptions
    threads: int
    counters: np.ndarray
    progress: ProgressCallback | None


def traverse(
    traced: TraversalInputs, tree: RayTree, rays: LeafRays, picks: NDArray[np.int32], unit: np.float32 = _NONE
) -> float:
    """Trace the picked triangles through a hierarchy, of shafts if `unit` is not 0; return the cost per triangle."""
    counts, soup, progress = np.zeros(N_COUNTERS, np.int64), traced.soup, traced.progress
    ticket = new_ticket(len(picks), BATCH)
    if unit:
        ticket = new_ticket(len(picks), shaft_hierarchy.BATCH)
        shafts = soup, picks, tree, rays, traced.how.facing, unit, counts
        run(shaft_hierarchy.trace_clusters, traced.threads, ticket, *shafts, progress=progress)
    else:
        nodes = soup, picks, traced.beam, tree, rays, traced.how, counts
        new_memory = lambda: (memory_for(len(tree.faces), traced.how),)
        run(trace_triangles, traced.threads, ticket, *nodes, own=new_memory, progress=progress)
    np.add(traced.counters, counts, out=traced.counters)
    cost = TEST * counts[TRIANGLE_TESTS] + NODE * counts[NODES] + BOX * counts[BOX_TESTS]
    return float(cost) / max(len(picks), 1)


def _unit(tree: RayTree) -> np.float32:
    """A power of two that scales all segments of a new hierarchy of shafts to at most 1 along each axis."""
    top = int(tree.groups[0, tree.heights[0] - 1])
    there = tree.alive[top] >> np.arange(tree.ways) & 1 != 0
    numbers = tree.numbers[top * ROWS * tree.ways :][: ROWS * tree.ways].reshape(2, 3, 2, tree.ways)
    low, high = numbers[:, :, 0, there].min((0, 2)), numbers[:, :, 1, there].max((0, 2))
    longest = float((high.astype(np.float64) - low).max())
    return np.float32(2.0 ** -min(max(int(np.frexp(longest)[1]), -100), 126))


def may_be_wide(traced: TraversalInputs, triangles: int) -> bool:
    """True if leaves of shafts could pay off."""
    return traced.beam.radius > 0.0 and triangles >= LEAST


def trace_wide(
    traced: TraversalInputs,
    rays: LeafRays,
    tree: RayTree,
    picks: NDArray[np.int32],
    bits: NDArray[np.uint64],
    empty: Empty,
) -> NDArray[np.int32]:
    """Trace a few triangles, or all triangles if shafts are cheaper; return the remaining triangles."""
    quiet, (few, picks) = traced._replace(progress=None), _split_runs(picks, 16, PROBE // 16)
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
    step = shaft_hierarchy.BATCH
    few, others = _split_runs(_in_morton_order(traced, picks), step, max(len(picks) // (SHARE * step), 4))
    if traverse(quiet, shafts, leaves, few, unit) + CLUSTERED < cost:
        traverse(traced, shafts, leaves, others, unit)
        others = picks[:0]
    packed.dead.reshape(-1)[places] |= leaves.dead[:, 0]
    write_bits(packed, bits, traced.threads)
    return np.sort(others)


def _in_morton_order(traced: TraversalInputs, picks: NDArray[np.int32]) -> NDArray[np.int32]:
    """The picked triangles in Morton order."""
    order: NDArray[np.int32] = sort_by_codes(traced.soup.corners, 10, traced.threads)[1]
    if len(picks) == len(order):
        return order
    picked = np.zeros(len(order), bool)
    picked[picks] = True
    return order[picked[order]]


def _split_runs(picks: NDArray[np.int32], run: int, n: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(n evenly spread runs of `run` triangles, all others)."""
    runs = -(-len(picks) // run)
    few = np.zeros(runs, bool)
    few[np.linspace(0, runs - 1, min(n, runs)).astype(np.int64)] = True
    few = np.repeat(few, run)[: len(picks)]
    return picks[few], picks[~few]


# --- Shadow queries [Olsson and Assarsson 2011, Sec. 3.1] -------------------------------------------------------------

SEGMENTS = 1 << 22
"""Maximum number of segments with their own ends in memory at once."""


def trace_shadow(
    soup: Soup,
    query: ShadowQuery,
    bits: NDArray[np.uint64],
    threads: int | None,
    counters: NDArray[np.int64] | None,
    progress: ProgressCallback | None,
    options: RayHierarchyOptions,
) -> None:
    """Answer a ShadowQuery by the triangles of a soup: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    progress : function of (triangles started, triangles), or None; restarts with each part of a query
    """
    threads = thread_count(threads)
    counters = new_counters() if counters is None else counters
    how = TraversalOptions(options.spheres, options.early_accept, query.cull_faces, options.backface, PAIRS)
    for part, part_bits in query_parts(query, bits):
        for beam in beams_of(part, not options.shared, threads):
            traced = TraversalInputs(soup, part, beam, how, threads, counters, progress)
            with borrowed() as empty:
                _trace_beam(traced, part_bits, options, empty)


def query_parts(query: ShadowQuery, bits: NDArray[np.uint64]) -> list[tuple[ShadowQuery, NDArray[np.uint64]]]:
    """Cut a query into parts whose segments fit in memory: bands of rows, or pieces of a single row."""
    (h, w), spp = query.sides.shape, query.samples.shape[1]
    most = max(SEGMENTS // spp, 1)
    if (query.light.kind in (FIXED, LIST) and spp == 1) or h * w <= most:
        return [(query, bits)]
    if h == 1:
        step = -(-most // 4) * 4  # sample sets repeat every four pixels of a row
        cuts = [(slice(None), slice(i, i + step)) for i in range(0, w, step)]
    else:
        step = max(most // (4 * w), 1) * 4
        cuts = [(slice(i, i + step), slice(None)) for i in range(0, h, step)]
    return [(with_receivers(query, itemgetter(cut)), bits[cut]) for cut in cuts]


def _trace_beam(traced: TraversalInputs, bits: NDArray[np.uint64], options: RayHierarchyOptions, empty: Empty) -> None:
    """Trace the segments of one beam."""
    # Boxes have a hierarchy per face. AROUND receivers keep screen order: adjacent pixels are close to each other.
    soup, query, beam, threads, counters = traced.soup, traced.query, traced.beam, traced.threads, traced.counters
    coherent = beam.kind != AROUND
    sort = ((options.sorted or options.blocks) and coherent) or (options.nodes is None and beam.kind == PERSPECTIVE)
    if options.blocks and coherent and query.sides.shape[0] > 1:
        projected = options.nodes is None and beam.kind == PERSPECTIVE and beam.radius == 0.0 and beam.n_samples == 1
        rays = rays_by_blocks(query, beam, bits, threads, counters, empty, projected)
    else:
        order = order_of(query, beam, bits, sort, threads, counters)
        rays = rays_of(query, beam, order, 16 if options.wide or options.blocks else 4, bits, threads, empty)
    if not len(rays.blocks):
        return
    kind = (beam.kind == PERSPECTIVE and options.nodes) or Boxes
    passes = occluders_first(soup, beam, threads) if options.two_pass else [_picks(soup, threads, options)]
    tree = tree_of(kind, beam, rays, threads, empty)
    for k, picks in enumerate(passes):
        if k > 0 and finished_share(rays) >= FINISHED:
            rays = unfinished_rays(query, beam, rays, bits, threads, empty)
            tree = tree_of(kind, beam, rays, threads, empty)
        if options.shafts and may_be_wide(traced, len(picks)):
            picks = trace_wide(traced, rays, tree, picks, bits, empty)
        if len(picks):
            traverse(traced, tree, rays, picks)
        write_bits(rays, bits, threads)


def _picks(soup: Soup, threads: int, options: RayHierarchyOptions) -> NDArray[np.int32]:
    """All triangles, in traversal order."""
    if options.clustered and len(soup.corners):
        return sort_by_codes(soup.corners, 10, threads)[1]
    return indices_of(len(soup.corners))
