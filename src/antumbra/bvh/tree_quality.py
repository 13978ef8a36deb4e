"""Validation of a BVH, its SAH cost, and statistics of its shape."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, new_ticket, run, shares, thread_count
from ..kernels.simd import get, ptr, stack_array
from .nodes import EMPTY, LINK, MAX_DEPTH, MAX_LEAF, Bvh, box_at, bvh_leaf, line_at, link_at

AREA_ROW = 64  # nodes whose areas are added one by one
AREA_ROWS = 64  # rows whose sums are added one by one
_CHUNK = AREA_ROW * AREA_ROWS  # nodes whose areas a thread sums at a time
_STACK_SIZE = MAX_DEPTH + 1
_OK = 0
_FAULTS = (
    "",
    "node {node}: the {side} link, {link}, leads to no node",
    "node {node}: the {side} link, {link}, leads to a node that has another parent, or to the root",
    "node {node}: more than MAX_DEPTH = {max_depth} inner nodes on the path to it",
    "node {node}: the {side} child is missing, though the tree has more than one triangle or more than one node",
    "node {node}: the {side} child is missing, but its box is not +inf to -inf",
    "node {node}: the {side} leaf has slots beyond the last",
    "node {node}: the {side} leaf has a slot that another leaf also has",
    "node {node}: the {side} box is not the bounds of the triangles in its leaf",
    "node {node}: the {side} box is not the bounds of the two boxes below it",
)
_NO_NODE, _SHARED, _DEEP, _MISSING, _NOT_EMPTY, _BEYOND, _TWICE, _LEAF_BOX, _INNER_BOX = range(1, len(_FAULTS))


class TreeStatistics(NamedTuple):
    """The shape of a BVH."""

    nodes: int  # inner nodes
    leaves: int
    depth: int  # inner nodes on the longest path from the root
    leaf_sizes: NDArray[np.int64]  # (MAX_LEAF + 1,) int64: [k] leaves have k triangles
    bytes_per_triangle: float


@kernel
def _bounds_leaf(bvh, box, first, last):
    """Whether the child box whose first word is `box` is exactly the bounds of the slots' corners; False for NaN."""
    words = ptr(bvh.nodes)
    for k in range(3):
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for slot in range(first, last):
            for c in range(k, 9, 3):
                x = bvh.corners[slot, c]
                if not (words[box + 4 * k] <= x <= words[box + 4 * k + 2]):
                    return False
                low, high = min(low, x), max(high, x)
        if not (words[box + 4 * k] == low and words[box + 4 * k + 2] == high):
            return False
    return True


@kernel
def _bounds_node(bvh, box, node):
    """Whether the child box whose first word is `box` is exactly the hull of the two boxes in `node`."""
    words = ptr(bvh.nodes)
    for k in range(3):
        a, b = line_at(node) + 4 * k, box + 4 * k
        low, high = min(words[a], words[a + 1]), max(words[a + 2], words[a + 3])
        if not (words[b] == low and words[b + 2] == high):
            return False
    return True


@kernel
def _is_empty_box(bvh, box):
    """Whether the child box whose first word is `box` is the box of a missing child."""
    words = ptr(bvh.nodes)
    for k in range(3):
        if words[box + 4 * k] != np.inf or words[box + 4 * k + 2] != -np.inf:
            return False
    return True


@kernel
def _check_child(bvh, node, side, reached, used):
    """The fault of one child, or _OK. Marks the child's node, or the slots of its leaf."""
    n_nodes, n, link = np.int64(len(bvh.nodes)), np.int64(len(bvh.prim_ids)), np.int64(bvh.links[node, LINK + side])
    box = box_at(node, side)
    if link == EMPTY:
        if n_nodes > 1 or n > 1 or n > side:  # a single triangle is on the left
            return _MISSING
        return _OK if _is_empty_box(bvh, box) else _NOT_EMPTY
    if link >= 0:
        if link >= n_nodes:
            return _NO_NODE
        if reached[link]:
            return _SHARED
        reached[link] = True
        return _OK if _bounds_node(bvh, box, link) else _INNER_BOX
    first, count = bvh_leaf(link)
    last = first + count
    if last > n:
        return _BEYOND
    for slot in range(first, last):
        if used[slot]:
            return _TWICE
        used[slot] = True
    return _OK if _bounds_leaf(bvh, box, first, last) else _LEAF_BOX


@kernel
def _check_tree(bvh, reached, used):
    """(fault, node, side) of the first fault in a traversal from the root; (_OK, 0, 0) if there is none."""
    stack = stack_array(np.int64, _STACK_SIZE, 2)
    stack[0, 0], stack[0, 1] = 0, 1
    reached[0] = True
    height = 1
    while height > 0:
        height -= 1
        node, depth = stack[height, 0], stack[height, 1]
        if depth > MAX_DEPTH:
            return _DEEP, node, 0
        for side in (1, 0):
            fault = _check_child(bvh, node, side, reached, used)
            if fault != _OK:
                return fault, node, side
            link = bvh.links[node, LINK + side]
            if link >= 0:
                stack[height, 0], stack[height, 1] = link, depth + 1
                height += 1
    return _OK, 0, 0


@kernel
def _check_slots(bvh, vertices, used):
    """The first slot whose triangle does not exist, is in an earlier slot, or has other corners; -1 if none."""
    for slot in range(len(bvh.prim_ids)):
        prim = np.int64(bvh.prim_ids[slot])
        if prim < 0 or prim >= len(vertices) or used[prim]:
            return slot
        used[prim] = True
        for k in range(9):
            if bvh.corners[slot, k] != vertices[prim, k]:  # NaN too
                return slot
    return -1


def _check_arrays(bvh: Bvh, n: int) -> None:
    """Check the shapes, dtypes and memory of the arrays of a BVH of n triangles."""
    shapes = {
        "nodes": (bvh.nodes, (max(len(bvh.nodes), 1), 16), np.float32),
        "links": (bvh.links, (len(bvh.nodes), 16), np.int32),
        "prim_ids": (bvh.prim_ids, (n,), np.int32),
        "corners": (bvh.corners, (n, 9), np.float32),
    }
    for name, (array, shape, dtype) in shapes.items():
        if array.shape != shape or array.dtype != dtype or not array.flags.c_contiguous:
            raise ValueError(
                f"{name} is {array.dtype} {array.shape}; it must be {np.dtype(dtype)} {shape}, C-contiguous"
            )
    if bvh.links.ctypes.data != bvh.nodes.ctypes.data or bvh.nodes.ctypes.data % 64:
        raise ValueError("links and nodes must be the same memory, aligned to 64 bytes")


def validate(bvh: Bvh, vertices: NDArray[np.float32]) -> None:
    """Check that `bvh` is a valid BVH of the triangles `vertices`, (n, 3, 3) float32.

    In a valid BVH:

    - every node but the root has one parent;
    - no path has more than MAX_DEPTH inner nodes;
    - every triangle is in exactly one leaf, and the slot has its corners;
    - every box is exactly the bounds of the triangles or boxes below it.

    Raises
    ------
    ValueError
        For the first fault; the message names its node or slot.
    """
    flat = np.ascontiguousarray(vertices, np.float32).reshape(-1, 9)
    n = len(flat)
    _check_arrays(bvh, n)
    slot = _check_slots(bvh, flat, np.zeros(n, np.bool_))
    if slot >= 0:
        raise ValueError(
            f"slot {slot}: triangle {bvh.prim_ids[slot]} does not exist, is in two slots, or has other corners (or NaN)"
        )
    if fault := tree_fault(bvh):
        raise ValueError(fault)


def tree_fault(bvh: Bvh) -> str:
    """The first fault of the links and boxes of a tree, as `validate` defines them; "" if there is none.

    The corners and any links may have been read from a file; nothing outside the arrays is touched.
    """
    reached, used = np.zeros(len(bvh.nodes), np.bool_), np.zeros(len(bvh.prim_ids), np.bool_)
    fault, node, side = _check_tree(bvh, reached, used)
    if fault != _OK:
        link, side_name = bvh.links[node, LINK + side], ("left", "right")[side]
        return _FAULTS[fault].format(node=node, side=side_name, link=link, max_depth=MAX_DEPTH)
    for name, marks in (("node", reached), ("slot", used)):
        if not marks.all():
            return f"{name} {int(np.argmin(marks))}: it is not in the tree"
    return ""


@inlined
def _extent(words, a, b):
    """The extent, in float64, along the axis of words `a` and `b` of the hull of two child boxes."""
    return np.float64(max(get(words, a + 2), get(words, b + 2))) - min(get(words, a), get(words, b))


@inlined
def _half_area(words, a, b):
    """Half the area, in float64, of the hull of the two child boxes that start at words `a` and `b`."""
    x, y, z = _extent(words, a, b), _extent(words, a + 4, b + 4), _extent(words, a + 8, b + 8)
    return x * (y + z) + y * z


@inlined
def areas_between(words, links, first, last):
    """The sums of half the areas of nodes `first` to `last` - 1, and of their leaves times their triangle counts."""
    nodes, leaves = 0.0, 0.0
    for node in range(first, last):
        nodes += _half_area(words, box_at(node, 0), box_at(node, 1))
        for side in range(2):
            link = np.int64(get(links, link_at(node, side)))
            if link < 0 and link != EMPTY:
                leaves += _half_area(words, box_at(node, side), box_at(node, side)) * bvh_leaf(link).count
    return nodes, leaves


@kernel
def _areas(ticket, bvh, sums):
    """Worker: write the sums of `areas_between` of each chunk of nodes, added row by row."""
    words, links = ptr(bvh.nodes), ptr(bvh.links)
    for first, last in shares(ticket):
        nodes, leaves = 0.0, 0.0
        for row in range(first, last, AREA_ROW):
            of_nodes, of_leaves = areas_between(words, links, row, min(row + AREA_ROW, last))
            nodes += of_nodes
            leaves += of_leaves
        sums[first // ticket[CHUNK], 0], sums[first // ticket[CHUNK], 1] = nodes, leaves


@kernel
def _root_area(root):  # root: (16,) float32, a node
    return _half_area(ptr(root), 0, 1)


def sah_cost(bvh: Bvh, c_traverse: float = 1.0, c_intersect: float = 1.0, threads: int | None = 1) -> float:
    """The SAH cost in float64: the expected cost of a ray that hits the root's box.

    An inner node that the ray enters costs `c_traverse`, and each triangle in a leaf that it enters costs
    `c_intersect`. The probability of entering a box is its area divided by the root's area, or 1 if the root has no
    area. A tree without triangles costs 0. The result is bitwise identical for any number of threads.
    """
    if len(bvh.prim_ids) == 0:
        return 0.0
    sums = np.empty((-(-len(bvh.nodes) // _CHUNK), 2))
    run(_areas, thread_count(threads), new_ticket(len(bvh.nodes), _CHUNK), bvh, sums)
    return cost_of_sums(sums, bvh.nodes[0], len(bvh.nodes), len(bvh.prim_ids), c_traverse, c_intersect)


def cost_of_sums(
    sums: NDArray[np.float64],
    root: NDArray[np.float32],
    n_nodes: int,
    n_triangles: int,
    c_traverse: float = 1.0,
    c_intersect: float = 1.0,
) -> float:
    """`sah_cost` from the sums of each chunk.

    sums : (k, 2) float64, of `areas_between` for AREA_ROW nodes, added AREA_ROWS at a time
    root : (16,) float32, the node
    """
    area, (of_nodes, of_leaves) = _root_area(root), sums.sum(axis=0)
    if area == 0.0:
        return c_traverse * n_nodes + c_intersect * n_triangles
    return float((c_traverse * of_nodes + c_intersect * of_leaves) / area)


@kernel
def _shape(links, sizes):
    """Fill the histogram of leaf sizes, and return the depth."""
    stack = stack_array(np.int64, _STACK_SIZE, 2)
    stack[0, 0], stack[0, 1] = 0, 1
    height, deepest = 1, 0
    while height > 0:
        height -= 1
        node, depth = stack[height, 0], stack[height, 1]
        deepest = max(deepest, depth)
        for side in range(2):
            link = np.int64(links[node, LINK + side])
            if link >= 0:
                stack[height, 0], stack[height, 1] = link, depth + 1
                height += 1
            elif link != EMPTY:
                sizes[bvh_leaf(link).count] += 1
    return deepest


def statistics(bvh: Bvh) -> TreeStatistics:
    """Nodes, leaves, depth, leaf sizes and memory of a valid BVH (see `validate`)."""
    sizes = np.zeros(MAX_LEAF + 1, np.int64)
    depth = _shape(bvh.links, sizes)
    size = bvh.nodes.nbytes + bvh.prim_ids.nbytes + bvh.corners.nbytes
    return TreeStatistics(len(bvh.nodes), int(sizes.sum()), int(depth), sizes, size / max(1, len(bvh.prim_ids)))
