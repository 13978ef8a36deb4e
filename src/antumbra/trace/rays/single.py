"""`single` and `wide`: one shadow ray at a time, over the binary BVH or a wide one, by the same loop.

`single` is the baseline. Every other tracer must agree with it bit for bit. Variants such as `single:random` differ
only in the order of children (`orders`).
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import Tree, tree_of
from ...bvh.wide import WideBvh, wide_tree_of
from ...kernels.fields import F32Ptr, I32Ptr
from ...kernels.jit import inlined, kernel, overload
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.predicate.exact import segment
from ...kernels.simd import get, ptr, stack_i64
from ...kernels.vec import scalars
from ...query.receivers import NOTHING
from ...query.shadow_query import horizon_of, is_above, patch_of, query_pointers, sample_of, set_bit
from ..counters import BELOW_HORIZON, N_COUNTERS, RAYS, REPEAT_HITS, add_counters, cleared_if, count, new_counters
from .interleaved import any_hit_wide
from .orders import BUILT, Ordered
from .traverse import triangle_hit, walk

TILE = 16  # side of a tile in pixels; one thread traces a tile's pixels one after the other


def as_built(bvh, threads=None) -> Ordered:
    """A `Bvh` whose children are visited as its builder chose."""
    return Ordered(bvh, BUILT)


class OrderedTree(NamedTuple):
    """Pointers to the arrays of an `Ordered`'s BVH, and its order."""

    tree: Tree
    prim_ids: I32Ptr  # int32 *
    corners: F32Ptr  # float32 *, 9 a triangle
    order: int


def pointers(prepared):
    """In kernels: the `OrderedTree` of an `Ordered`, the `WideTree` of a `WideBvh`."""


def any_hit(tree, ray, skip, cull_faces, counters):
    """In kernels: the slot of a triangle that the ray meets, or -1. The type of the tree chooses the walk."""


@inlined
def _ordered_tree(prepared):
    tree = tree_of(prepared.bvh)
    return OrderedTree(tree, tree.prim_ids, tree.corners, np.int64(prepared.order))


@overload(pointers)
def _pointers(prepared):
    if prepared.instance_class is Ordered:
        return lambda prepared: _ordered_tree(prepared)
    return lambda prepared: wide_tree_of(prepared)


@overload(any_hit)
def _any_hit(tree, ray, skip, cull_faces, counters):
    if tree.instance_class is OrderedTree:
        return lambda tree, ray, skip, cull_faces, counters: walk(
            tree.tree, ray, skip, cull_faces, tree.order, None, counters
        )[0]
    return lambda tree, ray, skip, cull_faces, counters: any_hit_wide(tree, ray, skip, cull_faces, counters)


@inlined
def _blocked(tree, ray, skip, cull_faces, last, counters):
    """Slot of a triangle that blocks the ray, or -1. `last`, the slot that blocked the ray before, is tested first."""
    if last >= 0 and get(tree.prim_ids, last) != skip:
        o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
        d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
        if triangle_hit(tree.corners, last, ray, o, d, cull_faces, counters):
            count(counters, REPEAT_HITS, 1)
            return last
    return any_hit(tree, ray, skip, cull_faces, counters)


@inlined
def _shadow_pixel(tree, query, i, bits, last, counters):
    """Trace all samples of receiver i. Return the slot of the last blocker."""
    o, skip = scalars(query.origins, 3 * i, 1), np.int64(get(query.ids, i))
    patch, horizon = patch_of(query, i), horizon_of(query, i)
    count(counters, RAYS, query.spp)
    for s in range(query.spp):
        lx, ly, lz = sample_of(query, patch, i, s)
        if not is_above(horizon, lx, ly, lz, query.corners):
            count(counters, BELOW_HORIZON, 1)
        else:
            ray = segment(o.x, o.y, o.z, lx, ly, lz)
            if ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0:  # an empty segment, which float32 could not decide
                continue
            slot = _blocked(tree, ray, skip, query.facing, last, counters)
            if slot < 0:
                continue
            last = slot
        set_bit(query, bits, i, s)
    return last


@kernel
def _shadow_tiles(ticket, prepared, query, bits, counters):
    chunk, out = query_pointers(query), ptr(bits)
    h, w = chunk.h, chunk.w
    columns = (w + TILE - 1) // TILE
    mine, tree = cleared_if(counters, stack_i64(N_COUNTERS)), pointers(prepared)
    for tile in items(ticket):
        y0, x0 = tile // columns * TILE, tile % columns * TILE
        last = np.int64(-1)  # reset for each tile, so that counts do not depend on threads
        for y in range(y0, min(y0 + TILE, h)):
            for x in range(x0, min(x0 + TILE, w)):
                if get(chunk.sides, y * w + x) != NOTHING:
                    last = _shadow_pixel(tree, chunk, y * w + x, out, last, mine)
    add_counters(counters, mine)


def trace_shadow(prepared, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery over an `Ordered` or a `WideBvh`: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    if counters is None and isinstance(prepared, WideBvh):
        counters = new_counters()  # counting is free here; the binary walk takes twice as long when it counts
    h, w = query.sides.shape
    tiles = -(-h // TILE) * -(-w // TILE)
    run(
        _shadow_tiles,
        thread_count(threads),
        new_ticket(tiles, 1),
        prepared,
        query,
        bits,
        counters,
        progress=progress,
    )
