"""`packet16`: packets of 16 shadow rays through the builder's own deep tree.

This is the baseline of multi-frusta tracing [Benthin and Wald 2009, Sec. 5.1; Wald et al. 2001]: one slab test per box
for all 16 rays, a mask of active rays, and no packet bounds. A packet leads from 16 neighbouring receivers to a stratum
of samples, or from one receiver to 16 of its samples (`packet16:samples`). Triangles are tested by edge functions,
where the paper uses Moeller and Trumbore's test.

For incoherent samples (see `ray_tile`), the same packets traverse a tree of blocks.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.block_tree import BlockTree
from ...bvh.nodes import EMPTY, Bvh, Tree, bvh_leaf, tree_of
from ...kernels.jit import inlined, kernel, overload
from ...kernels.parallel import items
from ...kernels.simd import bits, get, load16, lowest_bit, ptr, put, stack_f32, stack_i32, stack_i64
from ...query.shadow_query import ShadowQuery
from ..counters import CANDIDATES, N_COUNTERS, TRIANGLE_TESTS, TRIANGLES, add_counters, cleared, count
from ..descent import NOT_STARTED, after_leaf, load_saved, next_leaf, not_started, rays_as_shafts, root, save, slabs_of
from ..tracer import BLOCKS, Bits, Counters, Tracer
from ..tracer_cost import Cost, FittedRate
from ..tree_list import (
    TREE,
    TreeList,
    is_idle,
    list_of,
    single_tree,
    tree_in,
    tree_list_pointers,
    walk_tree,
    walk_tree_list,
)
from ..triangle_tests import DEFERRED, decide, defer, lanes_from, length1, triangle_in
from .ray_tile import (
    SCRATCH_FLOATS,
    SCRATCH_INTS,
    TileRays,
    TileRun,
    directions_of,
    finish_tile,
    open_rays,
    origins_of,
    query_chunk_in,
    rows_are_receivers,
    scratch_in,
    settle,
    start_tile,
    trace_block,
    trace_tiles,
)

T = TypeVar("T")


class Row(NamedTuple):
    """A row of a tile's rays."""

    rays: TileRays
    number: int
    facing: int  # a value of CULL_FACES


def pointers(prepared):
    """In kernels: the `Tree` of a `Bvh`, or the `TreeListPointers` of a `TreeList`."""


def trees_for(trees, y, x, stratum):
    """In kernels: (begin, end) of the trees for a stratum of the receivers near pixel (y, x)."""


def nothing_for(trees, y, x):
    """In kernels: True if there is nothing to trace for the receivers near pixel (y, x)."""


def tree_number(trees, k):
    """In kernels: tree k."""


def walk_trees(trees, i, end, alive, row, scratch, counters):
    """In kernels: trace a row through trees i .. end. Return (tree at which to continue, bits of the rays left)."""


def trace_leaf(tree, row, link, mask, deferred, counters):
    """In kernels: test the rays of a row in `mask` against a leaf. Return bits of the blocked rays."""


@overload(pointers)
def _pointers(prepared):
    return _by_type(prepared, Bvh, lambda prepared: tree_of(prepared), lambda prepared: tree_list_pointers(prepared))


@overload(trees_for)
def _trees_for(trees, y, x, stratum):
    one = lambda trees, y, x, stratum: (0, 1)
    return _by_type(trees, Tree, one, lambda trees, y, x, stratum: list_of(trees, y, x, stratum))


@overload(nothing_for)
def _nothing_for(trees, y, x):
    return _by_type(trees, Tree, lambda trees, y, x: False, lambda trees, y, x: is_idle(trees, y, x))


@overload(tree_number)
def _tree_number(trees, k):
    return _by_type(trees, Tree, lambda trees, k: trees, lambda trees, k: tree_in(trees, k))


@overload(walk_trees)
def _walk_trees(trees, i, end, alive, row, scratch, counters):
    if trees.instance_class is Tree:
        return lambda trees, i, end, alive, row, scratch, counters: _walk_one(trees, alive, row, scratch, counters)
    return lambda trees, i, end, alive, row, scratch, counters: walk_tree_list(
        trees, i, end, _slabs(row, alive), alive, row, scratch, counters
    )


@overload(walk_tree)
def _by_job(tree, slabs, at, alive, job, scratch, counters):
    if job.instance_class is Row:
        return lambda tree, slabs, at, alive, job, scratch, counters: _walk_tree(
            tree, slabs, at, alive, job, scratch, counters
        )


def _by_type(argument: Any, kind: type, one: T, other: T) -> T:
    """The implementation of an overload: `one` if the argument is of type `kind`, otherwise `other`."""
    return one if argument.instance_class is kind else other


@overload(trace_leaf)
def _trace_leaf(tree, row, link, mask, deferred, counters):
    if tree.instance_class is Tree:
        return lambda tree, row, link, mask, deferred, counters: _trace_triangles(
            tree, row, link, mask, deferred, counters
        )
    return lambda tree, row, link, mask, deferred, counters: trace_block(tree, row, link, mask, deferred, counters)


@inlined
def _on_triangle(tree, rays, r, slot):
    """Bits of the rays of row r that start on the triangle in `slot`."""
    if rows_are_receivers(rays):
        return np.int64(0xFFFF) if get(rays.tile.faces, r) == get(tree.prim_ids, slot) else 0
    return bits(load16(rays.tile.faces, 0) == get(tree.prim_ids, slot))


@inlined
def _slabs(row, alive):
    """The rays of a row, prepared for slab tests."""
    return slabs_of(rays_as_shafts(origins_of(row.rays, row.number), directions_of(row.rays, row.number)), alive)


@kernel
def _trace_triangles(tree, row, link, mask, deferred, counters):
    """`trace_leaf` for a `Tree`, triangle by triangle."""
    hits, (rays, r, facing) = 0, row
    if link == EMPTY:
        return hits
    o, d = origins_of(rays, r), directions_of(rays, r)
    span, leaf = length1(d), bvh_leaf(link)
    for slot in range(leaf.first, leaf.first + leaf.count):
        count(counters, TRIANGLES, 1)
        tested = mask & ~hits & ~_on_triangle(tree, rays, r, slot)
        if tested == 0:
            continue
        lanes = lanes_from(o, span, triangle_in(tree.corners, slot))
        if facing != 0:
            tested &= ~bits(lanes.t * np.float32(facing) > lanes.te)
            if tested == 0:
                continue
        count(counters, CANDIDATES, 1)
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = decide(d, lanes, facing)
        unsure &= tested
        if unsure != 0:
            defer(deferred, slot, r * rays.row_place, rays.lane_place, unsure)
        hits |= hit & tested
        if hits == mask:
            break
    return hits


@inlined
def _walk_tree(tree, slabs, at, alive, row, scratch, counters):
    """`walk_tree` of a row."""
    before, n_deferred = alive, get(scratch.deferred, 0)
    at = next_leaf(tree, slabs, at, scratch.stack, alive, counters)
    while at.mask != 0 and get(scratch.deferred, 0) <= DEFERRED:
        alive &= ~trace_leaf(tree, row, at.link, at.mask, scratch.deferred, counters)
        at = next_leaf(tree, slabs, after_leaf(at), scratch.stack, alive, counters)
    blocks = alive != before or get(scratch.deferred, 0) != n_deferred
    return at if at.mask != 0 else not_started(), alive, blocks


@inlined
def _walk_one(tree, alive, row, scratch, counters):
    """`walk_trees` for a single tree."""
    at, slabs = load_saved(scratch.at, alive), _slabs(row, alive)
    at = at if at.place != NOT_STARTED else root(alive)
    at, alive, _ = _walk_tree(tree, slabs, at, alive, row, scratch, counters)
    save(scratch.at, at)
    return 0 if at.place != NOT_STARTED else 1, alive


@kernel
def _walk(trees, rays, r, i, end, facing, scratch, counters):
    """Trace row r through trees i .. end. Return the tree at which to continue once deferred tests are settled."""
    alive = open_rays(rays, r)
    i, alive = walk_trees(trees, i, end, alive, Row(rays, r, facing), scratch, counters)
    put(rays.dead, r, get(rays.dead, r) | (rays.lanes & ~alive))
    return i if alive != 0 else end


@kernel
def _trace_packets(ticket, prepared, query, samples, job, out, counters):
    """Worker: trace tiles, packet by packet."""
    scratch, trees = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS)), pointers(prepared)
    mine = cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        y, x = n // job.shape.columns * job.shape.height, n % job.shape.columns * job.shape.width
        if nothing_for(trees, y, x):
            continue
        rays = start_tile(job, chunk, n, scratch, places, mine)
        put(scratch.at, TREE, 0)
        left_rows = rays.rows
        while left_rows != 0:
            r = lowest_bit(left_rows)
            left_rows &= left_rows - 1
            i, end = trees_for(trees, y, x, r)
            save(scratch.at, not_started())
            while i < end:
                i = _walk(trees, rays, r, i, end, chunk.query.facing, scratch, mine)
                if i < end:
                    settle(tree_number(trees, get(scratch.at, TREE)), chunk, rays, scratch, mine)
        settle(tree_number(trees, get(scratch.at, TREE)), chunk, rays, scratch, mine)
        finish_tile(chunk, rays, places)
    add_counters(counters, mine)


@dataclass(frozen=True)
class Packets:
    """Answers queries by packets."""

    by_sample: bool  # whether a packet holds the samples of one receiver; otherwise those of 16 receivers

    def __call__(
        self,
        prepared: Bvh | BlockTree | TreeList,
        query: ShadowQuery,
        bits: NDArray[np.uint64],
        threads: int | None = None,
        counters: NDArray[np.int64] | None = None,
        progress: ProgressCallback | None = None,
        chunks: range | None = None,
    ) -> None:
        """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

        prepared : Bvh, BlockTree or TreeList
        bits : (h, w, ceil(spp / 64)) uint64. Zeros on entry; for a tree list that is not fresh, the samples blocked so
            far.
        counters : from `new_counters`, or None
        chunks : range of the chunks of 16 samples to trace; None: all
        """
        trees = single_tree(prepared) if isinstance(prepared, BlockTree) else prepared
        fresh = trees.fresh if isinstance(trees, TreeList) else True
        run = TileRun(_trace_packets, self.by_sample, threads, counters, progress, fresh, chunks)
        trace_tiles(run, trees, query, bits)


over_pixels, over_samples = Packets(False), Packets(True)


class PixelPackets(Tracer):
    """The tracer `packet16`."""

    description = "packets of 16 rays, from 16 receivers to a stratum of the light"
    paper = "Benthin and Wald 2009, Sec. 5.1; Wald et al. 2001, Interactive rendering with coherent ray tracing"
    cost = Cost(
        rate=FittedRate(
            2.92316, 0.134349, 0.0917487, -0.245442, 0.255471, -0.0693798, -0.235064, 0.22628, 0.0802161,
            0.0268578, 0.0342314, 0.00867928, 0.00206011, 0.00273895, 0.00529525, 0.00566451, 0.00767648,
            -0.0230685, 0.0316768, 0.0370606, -0.00345228, 0.0104784, 0.556035, 0.15455,
        ),
        reference=85.69,
    )  # fmt: skip

    by_sample = False  # as in `Packets`

    def trace(
        self,
        prepared: Bvh | BlockTree,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        trees = single_tree(prepared, fresh) if isinstance(prepared, BlockTree) else prepared
        trace_tiles(TileRun(_trace_packets, self.by_sample, threads, counters, progress, fresh), trees, query, bits)


class SamplePackets(PixelPackets):
    """The tracer `packet16:samples`."""

    description = "packets of 16 rays, from one receiver to its samples"
    paper = "Benthin and Wald 2009, Sec. 5.1"
    cost = Cost(
        rate=FittedRate(
            0.666935, 0.44402, 0.475742, -0.36235, 0.180498, -0.0149725, -0.501242, 1.17332, -0.0327143,
            -0.0356973, -0.041029, -0.0275577, 0.0484122, -0.00967019, -0.00345283, 0.00361997, 0.00058795,
            0.0221433, 0.101475, -0.106482, 0.00053436, -0.0466791, 0.729809, 0.168781,
        ),
        reference=53.69,
    )  # fmt: skip

    by_sample = True


class BlockPackets(PixelPackets):
    """The tracer `packet16:blocks`. `multifrusta` answers queries of hemispheres in the same way."""

    description = "packets of 16 rays, from 16 receivers to a stratum of the light, through a tree of blocks"
    paper = "Benthin and Wald 2009, Sec. 5.1"
    form = BLOCKS
    cost = Cost(
        rate=FittedRate(
            2.63117, 0.250952, 0.169241, -0.322107, 0.217891, -0.0743943, -0.340595, 0.4174, 0.0390486,
            -0.018888, 0.00218856, -0.0151553, -0.00759231, 0.0010476, 0.00217563, 0.00474611, 0.00860236,
            0.00302356, 0.0519416, 0.0540755, -0.00273902, -0.00305495, 0.689343, 0.248789,
        ),
        form=40.0,
        reference=74.34,
    )  # fmt: skip
