"""From leaf to leaf: 16 shafts, or rays, down a binary tree with a stack of links and masks."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.simd import get, put
from .counters import BOX_TESTS, NODES, count
from .slabs import (
    Mixed,
    Shafts,
    Uniform,
    children_mixed,
    children_uniform,
    least_direction,
    mixed_axis,
    uniform_axis,
    way_of,
)

NOWHERE = -2  # place of a walk that has not begun


class Slabs(NamedTuple):
    """16 shafts prepared for slab tests; the `Uniform` axes hold only if all lanes that count go the same ways."""

    uniform: bool
    ux: Uniform
    uy: Uniform
    uz: Uniform
    mx: Mixed
    my: Mixed
    mz: Mixed


class At(NamedTuple):
    """Where a walk is. The lanes in `mask` are about to visit `link`; mask 0: the walk is over."""

    link: int
    place: int  # where the link was read: node * 16 + 12 for a left child, + 13 for a right one; -1: the root
    mask: int
    height: int  # int32 on the stack: place and mask, in turn


@inlined
def rays_as_shafts(o, d):
    """`Shafts` of 16 rays from o along d."""
    return Shafts(o.x, o.y, o.z, o.x, o.y, o.z, d.x, d.y, d.z, d.x, d.y, d.z)


@inlined
def slabs_of(s, alive):
    """`Slabs` of `Shafts`; `alive`: bits of the lanes that count."""
    limit = least_direction(s)
    wx = way_of(s.dx_low, s.dx_high, limit, alive)
    wy = way_of(s.dy_low, s.dy_high, limit, alive)
    wz = way_of(s.dz_low, s.dz_high, limit, alive)
    return Slabs(
        wx != 0 and wy != 0 and wz != 0,
        uniform_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, wx),
        uniform_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, wy),
        uniform_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, wz),
        mixed_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit),
        mixed_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit),
        mixed_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit),
    )


@inlined
def root(alive):
    """Where a walk of the lanes in `alive` begins."""
    return At(np.int64(0), np.int64(-1), alive, np.int64(0))


@inlined
def nowhere():
    """Where a walk is that has not begun."""
    return At(np.int64(0), np.int64(NOWHERE), np.int64(0), np.int64(0))


@inlined
def left(at):
    """Where a walk is when it has done with a leaf."""
    return At(at.link, at.place, np.int64(0), at.height)


@inlined
def save(memory, at):
    """Keep where a walk is in 4 int32."""
    put(memory, 0, at.link)
    put(memory, 1, at.place)
    put(memory, 2, at.mask)
    put(memory, 3, at.height)


@inlined
def saved(memory, alive):
    """Where a walk was when it was kept; the lanes that died since are gone."""
    return At(
        np.int64(get(memory, 0)), np.int64(get(memory, 1)), np.int64(get(memory, 2)) & alive, np.int64(get(memory, 3))
    )


@inlined
def popped(links, at, stack, alive):
    """The place on top of the stack that lanes in `alive` wait for, if `at` has none left."""
    link, place, mask, height = at.link, at.place, at.mask, at.height
    while mask == 0 and height > 0:
        height -= 2
        place, mask = np.int64(get(stack, height)), np.int64(get(stack, height + 1)) & alive
        link = np.int64(get(links, place))
    return At(link, place, mask, height)


@inlined
def entered(links, at, left, right, stack):
    """The child that lanes visit first, once those that meet either are known; the other one waits on the stack."""
    here, height = at.link * 16 + 12, at.height
    if left != 0 and right != 0:
        put(stack, height, here + 1)
        put(stack, height + 1, right)
        height += 2
    place = here if left != 0 else here + 1
    return At(np.int64(get(links, place)), place, left if left != 0 else right, height)


@inlined
def next_leaf(tree, slabs, at, stack, alive, counters):
    """Go on from `at` to the next leaf that a lane in `alive` meets."""
    at = popped(tree.links, at, stack, alive)
    while at.mask != 0 and at.link >= 0:
        count(counters, NODES, 1)
        count(counters, BOX_TESTS, 2)
        if slabs.uniform:
            left, right = children_uniform(tree.nodes, at.link, slabs.ux, slabs.uy, slabs.uz)
        else:
            left, right = children_mixed(tree.nodes, at.link, slabs.mx, slabs.my, slabs.mz)
        at = popped(tree.links, entered(tree.links, at, left & at.mask, right & at.mask, stack), stack, alive)
    return at
