"""Leaf-to-leaf traversal of a binary tree by 16 shafts or rays, with one stack of links and masks.

Slab tests compare one box with 16 lanes at once. A *shaft* contains all segments from a box of origins to a box of
targets. Along each axis, o_low and o_high bound the origins. d_low leads from the lower bound of the origins to the
lower bound of the targets, and d_high from upper bound to upper bound. At parameter t the shaft's points lie between
o_low + t d_low and o_high + t d_high. So the shaft meets the slab [low, high] of a node's box at t if

    o_high + t d_high >= low     and     o_low + t d_low <= high

Each condition bounds t on one side. The first bounds t from below if d_high > 0, the second if d_low < 0; otherwise
they bound t from above. An interval of directions that contains zero needs no special test, though the paper adds one:
both of its conditions bound t from below.

If the origin box is a point, the shaft is the frustum of multi-frusta tracing, and this is its interval slab test
[Benthin and Wald 2009, Sec. 4.1; Boulos et al. 2006]. If both boxes are points, the shaft is a ray.

The test is conservative in float32. A bound is fma(plane, r, k) with r = 1 / d and k = -o r; u is the unit roundoff.

- Rounding d and r adds an error of 3u |plane r|, at most 3u (|t| + |k|).
- Rounding k adds 4u |k|, and the fma adds u |t|.
- `_PAD` = 12u of |k|, added to k once, outwards, covers the errors in |k|. Only underflow is a fixed share of the
  shaft's length, which may exceed the boxes by far.
- r and k are multiplied by `GROW` for an exit, and by `_SHRINK` for an entry, which covers the errors 7u |t| of an
  entry and 9u |t| of an exit. A box behind the origin is not entered, whichever way its negative t is rounded.

A tiny |d| is replaced by a limit, with the sign that bounds t from below. The bound is never tighter than the exact
one.

Child order: any-hit lanes visit children in the tree's order (`next_leaf`), closest-hit lanes the nearer child first
(`next_block`).
"""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import MAX_DEPTH, block_leaf, box_at, line_at, link_at, sibling_at
from ..kernels.jit import F32Ptr, F32x16, I32Ptr, inlined
from ..kernels.simd import (
    absolute,
    bits,
    broadcast16,
    fma,
    get,
    load16,
    maximum,
    minimum,
    popcount,
    prefetch,
    put,
    select,
    splat16,
    store,
)
from .counters import BOX_TESTS, NODES, count
from .triangle_tests import fetch

# --- Slab tests of 16 shafts ------------------------------------------------------------------------------------------


GROW, _SHRINK = np.float32(1.0 + 2.0**-19), np.float32(1.0 - 2.0**-19)  # 32u
_PAD = np.float32(12 * 2.0**-24)
_VANISHING = np.float32(1e-37)  # more than what underflow takes from a bound
_LOW = np.float32(1e-7)  # directions below this fraction of the longest count as zero
_ZERO, _ONE, _INFINITE = np.float32(0.0), np.float32(1.0), np.float32(np.inf)


class Shafts(NamedTuple):
    """Bounds of 16 shafts; all fields f32x16."""

    ox_low: F32x16
    oy_low: F32x16
    oz_low: F32x16
    ox_high: F32x16
    oy_high: F32x16
    oz_high: F32x16
    dx_low: F32x16
    dy_low: F32x16
    dz_low: F32x16
    dx_high: F32x16
    dy_high: F32x16
    dz_high: F32x16


class Bound(NamedTuple):
    """The line b r + k in the coordinate b of a plane; both f32x16."""

    r: F32x16
    k: F32x16


class Uniform(NamedTuple):
    """Slabs of one axis along which all lanes have the same sign of direction: entry and exit bounds and planes."""

    near: Bound
    far: Bound
    near_plane: int  # offset in a node's line: 0 the lower planes, 2 the upper ones
    far_plane: int  # the same for the exit


class Mixed(NamedTuple):
    """Slabs of one axis for lanes of any direction: entry and exit bounds from the lower and the upper planes."""

    near_low: Bound  # t >= this bound at the lower plane; (0, 0) where it does not bind
    near_high: Bound  # t >= this bound at the upper plane
    far_low: Bound  # t <= this bound at the lower plane; (0, 1) or (0, infinity) where it does not bind
    far_high: Bound  # t <= this bound at the upper plane


@inlined
def _bounds(o, d):
    """The lower and the upper `Bound` t = (plane - o) / d."""
    r = _ONE / d
    k = -o * r
    pad = fma(absolute(k), _PAD, _VANISHING)
    return Bound(r * _SHRINK, (k - pad) * _SHRINK), Bound(r * GROW, (k + pad) * GROW)


@inlined
def _choose(there, bound, otherwise):
    """The bound in the lanes of `there`, and the constant t `otherwise` in the other lanes."""
    return Bound(select(there, bound.r, _ZERO), select(there, bound.k, otherwise))


@inlined
def mixed_axis(o_low, o_high, d_low, d_high, limit, endless):
    """`Mixed` of one axis, for vectors of any width; limit: the least |d| in each lane."""
    # Eq. (1) of docs/design/multifrusta.md
    end = _INFINITE if endless else _ONE
    up, down = d_high > -limit, d_low < limit
    low, high = _bounds(o_high, select(up, maximum(d_high, limit), d_high))
    near_low, far_low = _choose(up, low, _ZERO), _choose(~up, high, end)
    low, high = _bounds(o_low, select(down, minimum(d_low, -limit), d_low))
    return Mixed(near_low, _choose(down, low, _ZERO), far_low, _choose(~down, high, end))


@inlined
def direction_sign(d_low, d_high, limit, lanes):
    """Common sign of direction of `lanes` (bits) along an axis: 1, -1, or 0 if they differ or are near zero."""
    if ~bits(d_low >= limit) & lanes == 0:  # LLVM cannot compare the bits of two masks in WebAssembly
        return 1
    return -1 if ~bits(d_high <= -limit) & lanes == 0 else 0


@inlined
def uniform_axis(o_low, o_high, d_low, d_high, limit, sign):
    """`Uniform` of one axis; sign: its `direction_sign`, 1 or -1."""
    # Eq. (1) of docs/design/multifrusta.md
    up = sign > 0
    # dead lanes may hold any value: keep their reciprocals finite
    high, low = maximum(absolute(d_high), limit), maximum(absolute(d_low), limit)
    first, last = (o_high, o_low) if up else (o_low, o_high)
    enters, leaves = (high, low) if up else (-low, -high)
    t_near, t_far = _bounds(first, enters)[0], _bounds(last, leaves)[1]
    return Uniform(t_near, t_far, 0 if up else 2, 2 if up else 0)


@inlined
def least_direction(s):
    """The |d| below which a direction counts as zero, in each lane."""
    d = maximum(maximum(absolute(s.dx_low), absolute(s.dx_high)), maximum(absolute(s.dy_low), absolute(s.dy_high)))
    d = maximum(d, maximum(absolute(s.dz_low), absolute(s.dz_high)))
    o = maximum(maximum(absolute(s.ox_low), absolute(s.oy_low)), absolute(s.oz_low))
    return maximum(maximum(d, o * np.float32(1e-7)) * _LOW, np.float32(1e-25))


@inlined
def _at(bound, plane):
    return fma(plane, bound.r, bound.k)


@inlined
def span_uniform(nodes, at, x, y, z, end):
    """(entry t, exit t) f32x16 of the shafts in a box, between 0 and `end`; at: index in `nodes` of its lower x."""
    t_near = maximum(
        maximum(
            _at(x.near, broadcast16(nodes, at + x.near_plane)), _at(y.near, broadcast16(nodes, at + 4 + y.near_plane))
        ),
        maximum(_at(z.near, broadcast16(nodes, at + 8 + z.near_plane)), splat16(_ZERO)),
    )
    t_far = minimum(
        minimum(_at(x.far, broadcast16(nodes, at + x.far_plane)), _at(y.far, broadcast16(nodes, at + 4 + y.far_plane))),
        minimum(_at(z.far, broadcast16(nodes, at + 8 + z.far_plane)), end),
    )
    return t_near, t_far


@inlined
def _narrow(axis, low, high, t_near, t_far):
    """The interval (t_near, t_far), narrowed by one axis."""
    t_near = maximum(t_near, maximum(_at(axis.near_low, low), _at(axis.near_high, high)))
    return t_near, minimum(t_far, minimum(_at(axis.far_low, low), _at(axis.far_high, high)))


@inlined
def span_mixed(nodes, at, x, y, z, end):
    """`span_uniform` for lanes of any direction."""
    t_near, t_far = _narrow(x, broadcast16(nodes, at), broadcast16(nodes, at + 2), splat16(_ZERO), end)
    t_near, t_far = _narrow(y, broadcast16(nodes, at + 4), broadcast16(nodes, at + 6), t_near, t_far)
    return _narrow(z, broadcast16(nodes, at + 8), broadcast16(nodes, at + 10), t_near, t_far)


@inlined
def meets_uniform(nodes, at, x, y, z):
    """mask16 of the lanes whose shaft meets a box; at: index in `nodes` of its lower x."""
    t_near, t_far = span_uniform(nodes, at, x, y, z, splat16(_ONE))
    return t_near <= t_far


@inlined
def meets_mixed(nodes, at, x, y, z):
    """`meets_uniform` for lanes of any direction."""
    t_near, t_far = span_mixed(nodes, at, x, y, z, splat16(_ONE))
    return t_near <= t_far


@inlined
def children_uniform(nodes, node, x, y, z):
    """(bits of the lanes that meet the left child's box, bits of the lanes that meet the right child's box)."""
    return bits(meets_uniform(nodes, box_at(node, 0), x, y, z)), bits(meets_uniform(nodes, box_at(node, 1), x, y, z))


@inlined
def children_mixed(nodes, node, x, y, z):
    """`children_uniform` for lanes of any direction."""
    return bits(meets_mixed(nodes, box_at(node, 0), x, y, z)), bits(meets_mixed(nodes, box_at(node, 1), x, y, z))


# --- Traversal from leaf to leaf --------------------------------------------------------------------------------------


NOT_STARTED = -2  # place of a traversal that has not begun
WAITING_INTS, WAITING_FLOATS = 2 * MAX_DEPTH, 16 * MAX_DEPTH


class Slabs(NamedTuple):
    """16 shafts prepared for slab tests. The `Uniform` axes are valid only if `uniform` is true."""

    uniform: bool
    ux: Uniform
    uy: Uniform
    uz: Uniform
    mx: Mixed
    my: Mixed
    mz: Mixed


class Traversal(NamedTuple):
    """The state of a traversal. The lanes in `mask` are about to visit `link`; mask 0: the traversal is complete."""

    link: int
    place: int  # where the link is stored: `links.link_at`; -1: the root
    mask: int
    height: int  # number of int32 on the stack: place and mask, alternating


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
    wx = direction_sign(s.dx_low, s.dx_high, limit, alive)
    wy = direction_sign(s.dy_low, s.dy_high, limit, alive)
    wz = direction_sign(s.dz_low, s.dz_high, limit, alive)
    return Slabs(
        wx != 0 and wy != 0 and wz != 0,
        uniform_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, wx),
        uniform_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, wy),
        uniform_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, wz),
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
        t_near, t_far = span_uniform(nodes, at, slabs.ux, slabs.uy, slabs.uz, far)
    else:
        t_near, t_far = span_mixed(nodes, at, slabs.mx, slabs.my, slabs.mz, far)
    return bits(t_near <= t_far), t_near


@inlined
def root(alive):
    """The initial state of a traversal by the lanes in `alive`."""
    return Traversal(0, -1, alive, 0)


@inlined
def not_started():
    """The state of a traversal that has not begun."""
    return Traversal(0, np.int64(NOT_STARTED), 0, 0)


@inlined
def after_leaf(at):
    """The state of a traversal after a leaf."""
    return Traversal(at.link, at.place, 0, at.height)


@inlined
def save(memory, at):
    """Write the state of a traversal to 4 int32."""
    put(memory, 0, at.link)
    put(memory, 1, at.place)
    put(memory, 2, at.mask)
    put(memory, 3, at.height)


@inlined
def load_saved(memory, alive):
    """The saved state of a traversal, without the lanes that are no longer alive."""
    return Traversal(get(memory, 0), get(memory, 1), get(memory, 2) & alive, get(memory, 3))


@inlined
def pop_node(links, at, stack, alive):
    """If `at` has no lanes left, pop the stack until an entry has a lane in `alive`."""
    link, place, mask, height = at.link, at.place, at.mask, at.height
    while mask == 0 and height > 0:
        height -= 2
        place, mask = get(stack, height), get(stack, height + 1) & alive
        link = get(links, place)
    return Traversal(link, place, mask, height)


@inlined
def entered(links, at, left_lanes, right_lanes, stack):
    """Go to the left child and push the right one; `left_lanes`, `right_lanes`: bits of the lanes that meet them."""
    return enter_first(links, at, link_at(at.link, 0), left_lanes, right_lanes, stack)


@inlined
def enter_first(links, at, first, one, other, stack):
    """Go to the child at the place `first` and push its sibling; one, other: bits of the lanes that meet them."""
    height = at.height
    if one != 0 and other != 0:
        put(stack, height, sibling_at(first))
        put(stack, height + 1, other)
        height += 2
    place = first if one != 0 else sibling_at(first)
    return Traversal(get(links, place), place, one if one != 0 else other, height)


@inlined
def next_leaf(tree, slabs, at, stack, alive, counters):
    """Traverse from `at` to the next leaf that a lane in `alive` meets."""
    at = pop_node(tree.links, at, stack, alive)
    while at.mask != 0 and at.link >= 0:
        count(counters, NODES, 1)
        count(counters, BOX_TESTS, 2)
        for child in range(2):  # before the test; links of leaves are harmless prefetch addresses
            prefetch(tree.nodes, line_at(get(tree.links, link_at(at.link, child))))
        left_lanes, right_lanes = children(tree.nodes, at.link, slabs)
        at = pop_node(
            tree.links, entered(tree.links, at, left_lanes & at.mask, right_lanes & at.mask, stack), stack, alive
        )
    return at


class NearestTraversal(NamedTuple):
    """The state of a closest-hit traversal. The lanes in `mask` are about to visit `link`; mask 0: already visited."""

    link: int
    mask: int
    height: int  # links on the stack


class NearestStack(NamedTuple):
    """Pointers to the stack of a closest-hit traversal."""

    links: I32Ptr  # int32, WAITING_INTS: link and mask, alternating
    entries: F32Ptr  # float32, WAITING_FLOATS: entry t of each lane


@inlined
def _popped_near(at, waiting, far):
    """If `at` has no lanes, pop the stack until some lane enters the box of a link before `far`."""
    link, mask, height = at
    while mask == 0 and height > 0:
        height -= 1
        entries = load16(waiting.entries, 16 * height)
        link, mask = get(waiting.links, 2 * height), get(waiting.links, 2 * height + 1)
        mask &= bits(entries <= far)
    return NearestTraversal(link, mask, height)


@inlined
def after_visit(at):
    """The state of a closest-hit traversal after a link."""
    return NearestTraversal(at.link, 0, at.height)


@inlined
def _nearer_child(tree, slabs, at, waiting, far, counters):
    """Go to the child that most lanes enter first. Push the other child if some lane enters it before `far`."""
    count(counters, NODES, 1)
    count(counters, BOX_TESTS, 2)
    left_lanes, a = entry(tree.nodes, box_at(at.link, 0), slabs, far)
    right_lanes, b = entry(tree.nodes, box_at(at.link, 1), slabs, far)
    left_lanes &= at.mask
    right_lanes &= at.mask
    if left_lanes | right_lanes == 0:
        return after_visit(at)
    first = get(tree.links, link_at(at.link, 0))
    second = get(tree.links, link_at(at.link, 1))
    if left_lanes != 0:
        fetch(tree, first)
    if right_lanes == 0:
        return NearestTraversal(first, left_lanes, at.height)
    fetch(tree, second)
    if left_lanes == 0:
        return NearestTraversal(second, right_lanes, at.height)
    both = left_lanes & right_lanes
    swap = 2 * popcount(bits(b < a) & both) > popcount(both)
    put(waiting.links, 2 * at.height, first if swap else second)
    put(waiting.links, 2 * at.height + 1, left_lanes if swap else right_lanes)
    store(waiting.entries, 16 * at.height, a if swap else b)
    return NearestTraversal(second if swap else first, right_lanes if swap else left_lanes, at.height + 1)


@inlined
def next_block(tree, slabs, at, waiting, far, counters):
    """Traverse from `at` to the next block that a lane enters before `far`; mask 0: there is none."""
    at = _popped_near(at, waiting, far)
    while at.mask != 0 and (at.link >= 0 or block_leaf(at.link).count == 0):
        at = _nearer_child(tree, slabs, at, waiting, far, counters) if at.link >= 0 else after_visit(at)
        at = _popped_near(at, waiting, far)
    return at
