"""Traversal orders: the child that an any-hit ray visits first [Feltman et al. 2012, Sec. 3.1].

An any-hit ray ends at its first hit, so the order of children decides how many nodes it visits. An order is a number.
The any-hit walk (`traverse.walk`) passes it to `left_comes_first` at each node whose two boxes the ray enters. An order
that is the same for all rays at a node costs nothing: the builder stores the first child as the left one. `rtsah` does
so, and the builder `srdh` where it chooses a fixed order.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.links import line_at, order_at
from ...bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED, Bvh
from ...kernels.jit import inlined, kernel
from ...kernels.simd import as_i32, extract, get, load4, put, stack_f32, swap_halves

CLOSEST = -1  # not an any-hit order: the walk looks for the nearest hit
BUILT = UNORDERED  # the builder's choice at each node; without a choice, the child whose box is entered first
RANDOM, SRDH, NEAREST = 4, 5, 6  # besides LEFT_FIRST, FRONT_TO_BACK and BACK_TO_FRONT, by the children's centres


@inlined
def _squared(nodes, at, o):
    """Squared distances of twice the boxes' centres from twice the coordinate o, along one axis, in lanes 0 and 1."""
    planes = load4(nodes, at)
    away = planes + swap_halves(planes) - np.float32(2.0) * o
    return away * away


@inlined
def _left_is_closer(nodes, node, o):
    """Whether the centre of the left child's box is closer to the ray's origin."""
    b = line_at(node)
    away = _squared(nodes, b, o[0]) + _squared(nodes, b + 4, o[1]) + _squared(nodes, b + 8, o[2])
    return extract(away, 0) <= extract(away, 1)


@kernel
def _toss(node, o, d):
    """A coin toss that depends only on the ray and the node."""
    words = stack_f32(6)
    for k in range(3):
        put(words, k, o[k])
        put(words, 3 + k, d[k])
    h = np.uint32(node) * np.uint32(0x9E3779B1)
    for k in range(6):
        h = np.uint32((h ^ np.uint32(get(as_i32(words), k))) * np.uint32(0x85EBCA6B))
        h ^= h >> np.uint32(15)
    h = np.uint32(h * np.uint32(0xC2B2AE35))
    return (h >> np.uint32(31)) == 0


@kernel
def _by_ray(order, nodes, node, a, b, o, d):
    """`left_comes_first` of an order that depends on the ray. Not inlined, because few walks need it."""
    if order == FRONT_TO_BACK:
        return _left_is_closer(nodes, node, o)
    if order == BACK_TO_FRONT:
        return not _left_is_closer(nodes, node, o)
    if order == RANDOM:
        return _toss(node, o, d)
    return a <= b


@inlined
def left_comes_first(order, nodes, links, node, a, b, o, d):
    """Whether a ray from o along d visits a node's left child first.

    a, b : entry t of the boxes of the left and the right child
    """
    if order == BUILT or order == SRDH:
        chosen = np.int64(get(links, order_at(node)))
        if chosen == LEFT_FIRST:
            return True
        if chosen == UNORDERED and order == BUILT:
            return a <= b
        order = chosen if chosen != UNORDERED else np.int64(RANDOM)
    if order == CLOSEST:
        return a <= b
    return order == LEFT_FIRST or _by_ray(order, nodes, node, a, b, o, d)


class Ordered(NamedTuple):
    """The input of `single`: a BVH and the order in which its children are visited."""

    bvh: Bvh
    order: int
