"""The implicit hierarchy over a beam's rays: left-balanced, with a fixed number of children and no links.

Tree. The children of node i of a level are the nodes ``ways i`` to ``ways i + ways - 1`` of the level below. A node of
level 0 is a leaf of `ways` rays, so the leaves below a node are contiguous [Olsson and Assarsson 2011, Sec. 3.5].
Sixteen children fill a register; the paper uses four. The children of one node form a *group*: they are stored and
tested together. Each face of the cube around an apex has its own hierarchy.

Node classes, such as `box_nodes.Boxes` and `shaft_hierarchy.ShaftNodes`, have one field, `rows`: the number of float32
per node. They overload the functions of their interface. Other packages may add classes.
"""

from typing import Any, NamedTuple

import numpy as np

from ...kernels.jit import inlined, kernel, overloaded
from ...kernels.marshalling import packed
from ...kernels.parallel import items, new_ticket, run_short
from ...kernels.simd import get, ptr, ptr_at, put
from .light_beams import Beam, view_of
from .ray_leaves import PAD, Empty, LeafRays, leaves_of

# --- Interface of node classes ----------------------------------------------------------------------------------------


@overloaded("box_nodes", "shaft_hierarchy")
def bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    """In kernels: write the node of a leaf to a lane of its group; False if the leaf has no rays."""


@overloaded("box_nodes", "shaft_hierarchy")
def bound_node(nodes, children, alive, ways, group, lane):
    """In kernels: write the node that encloses the `alive` children (bits) of a group."""


@overloaded("box_nodes", "shaft_hierarchy")
def write_row(nodes, view, face, ways, shape, spheres, row):
    """In kernels: write the row of a triangle's `Shape` for the node tests; False if it blocks nothing on the face."""


@overloaded("box_nodes", "shaft_hierarchy")
def writes_sixteen(nodes):
    """In kernels: True if `box_nodes.write_point_rows` can write the rows of this class."""


@overloaded("box_nodes", "shaft_hierarchy")
def union_of(nodes, block, lanes, union):
    """In kernels: write the bounds of the shadows of some of 16 triangles, 6 float32; False if unsupported."""


@overloaded("box_nodes", "shaft_hierarchy")
def meet_union(nodes, group, union, ways):
    """In kernels: bits of the nodes of a group that the bounds from `union_of` meet."""


@overloaded("box_nodes", "shaft_hierarchy")
def possible(nodes, group, row, ways, alive, spheres):
    """In kernels: bits of the `alive` nodes of a group with rays that the triangle may block."""


@overloaded("box_nodes", "shaft_hierarchy")
def possible_triangles(nodes, group, node, block, ways):
    """In kernels: bits of the triangles among 16 that may block rays of a node of a group, if `writes_sixteen`.

    block : pointer to the first number of the triangles' rows
    """


@overloaded("box_nodes", "shaft_hierarchy")
def covered(nodes, group, row, ways, among):
    """In kernels: bits of the nodes in `among` (bits) of a group whose rays are all blocked by the triangle."""


# --- The hierarchy ----------------------------------------------------------------------------------------------------

LEVELS = 16
"""Maximum number of levels: enough for 2^32 rays with four children per node."""


class RayTree(NamedTuple):
    """Hierarchies over the rays of a beam, one for each of k faces."""

    ways: int  # children per node: 4 or 16
    shift: int  # ways = 1 << shift
    nodes: Any  # Boxes, ShaftNodes or Cones: the class defines what the numbers mean
    step: int  # numbers per group: `nodes.rows` x ways
    numbers: np.ndarray  # (groups step + PAD,) float32
    alive: np.ndarray  # (groups + PAD,) int32: bits of the children with unfinished rays
    heights: np.ndarray  # (k,) int64: number of levels
    sizes: np.ndarray  # (k, LEVELS) int64: nodes of each level
    groups: np.ndarray  # (k, LEVELS) int64: the first group of each level
    leaves: np.ndarray  # (k + 1,) int64: the first leaf of each face, and the end
    faces: np.ndarray  # (k,) int64: the face of each hierarchy


@inlined
def tree_pointers(tree):
    """The same `RayTree` with pointers instead of arrays: passing an array on costs a reference count."""
    return RayTree(
        tree.ways, tree.shift, tree.nodes, tree.step, ptr(tree.numbers), ptr(tree.alive), ptr(tree.heights),
        ptr(tree.sizes), ptr(tree.groups), ptr(tree.leaves), ptr(tree.faces),
    )  # fmt: skip


@inlined
def size_of(tree, part, level):
    """Number of nodes of a level."""
    return get(tree.sizes, part * LEVELS + level)


@inlined
def groups_of(tree, part, level):
    """The first group of a level."""
    return get(tree.groups, part * LEVELS + level)


@inlined
def group_at(tree, group):
    """Pointer to the numbers of a group."""
    return ptr_at(tree.numbers, group * tree.step)


@kernel
def _bound_nodes(tree, view, leaves, part, level, g):
    """Bound the nodes of group g of a level by their rays, or by the nodes below. Missing nodes are zero."""
    # In: tree, a `RayTree`, and part, the number of its face; view and leaves, of `view_of` and `leaves_of`
    n, ways, group = size_of(tree, part, level), np.int64(tree.ways), group_at(tree, groups_of(tree, part, level) + g)
    below, alive = groups_of(tree, part, max(level - 1, 0)), 0
    for k in range(tree.step):
        put(group, k, np.float32(0.0))
    for lane in range(min(ways, n - g * ways)):
        i = g * ways + lane
        if level == 0:
            known = bound_leaf(tree.nodes, view, get(tree.faces, part), leaves, get(tree.leaves, part) + i, group, lane)
        else:
            live = get(tree.alive, below + i)
            known = live != 0
            if known:
                bound_node(tree.nodes, group_at(tree, below + i), live, ways, group, lane)
        if known:
            alive |= 1 << lane
    put(tree.alive, groups_of(tree, part, level) + g, alive)


@kernel
def _bound(ticket, arrays, beam, rays, level, starts):
    """Worker: bound the nodes of one level of all faces; starts: of each face, and the end, in groups of the level."""
    # In: arrays, a `RayTree`, whose numbers are written; beam, a `Beam`, and rays, its `LeafRays`
    tree, leaves, view, part = tree_pointers(arrays), leaves_of(rays), view_of(beam), 0
    for g in items(ticket):
        while starts[part + 1] <= g:
            part += 1
        _bound_nodes(tree, view, leaves, part, level, g - starts[part])


def tree_of(kind: Any, beam: Beam, rays: LeafRays, threads: int, empty: Empty = np.empty) -> RayTree:
    """Build the `RayTree` over a beam's rays; ``kind``: `Boxes`, `ShaftNodes` or `Cones`."""
    nodes, ways, k = kind(), rays.ways, len(rays.faces)
    step = nodes.rows * ways
    shift = ways.bit_length() - 1
    heights, sizes, groups = np.zeros(k, np.int64), np.zeros((k, LEVELS), np.int64), np.zeros((k, LEVELS), np.int64)
    total = 0
    for part, n in enumerate(np.diff(rays.starts).tolist()):
        while True:
            level = heights[part]
            sizes[part, level], groups[part, level] = n, total
            n = -(-n // ways)
            total += n
            heights[part] += 1
            if n <= 1:
                break
    numbers = empty(total * step + PAD, np.float32)
    numbers[-PAD:] = 0
    alive = np.zeros(total + PAD, np.int32)
    tree = RayTree(ways, shift, nodes, step, numbers, alive, heights, sizes, groups, rays.starts, rays.faces)
    bounded = packed(tree), packed(beam), packed(rays)
    for level in range(int(heights.max(initial=0))):
        starts = np.append(0, np.cumsum(-(-sizes[:, level] // ways)))
        run_short(_bound, threads, new_ticket(int(starts[-1]), 64), *bounded, level, starts)
    return tree
