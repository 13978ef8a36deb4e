"""Refit a wide BVH to moved triangles, with the binary BVH from which it was made.

Each child of a wide node has the box of a child of a binary node, and the wide node stores which. Once the binary BVH
is refitted, the wide one thus needs no new choice and no bottom-up pass: boxes and triangles are copied. Threads refit
one small part of both trees at a time, so what is copied is still in the cache.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.array_pool import ArrayPool
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short
from ..kernels.simd import get, load16, ptr, ptr_at, put, stack_f32, store
from .nodes import BINARY, GROUP_WORDS, LINKS, NO_CHILD, NODE_WORDS, WIDTH, Bvh, WideBvh, is_leaf, tree_of, wide_leaf
from .refit import refit_part, write_top
from .tree_layout import TreeFrontier, cut_tree
from .wide_bvh import fill_group, fill_node, reach_of_root

_PART = 1024  # maximum nodes of the binary BVH in a part: both trees of a part fit in an L2 cache


class RefitParts(NamedTuple):
    """Which nodes and groups of a wide BVH depend on which part of the binary one, and so are refitted with it."""

    cut: TreeFrontier  # of the binary BVH, into s parts
    nodes: NDArray[np.int32]  # (n_nodes,) int32: wide nodes, part by part; at the end those that depend on several
    groups: NDArray[np.int32]  # (n_groups,) int32: groups, likewise
    starts: NDArray[np.int64]  # (s + 2, 2) int64: first position of each part in `nodes` and `groups`, and their ends


def refit_parts(wide: WideBvh) -> RefitParts:
    """The parts of a wide BVH and of its binary one."""
    cut = cut_tree(wide.bvh, largest=_PART)
    s, roots = len(cut.parts), cut.parts[:, 0]
    inner = np.flatnonzero(roots >= 0)
    inner = inner[np.argsort(roots[inner])]
    links, owners = wide.links[:, LINKS : LINKS + WIDTH], wide.links[:, BINARY : BINARY + WIDTH] >> 1
    place = np.searchsorted(roots[inner], owners, "right") - 1
    part = np.where((place >= 0) & (owners < cut.parts[inner[place], 1]), inner[place], s)
    is_child = links != NO_CHILD
    lowest, highest = np.where(is_child, part, s).min(1), np.where(is_child, part, -1).max(1)
    of_nodes, of_groups = np.where(lowest == highest, lowest, s), np.full(len(wide.groups), s)
    leaves = is_leaf(links) & is_child
    of_groups[wide_leaf(links[leaves]).group] = part[leaves]
    order = [np.argsort(of_what, kind="stable") for of_what in (of_nodes, of_groups)]
    counts = [np.bincount(of_what, minlength=s + 1) for of_what in (of_nodes, of_groups)]
    starts = np.zeros((s + 2, 2), np.int64)
    starts[1:] = np.cumsum(np.stack(counts, 1), axis=0)
    return RefitParts(cut, order[0].astype(np.int32), order[1].astype(np.int32), starts)


@inlined
def _refit_node(source, old, links, node, words):
    """Copy a wide node, with boxes of the refitted binary BVH."""
    at = node * NODE_WORDS
    for word in range(0, NODE_WORDS, 16):
        store(words, at + word, load16(old, at + word))
    lane = 0
    while lane < WIDTH and get(links, at + LINKS + lane) != NO_CHILD:
        fill_node(source, np.int64(get(links, at + BINARY + lane)), lane, words, at)
        lane += 1


@inlined
def _copy_part(part, parts, wide, new, last):
    """Copy the boxes and triangles of the wide nodes and groups of a part; `last`: scratch memory."""
    source, corners, nodes, groups = ptr(new.bvh.nodes), ptr(new.bvh.corners), ptr(new.nodes), ptr(new.groups)
    old, links, slots = ptr(wide.nodes), ptr(wide.links), ptr(wide.slots)
    for i in range(parts.starts[part, 0], parts.starts[part + 1, 0]):
        _refit_node(source, old, links, np.int64(parts.nodes[i]), nodes)
    for i in range(parts.starts[part, 1], parts.starts[part + 1, 1]):
        group = np.int64(parts.groups[i])
        fill_group(corners, ptr_at(slots, group * WIDTH), last, ptr_at(groups, group * GROUP_WORDS))


@kernel
def _refit_parts(ticket, vertices, wide, parts, new, boxes):
    """Worker: refit each part of both trees, and store its box."""
    # In: vertices, (n, 9) float32; wide, `WideBvh`; parts, `RefitParts`. Out: new, `WideBvh`; boxes, (s, 8) float32
    v, old, out, last = ptr(vertices), tree_of(wide.bvh), tree_of(new.bvh), stack_f32(WIDTH)
    for p in items(ticket):
        root, end, _ = parts.cut.parts[p]
        store(boxes, p * 8, refit_part(v, old, root, end, out, None))
        _copy_part(p, parts, wide, new, last)


@kernel
def _copy_rest(part, wide, parts, new):
    """Copy the wide nodes and groups that depend on several parts."""
    _copy_part(part, parts, wide, new, stack_f32(WIDTH))


def refit_wide(
    wide: WideBvh, parts: RefitParts, vertices: NDArray[np.float32], threads: int, pool: ArrayPool
) -> WideBvh:
    """The same wide BVH and binary BVH, of two triangles or more, with moved triangles. Children keep their order.

    vertices : (n, 3, 3) float32
        All triangles of the scene, finite and at most 1e18 in magnitude. The `prim_ids` of `wide.bvh` index them.

    The result is identical for any number of threads. Its arrays are in recycled memory.
    """
    bvh, s = wide.bvh, len(parts.cut.parts)
    nodes, groups = pool.empty(wide.nodes.shape, np.float32), pool.empty(wide.groups.shape, np.float32)
    binary, corners = pool.empty(bvh.nodes.shape, np.float32), pool.empty(bvh.corners.shape, np.float32)
    moved = Bvh(binary, binary.view(np.int32), bvh.prim_ids, corners)
    new = WideBvh(nodes, nodes.view(np.int32), groups, wide.slots, wide.reach, moved)
    boxes = np.empty((s, 8), np.float32)
    run_short(_refit_parts, threads, new_ticket(s, 1), vertices.reshape(-1, 9), wide, parts, new, boxes)
    write_top(parts.cut, boxes, binary)
    _copy_rest(s, wide, parts, new)
    return new._replace(reach=reach_of_root(nodes))
