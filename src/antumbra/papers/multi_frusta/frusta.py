"""`multifrusta:paper`: multi-frusta tracing as published [Benthin and Wald 2009, Sec. 3 and 4, Appendix A].

The tracer `multifrusta` is this package's own variant. Here 16 frusta go through a shallow tree together. A frustum
begins at one receiver, and its base is the whole light. At leaves, corner rays cull frusta; then 16 rays of one frustum
are tested side by side. A frustum ends when all its rays are blocked.

Differences from the paper:

- Either side of a triangle blocks, unless the query culls faces. The paper always culls back faces.
- A majority of the frusta decides which child is nearer. Appendix A does not say how lanes that disagree decide.
- Intervals of directions that contain zero need no second test (see `trace.descent`).
- Float32 decides only certain cases.

Sec. 5.3 and Table 2 shrink frusta to their unblocked rays, in three ways. Each is a tracer: rays are tested against the
boxes of leaves, rectangles on the light shrink, and bounds of directions shrink as well.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ...bvh.blocks import block_pointers
from ...bvh.links import block_leaf, box_at, box_of_link_at
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items
from ...kernels.simd import bits, get, lowest_bit, ptr, splat16, stack_f32, stack_i32, stack_i64
from ...trace.counters import BOX_TESTS, N_COUNTERS, NODES, add_counters, cleared, count
from ...trace.descent import (
    entry,
    least_direction,
    left,
    meets_mixed,
    mixed_axis,
    popped,
    rays_as_shafts,
    root,
    save,
    saved,
    slabs_of,
)
from ...trace.packets.ray_tile import (
    SCRATCH_FLOATS,
    SCRATCH_INTS,
    directions_of,
    finish_tile,
    open_rays,
    origins_of,
    query_chunk_in,
    scratch_in,
    settle,
    start_tile,
    trace_tiles,
)
from ...trace.triangle_tests import DEFERRED
from .cornerrays import FRUSTA_FLOATS, frusta_as_shafts, make_frusta, shrink
from .frustaleaf import WORK, trace_block
from .order import entered_nearer, prefers_right

BLOCK = 4  # triangles in a leaf of the shallow tree, at most


class Shrinking(NamedTuple):
    """How a frustum shrinks to its unblocked rays (Sec. 5.3)."""

    leaf_boxes: bool = False  # test rays against the boxes of leaves (*Ray-AABB*)
    corners: bool = False  # after a leaf, compute corner rays from the unblocked rays (*CR*)
    directions: bool = False  # compute the bounds of directions from them too (*FS*)


@inlined
def open_frusta(rays):
    """Bits of the frusta that have an unblocked ray."""
    alive, left_rows = np.int64(0), rays.rows
    while left_rows != 0:
        r = lowest_bit(left_rows)
        left_rows &= left_rows - 1
        if open_rays(rays, r) != 0:
            alive |= np.int64(1) << r
    return alive


@kernel
def _reach_box(tree, place, mask, rays, counters):
    """Bits of the frusta in `mask` with an unblocked ray that meets a leaf's box."""
    reached, box = np.int64(0), box_of_link_at(place)
    while mask != 0:
        r = lowest_bit(mask)
        mask &= mask - 1
        s = rays_as_shafts(origins_of(rays, r), directions_of(rays, r))
        limit = least_direction(s)
        x = mixed_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, False)
        y = mixed_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, False)
        z = mixed_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, False)
        count(counters, BOX_TESTS, 1)
        if bits(meets_mixed(tree.nodes, box, x, y, z)) & open_rays(rays, r) != 0:
            reached |= np.int64(1) << r
    return reached


@inlined
def _next_leaf(tree, slabs, at, stack, alive, counters):
    """Walk from `at` to the next leaf that a frustum in `alive` meets, the nearer child first."""
    end = splat16(np.float32(1.0))
    at = popped(tree.links, at, stack, alive)
    while at.mask != 0 and at.link >= 0:
        count(counters, NODES, 1)
        count(counters, BOX_TESTS, 2)
        in_left, near_left = entry(tree.nodes, box_at(at.link, 0), slabs, end)
        in_right, near_right = entry(tree.nodes, box_at(at.link, 1), slabs, end)
        in_left, in_right = in_left & at.mask, in_right & at.mask
        turn = prefers_right(near_left, near_right, in_left & in_right) > 0
        at = popped(tree.links, entered_nearer(tree.links, at, in_left, in_right, turn, stack), stack, alive)
    return at


@kernel
def _walk(tree, rays, frusta, shrinking, facing, work, scratch, counters):
    """Continue the traversal. Return whether it must go on, with new bounds or after deferred tests are settled."""
    alive = open_frusta(rays)
    slabs = slabs_of(frusta_as_shafts(rays, frusta), alive)
    at = _next_leaf(tree, slabs, saved(scratch.at, alive), scratch.stack, alive, counters)
    while at.mask != 0:
        if np.int64(get(scratch.deferred, 0)) > DEFERRED:
            save(scratch.at, at)
            return True
        mask = at.mask
        if shrinking.leaf_boxes and block_leaf(at.link).count != 0:
            mask = _reach_box(tree, at.place, mask, rays, counters)
        if mask != 0:
            leaf = trace_block(tree, at.link, mask, rays, frusta, facing, work, scratch.deferred, counters)
            alive &= ~leaf.done
            if shrinking.corners and leaf.struck != 0:
                shrink(rays, frusta, leaf.struck, shrinking.directions, counters)
                if shrinking.directions:
                    save(scratch.at, left(at))
                    return True
        at = _next_leaf(tree, slabs, left(at), scratch.stack, alive, counters)
    return False


@kernel
def _trace_frusta(ticket, arrays, query, samples, job, out, counters, shrinking):
    """Worker: trace tiles."""
    scratch = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS))
    own, work = stack_f32(FRUSTA_FLOATS), stack_f32(WORK)
    tree, mine = block_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, mine)
        frusta = make_frusta(chunk, samples, job, rays, own)
        save(scratch.at, root(open_frusta(rays)))
        while _walk(tree, rays, frusta, shrinking, chunk.query.facing, work, scratch, mine):
            if np.int64(get(scratch.deferred, 0)) > DEFERRED:
                settle(tree, chunk, rays, scratch, mine)
        settle(tree, chunk, rays, scratch, mine)
        finish_tile(chunk, rays, places)
    add_counters(counters, mine)


def trace_shadow(shrinking, tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    shrinking : Shrinking
    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_tiles(_trace_frusta, tree, query, True, bits, threads, counters, progress, shrinking)


as_published = partial(trace_shadow, Shrinking())
with_leaf_boxes = partial(trace_shadow, Shrinking(leaf_boxes=True))
with_corners = partial(trace_shadow, Shrinking(corners=True))
with_all = partial(trace_shadow, Shrinking(corners=True, directions=True))
