"""The implicit hierarchy over a beam's rays: left-balanced, a fixed number of children, no links.

Node i of a level has the nodes ``ways i`` to ``ways i + ways - 1`` of the level below, and at level 0 a leaf of as many
rays; so a node's leaves are a range too [Olsson and Assarsson 2011, Sec. 3.5]. Sixteen children fill a register; four
are the paper's. Children of one node, a *group*, lie together and are tested together. Each face of the cube around an
apex has a hierarchy of its own.
"""

from typing import Any, NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take
from ..kernels.simd import get, ptr, ptr_at, put
from .memory import Empty
from .nodes import bound_leaf, bound_node
from .rays import PAD, LeafRays, leaves_of
from .view import view_of

LEVELS = 16
"""No hierarchy has more: 2^32 rays in fours."""


class RayTree(NamedTuple):
    """Hierarchies over the rays of a beam, one for each face; k of them."""

    ways: int
    shift: int  # ways = 1 << shift
    nodes: Any  # Boxes, Shafts or Cones: the class says what the numbers mean
    step: int  # numbers of a group: `nodes.rows` x ways
    numbers: np.ndarray  # float32, groups of them
    alive: np.ndarray  # (groups + PAD,) int32: bits of the children that anything is still asked about
    heights: np.ndarray  # (k,) int64: levels
    sizes: np.ndarray  # (k, LEVELS) int64: nodes of each level
    groups: np.ndarray  # (k, LEVELS) int64: the first group of each level
    leaves: np.ndarray  # (k,) int64: the first leaf
    faces: np.ndarray  # (k,) int64


@inlined
def tree_pointers(tree):
    """The same `RayTree` with pointers instead of arrays: each array that is passed on costs a reference count."""
    return RayTree(
        tree.ways, tree.shift, tree.nodes, tree.step, ptr(tree.numbers), ptr(tree.alive), ptr(tree.heights),
        ptr(tree.sizes), ptr(tree.groups), ptr(tree.leaves), ptr(tree.faces),
    )  # fmt: skip


@inlined
def size_of(tree, part, level):
    """Nodes of a level."""
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
def _bound(ticket, arrays, beam, rays, part, level):
    """Worker: groups of nodes of one level, from the rays or from the nodes below."""
    tree, leaves, view = tree_pointers(arrays), leaves_of(rays), view_of(beam)
    n, start, ways = size_of(tree, part, level), groups_of(tree, part, level), np.int64(tree.ways)
    below = groups_of(tree, part, max(level - 1, 0))
    face, first_leaf = get(tree.faces, part), get(tree.leaves, part)
    first = take(ticket)
    while first >= 0:
        for g in range(first, min(first + ticket[CHUNK], ticket[N])):
            group, alive = group_at(tree, start + g), np.int64(0)
            for lane in range(min(ways, n - g * ways)):
                i = g * ways + lane
                if level == 0:
                    known = bound_leaf(tree.nodes, view, face, leaves, first_leaf + i, group, lane)
                else:
                    live = np.int64(get(tree.alive, below + i))
                    known = live != 0
                    if known:
                        bound_node(tree.nodes, group_at(tree, below + i), live, ways, group, lane)
                if known:
                    alive |= np.int64(1) << lane
            put(tree.alive, start + g, alive)
        first = take(ticket)


def tree_of(kind: Any, beam, rays: LeafRays, threads: int, empty: Empty = np.empty) -> RayTree:
    """The `RayTree` over a beam's rays; ``kind``: `Boxes`, `Shafts` or `Cones`."""
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
    numbers[:] = 0
    tree = RayTree(
        ways,
        shift,
        nodes,
        step,
        numbers,
        np.zeros(total + PAD, np.int32),
        heights,
        sizes,
        groups,
        rays.starts,
        rays.faces,
    )
    for part in range(k):
        for level in range(int(heights[part])):
            ticket = new_ticket(-(-int(sizes[part, level]) // ways), 64)
            run(_bound, threads, ticket, tree, beam, rays, part, level)
    return tree
