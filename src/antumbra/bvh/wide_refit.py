"""Refit a wide BVH to moved triangles.

A refitted wide BVH has a smaller binary BVH than it was made from: each group is a leaf. All boxes follow from those of
the groups, whose triangles are gathered from indexed vertices and bounded eight at a time. The same pass finds whether
all triangles still have an area. Each child of a wide node has the box of a child of a binary one, which is copied.
Threads refit one small part of both trees at a time, which stays in the cache.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.array_pool import ArrayPool
from ..kernels.exact.filters import has_area
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short
from ..kernels.simd import (
    bits,
    get,
    join,
    load4,
    load8,
    load16,
    lowest_bit,
    minimum,
    prefetch,
    ptr,
    ptr_at,
    put,
    select,
    splat8,
    stack_array,
    stack_f64,
    store,
    to_f64,
)
from ..kernels.transposition import transposed4, transposed8
from ..scene.triangle_setup import surely_have_area, write_corners
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
from .wide_bvh import (
    NOWHERE,
    child_areas,
    cost_of_areas,
    fill_node,
    group_box,
    reach_of_root,
    sum_of_lanes,
    write_group,
)

# --- What refits of a tree have in common -----------------------------------------------------------------------------


_PART = 512  # maximum nodes of the binary BVH in a part, so that both trees of a part fit in an L2 cache
_STACK_SIZE = MAX_DEPTH + 2
_AHEAD = 32  # prefetch distance in slots


class WideRefit(NamedTuple):
    """A wide BVH to be refitted, and its parts.

    The boxes of a part are in *places*: those of its groups first, those of its binary nodes from `room` on.
    """

    wide: WideBvh  # without triangles and boxes; groups in the order of slots are the leaves of its binary BVH
    cut: TreeFrontier  # of the binary BVH, into s parts
    group_ranges: NDArray[np.int64]  # (s, 2) int64: first group of each part, and end
    room: int  # places for groups
    places: NDArray[np.int32]  # (m, 2) int32: of the children of each binary node
    lane_places: NDArray[np.int32]  # (n_nodes, 8) int32: of the children of each wide node, if all are in one part
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
    s, ranges = len(cut.parts), _group_ranges(cut, wide)
    part_of = np.full(len(wide.bvh.nodes), s, np.int32)
    for number, (root, end, _) in enumerate(cut.parts.tolist()):
        part_of[max(root, 0) : end if root >= 0 else 0] = number
    binary = wide.links[:, BINARY:]
    part = part_of[binary >> 1]
    is_child = wide.links[:, LINKS:BINARY] != NO_CHILD
    lowest, highest = np.where(is_child, part, s).min(1), np.where(is_child, part, -1).max(1)
    of_nodes = np.where(lowest == highest, lowest, s)
    starts = np.concatenate([[0], np.cumsum(np.bincount(of_nodes, minlength=s + 1))])
    order = np.argsort(of_nodes, kind="stable").astype(np.int32)
    room = int((ranges[:, 1] - ranges[:, 0]).max())
    firsts, roots = np.append(ranges[:, 0], 0)[part_of], np.append(cut.parts[:, 0], 0)[part_of]
    inner = room + wide.bvh.links[:, LINK : LINK + 2] - roots[:, None]
    places = np.where(groups >= 0, groups - firsts[:, None], inner).astype(np.int32)
    lane_places = np.where(is_child & (of_nodes < s)[:, None], places.reshape(-1)[binary], 0)
    return WideRefit(wide, cut, ranges, room, places, lane_places, order, starts)


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


def vertices_of_slots(wide: WideBvh, faces: NDArray[np.int32] | None) -> NDArray[np.int32]:
    """(slots + WIDTH + _AHEAD, 3) int32: the vertices of the triangle in each slot, and of any behind the last one.

    faces : (n, 3) int32, vertices of each face; None: 0, 1, 2; 3, 4, 5; and so on
    """
    ids = np.append(wide.bvh.prim_ids, np.full(WIDTH + _AHEAD, wide.bvh.prim_ids[-1]))
    return 3 * ids[:, None] + np.arange(3, dtype=np.int32) if faces is None else faces[ids]


class MovedVertices(NamedTuple):
    """Vertices of the triangles in slots."""

    positions: NDArray[np.float32]  # (v, 3) float32; the memory of one more number follows
    of_slots: NDArray[np.int32]  # see `vertices_of_slots`


class _Moved(NamedTuple):
    """Where triangles have moved, and what is found of them."""

    vertices: MovedVertices
    wide: WideBvh  # output, with room for WIDTH more corners
    part_boxes: NDArray[np.float32]  # (s, 8) float32, output
    areas: NDArray[np.float64]  # (s + 1,) float64, output: sums of `child_areas`, of wide nodes by part
    faults: NDArray[np.bool_]  # (1,) bool, set if a triangle has no area


class RefittedTree(NamedTuple):
    """A refitted tree, and what the pass has found."""

    wide: WideBvh
    cost: float  # `wide_cost`, but for rounding
    all_have_area: bool  # whether all triangles have an area


@inlined
def _corner_of_two(positions, ids, lane, corner):
    """One corner of the triangles in a lane and the fourth after it."""
    first, second = get(ids, 3 * lane + corner), get(ids, 3 * (lane + 4) + corner)
    return join(load4(positions, 3 * np.int64(first)), load4(positions, 3 * np.int64(second)))


@inlined
def _corner_of_eight(positions, ids, corner):
    """(x, y, z) of one corner of eight triangles, per lane."""
    return transposed4(
        _corner_of_two(positions, ids, 0, corner), _corner_of_two(positions, ids, 1, corner),
        _corner_of_two(positions, ids, 2, corner), _corner_of_two(positions, ids, 3, corner),
    )[:3]  # fmt: skip


@inlined
def _find_areas(v0, v1, v2, used, corners, faults):
    """Set `faults` if the triangle in a `used` lane (mask) has no area; corners: float32 *, those of the first one."""
    unsure = ~bits(surely_have_area(v0, v1, v2)) & bits(used)
    while unsure != 0:
        if not has_area(corners, lowest_bit(unsure)):
            faults[0] = True
        unsure &= unsure - 1


@inlined
def _box_of_lanes(lower, upper):
    """The box of the boxes in eight lanes; lower, upper: their corners."""
    zero = splat8(np.float32(0.0))
    a, b, c, d, e, f, g, h = transposed8(
        lower[0], lower[1], lower[2], zero, -upper[0], -upper[1], -upper[2], zero
    )  # fmt: skip
    return minimum(minimum(minimum(a, b), minimum(c, d)), minimum(minimum(e, f), minimum(g, h)))


@inlined
def _move_group(group, moved):
    """Copy the corners of a group, write its rows, and find triangles without area. Return the box of the group.

    Whatever its number of triangles, eight slots are copied, which takes no longer than an unpredictable branch. Other
    threads may copy the same corners to the slots of the next group.
    """
    slots, positions = ptr_at(ptr(moved.wide.slots), group * WIDTH), ptr(moved.vertices.positions)
    first = np.int64(get(slots, 0))
    ids, corners = ptr_at(ptr(moved.vertices.of_slots), 3 * first), ptr_at(ptr(moved.wide.bvh.corners), 9 * first)
    for lane in range(WIDTH):
        prefetch(positions, 3 * np.int64(get(ids, 3 * (lane + _AHEAD))))
        a, b, c = np.int64(get(ids, 3 * lane)), np.int64(get(ids, 3 * lane + 1)), np.int64(get(ids, 3 * lane + 2))
        write_corners(positions, a, b, c, ptr_at(corners, 9 * lane))
    v0, v1, v2 = (
        _corner_of_eight(positions, ids, 0), _corner_of_eight(positions, ids, 1), _corner_of_eight(positions, ids, 2)
    )  # fmt: skip
    columns, used = (v0[0], v0[1], v0[2], v1[0], v1[1], v1[2], v2[0], v2[1]), load8(slots, 0) >= np.int32(0)
    write_group(columns, v2[2], used, ptr_at(ptr(moved.wide.groups), group * GROUP_WORDS))
    _find_areas(v0, v1, v2, used, corners, moved.faults)
    lower, upper = group_box(columns, v2[2], used)
    return _box_of_lanes(lower, upper)


@inlined
def _refit_binary(root, end, refit, moved, boxes):
    """Refit the binary nodes `end` - 1 down to `root`, and return the box of the root; boxes: float32 *, by place."""
    places, links = ptr(refit.places), ptr(refit.wide.bvh.links)
    nodes, new_links = ptr(moved.wide.bvh.nodes), ptr(moved.wide.bvh.links)
    for node in range(end - 1, root - 1, -1):
        left = load8(boxes, np.int64(get(places, 2 * node)) * 8)
        right = load8(boxes, np.int64(get(places, 2 * node + 1)) * 8)
        write_boxes(nodes, node, left, right)
        put(new_links, link_at(node, 0), get(links, link_at(node, 0)))
        put(new_links, link_at(node, 1), get(links, link_at(node, 1)))
        put(new_links, order_at(node), get(links, order_at(node)))
        store(boxes, (refit.room + node - root) * 8, minimum(left, right))
    return load8(boxes, refit.room * 8)


@inlined
def _box_of_lane(boxes, places, lane):
    return load8(boxes, np.int64(get(places, lane)) * 8)


@inlined
def _refit_nodes(part, refit, moved, boxes):
    """Write the wide nodes of a part; boxes: float32 *, by place. Return the sum of their `child_areas`, per lane."""
    old, links, words = ptr(refit.wide.nodes), ptr(refit.wide.links), ptr(moved.wide.nodes)
    areas = to_f64(splat8(np.float32(0.0)))
    for i in range(refit.starts[part], refit.starts[part + 1]):
        node = np.int64(refit.nodes[i])
        at, places = node * NODE_WORDS, ptr_at(ptr(refit.lane_places), node * WIDTH)
        x0, y0, z0, _, x1, y1, z1, _ = transposed8(
            _box_of_lane(boxes, places, 0), _box_of_lane(boxes, places, 1),
            _box_of_lane(boxes, places, 2), _box_of_lane(boxes, places, 3),
            _box_of_lane(boxes, places, 4), _box_of_lane(boxes, places, 5),
            _box_of_lane(boxes, places, 6), _box_of_lane(boxes, places, 7),
        )  # fmt: skip
        is_child = load8(links, at + LINKS) != NO_CHILD
        store(words, at, select(is_child, x0, NOWHERE))
        store(words, at + WIDTH, select(is_child, -x1, -NOWHERE))
        store(words, at + 2 * WIDTH, select(is_child, y0, NOWHERE))
        store(words, at + 3 * WIDTH, select(is_child, -y1, -NOWHERE))
        store(words, at + 4 * WIDTH, select(is_child, z0, NOWHERE))
        store(words, at + 5 * WIDTH, select(is_child, -z1, -NOWHERE))
        store(words, at + LINKS, load16(old, at + LINKS))
        areas = areas + child_areas(words, at)
    return areas


@kernel
def _refit_parts(ticket, refit, moved, scratch):
    """Worker: refit each part of both trees."""
    # In: refit, a `WideRefit`; moved, a `_Moved`; scratch, (places, 8) float32
    boxes, lanes = ptr(scratch), stack_f64(WIDTH)
    for p in items(ticket):
        root, end, _ = refit.cut.parts[p]
        first = refit.group_ranges[p, 0]
        for group in range(first, refit.group_ranges[p, 1]):
            store(boxes, (group - first) * 8, _move_group(group, moved))
        if root < 0:
            store(moved.part_boxes, p * 8, load8(boxes, 0))
            continue
        store(moved.part_boxes, p * 8, _refit_binary(root, end, refit, moved, boxes))
        moved.areas[p] = sum_of_lanes(_refit_nodes(p, refit, moved, boxes), lanes)


@kernel
def _refit_rest(part, refit, moved):
    """Write the wide nodes that have boxes of several parts; `part`: their place in `WideRefit.starts`."""
    # In: refit, a `WideRefit`; moved, a `_Moved`
    source, old, links = ptr(moved.wide.bvh.nodes), ptr(refit.wide.nodes), ptr(refit.wide.links)
    words, areas = ptr(moved.wide.nodes), to_f64(splat8(np.float32(0.0)))
    for i in range(refit.starts[part], refit.starts[part + 1]):
        at = np.int64(refit.nodes[i]) * NODE_WORDS
        for word in range(0, NODE_WORDS, 16):
            store(words, at + word, load16(old, at + word))
        lane = 0
        while lane < WIDTH and get(links, at + LINKS + lane) != NO_CHILD:
            fill_node(source, np.int64(get(links, at + BINARY + lane)), lane, words, at)
            lane += 1
        areas = areas + child_areas(words, at)
    moved.areas[part] = sum_of_lanes(areas, stack_f64(WIDTH))


def refit_wide(refit: WideRefit, vertices: MovedVertices, threads: int, pool: ArrayPool) -> RefittedTree:
    """The same wide BVH with moved triangles, and a refitted binary BVH whose leaves are the groups.

    Coordinates must be finite, and at most 1e18 in magnitude. Children keep their order. The result is identical for
    any number of threads, and its arrays are in recycled memory.
    """
    wide, s, n = refit.wide, len(refit.cut.parts), len(refit.wide.bvh.prim_ids)
    nodes, groups = pool.empty(wide.nodes.shape, np.float32), pool.empty((len(wide.slots), GROUP_WORDS), np.float32)
    lines, corners = pool.empty(wide.bvh.nodes.shape, np.float32), pool.empty((n + WIDTH, 9), np.float32)[:n]
    bvh = Bvh(lines, lines.view(np.int32), wide.bvh.prim_ids, corners)
    new = WideBvh(nodes, nodes.view(np.int32), groups, wide.slots, wide.reach, bvh)
    areas, faults = np.zeros(s + 1), np.zeros(1, np.bool_)
    moved = _Moved(vertices, new, np.empty((s, 8), np.float32), areas, faults)
    scratch = lambda: (aligned_empty((2 * refit.room, 8), "f4"),)  # a part has fewer nodes than groups
    run_short(_refit_parts, threads, new_ticket(s, 1), refit, moved, own=scratch)
    write_top(refit.cut, moved.part_boxes, lines)
    _refit_rest(s, refit, moved)
    new = new._replace(reach=reach_of_root(nodes))
    return RefittedTree(new, cost_of_areas(nodes, float(areas.sum())), not faults[0])
