"""Nodes as shafts [Haines and Wallace 1991]: a box around receivers, and a box around the ends of their segments.

If a light is as large as the lit surfaces, a cone with one apex bounds the segments poorly. A shaft bounds them well:
the segments of a few receivers to a small part of the light lie in the hull of two small boxes.

The hull is the set of all (1 - t) R + t L for t in [0, 1], Eq. (4) of docs/design/rayhierarchy.md. A box meets the hull
if the boxes overlap along all axes for some t. Each axis gives two conditions that are linear in t. They leave an
interval of t, and the box misses the hull if it is empty.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel, overload
from ..kernels.simd import (
    bits,
    get,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
)
from . import nodes as names
from .rays import block_of, ends_in, origins_in

ROWS = 12  # numbers per node: lowest and highest x, y and z of the receivers, then of the ends
_ENDS = 6
_F = np.float32
_E = _F(2.0**-20)  # exceeds the rounding error of t


class ShaftNodes(NamedTuple):
    """Nodes of a hierarchy; see `nodes`."""

    rows: int = ROWS  # float32 per node


@inlined
def _put_range(group, k, ways, lane, there, x):
    inf = _F(np.inf)
    put(group, k * ways + lane, reduce_min(select(there, x, inf)))
    put(group, (k + 1) * ways + lane, reduce_max(select(there, x, -inf)))


@kernel
def _shaft_of_leaf(leaves, leaf, group, lane):
    """Write the shaft around the segments of a leaf; False if it has no ray."""
    ways, lanes = leaves.ways, np.int64(get(leaves.lanes, leaf))
    if lanes == 0:
        return False
    there, block = mask_from_bits16(lanes), block_of(leaves, leaf)
    o, ends = origins_in(leaves, block), ends_in(leaves, leaf, block)
    _put_range(group, 0, ways, lane, there, o.x)
    _put_range(group, 2, ways, lane, there, o.y)
    _put_range(group, 4, ways, lane, there, o.z)
    for k in range(3):
        low, high = _F(np.inf), _F(-np.inf)
        for s in range(leaves.count):
            x = load16(ends, (3 * s + k) * ways)
            low = min(low, reduce_min(select(there, x, _F(np.inf))))
            high = max(high, reduce_max(select(there, x, _F(-np.inf))))
        put(group, (_ENDS + 2 * k) * ways + lane, low)
        put(group, (_ENDS + 2 * k + 1) * ways + lane, high)
    return True


@kernel
def _shaft_of_nodes(children, alive, ways, group, lane):
    """Write the shaft around a group."""
    there = mask_from_bits16(alive)
    for k in range(0, ROWS, 2):
        low, high = load16(children, k * ways), load16(children, (k + 1) * ways)
        put(group, k * ways + lane, reduce_min(select(there, low, _F(np.inf))))
        put(group, (k + 1) * ways + lane, reduce_max(select(there, high, _F(-np.inf))))


@overload(names.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is ShaftNodes:
        return lambda nodes, view, face, leaves, leaf, group, lane: _shaft_of_leaf(leaves, leaf, group, lane)


@overload(names.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is ShaftNodes:
        return lambda nodes, children, alive, ways, group, lane: _shaft_of_nodes(children, alive, ways, group, lane)


@inlined
def _clip(t, a, b):
    """Clip the interval t to (1 - t) a + t b <= 0, slightly enlarged. An empty interval has first > last."""
    first, last = t
    zero = _F(0.0)
    before, after = a > zero, b > zero
    at = a / (a - b)  # unused where `before` equals `after`
    first = select(before, select(after, splat16(_F(2.0)), maximum(first, select(after, zero, at) - _E)), first)
    return first, select(after & ~before, minimum(last, select(before, _F(1.0), at) + _E), last)


@kernel
def meet_shafts(group, box, ways):
    """Bits of the nodes of a group that a box may meet; box: pointer to the lowest and highest x, y and z."""
    t = splat16(_F(0.0)), splat16(_F(1.0))
    ends = ptr_at(group, _ENDS * ways)
    for k in range(0, 6, 2):
        low, high = get(box, k), get(box, k + 1)
        t = _clip(t, load16(group, k * ways) - high, load16(ends, k * ways) - high)
        t = _clip(t, low - load16(group, (k + 1) * ways), low - load16(ends, (k + 1) * ways))
    return bits(~(t[0] > t[1]))
