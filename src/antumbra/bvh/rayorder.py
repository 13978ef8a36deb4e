"""Choose the best order of children of a finished tree for sampled rays, by the cost metric of [Feltman et al. 2012,
Sec. 3.2].

A builder only has estimates of this metric. Let C be the cost of a subtree for a ray, and H whether the ray meets
something in the subtree. If the left child A comes first, the cost is

    C = C(A) + (1 - H(A)) C(B)                                           (docs/design/srdh.md, eq. 3)

So the right child B should be first if, over the rays that come to the node,

    sum of H(B) C(A)  >  sum of H(A) C(B)                                (docs/design/srdh.md, eq. 4)

C and H of all subtrees that a ray enters follow from the leaves up. A node's own order does not change its children's C
and H. So one pass finds the best order at each node, for the rays that come there by the old orders. Boxes and
triangles cost 1 each, so all sums are whole numbers.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import (
    atomic_add,
    bits,
    load4,
    load16,
    maximum,
    minimum,
    ptr,
    splat4,
    stack_array,
    store,
    swap_halves,
)
from ..trace.rays.ray_hits import Intersections
from .links import LINK, ORDER, bvh_leaf, line_at
from .nodes import EMPTY, LEFT_FIRST, MAX_DEPTH, Bvh, aligned_empty, parents_first
from .order import swap_children
from .rayset import GROW, bounded_rays, check_intersections, ray_at

_CHUNK = 64  # rays
_LEVELS = MAX_DEPTH + 2


class _Frames(NamedTuple):
    """The nodes on the path from the root to a ray's current node, (_LEVELS,) int64 each."""

    node: np.ndarray  # index of the node
    entered: np.ndarray  # bits of the children whose boxes the ray enters
    side: np.ndarray  # the next child; 2: both are done
    comes: np.ndarray  # 1 if the ray comes here by the old orders
    cost: np.ndarray  # cost of the left child
    hits: np.ndarray  # 1 if the ray meets something in the left child


@inlined
def _children_entered(nodes, node, ray):
    """Bits of the children whose boxes a ray enters."""
    b = line_at(node)
    x, y, z = (
        (load4(nodes, b) - ray.ox) * ray.ix,
        (load4(nodes, b + 4) - ray.oy) * ray.iy,
        (load4(nodes, b + 8) - ray.oz) * ray.iz,
    )
    u, v, w = swap_halves(x), swap_halves(y), swap_halves(z)
    near = maximum(maximum(minimum(x, u), minimum(y, v)), maximum(minimum(z, w), splat4(np.float32(0.0))))
    far = minimum(minimum(maximum(x, u), maximum(y, v)), minimum(maximum(z, w), splat4(np.float32(1.0))))
    return bits(near <= far * GROW) & 3


@inlined
def _leaf(bvh, link, met, ray):
    """(triangles of a leaf, 1 if the ray meets one of them); `met` has the last ray that met each triangle."""
    if link == EMPTY:
        return np.int64(0), np.int64(0)
    leaf, hit = bvh_leaf(link), np.int64(0)
    for slot in range(leaf.first, leaf.first + leaf.count):
        hit |= np.int64(met[bvh.prim_ids[slot]] == ray)
    return leaf.count, hit


@kernel
def _weigh(bvh, box_ray, i, met, frames, gains):
    """Add to each node's gain the cost that ray i saves if the right child comes first."""
    nodes = ptr(bvh.nodes)
    frames.node[0], frames.side[0], frames.comes[0] = 0, 0, 1
    frames.entered[0] = _children_entered(nodes, 0, box_ray)
    depth, cost, hit = 0, np.int64(0), np.int64(0)  # cost, hit: of the child that was done last
    while depth >= 0:
        node, side = frames.node[depth], frames.side[depth]
        if side == 1:
            frames.cost[depth], frames.hits[depth] = cost, hit
        if side == 2:
            left, right, met_left = frames.cost[depth], cost, frames.hits[depth]
            if frames.comes[depth] and met_left | hit:
                atomic_add(gains, node, hit * left - met_left * right)
            cost, hit = left + (1 - met_left) * right, hit | met_left
            cost += 1  # this node's own box
            depth -= 1
            continue
        frames.side[depth] += 1
        cost, hit = np.int64(1), np.int64(0)
        if not frames.entered[depth] >> side & 1:
            continue
        link = np.int64(bvh.links[node, LINK + side])
        if link < 0:
            count, hit = _leaf(bvh, link, met, i)
            cost += count
            continue
        comes = frames.comes[depth] if side == 0 or frames.hits[depth] == 0 else 0
        depth += 1
        frames.node[depth], frames.side[depth], frames.comes[depth] = link, 0, comes
        frames.entered[depth] = _children_entered(nodes, link, box_ray)


@kernel
def _weigh_rays(ticket, bvh, rays, found, gains, met):
    """Worker: add the gains of each ray. `met` is the thread's own memory, -1 for each triangle."""
    frames = _Frames(
        stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS),
        stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS),
    )  # fmt: skip
    for i in items(ticket):
        for k in range(found.first[i], found.first[i + 1]):
            met[found.prims[k]] = i
        _weigh(bvh, ray_at(ptr(rays), i), i, met, frames, gains)


@kernel
def _choose(bvh, gains):
    """Put the children of all nodes into the better order."""
    words = ptr(bvh.links)
    for node in range(len(bvh.nodes)):
        if gains[node] != 0:
            bvh.links[node, ORDER] = LEFT_FIRST
        if gains[node] > 0:
            swap_children(words, node)


@kernel
def _copy_nodes(bvh, order, numbers, new_nodes, new_links):
    """Copy the nodes in `order`, depth first. `numbers` is scratch memory for the new indices."""
    for i in range(len(order)):
        numbers[order[i]] = i
    for i in range(len(order)):
        store(new_nodes, line_at(i), load16(bvh.nodes, line_at(np.int64(order[i]))))
        for side in range(2):
            link = bvh.links[order[i], LINK + side]
            new_links[i, LINK + side] = numbers[link] if link >= 0 else link


def order_by_rays(bvh: Bvh, threads: int | None = None, *, rays: Intersections | None = None) -> Bvh:
    """The same tree, with the first child of each node chosen for these rays. Where no ray decides, orders stay.

    Parameters
    ----------
    bvh : Bvh
        It is not changed. The builder's orders by distance become constant where rays decide.
    rays : Intersections
        A sparse sample of the rays that will be traced, with all triangles that each ray meets. With None or an
        empty sample, `bvh` itself is returned.

    Returns
    -------
    Bvh
        The same bits for any number of threads. A left child follows its parent in memory.

    Raises
    ------
    InputError
        If a ray meets a triangle out of range.
    """
    if rays is None or len(rays.origins) == 0 or len(bvh.prim_ids) < 2:
        return bvh
    check_intersections(rays, len(bvh.prim_ids))
    m, threads = len(rays.origins), thread_count(threads)
    gains = np.zeros(len(bvh.nodes), np.int64)
    own = lambda: (np.full(len(bvh.prim_ids), -1, np.int32),)
    run(_weigh_rays, threads, new_ticket(m, _CHUNK), bvh, bounded_rays(rays), rays, gains, own=own)
    old, new = aligned_empty(bvh.nodes.shape, "f4"), aligned_empty(bvh.nodes.shape, "f4")
    old[:] = bvh.nodes
    chosen = bvh._replace(nodes=old, links=old.view(np.int32))
    _choose(chosen, gains)
    _copy_nodes(chosen, parents_first(chosen.links), np.empty(len(old), np.int32), new, new.view(np.int32))
    return bvh._replace(nodes=new, links=new.view(np.int32))
