"""Refit a wide BVH to moved triangles.

A refitted wide BVH has a smaller binary BVH than it was made from: each group is a leaf. All boxes follow from those of
the groups, whose triangles are bounded eight at a time. Each child of a wide node has the box of a child of a binary
one, which is copied. Threads refit one small part of both trees at a time, which stays in the cache.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.array_pool import ArrayPool
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short
from ..kernels.simd import (
    get,
    load8,
    load16,
    minimum,
    prefetch,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    stack_array,
    stack_f32,
    store,
)
from ..kernels.transposition import transposed8
from .nodes import (
    BINARY,
    GROUP_WORDS,
    LINK,
    LINKS,
    MAX_DEPTH,
    NO_CHILD,
    NODE_WORDS,
    ORDER,
    WIDTH,
    Bvh,
    WideBvh,
    aligned_empty,
    bvh_leaf,
    bvh_link,
    is_leaf,
    link_at,
    order_at,
    wide_leaf,
    wide_link,
)
from .refit import write_top
from .tree_layout import TreeFrontier, cut_tree
from .triangle_bounds import write_boxes
from .wide_bvh import fill_node, group_box, reach_of_root, write_group

# --- What refits of a tree have in common -----------------------------------------------------------------------------


_PART = 512  # maximum nodes of the binary BVH in a part, so that both trees of a part fit in an L2 cache
_STACK_SIZE = MAX_DEPTH + 2
_BOXES = 8 * _STACK_SIZE
_AHEAD = 32  # prefetch distance in slots


class WideRefit(NamedTuple):
    """A wide BVH to be refitted, and its parts. Where a child of a binary node is no group, its group is -1."""

    wide: WideBvh  # without triangles and boxes; groups in the order of slots are the leaves of its binary BVH
    groups: NDArray[np.int32]  # (m, 2) int32: the group of each child of a binary node
    cut: TreeFrontier  # of the binary BVH, into s parts
    group_ranges: NDArray[np.int64]  # (s, 2) int64: first group of each part, and end
    nodes: NDArray[np.int32]  # (n_nodes,) int32: wide nodes by part; at the end those with boxes of several parts
    starts: NDArray[np.int64]  # (s + 2,) int64: where each part begins in `nodes`; their ends


@kernel
def _collapse_groups(links, slots, group_of, new_links, new_numbers, groups):
    """Write the binary BVH whose leaves are groups, without boxes, and return its number of nodes."""
    # In: links, (n, 16) int32; slots, (g, 8) int32; group_of, (2n,) int32: the group of child 2 * node + side, or -1
    # Out: new_links, (n, 16) int32; new_numbers, (n,) int32: the new number of each node; groups, of `WideRefit`
    stack = stack_array(np.int64, _STACK_SIZE, 2)  # node, 2 * new parent + side
    stack[0, 0], stack[0, 1] = 0, -1
    height, n = 1, 0
    while height > 0:
        height -= 1
        node, place = stack[height]
        if place >= 0:
            new_links[place >> 1, LINK + (place & 1)] = n
        new_numbers[node] = n
        new_links[n, ORDER], new_links[n, ORDER + 1] = links[node, ORDER], 0
        for side in (1, 0):
            group = np.int64(group_of[2 * node + side])
            groups[n, side] = group
            if group < 0:
                stack[height, 0], stack[height, 1] = links[node, LINK + side], 2 * n + side
                height += 1
                continue
            count = 0
            while count < WIDTH and slots[group, count] >= 0:
                count += 1
            new_links[n, LINK + side] = bvh_link(np.int64(slots[group, 0]), count)
        n += 1
    return n


def _with_group_leaves(wide: WideBvh) -> tuple[WideBvh, NDArray[np.int32]]:
    """`WideRefit.wide` and `groups` of a wide BVH. A group has consecutive slots, since all trees are depth first."""
    bvh, nodes = wide.bvh, aligned_empty(wide.nodes.shape, "f4")
    nodes[:] = wide.nodes
    links = nodes.view(np.int32)
    children, link = links[:, BINARY:], links[:, LINKS:BINARY]
    leaves = is_leaf(link) & (link != NO_CHILD)
    leaf, begins = wide_leaf(link[leaves]), np.zeros(len(bvh.prim_ids), np.bool_)
    begins[wide.slots[:, 0]] = True
    number = np.cumsum(begins, dtype=np.int32)[wide.slots[:, 0]] - 1
    slots = np.empty_like(wide.slots)
    slots[number] = wide.slots
    link[leaves] = wide_link(number[leaf.group], leaf.count)
    group_of = np.full(2 * len(bvh.nodes), -1, np.int32)
    group_of[children[leaves]] = number[leaf.group]
    lines, numbers = aligned_empty(bvh.nodes.shape, "f4"), np.empty(len(bvh.nodes), np.int32)
    groups = np.empty((len(bvh.nodes), 2), np.int32)
    m = _collapse_groups(bvh.links, slots, group_of, lines.view(np.int32), numbers, groups)
    children[:] = 2 * numbers[children >> 1] + (children & 1)
    lines = lines[:m].copy()
    collapsed = Bvh(lines, lines.view(np.int32), bvh.prim_ids, bvh.corners[:0].copy())
    old = wide.groups[:0].copy()  # triangles are not kept, since each refit writes them anew
    return WideBvh(nodes, links, old, slots, wide.reach, collapsed), groups[:m].copy()


def wide_refit(wide: WideBvh) -> WideRefit:
    """Prepare refits of a wide BVH of two triangles or more."""
    wide, groups = _with_group_leaves(wide)
    cut = cut_tree(wide.bvh, largest=_PART)
    s = len(cut.parts)
    part_of = np.full(len(wide.bvh.nodes), s, np.int32)
    for number, (root, end, _) in enumerate(cut.parts.tolist()):
        part_of[max(root, 0) : end if root >= 0 else 0] = number
    part = part_of[wide.links[:, BINARY:] >> 1]
    is_child = wide.links[:, LINKS:BINARY] != NO_CHILD
    lowest, highest = np.where(is_child, part, s).min(1), np.where(is_child, part, -1).max(1)
    of_nodes = np.where(lowest == highest, lowest, s)
    starts = np.concatenate([[0], np.cumsum(np.bincount(of_nodes, minlength=s + 1))])
    order = np.argsort(of_nodes, kind="stable").astype(np.int32)
    return WideRefit(wide, groups, cut, _group_ranges(cut, wide), order, starts)


def _group_ranges(cut: TreeFrontier, wide: WideBvh) -> NDArray[np.int64]:
    """`WideRefit.group_ranges`: parts are in the order of their slots, as groups are."""
    first_slots = np.empty(len(cut.parts), np.int64)
    for part, (link, _, _) in enumerate(cut.parts.tolist()):
        while not is_leaf(link):
            link = int(wide.bvh.links[link, LINK])
        first_slots[part] = bvh_leaf(link).first
    firsts = np.searchsorted(wide.slots[:, 0], first_slots)
    ends = np.append(np.sort(firsts), len(wide.slots))
    return np.stack([firsts, ends[np.searchsorted(ends, firsts, "right")]], 1)


# --- Refits -----------------------------------------------------------------------------------------------------------


class _Moved(NamedTuple):
    """Where triangles have moved, and the boxes of groups and parts."""

    vertices: NDArray[np.float32]  # (n, 9) float32
    wide: WideBvh  # output
    boxes: NDArray[np.float32]  # (n_groups, 8) float32, output
    part_boxes: NDArray[np.float32]  # (s, 8) float32, output


@inlined
def _copy_corners(slot, moved, last, lane):
    """Copy the corners of the triangle in a slot. Return their first eight numbers, and store the last to a lane."""
    ids, vertices, corners = ptr(moved.wide.bvh.prim_ids), ptr(moved.vertices), ptr(moved.wide.bvh.corners)
    end = len(moved.wide.bvh.prim_ids) - 1
    slot = min(slot, end)
    ahead, row = get(ids, min(slot + _AHEAD, end)) * 9, get(ids, slot) * 9
    prefetch(vertices, ahead)
    prefetch(vertices, ahead + 8)
    numbers, number = load8(vertices, row), get(vertices, row + 8)
    store(corners, slot * 9, numbers)
    put(corners, slot * 9 + 8, number)
    put(last, lane, number)
    return numbers


@inlined
def _move_group(group, moved, last):
    """Copy the corners of a group, write its rows, and its box; `last`: scratch memory.

    Whatever its number of triangles, eight slots are copied, which takes no longer than an unpredictable branch. Other
    threads may copy the same corners to the slots of the next group.
    """
    slots, boxes = ptr_at(ptr(moved.wide.slots), group * WIDTH), ptr_at(ptr(moved.boxes), group * 8)
    first = np.int64(get(slots, 0))
    columns = transposed8(
        _copy_corners(first, moved, last, 0), _copy_corners(first + 1, moved, last, 1),
        _copy_corners(first + 2, moved, last, 2), _copy_corners(first + 3, moved, last, 3),
        _copy_corners(first + 4, moved, last, 4), _copy_corners(first + 5, moved, last, 5),
        _copy_corners(first + 6, moved, last, 6), _copy_corners(first + 7, moved, last, 7),
    )  # fmt: skip
    z2, used = load8(last, 0), load8(slots, 0) >= np.int32(0)
    write_group(columns, z2, used, ptr_at(ptr(moved.wide.groups), group * GROUP_WORDS))
    lower, upper = group_box(columns, z2, used)
    put(boxes, 0, reduce_min(lower[0]))
    put(boxes, 1, reduce_min(lower[1]))
    put(boxes, 2, reduce_min(lower[2]))
    put(boxes, 3, np.float32(0.0))
    put(boxes, 4, -reduce_max(upper[0]))
    put(boxes, 5, -reduce_max(upper[1]))
    put(boxes, 6, -reduce_max(upper[2]))
    put(boxes, 7, np.float32(0.0))


@inlined
def _refit_binary(root, end, refit, moved):
    """Refit the binary nodes `end` - 1 down to `root`, and return the box of the root."""
    stack, height, boxes = stack_f32(_BOXES), 0, ptr(moved.boxes)
    groups, links = ptr(refit.groups), ptr(refit.wide.bvh.links)
    nodes, new_links = ptr(moved.wide.bvh.nodes), ptr(moved.wide.bvh.links)
    for node in range(end - 1, root - 1, -1):
        left, right = np.int64(get(groups, 2 * node)), np.int64(get(groups, 2 * node + 1))
        if left < 0:
            height -= 1
            left_box = load8(stack, height * 8)
        else:
            left_box = load8(boxes, left * 8)
        if right < 0:
            height -= 1
            right_box = load8(stack, height * 8)
        else:
            right_box = load8(boxes, right * 8)
        write_boxes(nodes, node, left_box, right_box)
        put(new_links, link_at(node, 0), get(links, link_at(node, 0)))
        put(new_links, link_at(node, 1), get(links, link_at(node, 1)))
        put(new_links, order_at(node), get(links, order_at(node)))
        store(stack, height * 8, minimum(left_box, right_box))
        height += 1
    return load8(stack, 0)


@inlined
def _refit_nodes(part, refit, moved):
    """Copy the wide nodes of a part, with boxes of the refitted binary BVH."""
    source, old, links = ptr(moved.wide.bvh.nodes), ptr(refit.wide.nodes), ptr(refit.wide.links)
    words = ptr(moved.wide.nodes)
    for i in range(refit.starts[part], refit.starts[part + 1]):
        at = np.int64(refit.nodes[i]) * NODE_WORDS
        for word in range(0, NODE_WORDS, 16):
            store(words, at + word, load16(old, at + word))
        lane = 0
        while lane < WIDTH and get(links, at + LINKS + lane) != NO_CHILD:
            fill_node(source, np.int64(get(links, at + BINARY + lane)), lane, words, at)
            lane += 1


@kernel
def _refit_parts(ticket, refit, moved):
    """Worker: refit each part of both trees; `refit`: a `WideRefit`, `moved`: a `_Moved`."""
    last = stack_f32(WIDTH)
    for p in items(ticket):
        root, end, _ = refit.cut.parts[p]
        for group in range(refit.group_ranges[p, 0], refit.group_ranges[p, 1]):
            _move_group(group, moved, last)
        if root < 0:
            store(moved.part_boxes, p * 8, load8(moved.boxes, refit.group_ranges[p, 0] * 8))
            continue
        store(moved.part_boxes, p * 8, _refit_binary(root, end, refit, moved))
        _refit_nodes(p, refit, moved)


@kernel
def _refit_rest(part, refit, moved):
    """Copy the wide nodes that have boxes of several parts; `part`: their place in `WideRefit.starts`."""
    # In: refit, a `WideRefit`; moved, a `_Moved`
    _refit_nodes(part, refit, moved)


def refit_wide(refit: WideRefit, vertices: NDArray[np.float32], threads: int, pool: ArrayPool) -> WideBvh:
    """The same wide BVH with moved triangles, and a refitted binary BVH whose leaves are the groups.

    vertices : (n, 3, 3) float32
        All triangles of the scene, finite and at most 1e18 in magnitude. The `prim_ids` of the tree index them.

    Children keep their order. The result is identical for any number of threads, and its arrays are in recycled memory.
    """
    wide, s = refit.wide, len(refit.cut.parts)
    nodes, groups = pool.empty(wide.nodes.shape, np.float32), pool.empty((len(wide.slots), GROUP_WORDS), np.float32)
    lines, corners = pool.empty(wide.bvh.nodes.shape, np.float32), pool.empty((len(wide.bvh.prim_ids), 9), np.float32)
    bvh = Bvh(lines, lines.view(np.int32), wide.bvh.prim_ids, corners)
    new = WideBvh(nodes, nodes.view(np.int32), groups, wide.slots, wide.reach, bvh)
    boxes = pool.empty((len(groups), 8), np.float32)
    moved = _Moved(vertices.reshape(-1, 9), new, boxes, np.empty((s, 8), np.float32))
    run_short(_refit_parts, threads, new_ticket(s, 1), refit, moved)
    write_top(refit.cut, moved.part_boxes, lines)
    _refit_rest(s, refit, moved)
    return new._replace(reach=reach_of_root(nodes))
