"""Multi-frusta tracing on a device [Benthin and Wald 2009]: a warp of shafts walks the tree with one stack.

Each thread holds a shaft: the segments from the receivers of a part of a tile (`shaft_parts`) to one light sample each,
all of one stratum. These are the lanes of the CPU's `multifrusta`. The threads of a subgroup, of any size, visit a node
if one of their shafts meets its box. They agree by ballots, so that the stack has the same links in all of them, beside
the thread's own bit. Per leaf and triangle, a thread decides whether its shaft surely misses it, or is surely blocked
as a whole; only otherwise it tests its segments one by one. Undecided tests are listed as those of single rays.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import EMPTY, bvh_leaf, link_at
from ...kernels.device import atomic_add, ballot, lane_index, thread_index
from ...kernels.exact.filters import FilterRays, filter_hits, larger, max_magnitude, smaller
from ...kernels.jit import F32Ptr, inlined, kernel
from ...kernels.simd import f32_at, get, i32_at, lowest_bit, popcount, put, splat1, stack_f32, stack_i32
from .device_rays import AGAIN, BLOCKED, TRACED, SampleBuffers, receiver_at, sample_state
from .device_shafts import Ends, cull_triangle, enter_boxes, shaft_of
from .device_traversal import STACK, VISITS, Work, counts_with, filter_triangle, list_pair
from .shaft_parts import PART, ShaftTiles, receiver_of

_STACK = 2 * STACK  # a link, and whether this thread's shaft meets its box
_INF, _ZERO, _ONE = np.float32(np.inf), np.float32(0.0), np.float32(1.0)


class _Segments(NamedTuple):
    """The segments of a thread: from the receivers of a part of a tile, one in each lane, to their samples s."""

    rays: SampleBuffers
    work: Work
    tiles: ShaftTiles
    at: int  # the first receiver of the tile
    s: int
    ends: F32Ptr  # float32, rows of x, y, z: the samples


@inlined
def _receiver_in(segments, lane):
    """The index of a lane's receiver."""
    return receiver_of(segments.tiles, segments.rays.w, segments.at, lane)


@inlined
def _number_of(segments, i):
    """The number of receiver i's segment in the chunk."""
    return i * segments.rays.spp + segments.s - segments.work.first


@inlined
def _lower3(a, b):
    return smaller(a[0], b[0]), smaller(a[1], b[1]), smaller(a[2], b[2])


@inlined
def _upper3(a, b):
    return larger(a[0], b[0]), larger(a[1], b[1]), larger(a[2], b[2])


@inlined
def _begin(segments, lanes):
    """Write the known states of the segments in `lanes` (bits), unless they are CLEAR, and the ends of the others.

    Return (bits of the segments to be traced, their `Ends`).
    """
    work, low, high = segments.work, (_INF, _INF, _INF), (-_INF, -_INF, -_INF)
    open_, o_low, o_high, l_low, l_high, shortest = 0, low, high, low, high, _INF
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        i = _receiver_in(segments, lane)
        r, j = receiver_at(segments.rays, i), _number_of(segments, i)
        l, state, undecided = sample_state(segments.rays, r, i, segments.s)
        answer = np.int64(state)
        if undecided and not list_pair(work, j, -1):
            answer = np.int64(AGAIN)
        if answer == BLOCKED or answer == AGAIN:
            put(i32_at(work.out), j, answer)
        if answer == TRACED:
            open_ |= 1 << lane
            o_low, o_high = _lower3(o_low, r.o), _upper3(o_high, r.o)
            l_low, l_high = _lower3(l_low, l), _upper3(l_high, l)
            shortest = smaller(shortest, max_magnitude((l[0] - r.o[0], l[1] - r.o[1], l[2] - r.o[2])))
            for axis in range(3):
                put(segments.ends, 16 * axis + lane, l[axis])
    if open_ == 0:
        o_low = o_high = (_ZERO, _ZERO, _ZERO)
        l_low = l_high = (_ONE, _ONE, _ONE)
    return open_, Ends(o_low, o_high, l_low, l_high, shortest)


@inlined
def _test_segments(segments, shaft, slot, triangle, prim, open_):
    """Test segments (bits) one by one against the triangle in a slot. Return those that are still open."""
    work, ends, left = segments.work, segments.ends, open_
    while left != 0:
        lane = lowest_bit(left)
        left &= left - 1
        i = _receiver_in(segments, lane)
        r, j = receiver_at(segments.rays, i), _number_of(segments, i)
        if r.id == prim:
            continue
        ray = FilterRays(
            splat1(r.o[0]), splat1(r.o[1]), splat1(r.o[2]), splat1(get(ends, lane) - r.o[0]),
            splat1(get(ends, 16 + lane) - r.o[1]), splat1(get(ends, 32 + lane) - r.o[2]), splat1(_ZERO), splat1(_ONE),
            shaft.unit, shaft.floor,
        )  # fmt: skip
        tests = filter_hits(ray, triangle)
        if tests.hits != 0 and counts_with(1 if tests.positive != 0 else -1, work.cull_faces):
            put(i32_at(work.out), j, BLOCKED)
            open_ &= ~(1 << lane)
        elif tests.unsure != 0 and not list_pair(work, j, slot):
            put(i32_at(work.out), j, AGAIN)
            open_ &= ~(1 << lane)
    return open_


@inlined
def _block(segments, prim, open_):
    """Mark segments (bits) as blocked by a triangle, unless it is their receiver's own. Return those still open."""
    left = open_
    while left != 0:
        lane = lowest_bit(left)
        left &= left - 1
        i = _receiver_in(segments, lane)
        if receiver_at(segments.rays, i).id != prim:
            put(i32_at(segments.work.out), _number_of(segments, i), BLOCKED)
            open_ &= ~(1 << lane)
    return open_


@inlined
def _test_leaf(tree, segments, shaft, link, open_):
    """Test segments (bits) against the triangles of a leaf. Return those that are still open."""
    leaf = bvh_leaf(link)
    for slot in range(leaf.first, leaf.first + leaf.count):
        if open_ == 0:
            break
        triangle, prim = filter_triangle(tree.triangles, slot)
        v = cull_triangle(shaft, triangle, segments.work.cull_faces)
        if v.cover != 0:
            open_ = _block(segments, prim, open_)
        elif v.miss == 0:
            open_ = _test_segments(segments, shaft, slot, triangle, prim, open_)
    return open_


@inlined
def _walk(tree, segments, shaft, open_):
    """Trace segments (bits) with the other threads of the subgroup.

    All threads take the same turns, because each of them depends on ballots alone.
    """
    nodes, links, stack, height = f32_at(tree.nodes), i32_at(tree.nodes), stack_i32(_STACK), 0
    link, mine, visits = np.int64(0), open_ != 0, np.int32(0)
    going = ballot(mine) != 0
    while going:
        while link >= 0:
            left, right, left_first = enter_boxes(nodes, link, shaft)
            left, right = left and mine, right and mine
            lefts, rights, visits = ballot(left), ballot(right), visits + np.int32(1)
            if lefts | rights == 0:
                link = np.int64(EMPTY)
                break
            first = lefts != 0
            if lefts != 0 and rights != 0:
                first = 2 * popcount(ballot(left and right and left_first)) >= popcount(lefts & rights)
                put(stack, 2 * height, get(links, link_at(link, 1 if first else 0)))
                put(stack, 2 * height + 1, np.int32(right if first else left))
                height += 1
            link, mine = np.int64(get(links, link_at(link, 0 if first else 1))), left if first else right
        if link != EMPTY and mine:
            open_ = _test_leaf(tree, segments, shaft, link, open_)
        going = False
        while height > 0 and not going:
            height -= 1
            link, mine = np.int64(get(stack, 2 * height)), get(stack, 2 * height + 1) != 0 and open_ != 0
            going = ballot(mine) != 0
    if lane_index() == 0 and visits != 0:
        atomic_add(i32_at(segments.work.counts), VISITS, visits)


@kernel
def trace_shafts(tree, rays, work, tiles):  # tree: TreeBuffers, rays: SampleBuffers, work: Work, tiles: ShaftTiles
    """Trace the segments of a chunk in one thread per part and sample: write the states that are not CLEAR."""
    k = thread_index()
    part, s = k // rays.spp, k % rays.spp
    at, lanes = np.int64(0), np.int64(0)
    if part < tiles.n:
        at = tiles.first + np.int64(get(i32_at(tiles.parts), PART * part))
        lanes = np.int64(get(i32_at(tiles.parts), PART * part + 1))
    segments = _Segments(rays, work, tiles, at, s, stack_f32(48))
    open_, ends = _begin(segments, lanes)
    _walk(tree, segments, shaft_of(tree, ends), open_)
