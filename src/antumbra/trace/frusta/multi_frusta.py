"""`multifrusta`: multi-frusta tracing of soft shadows [Benthin and Wald 2009].

Shafts of shadow rays traverse a shallow BVH, 16 at a time. Single rays are tested only where shafts are undecided.
Queries that shafts cannot handle well go to packets (`trace_shadow`).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.block_tree import BlockTree
from ...bvh.nodes import boxes_of
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import get, lowest_bit, popcount, ptr, put, stack_f32, stack_i32, stack_i64
from ...query.shadow_query import ShadowQuery
from ...scene.lights import is_list
from ..counters import N_COUNTERS, TILE_GROUP_TILES, add_counters, cleared, count, new_counters
from ..horizon import apply_horizon
from ..light_table import STRATA, light_table
from ..packets.packet16 import over_pixels, over_samples
from ..packets.ray_tile import extents_of, is_far, is_huge, is_incoherent
from ..shafts import invalidate_inverses, invalidate_shafts, make_beams
from ..tile import (
    bound_receivers,
    finished_strata,
    first_pixel,
    move_light,
    query_chunk_of,
    read_bits,
    sets_of,
    tile_at,
    tile_shape,
    write_bits,
)
from ..tracer import BLOCKS, Bits, Box, Counters, Tracer
from ..tracer_cost import Cost, FittedRate
from ..tree_list import TreeList, is_idle, single_tree, tree_list_pointers
from .bundle import (
    AT,
    DEFERRED_INTS,
    LANES,
    PLACES,
    STACK,
    TILES,
    Bundle,
    Scratch,
    bundle_of,
    fill_lanes,
    finished_groups,
    reset_blockers,
    tile_group_of,
    tiles_to_fill,
    trace_lanes,
)
from .shaft_culling import WORK
from .tile_clusters import (
    MAX_TILES,
    PARTS_INTS,
    REGIONS,
    RUN,
    TRIAL_FLOATS,
    choose_group,
    corner_of,
    layout_of,
    list_parts,
    load_cluster,
    mark_unlisted,
    order_parts,
    parts_at,
    record_costs,
    reset_trials,
    runs,
    work_of,
)
from .tile_group import TILE_GROUP_FLOATS, finished, make_tile_group

_INTERLEAVED = 4  # least number of tiles in a bundle with separate shafts
_BUSY = 64  # least number of regions per thread for which threads take several regions at once


@inlined
def _start_tile(chunk, g, scratch, fresh, known, counters):
    """Prepare tile g, whose receivers are loaded. Return whether it has segments to trace.

    Unless `fresh`, the bits at `known` mark segments known to be blocked.
    """
    tile, valid = tile_at(scratch.tiles, g, chunk), get(scratch.valid, g)
    y0, x0 = first_pixel(scratch.places, g)
    bound_receivers(tile, valid)
    if not chunk.fixed:
        move_light(chunk, y0, x0, valid, tile)
    if fresh:
        apply_horizon(chunk, y0, x0, valid, tile, scratch.deferred, counters)
    else:
        read_bits(chunk, y0, x0, valid, tile, known)
    if finished_strata(tile, valid) == 0xFFFF:
        return False
    make_beams(tile)
    invalidate_inverses(tile)
    invalidate_shafts(tile)
    return True


@inlined
def _fill_slot(chunk, bundle, slot, g, scratch):
    """Put tile g in a slot of a bundle. Return bits of its lanes that have segments to trace."""
    tile = tile_at(scratch.tiles, g, chunk)
    put(scratch.slots, slot, g)
    fill_lanes(slot, tile, bundle, scratch.lanes)
    groups = ~finished_groups(tile, get(scratch.valid, g), bundle) & ((1 << bundle.groups) - 1)
    return groups << (slot * bundle.groups)


@inlined
def _bundle_separate(numbers, chunk, scratch):
    """Make a `Bundle` of the first tiles in `numbers` (bits), each with its own shafts.

    Return (bundle, bits of its live lanes, bits of the tiles left).
    """
    n = min(popcount(numbers), max(_INTERLEAVED, tiles_to_fill(chunk.n_samples)))
    bundle, alive = bundle_of(n, chunk.n_samples), 0
    for slot in range(n):
        alive |= _fill_slot(chunk, bundle, slot, lowest_bit(numbers), scratch)
        numbers &= numbers - 1
    return bundle, alive, numbers


@inlined
def _bundle_together(members, chunk, scratch, counters):
    """Make a `Bundle` of a tile group of `members` (bits). Return (bundle, bits of its live lanes)."""
    count(counters, TILE_GROUP_TILES, popcount(members))
    put(scratch.slots, 0, lowest_bit(members))
    bundle, tile_group = Bundle(1, np.int64(STRATA), 1, True), tile_group_of(scratch, chunk)
    make_tile_group(tile_group, members, chunk)
    fill_lanes(0, tile_group.union, bundle, scratch.lanes)
    return bundle, ~finished(tile_group) & 0xFFFF


@inlined
def _trace_parts(tree_list, n, chunk, scratch, known, counters):
    """Trace n tiles whose receivers are loaded; a tile group, if they form one, is traced first."""
    (y, x), live = first_pixel(scratch.places, 0), 0
    for g in range(n):
        if _start_tile(chunk, g, scratch, tree_list.fresh, known, counters):
            live |= 1 << g
    grouping, before = choose_group(chunk, scratch.tiles, live, scratch.trials), work_of(counters)
    members, separate = grouping.members, live & ~grouping.members
    while members | separate != 0:
        if members != 0:
            bundle, alive = _bundle_together(members, chunk, scratch, counters)
        else:
            bundle, alive, separate = _bundle_separate(separate, chunk, scratch)
        trace_lanes(tree_list, y, x, alive, chunk, bundle, scratch, counters)
        members = 0
    record_costs(scratch.trials, grouping, work_of(counters) - before, live)


@kernel
def _trace_areas(ticket, arrays, query, table, shape, layout, regions, k, n_samples, out, counters):
    """Worker: trace the areas of a picture, cluster by cluster.

    layout : RegionLayout
    regions : number of regions per area
    k : number of the chunk
    n_samples : number of samples in the chunk
    out : bits of all receivers
    """
    # In: query, table, shape, layout, regions, k, n_samples. Out: out, counters.
    scratch = Scratch(
        stack_f32(TILES), stack_f32(LANES), stack_f32(WORK), stack_f32(TILE_GROUP_FLOATS), stack_i32(STACK),
        stack_i32(MAX_TILES), stack_i32(MAX_TILES), stack_i32(PARTS_INTS), stack_i32(PLACES), stack_i32(AT),
        stack_i32(DEFERRED_INTS), stack_f32(TRIAL_FLOATS),
    )  # fmt: skip
    tree_list, mine = tree_list_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_of(query, table, shape, k, n_samples), ptr(out)
    parts, n_tiles, room = parts_at(scratch.parts), regions * MAX_TILES, tile_at(scratch.tiles, 0, chunk)
    put(scratch.deferred, 0, 0)
    reset_trials(scratch.trials)
    for at in items(ticket):
        y, x = corner_of(layout, at * regions)
        if y >= shape.rows or x >= shape.columns:  # a square of regions reaches beyond the picture
            continue
        idle = is_idle(tree_list, y * shape.height, x * shape.width)
        mark_unlisted(parts, n_tiles, 0 if idle else 0xFFFF)
        reset_blockers(scratch, -1)
        n = list_parts(chunk, layout, y, x, n_tiles, room, parts)
        while n > 0:
            order_parts(parts, n)
            for first in range(0, n, MAX_TILES):
                m = min(n - first, MAX_TILES)
                load_cluster(chunk, layout, y, x, first, m, scratch)
                _trace_parts(tree_list, m, chunk, scratch, places, mine)
                for g in range(m):
                    y0, x0 = first_pixel(scratch.places, g)
                    write_bits(chunk, y0, x0, get(scratch.valid, g), tile_at(scratch.tiles, g, chunk), places)
            n = list_parts(chunk, layout, y, x, n_tiles, room, parts)
    add_counters(counters, mine)


def trace_tree_list(
    tree_list: TreeList,
    query: ShadowQuery,
    bits: NDArray[np.uint64],
    threads: int | None = None,
    counters: NDArray[np.int64] | None = None,
    progress: ProgressCallback | None = None,
    chunks: range | None = None,
) -> None:
    """Trace shafts through the trees of a `TreeList`; other arguments as for `trace_shadow`.

    bits : zeros on entry; for a tree list that is not fresh, the segments blocked so far
    chunks : range of the chunks of 16 samples to trace; None: all
    """
    counters = new_counters() if counters is None else counters
    shape, spp = tile_shape(query), query.samples.shape[1]
    table, layout, n_threads = light_table(query, sets_of(shape)), layout_of(shape), thread_count(threads)
    regions = REGIONS if layout.rows * layout.columns >= _BUSY * n_threads else 1
    for chunk in range(-(-spp // STRATA)) if chunks is None else chunks:
        count = min(STRATA, spp - chunk * STRATA)
        ticket = new_ticket(runs(layout) * RUN // regions, 1)
        arrays = tree_list, query, table, shape, layout, regions, chunk, count, bits, counters
        run(_trace_areas, n_threads, ticket, *arrays, progress=progress)


BENTHIN = "Benthin and Wald 2009, Efficient ray traced soft shadows using multi-frusta tracing"


class MultiFrusta(Tracer):
    """The tracer `multifrusta`.

    Packets trace the queries for which shafts are unsuitable (`packets.ray_tile`): hemispheres, interleaved lists, huge
    lights, and coordinates too large for shafts.
    """

    description = "16 shafts of shadow rays at once, single rays only where shafts are undecided"
    paper = BENTHIN
    form = BLOCKS
    cost = Cost(
        rate=FittedRate(
            -3.88631, 0, 1.27162, -0.21158, 0.311555, -0.133284, -0.417633, 3.13619, 0.170438, 0.0597608,
            0.042275, 0.00412522, 0.0178118, 0.0179704, 0.00686525, 0.00853311, 0.0179585, 0, 0, 0.145412,
            0.00544167, -0.0785702, 0.476593, 0.115218,
        ),
        form=40.0,
        quick_overhead=0.12,
        tried=5.0,
        reference=14.27,
    )  # fmt: skip

    def suits(self, query: ShadowQuery, box: Box) -> bool:
        return not (is_incoherent(query) or is_far(query, box))

    def trace(
        self,
        prepared: BlockTree,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        trees = single_tree(prepared, fresh)
        if is_incoherent(query) or is_huge(query, extents_of(prepared)) or is_far(query, boxes_of(prepared.nodes[:1])):
            by_packets = over_samples if is_list(query.light) else over_pixels
            by_packets(trees, query, bits, threads, counters, progress)
            return
        trace_tree_list(trees, query, bits, threads, counters, progress)

    @property
    def trace_suited(self) -> Callable[..., None]:
        """With shafts to huge lights, too: `auto` compares times, where `trace` goes by a rule."""
        return _trace_by_shafts


trace_shadow = MultiFrusta().trace


def _trace_by_shafts(
    tree: BlockTree,
    query: ShadowQuery,
    bits: Bits,
    threads: int | None = None,
    counters: Counters | None = None,
    progress: ProgressCallback | None = None,
    fresh: bool = True,
) -> None:
    """Answer a query that suits shafts."""
    trace_tree_list(single_tree(tree, fresh), query, bits, threads, counters, progress)
