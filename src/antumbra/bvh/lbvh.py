"""`lbvh`: a BVH from Morton codes, built in parallel [Karras 2012], after [Lauterbach et al. 2009].

Triangles are sorted by the Morton codes of their centroids. A node is a range of triangles, split at the highest
differing bit. As in the paper, positions break ties between equal codes. The top levels are split top-down.

Threads then build the subtrees independently, each bottom-up from its last leaf to its first [Apetrei 2014]. The part
to the right of a gap waits on a stack until a higher gap closes it, so boxes are joined as nodes are created. Nodes are
counted first, and then written backwards from a subtree's last position, which puts them in depth-first order in the
final array.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short, thread_count
from ..kernels.simd import (
    get,
    highest_bit,
    load8,
    minimum,
    prefetch,
    ptr,
    put,
    splat8,
    stack_array,
    stack_f32,
    stack_i64,
    store,
)
from .morton_sort import Codes, grid_of, radix_sort, write_codes
from .nodes import MAX_DEPTH, Bvh, aligned_empty, bvh_link, link_at, tree_of
from .top_down import largest_subtree
from .top_levels import UpperLevels, join_boxes, place, top_lines
from .triangle_bounds import (
    INF,
    TRIANGLES_PER_SHARE,
    checked_vertices,
    scene_bounds,
    triangle_box,
    trivial_bvh,
    write_boxes,
)

_LEVELS = 96  # more than any tree has: 63 bits of a code and 28 of a position
_RANGES = _LEVELS + 1
_STACK_SIZE = 2 * _LEVELS
_BOXES = 8 * _LEVELS
_NO_LEVEL, _LOWEST = np.int64(2**63 - 1), np.int64(-(2**63))
_AHEAD = 64  # prefetch distance in triangles
_PER_THREAD = 131072  # triangles: with fewer, waking a thread ten times takes longer than its work


class SortedTriangles(NamedTuple):
    """Triangles in the order of their codes."""

    codes: NDArray[Codes]  # (n,) int32 or int64
    ids: NDArray[np.int32]  # (n,) int32: the triangle of each slot
    drop: np.int64  # number of low bits of the codes to ignore


class MortonForest(NamedTuple):
    """The subtrees below the top levels."""

    ranges: NDArray[np.int64]  # (s, 2) int64: first and last slot
    counts: NDArray[np.int64]  # (s,) int64: number of nodes
    places: NDArray[np.int64]  # (s,) int64: first node
    roots: NDArray[np.float32]  # (s, 8) float32: box of the root
    links: NDArray[np.int64]  # (s,) int64: link to the root
    heights: NDArray[np.int64]  # (s,) int64: nodes on the longest path


@inlined
def _level(codes, i, k, drop):
    """The height in the tree at which slots `i` and `k` separate. Only the order of these numbers is meaningful.

    It is the exclusive or of the two codes, since the gaps that are compared differ in its highest bit. Equal codes
    come below all others, ordered by the exclusive or of their positions.
    """
    differing = (get(codes, i) ^ get(codes, k)) >> drop
    return differing if differing != 0 else (i ^ k) - np.int64(1 << 32)


@kernel
def split_position(codes, first, last, drop):  # codes: pointer
    """The first slot of the right child of a range."""
    differing = np.int64(get(codes, first) ^ get(codes, last - 1)) >> drop
    if differing == 0:
        bit = highest_bit(first ^ (last - 1))
        return (last - 1) >> bit << bit
    bit = highest_bit(differing) + drop
    low, high = first, last - 1  # the bit is clear in `low`, set in `high`
    while high - low > 1:
        middle = (low + high) >> 1
        if (np.int64(get(codes, middle)) >> bit) & 1:
            high = middle
        else:
            low = middle
    return high


@kernel
def _cut_top(codes, drop, largest, children, ranges):
    """Fill the arrays of `split_top`, and return (number of nodes, number of ranges)."""
    stack = stack_array(np.int64, _RANGES, 4)  # first and last slot, parent, side
    stack[0] = 0, len(codes), -1, 0
    height, t, s = 1, 0, 0
    while height > 0:
        height -= 1
        first, last, parent, side = stack[height]
        is_node = last - first > largest
        if parent >= 0:
            children[parent, side] = t if is_node else ~s
        if not is_node:
            ranges[s, 0], ranges[s, 1] = first, last
            s += 1
            continue
        middle = split_position(ptr(codes), first, last, drop)
        stack[height] = middle, last, t, 1
        stack[height + 1] = first, middle, t, 0
        height += 2
        t += 1
    return t, s


def split_top(codes: NDArray[Codes], drop: np.int64, largest: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(children, ranges) of the nodes over more than `largest` triangles, as in `UpperLevels`; parents first."""
    capacity = len(codes) // largest * _LEVELS + 1
    children, ranges = np.empty((capacity, 2), np.int64), np.empty((capacity + 1, 2), np.int64)
    t, s = _cut_top(codes, drop, largest, children, ranges)
    return children[:t].copy(), ranges[:s].copy()


@inlined
def _leaf_before(codes, drop, max_leaf, first, end, after):
    """(start, level before it) of the leaf that ends at slot `end`, in a subtree that begins at slot `first`.

    It is the largest subtree there of at most `max_leaf` triangles. Levels within a subtree are lower than those on
    both sides of it; `after` is the level at `end`.
    """
    start, before, highest = end, after, _LOWEST
    for i in range(end - 1, max(end - max_leaf, first) - 1, -1):
        level = _level(codes, i - 1, i, drop) if i > first else _NO_LEVEL
        if highest < level and highest < after:
            start, before = i, level
        highest = max(highest, level)
    return start, before


@kernel
def _count_nodes(ticket, source, max_leaf, forest):
    """Worker: count the nodes of each subtree, one fewer than its leaves."""
    codes, drop = ptr(source.codes), source.drop
    for s in items(ticket):
        first, end = forest.ranges[s]
        after, count = _NO_LEVEL, -1
        while end > first:
            end, after = _leaf_before(codes, drop, max_leaf, first, end, after)
            count += 1
        forest.counts[s] = count


@inlined
def _write_leaf(vertices, ids, start, end, corners):
    """Copy the corners of the triangles `ids` in the slots of a leaf, and return their box."""
    box = splat8(INF)
    for i in range(end - 1, start - 1, -1):
        ahead, id_ = get(ids, max(i - _AHEAD, 0)) * 9, get(ids, i)
        prefetch(vertices, ahead)
        prefetch(vertices, ahead + 8)
        store(corners, i * 9, load8(vertices, id_ * 9))
        put(corners, i * 9 + 8, get(vertices, id_ * 9 + 8))
        box = minimum(box, triangle_box(vertices, id_))
    return box


@kernel
def _build_subtree(vertices, codes, drop, max_leaf, first, last, end_node, out):
    """Build the subtree of a range of slots, with its nodes just before `end_node`, and return (box, link, height)."""
    # In: vertices, float32 *, 9 per triangle; codes, pointer, sorted; drop, max_leaf; first, last, slots
    # Out: out, a `Tree`: nodes, links, and corners of the slots
    levels, stack, boxes = stack_i64(_LEVELS), stack_i64(_STACK_SIZE), stack_f32(_BOXES)
    ids, node, height, box, link, depth = out.prim_ids, end_node, 0, splat8(INF), 0, 0
    end, level = last, _NO_LEVEL
    while end > first:
        start, level = _leaf_before(codes, drop, max_leaf, first, end, level)
        box, link, depth = _write_leaf(vertices, ids, start, end, out.corners), bvh_link(start, end - start), 0
        end = start
        while height > 0 and get(levels, height - 1) <= level:  # equal only if it is _NO_LEVEL
            height -= 1
            right_box = load8(boxes, height * 8)
            node -= 1
            write_boxes(out.nodes, node, box, right_box)
            put(out.links, link_at(node, 0), link)
            put(out.links, link_at(node, 1), get(stack, height * 2))
            link, depth = node, max(depth, get(stack, height * 2 + 1)) + 1
            box = minimum(box, right_box)
        put(levels, height, level)
        put(stack, height * 2, link)
        put(stack, height * 2 + 1, depth)
        store(boxes, height * 8, box)
        height += 1
    return box, link, depth


@kernel
def _build_subtrees(ticket, vertices, source, max_leaf, forest, bvh):
    """Worker: build the nodes and corners of each subtree."""
    out = tree_of(bvh)
    for s in items(ticket):
        first, last = forest.ranges[s]
        box, link, height = _build_subtree(
            ptr(vertices),
            ptr(source.codes),
            source.drop,
            max_leaf,
            first,
            last,
            forest.places[s] + forest.counts[s],
            out,
        )
        store(forest.roots, s * 8, box)
        forest.links[s], forest.heights[s] = link, height


@kernel
def _depth(children, forest, heights):
    """The depth of the whole tree: nodes on its longest path. `heights` has a zero for each node of the top levels."""
    for t in range(len(children) - 1, -1, -1):
        for side in range(2):
            child = children[t, side]
            heights[t] = max(heights[t], (forest.heights[~child] if child < 0 else heights[child]) + 1)
    return heights[0] if len(children) else forest.heights[0]


def _build_from_codes(
    flat: NDArray[np.float32], source: SortedTriangles, max_leaf: int, threads: int
) -> tuple[Bvh, int]:
    """(Bvh, its depth) of sorted triangles."""
    n = len(flat)
    children, ranges = split_top(source.codes, source.drop, largest_subtree(n))
    t, s = len(children), len(ranges)
    numbers = [np.empty(s, np.int64) for _ in range(4)]
    forest = MortonForest(ranges, numbers[0], numbers[1], np.empty((s, 8), np.float32), numbers[2], numbers[3])
    run_short(_count_nodes, threads, new_ticket(s, 1), source, max_leaf, forest)
    node_at = np.empty(t, np.int64)
    nodes = aligned_empty((place(children, forest.counts, node_at, forest.places), 16), "f4")
    bvh = Bvh(nodes, nodes.view(np.int32), source.ids, aligned_empty((n, 9), "f4"))
    run_short(_build_subtrees, threads, new_ticket(s, 1), flat, source, max_leaf, forest, bvh)
    top = UpperLevels(np.empty((t, 2, 8), np.float32), children, ranges, forest.roots)
    join_boxes(children, forest.roots, top.boxes)
    nodes[node_at] = top_lines(top, node_at, forest.links)
    return bvh, int(_depth(children, forest, np.zeros(t, np.int64)))


def build(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4, bits: int = 10) -> Bvh:
    """Build a BVH from Morton codes. The tree is bitwise identical for any number of threads.

    Parameters
    ----------
    vertices, threads, max_leaf
        As for `binned_sah.build`, as are the errors and the result.
    bits : int
        Bits of a code per axis: 10 or 21.

    Notes
    -----
    Every subtree of at most `max_leaf` triangles is a leaf, except the root. 63-bit codes can make a tree deeper than
    MAX_DEPTH; then only as many leading bits are used as are safe.
    """
    flat, threads = checked_vertices(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    if n < 2:
        return trivial_bvh(flat)
    threads = min(threads, 1 + n // _PER_THREAD)
    max_leaf = min(max_leaf, n - 1)  # the root is never a leaf
    codes, ids = sort_by_codes(flat, bits, threads)
    bvh, depth = _build_from_codes(flat, SortedTriangles(codes, ids, np.int64(0)), max_leaf, threads)
    if depth > MAX_DEPTH:
        safe = MAX_DEPTH - (n - 1).bit_length()  # equal codes need as many levels as a position has bits
        bvh, depth = _build_from_codes(flat, SortedTriangles(codes, ids, np.int64(3 * bits - safe)), max_leaf, threads)
    return bvh


def sort_by_codes(
    flat: NDArray[np.float32], bits: int, threads: int, centroids: NDArray[np.float32] | None = None
) -> tuple[NDArray[Codes], NDArray[np.int32]]:
    """(codes, ids), (n,) each: the triangles `flat`, (n, 9) float32, sorted by codes of `bits` bits per axis.

    centroids : their centroid box, if it is known
    """
    n = len(flat)
    codes: NDArray[Codes] = aligned_empty((n,), "i4" if bits == 10 else "i8")
    ids = aligned_empty((n,), "i4")
    if centroids is None:
        centroids = scene_bounds(flat, threads)[1]
    run_short(write_codes, threads, new_ticket(n, TRIANGLES_PER_SHARE), flat, grid_of(centroids, bits), codes, ids)
    return radix_sort(codes, ids, 3 * bits, threads)


def build63(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """`build` with 63-bit codes."""
    return build(vertices, threads, max_leaf, 21)
