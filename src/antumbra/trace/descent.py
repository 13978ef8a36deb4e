"""Descent from leaf to leaf: 16 shafts, or rays, down a binary tree with a stack of links and masks.

Any-hit lanes visit children in the tree's order (`next_leaf`). Closest-hit lanes visit the nearer child first
(`next_block`).
"""

from typing import NamedTuple

import numpy as np

from ..bvh.links import block_leaf, box_at, line_at, link_at, sibling_at
from ..bvh.nodes import MAX_DEPTH
from ..kernels.fields import F32Ptr, I32Ptr
from ..kernels.jit import inlined
from ..kernels.simd import bits, get, load16, popcount, prefetch, put, store
from .blocktest import fetch
from .counters import BOX_TESTS, NODES, count
from .slabs import (
    Mixed,
    Shafts,
    Uniform,
    children_mixed,
    children_uniform,
    least_direction,
    mixed_axis,
    span_mixed,
    span_uniform,
    uniform_axis,
    way_of,
)

NOWHERE = -2  # place of a walk that has not begun
WAITING_INTS, WAITING_FLOATS = 2 * MAX_DEPTH, 16 * MAX_DEPTH


class Slabs(NamedTuple):
    """16 shafts prepared for slab tests. The `Uniform` axes are valid only if all live lanes go the same ways."""

    uniform: bool
    ux: Uniform
    uy: Uniform
    uz: Uniform
    mx: Mixed
    my: Mixed
    mz: Mixed


class At(NamedTuple):
    """The state of a walk. The lanes in `mask` are about to visit `link`; mask 0: the walk is over."""

    link: int
    place: int  # where the link is stored: `links.link_at`; -1: the root
    mask: int
    height: int  # int32 on the stack: place and mask, alternating


@inlined
def rays_as_shafts(o, d):
    """`Shafts` of 16 rays from o along d."""
    return Shafts(o.x, o.y, o.z, o.x, o.y, o.z, d.x, d.y, d.z, d.x, d.y, d.z)


@inlined
def slabs_of(s, alive):
    """`Slabs` of `Shafts` whose t ends at 1; `alive`: bits of the live lanes."""
    return _slabs(s, alive, False)


@inlined
def endless_slabs_of(s, alive):
    """`Slabs` of endless `Shafts`, whose t has no upper limit."""
    return _slabs(s, alive, True)


@inlined
def _slabs(s, alive, endless):
    limit = least_direction(s)
    wx = way_of(s.dx_low, s.dx_high, limit, alive)
    wy = way_of(s.dy_low, s.dy_high, limit, alive)
    wz = way_of(s.dz_low, s.dz_high, limit, alive)
    return Slabs(
        wx != 0 and wy != 0 and wz != 0,
        uniform_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, wx, endless),
        uniform_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, wy, endless),
        uniform_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, wz, endless),
        mixed_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, endless),
        mixed_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, endless),
        mixed_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, endless),
    )


@inlined
def children(nodes, node, slabs):
    """(bits of the lanes that meet the left child's box, bits of the lanes that meet the right child's box)."""
    if slabs.uniform:
        return children_uniform(nodes, node, slabs.ux, slabs.uy, slabs.uz)
    return children_mixed(nodes, node, slabs.mx, slabs.my, slabs.mz)


@inlined
def entry(nodes, at, slabs, far):
    """(bits of the lanes that may enter a box before `far`, the entry t of each lane).

    at : index in `nodes` of the box's lower x
    """
    if slabs.uniform:
        near, end = span_uniform(nodes, at, slabs.ux, slabs.uy, slabs.uz, far)
    else:
        near, end = span_mixed(nodes, at, slabs.mx, slabs.my, slabs.mz, far)
    return bits(near <= end), near


@inlined
def root(alive):
    """The start of a walk of the lanes in `alive`."""
    return At(np.int64(0), np.int64(-1), alive, np.int64(0))


@inlined
def nowhere():
    """The state of a walk that has not begun."""
    return At(np.int64(0), np.int64(NOWHERE), np.int64(0), np.int64(0))


@inlined
def left(at):
    """The state of a walk after a leaf."""
    return At(at.link, at.place, np.int64(0), at.height)


@inlined
def save(memory, at):
    """Write the state of a walk to 4 int32."""
    put(memory, 0, at.link)
    put(memory, 1, at.place)
    put(memory, 2, at.mask)
    put(memory, 3, at.height)


@inlined
def saved(memory, alive):
    """The saved state of a walk, without the lanes that have died since."""
    return At(
        np.int64(get(memory, 0)), np.int64(get(memory, 1)), np.int64(get(memory, 2)) & alive, np.int64(get(memory, 3))
    )


@inlined
def popped(links, at, stack, alive):
    """If `at` has no lanes left, pop the stack up to an entry with a lane in `alive`."""
    link, place, mask, height = at.link, at.place, at.mask, at.height
    while mask == 0 and height > 0:
        height -= 2
        place, mask = np.int64(get(stack, height)), np.int64(get(stack, height + 1)) & alive
        link = np.int64(get(links, place))
    return At(link, place, mask, height)


@inlined
def entered(links, at, left, right, stack):
    """Go to the left child first, and push the right one. left, right: bits of the lanes that meet each."""
    return entered_first(links, at, link_at(at.link, 0), left, right, stack)


@inlined
def entered_first(links, at, first, one, other, stack):
    """Go to the child at the place `first`, and push its sibling. one, other: bits of the lanes that meet each."""
    height = at.height
    if one != 0 and other != 0:
        put(stack, height, sibling_at(first))
        put(stack, height + 1, other)
        height += 2
    place = first if one != 0 else sibling_at(first)
    return At(np.int64(get(links, place)), place, one if one != 0 else other, height)


@inlined
def next_leaf(tree, slabs, at, stack, alive, counters):
    """Walk from `at` to the next leaf that a lane in `alive` meets."""
    at = popped(tree.links, at, stack, alive)
    while at.mask != 0 and at.link >= 0:
        count(counters, NODES, 1)
        count(counters, BOX_TESTS, 2)
        for child in range(2):  # before it is known which of them are met; the links of leaves are no addresses
            prefetch(tree.nodes, line_at(np.int64(get(tree.links, link_at(at.link, child)))))
        left, right = children(tree.nodes, at.link, slabs)
        at = popped(tree.links, entered(tree.links, at, left & at.mask, right & at.mask, stack), stack, alive)
    return at


class Near(NamedTuple):
    """The state of a closest-hit walk. The lanes in `mask` are about to visit `link`; mask 0: they have visited it."""

    link: int
    mask: int
    height: int  # links on the stack


class Waiting(NamedTuple):
    """Pointers to the stack of a closest-hit walk."""

    links: I32Ptr  # int32, WAITING_INTS: link and mask, alternating
    entries: F32Ptr  # float32, WAITING_FLOATS: entry t of each lane


@inlined
def _popped_near(at, waiting, far):
    """If `at` has no lanes, pop the stack up to a link whose box some lane still enters before `far`."""
    link, mask, height = at
    while mask == 0 and height > 0:
        height -= 1
        entries = load16(waiting.entries, 16 * height)
        link, mask = np.int64(get(waiting.links, 2 * height)), np.int64(get(waiting.links, 2 * height + 1))
        mask &= bits(entries <= far)
    return Near(link, mask, height)


@inlined
def visited(at):
    """The state of a closest-hit walk after a link."""
    return Near(at.link, np.int64(0), at.height)


@inlined
def _nearer_child(tree, slabs, at, waiting, far, counters):
    """Go to the child whose box most lanes enter first. Push the other child if some lane enters it before `far`."""
    count(counters, NODES, 1)
    count(counters, BOX_TESTS, 2)
    left, a = entry(tree.nodes, box_at(at.link, 0), slabs, far)
    right, b = entry(tree.nodes, box_at(at.link, 1), slabs, far)
    left &= at.mask
    right &= at.mask
    if left | right == 0:
        return visited(at)
    first = np.int64(get(tree.links, link_at(at.link, 0)))
    second = np.int64(get(tree.links, link_at(at.link, 1)))
    if left != 0:
        fetch(tree, first)
    if right == 0:
        return Near(first, left, at.height)
    fetch(tree, second)
    if left == 0:
        return Near(second, right, at.height)
    both = left & right
    swap = 2 * popcount(bits(b < a) & both) > popcount(both)
    put(waiting.links, 2 * at.height, first if swap else second)
    put(waiting.links, 2 * at.height + 1, left if swap else right)
    store(waiting.entries, 16 * at.height, a if swap else b)
    return Near(second if swap else first, right if swap else left, at.height + 1)


@inlined
def next_block(tree, slabs, at, waiting, far, counters):
    """Walk from `at` to the next block that a lane enters before `far`; mask 0: there is none."""
    at = _popped_near(at, waiting, far)
    while at.mask != 0 and (at.link >= 0 or block_leaf(at.link).count == 0):
        at = _nearer_child(tree, slabs, at, waiting, far, counters) if at.link >= 0 else visited(at)
        at = _popped_near(at, waiting, far)
    return at
