"""Derive a tree from the previous frame's: refit it to moved triangles, or filter it to those that survive culling.

Refitting recomputes the boxes. `DeformingTree` rebuilds the tree once its SAH cost has grown too much; [Lauterbach et
al. 2006, "RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs"] rebuild by a similar measure. Threads refit
parts of the tree independently, from the last node to the first. Nodes are in depth-first order, so a node's child
boxes are the two computed last. The same pass can bound a subset of the triangles (`boxes_of_subset`).

Filtering serves a cached tree of all triangles in the scene, from which culling leaves a different subset in each
frame. It is faster than building a tree of the subset, because the splits are reused and only boxes change. Nodes and
slots keep their order, so their new numbers are prefix sums, and threads write them independently.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.array_pool import ArrayPool
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short, thread_count
from ..kernels.simd import get, load8, load16, minimum, prefetch, ptr, put, splat8, stack_f32, store
from . import binned_sah
from .nodes import (
    MAX_DEPTH,
    MAX_LEAF,
    ORDER,
    Bvh,
    aligned_empty,
    box_at,
    bvh_leaf,
    bvh_link,
    line_at,
    link_at,
    order_at,
    tree_of,
)
from .top_levels import UpperLevels, join_boxes, top_lines
from .tree_layout import TreeFrontier, children_of_top, cut_tree
from .tree_quality import sah_cost
from .triangle_bounds import checked_vertices, scene_bounds, triangle_box, trivial_bvh, write_boxes

# --- Refitting and rebuilding -----------------------------------------------------------------------------------------


LIMIT = 1.1  # a tree is rebuilt once its cost exceeds this multiple of its cost when built
_AHEAD = 32  # prefetch distance in slots
_INF = np.float32(np.inf)
_BOXES = 8 * (MAX_DEPTH + 2)


@inlined
def _refit_leaf(vertices, link, out):
    """Copy the corners of a leaf's triangles and return their box."""
    box, leaf = splat8(_INF), bvh_leaf(np.int64(link))
    for slot in range(leaf.first + leaf.count - 1, leaf.first - 1, -1):
        ahead = get(out.prim_ids, max(slot - _AHEAD, 0)) * 9
        prefetch(vertices, ahead)
        prefetch(vertices, ahead + 8)
        source = get(out.prim_ids, slot) * 9
        store(out.corners, slot * 9, load8(vertices, source))
        put(out.corners, slot * 9 + 8, get(vertices, source + 8))
        box = minimum(box, triangle_box(vertices, source // 9))
    return box


@inlined
def _filtered_leaf_box(link, old, flags):
    """The box of a leaf's flagged triangles; lower = +inf and upper = -inf if there are none."""
    box, leaf = splat8(_INF), bvh_leaf(np.int64(link))
    for slot in range(leaf.first, leaf.first + leaf.count):
        if flags[slot]:
            box = minimum(box, triangle_box(old.corners, slot))
    return box


@inlined
def _leaf_box(vertices, link, old, out, flags):
    """`_refit_leaf`; with `flags`, the box of the flagged triangles instead."""
    return _refit_leaf(vertices, link, out) if flags is None else _filtered_leaf_box(link, old, flags)


@kernel
def refit_part(vertices, old, root, last, out, flags):
    """Refit a part of a tree: the leaf `root`, or the subtree of nodes `last` - 1 down to `root`. Return its box."""
    # In: vertices, float32 *, 9 per triangle; old, a `Tree`; flags, as in `_leaf_box`. Out: out, a `Tree`
    if root < 0:
        return _leaf_box(vertices, root, old, out, flags)
    boxes, height = stack_f32(_BOXES), 0
    for node in range(last - 1, root - 1, -1):
        left_link, right_link = get(old.links, link_at(node, 0)), get(old.links, link_at(node, 1))
        if left_link >= 0:
            height -= 1
            left_box = load8(boxes, height * 8)
        if right_link >= 0:
            height -= 1
            right_box = load8(boxes, height * 8)
        else:
            right_box = _leaf_box(vertices, right_link, old, out, flags)
        if left_link < 0:
            left_box = _leaf_box(vertices, left_link, old, out, flags)
        write_boxes(out.nodes, node, left_box, right_box)
        put(out.links, link_at(node, 0), left_link)
        put(out.links, link_at(node, 1), right_link)
        put(out.links, order_at(node), get(old.links, order_at(node)))
        store(boxes, height * 8, minimum(left_box, right_box))
        height += 1
    return load8(boxes, 0)


@kernel
def _refit_parts(ticket, vertices, bvh, parts, new, flags, boxes):
    """Worker: refit the nodes and corners of each part, and store its box; `flags` as in `_refit_triangles`."""
    v, old, out = ptr(vertices), tree_of(bvh), tree_of(new)
    for p in items(ticket):
        root, end, _ = parts[p]
        store(boxes, p * 8, refit_part(v, old, root, end, out, flags))


def refit(bvh: Bvh, vertices: NDArray[np.float32], threads: int | None = None) -> Bvh:
    """The same tree with the boxes of moved triangles. The result is bitwise identical for any number of threads.

    Parameters
    ----------
    bvh : Bvh
        Its nodes must be in depth-first order, as from every builder. It is not modified. The new tree shares its
        `prim_ids`.
    vertices : (n, 3, 3) float32
        As for a builder, with as many triangles as `bvh`, in the same order.

    Raises
    ------
    InputError
        As for a builder, or if the number of triangles differs.
    """
    flat, threads = checked_vertices(vertices, 1), thread_count(threads)
    n = len(flat)
    if n != len(bvh.prim_ids):
        raise InputError(f"vertices has {n} triangles; the BVH is of {len(bvh.prim_ids)}")
    scene_bounds(flat, threads)  # checks the coordinates
    if n < 2:
        return trivial_bvh(flat)
    return _refit_triangles(bvh, flat, np.empty((n, 9), np.float32), None, threads)


def refit_faces(bvh: Bvh, vertices: NDArray[np.float32], threads: int, pool: ArrayPool) -> Bvh:
    """`refit` for a tree of two faces or more of a scene, in recycled memory.

    vertices : (n, 3, 3) float32
        All triangles of the scene, finite and at most 1e18 in magnitude. The `prim_ids` of `bvh` index them.
    """
    flat, corners = vertices.reshape(-1, 9), pool.empty(bvh.corners.shape, np.float32)
    return _refit_triangles(bvh, flat, corners, None, threads, pool)


def boxes_of_subset(bvh: Bvh, flags: NDArray[np.bool_], threads: int) -> Bvh:
    """The same tree, of two triangles or more, with boxes that bound only the flagged triangles.

    flags : (n,) bool, by slot

    The box of a child without flagged triangles has lower = +inf and upper = -inf, which no ray enters.
    """
    return _refit_triangles(bvh, bvh.corners, bvh.corners, flags, threads)


def _refit_triangles(
    bvh: Bvh,
    flat: NDArray[np.float32],
    corners: NDArray[np.float32],
    flags: NDArray[np.bool_] | None,
    threads: int,
    pool: ArrayPool | None = None,
) -> Bvh:
    """`refit`, or `boxes_of_subset` if `flags` is not None. The new tree takes over `corners`."""
    pieces = cut_tree(bvh)
    nodes = aligned_empty(bvh.nodes.shape, "f4") if pool is None else pool.empty(bvh.nodes.shape, np.float32)
    new = Bvh(nodes, nodes.view(np.int32), bvh.prim_ids, corners)
    part_boxes = np.empty((len(pieces.parts), 8), np.float32)
    run_short(_refit_parts, threads, new_ticket(len(part_boxes), 1), flat, bvh, pieces.parts, new, flags, part_boxes)
    write_top(pieces, part_boxes, nodes)
    return new


def write_top(cut: TreeFrontier, part_boxes: NDArray[np.float32], nodes: NDArray[np.float32]) -> None:
    """Write the nodes of the top of a refitted tree to `nodes`; `part_boxes`: (s, 8) float32."""
    children, boxes = children_of_top(cut), np.empty((len(cut.numbers), 2, 8), np.float32)
    join_boxes(children, part_boxes, boxes)
    roots = cut.parts[:, 0]
    orders = cut.top.view(np.int32)[:, ORDER]
    nodes[cut.numbers] = top_lines(UpperLevels(boxes, children, roots, part_boxes, orders), cut.numbers, roots)


class DeformingTree:
    """The BVH of a deforming mesh: refitted while its SAH cost stays low, otherwise rebuilt.

    build : a builder (`engine.method_registry`)
    limit : the maximum SAH cost of a refitted tree, relative to its cost when built

    Refitting is exact: it affects the speed of a query, never its result.
    """

    def __init__(self, build: Callable[[NDArray[np.float32], int | None], Bvh], limit: float = LIMIT) -> None:
        self.build, self.limit = build, limit
        self.bvh: Bvh | None = None
        self.cost = 0.0  # of the tree when it was built

    def update(self, vertices: NDArray[np.float32], threads: int | None = None) -> Bvh:
        """The BVH of these triangles. Raises the same errors as a builder."""
        old = self.bvh  # read once: another thread may replace it
        if old is not None and len(old.prim_ids) == len(vertices):
            bvh = refit(old, vertices, threads)
            if sah_cost(bvh, threads=threads) <= self.limit * self.cost:
                self.bvh = bvh
                return bvh
        bvh = self.build(vertices, threads)
        self.bvh, self.cost = bvh, sah_cost(bvh, threads=threads)
        return bvh


# --- Filtering --------------------------------------------------------------------------------------------------------


NODES_PER_SHARE = 4096  # nodes that a thread processes at a time


@inlined
def _is_empty(nodes, node, side):
    """Whether a child's box is empty."""
    return get(nodes, box_at(node, side)) == np.float32(np.inf)


@kernel
def _find_branches(ticket, bvh, branches):
    """Worker: mark the nodes whose children both have flagged triangles."""
    tree = tree_of(bvh)
    for node in items(ticket):
        branches[node] = not (_is_empty(tree.nodes, node, 0) or _is_empty(tree.nodes, node, 1))


@inlined
def _new_link(tree, link, node_at, slot_at):
    """The new link to the first node with two children, or to the leaf, that `link` leads to."""
    while link >= 0 and (_is_empty(tree.nodes, link, 0) or _is_empty(tree.nodes, link, 1)):
        link = get(tree.links, link_at(link, 1 if _is_empty(tree.nodes, link, 0) else 0))
    if link >= 0:
        return np.int64(node_at[link])
    first, count = bvh_leaf(link)
    start, end = np.int64(slot_at[first]), np.int64(slot_at[first + count])
    return bvh_link(start, end - start)


@kernel
def _write_branches(ticket, bvh, branches, node_at, slot_at, new):
    """Worker: write the marked nodes to their new places, with new links."""
    # In: bvh, of `boxes_of_subset`; branches, bool; node_at, slot_at, int32: new number of each node and slot
    tree, out = tree_of(bvh), tree_of(new)
    for node in items(ticket):
        if branches[node]:
            new_node = np.int64(node_at[node])
            store(out.nodes, line_at(new_node), load16(tree.nodes, line_at(node)))
            for side in range(2):
                link = _new_link(tree, get(tree.links, link_at(node, side)), node_at, slot_at)
                put(out.links, link_at(new_node, side), link)


def _numbers(flags: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(n + 1,) int32: the number of set flags before each position."""
    numbers = np.zeros(len(flags) + 1, np.int32)
    np.cumsum(flags, out=numbers[1:])
    return numbers


def filter_tree(bvh: Bvh, triangles: NDArray[np.integer], threads: int) -> Bvh:
    """The tree of a subset of the triangles, without the nodes that then have fewer than two children.

    Parameters
    ----------
    bvh : Bvh
        Its nodes must be in depth-first order. It is not modified.
    triangles : (m,) int
        Indices of the triangles to keep.

    Returns
    -------
    Bvh
        Like those of `bvh`, its `prim_ids` are indices in the whole scene. Splits and child orders are those of `bvh`.
        Small subsets get a new tree from `bsah` instead.
    """
    flags = np.zeros(bvh.prim_ids.max(initial=-1) + 1, np.bool_)
    flags[triangles] = True
    slots = flags[bvh.prim_ids]
    prim_ids, corners = bvh.prim_ids[slots], bvh.corners[slots]
    if len(prim_ids) <= MAX_LEAF:  # they may all lie in one leaf, which is not a tree
        small = binned_sah.build(corners.reshape(-1, 3, 3), threads)
        return small._replace(prim_ids=prim_ids[small.prim_ids])
    bounded = boxes_of_subset(bvh, slots, threads)
    branches = np.empty(len(bvh.nodes), np.bool_)
    run_short(_find_branches, threads, new_ticket(len(branches), NODES_PER_SHARE), bounded, branches)
    node_at, slot_at = _numbers(branches), _numbers(slots)
    nodes = aligned_empty((int(node_at[-1]), 16), "f4")
    new = Bvh(nodes, nodes.view(np.int32), prim_ids, corners)
    ticket = new_ticket(len(branches), NODES_PER_SHARE)
    run_short(_write_branches, threads, ticket, bounded, branches, node_at, slot_at, new)
    return new
