"""`ploc`: a BVH by parallel locally-ordered clustering [Meister and Bittner 2018b].

Triangles are sorted by Morton codes, and each is a cluster at first. In a round, every cluster finds its nearest
neighbour among the RADIUS clusters on either side: the one with which it has the common box of the smallest area. Two
that are nearest to each other merge, and take the place of the first. Rounds follow until one cluster is left. Then
subtrees of few triangles become leaves where that is no dearer.

Threads cluster ranges of the sorted triangles independently, and one thread the roots of all ranges.

Departures from the paper: neighbours are compared sixteen at a time, for which every coordinate has a row of its own.
Ties go to the neighbours 2 k and 2 k + 1, then to the first neighbour, so that some pair always merges. And where the
tree could become too deep, clusters 2 k and 2 k + 1 merge whatever their boxes, which halves the number of clusters.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overload
from ..kernels.parallel import thread_count
from ..kernels.simd import (
    as_i32,
    bits,
    extract,
    gather,
    get,
    iota16,
    load8,
    load16,
    mask_from_bits16,
    minimum,
    popcount,
    prefetch,
    ptr,
    ptr_at,
    put,
    select,
    shuffle,
    splat16,
    stack_i32,
    stack_i64,
    store,
    store_compressed,
)
from .binned_split import source_of
from .lbvh import sort_by_codes, split_top
from .nodes import LINK, MAX_DEPTH, MAX_LEAF, Bvh, bvh_link, line_at, link_at, order_at
from .top_down import build_below, build_range, copy_corners, largest_subtree
from .top_levels import UpperLevels, assemble, join_boxes
from .triangle_bounds import INF, area_scale_for, checked_vertices, scene_bounds, triangle_box, trivial_bvh

# --- The clusters of a range ------------------------------------------------------------------------------------------


RADIUS = 4
_LANES = 16
_MARGIN = 2 * _LANES  # words before and after a row of active clusters, which are read but do not count
_ROWS = 6  # lower x, y, z, -upper x, y, z: one `minimum` joins two boxes
_ACTIVE_WORDS = _ROWS + 2
_MERGED_WORDS = 2 * (_ROWS + 5)  # there are up to twice as many clusters as triangles
_EVEN, _NEXT, _PREVIOUS, _SAME = 0x5555, np.int32(1), np.int32(-1), np.int32(0)


class Active(NamedTuple):
    """The clusters that are yet to be merged, in order."""

    rows: F32Ptr  # float32 *: the boxes, _ROWS rows
    stride: int  # words from one row to the next
    ids: I32Ptr
    offsets: I32Ptr  # from a cluster to its nearest neighbour: -RADIUS to RADIUS


class Forest(NamedTuple):
    """All clusters: the triangles in order, then those made of two, children first."""

    rows: F32Ptr  # float32 *: the boxes, _ROWS rows
    stride: int
    costs: F32Ptr  # SAH cost of the subtree
    left: I32Ptr  # child; of a triangle, ~slot
    right: I32Ptr
    sizes: I32Ptr  # triangles
    nodes: I32Ptr  # of the subtree; 0: it is a leaf


@inlined
def _active_in(memory, room):
    """The memory for the active clusters, fewer than room - 2 * _MARGIN."""
    ids = as_i32(ptr_at(memory, _ROWS * room))
    return Active(ptr_at(memory, _MARGIN), room, ids, ptr_at(ids, room + _MARGIN))


@inlined
def _forest_in(memory, room):
    """The memory for all clusters."""
    stride, rows = 2 * room, ptr_at(memory, _ACTIVE_WORDS * room)
    costs = ptr_at(rows, _ROWS * stride)
    left = as_i32(ptr_at(costs, stride))
    return Forest(rows, stride, costs, left, ptr_at(left, stride), ptr_at(left, 2 * stride), ptr_at(left, 3 * stride))


def _words_for(n: int) -> tuple[int, int]:
    """(room, float32 of memory) for `n` clusters at first."""
    room = n + 3 * _MARGIN
    return room, (_ACTIVE_WORDS + _MERGED_WORDS) * room


@inlined
def _begin(active, forest, k, slot, box):
    """Add a triangle as cluster `k`."""
    for axis in range(3):
        lower, upper = extract(box, axis), extract(box, axis + 4)
        put(active.rows, axis * active.stride + k, lower)
        put(active.rows, (axis + 3) * active.stride + k, upper)
        put(forest.rows, axis * forest.stride + k, lower)
        put(forest.rows, (axis + 3) * forest.stride + k, upper)
    put(active.ids, k, k)
    put(forest.left, k, ~slot)
    put(forest.sizes, k, 1)
    put(forest.nodes, k, 0)


# --- Rounds -----------------------------------------------------------------------------------------------------------


@inlined
def _load(active, row, i):
    return load16(active.rows, row * active.stride + i)


@inlined
def _boxes(active, i):
    """The rows of sixteen clusters."""
    lower = _load(active, 0, i), _load(active, 1, i), _load(active, 2, i)
    return *lower, _load(active, 3, i), _load(active, 4, i), _load(active, 5, i)


@inlined
def _common_area(active, boxes, i, scale):
    """Half the area of the common boxes of sixteen clusters and of those from `i` on; inf outside all clusters."""
    x = (minimum(boxes[0], _load(active, 0, i)) + minimum(boxes[3], _load(active, 3, i))) * scale
    y = (minimum(boxes[1], _load(active, 1, i)) + minimum(boxes[4], _load(active, 4, i))) * scale
    z = (minimum(boxes[2], _load(active, 2, i)) + minimum(boxes[5], _load(active, 5, i))) * scale
    return x * (y + z) + y * z  # sides are negated, but products of pairs have the right sign


@kernel
def _find_nearest(active, m, scale):
    """Find the nearest neighbour of each of `m` clusters; scale, as in `PlocSettings`."""
    # In, out: active, an `Active`
    for i in range(0, m, _LANES):
        boxes = _boxes(active, i)
        is_even = mask_from_bits16(_EVEN)
        after, before = _common_area(active, boxes, i + 1, scale), _common_area(active, boxes, i - 1, scale)
        least, offsets = select(is_even, after, before), select(is_even, splat16(_NEXT), _PREVIOUS)
        for k in range(2 * RADIUS):
            offset = k - RADIUS + np.int64(k >= RADIUS)
            area = _common_area(active, boxes, i + offset, scale)
            nearer = area < least
            least, offsets = select(nearer, area, least), select(nearer, splat16(np.int32(offset)), offsets)
        store(active.offsets, i, offsets)


@kernel
def _pair_neighbours(active, m):
    """Let clusters 2 k and 2 k + 1 of the `m` clusters of an `Active` be nearest to each other."""
    # In, out: active
    for i in range(0, m, _LANES):
        store(active.offsets, i, select(mask_from_bits16(_EVEN), splat16(_NEXT), _PREVIOUS))


@inlined
def _ranks(mask):
    """The number of set lanes before each lane."""
    ones = select(mask, splat16(_NEXT), _SAME)
    x = ones
    x += select(mask_from_bits16(0xFFFE), shuffle(x, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14), _SAME)
    x += select(mask_from_bits16(0xFFFC), shuffle(x, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13), _SAME)
    x += select(mask_from_bits16(0xFFF0), shuffle(x, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11), _SAME)
    x += select(mask_from_bits16(0xFF00), shuffle(x, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7), _SAME)
    return x - ones


@kernel
def _merge_pairs(active, m, forest, next_id):
    """Merge clusters that are nearest to each other, close the gaps, and return (clusters left, next free cluster)."""
    # In, out: active, an `Active` of `m` clusters; forest, a `Forest`, where merged ones begin at `next_id`
    left_over = 0
    store(active.offsets, m, splat16(_SAME))
    for i in range(0, m, _LANES):
        offsets, ids = load16(active.offsets, i), load16(active.ids, i)
        partners = iota16() + np.int32(i) + offsets
        are_nearest = offsets + gather(active.offsets, partners) == _SAME
        merge = are_nearest & (offsets > _SAME)
        stay = (iota16() < np.int32(m - i)) & ~(are_nearest & (offsets < _SAME))
        for row in range(_ROWS):
            bounds = ptr_at(active.rows, row * active.stride)
            alone = load16(bounds, i)
            joined = minimum(alone, gather(bounds, partners))
            store_compressed(forest.rows, row * forest.stride + next_id, merge, joined)
            store_compressed(bounds, left_over, stay, select(merge, joined, alone))
        store_compressed(forest.left, next_id, merge, ids)
        store_compressed(forest.right, next_id, merge, gather(active.ids, partners))
        store_compressed(active.ids, left_over, stay, select(merge, _ranks(merge) + np.int32(next_id), ids))
        next_id += popcount(bits(merge))
        left_over += popcount(bits(stay))
    return left_over, next_id


@inlined
def _surround(active, m):
    """Surround the clusters with boxes that are nearest to none."""
    for row in range(_ROWS):
        bounds = ptr_at(active.rows, row * active.stride)
        store(bounds, -_LANES, splat16(-INF))
        store(bounds, m, splat16(-INF))
        store(bounds, m + _LANES, splat16(-INF))


@kernel
def _cluster(active, m, rounds, forest, scale):
    """Merge `m` clusters in at most `rounds` rounds, and return the number of all clusters; the last is the root."""
    # In, out: active, an `Active`, and forest, a `Forest`, of the clusters; scale, as in `PlocSettings`
    next_id = m
    while m > 1:
        _surround(active, m)
        rounds -= 1
        if (m - 1) >> rounds > 0:  # fewer rounds may not suffice for what a round leaves
            _pair_neighbours(active, m)
        else:
            _find_nearest(active, m, scale)
        m, next_id = _merge_pairs(active, m, forest, next_id)
    return next_id


# --- Subtrees ---------------------------------------------------------------------------------------------------------


TOP_ROUNDS = 24
_ROUNDS = MAX_DEPTH - TOP_ROUNDS  # of a range: a round adds at most one level
_AHEAD = 64  # prefetch distance in triangles
_STACK_SIZE = 3 * (MAX_DEPTH + 1)
_LEAF_STACK = MAX_LEAF + 1


class SortedTriangles(NamedTuple):
    """Triangles in the order of their codes, for `build_below`."""

    ids: NDArray[np.int32]  # (n,) int32: the triangle of each slot
    roots: NDArray[np.float32]  # (s, 16) float32: the first eight are the box of each range's root, an output
    room: np.int64  # of `_words_for`


class SortedSource(NamedTuple):
    """Pointers to the arrays of `SortedTriangles`, and scratch memory."""

    ids: I32Ptr
    roots: F32Ptr
    room: int
    scratch: F32Ptr


class PlocSettings(NamedTuple):
    """Settings for all ranges of a scene."""

    max_leaf: np.int64
    scale: np.float32  # a power of two that scales the largest coordinate to about 1, so that no area overflows


@overload(source_of)
def _source_of(method, depth, scratch):
    if method.instance_class is SortedTriangles:

        def source(method, depth, scratch):
            return SortedSource(ptr(method.ids), ptr(method.roots), method.room, scratch)

        return source


@inlined
def _half_area(forest, k, scale):
    rows, stride = forest.rows, forest.stride
    x = (get(rows, k) + get(rows, 3 * stride + k)) * scale
    y = (get(rows, stride + k) + get(rows, 4 * stride + k)) * scale
    z = (get(rows, 2 * stride + k) + get(rows, 5 * stride + k)) * scale
    return x * (y + z) + y * z


@kernel
def _choose_leaves(forest, n, end, settings):
    """Count triangles and nodes. A node and a triangle cost 1 each to visit; of equals, the leaf is chosen."""
    # In, out: forest, a `Forest` of `n` triangles and `end` clusters; settings, `PlocSettings`
    for k in range(n):
        put(forest.costs, k, _half_area(forest, k, settings.scale))
    for k in range(n, end):
        left, right, area = get(forest.left, k), get(forest.right, k), _half_area(forest, k, settings.scale)
        size = get(forest.sizes, left) + get(forest.sizes, right)
        nodes = get(forest.nodes, left) + get(forest.nodes, right) + 1
        cost, cost_of_leaf = area + get(forest.costs, left) + get(forest.costs, right), area * np.float32(size)
        if size <= settings.max_leaf and cost_of_leaf <= cost:
            cost, nodes = cost_of_leaf, 0
        put(forest.costs, k, cost)
        put(forest.sizes, k, size)
        put(forest.nodes, k, nodes)


@kernel
def _write_leaf(forest, ids, k, slot, out):
    """Write the triangles of cluster `k`, a leaf, from `slot` on, and return its link."""
    # In: forest, a `Forest`; ids, of `SortedSource`
    # Out: out, a `Tree`: prim_ids
    stack, height, first = stack_i32(_LEAF_STACK), 1, slot
    put(stack, 0, k)
    while height > 0:
        height -= 1
        k = get(stack, height)
        left = get(forest.left, k)
        if left < 0:
            put(out.prim_ids, slot, get(ids, ~left))
            slot += 1
            continue
        put(stack, height, get(forest.right, k))
        put(stack, height + 1, left)
        height += 2
    return bvh_link(first, slot - first)


@inlined
def _write_boxes(forest, left, right, node, out):
    """Write the boxes of both children to a node."""
    for axis in range(3):
        lower, word = ptr_at(forest.rows, axis * forest.stride), line_at(node) + 4 * axis
        upper = ptr_at(lower, 3 * forest.stride)
        put(out.nodes, word, get(lower, left))
        put(out.nodes, word + 1, get(lower, right))
        put(out.nodes, word + 2, -get(upper, left))
        put(out.nodes, word + 3, -get(upper, right))
    put(out.links, order_at(node), 0)
    put(out.links, order_at(node) + 1, 0)


@kernel
def _write_subtree(forest, ids, root, first, out):
    """Write the nodes from 1 on and the slots from `first` on, depth first. Return the link to cluster `root`."""
    # In: forest, a `Forest`; ids, of `SortedSource`
    # Out: out, a `Tree`: nodes, links, prim_ids
    if get(forest.nodes, root) == 0:
        return _write_leaf(forest, ids, root, first, out)
    stack, height = stack_i64(_STACK_SIZE), 3
    put(stack, 0, root)
    put(stack, 1, 1)
    put(stack, 2, first)
    while height > 0:
        height -= 3
        k, node, slot = get(stack, height), get(stack, height + 1), get(stack, height + 2)
        left, right = get(forest.left, k), get(forest.right, k)
        _write_boxes(forest, left, right, node, out)
        next_node, next_slot = node + 1 + get(forest.nodes, left), slot + get(forest.sizes, left)
        for side in (1, 0):  # the left child is visited next
            child, child_node = (left, node + 1) if side == 0 else (right, next_node)
            child_slot = slot if side == 0 else next_slot
            if get(forest.nodes, child) == 0:
                put(out.links, link_at(node, side), _write_leaf(forest, ids, child, child_slot, out))
                continue
            put(out.links, link_at(node, side), child_node)
            put(stack, height, child)
            put(stack, height + 1, child_node)
            put(stack, height + 2, child_slot)
            height += 3
    return 1


@kernel
def _build_range(vertices, source, first, last, settings, s, out):
    """Cluster the triangles in slots `first` to `last` - 1, which are range `s`, and return the number of nodes."""
    # In: vertices, float32 *, 9 per triangle; source, a `SortedSource`; settings, `PlocSettings`
    # Out: source.roots; out, a `Tree`, as for `build_range`
    active, forest = _active_in(source.scratch, source.room), _forest_in(source.scratch, source.room)
    for slot in range(first, last):
        ahead = get(source.ids, min(slot + _AHEAD, last - 1)) * 9
        prefetch(vertices, ahead)
        prefetch(vertices, ahead + 8)
        _begin(active, forest, slot - first, slot, triangle_box(vertices, get(source.ids, slot)))
    end = _cluster(active, last - first, _ROUNDS, forest, settings.scale)
    _choose_leaves(forest, last - first, end, settings)
    for row in range(_ROWS):
        put(source.roots, s * 16 + row + row // 3, get(forest.rows, row * forest.stride + end - 1))
    put(out.links, LINK, _write_subtree(forest, source.ids, end - 1, first, out))
    copy_corners(vertices, first, last, out)
    return get(forest.nodes, end - 1)


@overload(build_range)
def _build_range_of(vertices, source, part, settings, s, out):
    if settings.instance_class is PlocSettings:

        def build(vertices, source, part, settings, s, out):
            return _build_range(vertices, source, part.first, part.last, settings, s, out)

        return build


# --- The whole tree ---------------------------------------------------------------------------------------------------


_PER_THREAD = 65536  # triangles: with fewer, waking a thread several times takes longer than its work


@kernel
def _cluster_roots(roots, scale, room, memory, children):
    """Cluster the roots of all ranges, and fill `children`, as in `UpperLevels`: parents first."""
    # In: roots, (s, 16) float32; scale, as in `PlocSettings`; room, of `_words_for`
    # Scratch: memory
    n, t = len(roots), len(children)
    active, forest = _active_in(ptr(memory), room), _forest_in(ptr(memory), room)
    for k in range(n):
        _begin(active, forest, k, k, load8(roots, k * 16))
    _cluster(active, n, TOP_ROUNDS, forest, scale)
    for i in range(t):
        k = n + t - 1 - i  # children were made first
        left, right = get(forest.left, k), get(forest.right, k)
        children[i, 0] = ~left if left < n else n + t - 1 - left
        children[i, 1] = ~right if right < n else n + t - 1 - right


def build(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build a BVH by locally-ordered clustering. The tree is bitwise identical for any number of threads.

    Parameters
    ----------
    vertices, threads, max_leaf
        As for `binned_sah.build`, as are the errors and the result.
    """
    flat, threads = checked_vertices(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    if n < 2:
        return trivial_bvh(flat)
    threads = min(threads, 1 + n // _PER_THREAD)
    box, centroids = scene_bounds(flat, threads)
    codes, ids = sort_by_codes(flat, 10, threads, centroids)
    ranges = split_top(codes, np.int64(0), largest_subtree(n))[1]
    s = len(ranges)
    room, words = _words_for(int((ranges[:, 1] - ranges[:, 0]).max()))
    settings = PlocSettings(np.int64(min(max_leaf, n - 1)), area_scale_for(box))  # the root is never a leaf
    top = UpperLevels(
        np.empty((s - 1, 2, 8), np.float32),
        np.empty((s - 1, 2), np.int64),
        np.column_stack([ranges, np.zeros(s, np.int64)]),
        np.zeros((s, 16), np.float32),
    )
    method = SortedTriangles(ids, top.range_boxes, np.int64(room))
    bvh, subtrees = build_below(flat, method, words, top, settings, threads)
    room, words = _words_for(s)
    _cluster_roots(top.range_boxes, settings.scale, np.int64(room), np.empty(words, np.float32), top.children)
    join_boxes(top.children, np.ascontiguousarray(top.range_boxes[:, :8]), top.boxes)
    return assemble(bvh, top, subtrees, threads)
