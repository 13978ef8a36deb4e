"""Which of two children an any-hit ray visits first: the traversal orders of [Feltman et al. 2012, Sec. 3.1].

A ray that asks for any hit ends at the first one, so the order of children decides how much it visits. An order is a
number that the one body of any-hit (`traverse.walk`) hands to `left_comes_first` at each node whose boxes both are
entered. Orders that are the same for all rays at a node cost nothing: the child to visit first is stored as the left
one (`rtsah`, and what the builder `srdh` chooses).
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED, Bvh
from ...kernels.jit import inlined, kernel
from ...kernels.simd import as_i32, extract, get, load4, put, stack_f32, swap_halves

CLOSEST = -1  # no order of any-hit: the nearest hit is wanted
BUILT = UNORDERED  # as the builder chose at each node; where it did not, the child whose box is entered first
RANDOM, SRDH, NEAREST = 4, 5, 6  # besides LEFT_FIRST, FRONT_TO_BACK and BACK_TO_FRONT, by the children's centres


@inlined
def _squared(nodes, at, o):
    """Along one axis: in lanes 0 and 1 the squared distances of twice the boxes' centres from twice a coordinate o."""
    planes = load4(nodes, at)
    away = planes + swap_halves(planes) - np.float32(2.0) * o
    return away * away


@inlined
def _left_is_closer(nodes, node, o):
    """Whether the centre of the left child's box is closer to the ray's origin."""
    b = node * 16
    away = _squared(nodes, b, o[0]) + _squared(nodes, b + 4, o[1]) + _squared(nodes, b + 8, o[2])
    return extract(away, 0) <= extract(away, 1)


@kernel
def _toss(node, o, d):
    """A coin that falls the same way whenever the same ray comes to the same node."""
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
    """`left_comes_first` of an order that depends on the ray; out of line, since few walks want it."""
    if order == FRONT_TO_BACK:
        return _left_is_closer(nodes, node, o)
    if order == BACK_TO_FRONT:
        return not _left_is_closer(nodes, node, o)
    if order == RANDOM:
        return _toss(node, o, d)
    return a <= b


@inlined
def left_comes_first(order, nodes, links, node, a, b, o, d):
    """Whether an any-hit ray from o along d, or a closest-hit one, visits a node's left child first.

    a, b : where it enters the boxes of the left and the right child
    """
    if order == BUILT or order == SRDH:
        chosen = np.int64(get(links, node * 16 + 14))
        if chosen == LEFT_FIRST:
            return True
        if chosen == UNORDERED and order == BUILT:
            return a <= b
        order = chosen if chosen != UNORDERED else np.int64(RANDOM)
    if order == CLOSEST:
        return a <= b
    return order == LEFT_FIRST or _by_ray(order, nodes, node, a, b, o, d)


class Ordered(NamedTuple):
    """What `single` walks: a BVH and the order in which its children are visited."""

    bvh: Bvh
    order: int
