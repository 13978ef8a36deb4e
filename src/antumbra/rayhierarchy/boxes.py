"""Nodes as boxes in the beam's projection: tighter and cheaper than the paper's cones.

On a face of the cube around the apex, a ray is a point (u, v), and q = 1 / depth gives its end. Planes stay planes:
n . x + m = depth (n_u u + n_v v + n_w + m q). A plane is tested at the box corner farthest along its normal, with three
products. The box in (u, v) is a pyramid from the apex: the paper's cone with a square section. For a distant light, it
is a box along the light's direction.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel, overload
from ..kernels.simd import bits, fma, get, load16, mask_from_bits16, put, reduce_max, reduce_min, select
from . import nodes as names
from .beams import PERSPECTIVE
from .boxrows import BOX, CORNERS, lower, upper, write_box_row
from .rays import block_of, origins_in
from .rows import COVERS, INNER, LANES, OUTER, number, number16, whole
from .view import projected16

ROWS = 6  # numbers per node: the lowest and highest u, v and q
_F = np.float32
_HUGE = np.float32(1e30)


class Boxes(NamedTuple):
    """Nodes of a hierarchy; see `nodes`."""

    rows: int = ROWS  # float32 per node


@kernel
def _union_of_boxes(block, lanes, union):
    """Write the box around the shadow boxes of some of 16 triangles."""
    mask, inf = mask_from_bits16(lanes), _F(np.inf)
    for k in range(0, 6, 2):
        put(union, k, reduce_min(select(mask, load16(block, LANES * (BOX + k)), inf)))
        put(union, k + 1, reduce_max(select(mask, load16(block, LANES * (BOX + k + 1)), -inf)))
    return True


@inlined
def _meet_box(group, union, ways):
    """Bits of the nodes that a box meets."""
    found = mask_from_bits16(0xFFFF)
    for k in range(0, 6, 2):
        found = found & (load16(group, k * ways) <= get(union, k + 1))
        found = found & (load16(group, (k + 1) * ways) >= get(union, k))
    return bits(found)


@overload(names.union_of)
def _union_of(nodes, block, lanes, union):
    if nodes.instance_class is Boxes:
        return lambda nodes, block, lanes, union: _union_of_boxes(block, lanes, union)


@overload(names.meet_union)
def _meet_union(nodes, group, union, ways):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, union, ways: _meet_box(group, union, ways)


@inlined
def _put_box(group, ways, lane, low, high):
    for k in range(3):
        put(group, 2 * k * ways + lane, low[k])
        put(group, (2 * k + 1) * ways + lane, high[k])


@kernel
def _box_of_leaf(view, face, leaves, leaf, group, lane):
    """Write the box around the receivers of a leaf; empty lanes are ignored."""
    ways, lanes = leaves.ways, np.int64(get(leaves.lanes, leaf))
    if lanes == 0:
        return False
    there = mask_from_bits16(lanes)
    u, v, q = projected16(view, origins_in(leaves, block_of(leaves, leaf)), face)
    everywhere = mask_from_bits16(0)
    if view.kind == PERSPECTIVE:
        everywhere = there & ~((q > _F(0.0)) & (q < _HUGE))  # at the apex: unbounded
    _put_range(group, 0, ways, lane, there, u, everywhere)
    _put_range(group, 2, ways, lane, there, v, everywhere)
    _put_range(group, 4, ways, lane, there, q, everywhere)
    return True


@inlined
def _put_range(group, k, ways, lane, there, x, everywhere):
    """Write the lowest and highest x of some lanes as numbers k and k + 1 of a node.

    The range is unbounded if `everywhere` has a lane.
    """
    inf = _F(np.inf)
    put(group, k * ways + lane, reduce_min(select(everywhere, -inf, select(there, x, inf))))
    put(group, (k + 1) * ways + lane, reduce_max(select(everywhere, inf, select(there, x, -inf))))


@kernel
def _box_of_nodes(children, alive, ways, group, lane):
    """Write the box around a group."""
    inf = _F(np.inf)
    low, high = (inf, inf, inf), (-inf, -inf, -inf)
    for i in range(ways):
        if alive >> i & 1:
            low = lower(low, (get(children, i), get(children, 2 * ways + i), get(children, 4 * ways + i)))
            high = upper(high, (get(children, ways + i), get(children, 3 * ways + i), get(children, 5 * ways + i)))
    _put_box(group, ways, lane, low, high)


@overload(names.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is Boxes:
        return lambda nodes, view, face, leaves, leaf, group, lane: _box_of_leaf(view, face, leaves, leaf, group, lane)


@overload(names.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is Boxes:
        return lambda nodes, children, alive, ways, group, lane: _box_of_nodes(children, alive, ways, group, lane)


@inlined
def _height(row, at, u, v, q):
    """f32x16: the value of the plane at position `at` of a row for the points (u, v, q)."""
    f = fma(u, number16(row, at), number16(row, at + 2))
    return fma(q, number16(row, at + 3), fma(v, number16(row, at + 1), f))


@inlined
def _not_outside(group, row, at, corner):
    """mask16 of the nodes whose farthest corner is not on the negative side of an outer plane."""
    u, v = load16(group, whole(row, corner)), load16(group, whole(row, corner + 1))
    q = load16(group, whole(row, corner + 2))
    return ~(_height(row, at, u, v, q) < _F(0.0))


@inlined
def _overlaps(group, row, ways):
    """mask16 of the nodes that overlap the box of the triangle's shadow."""
    u = (load16(group, 0) <= number16(row, BOX + 1)) & (load16(group, ways) >= number16(row, BOX))
    v = (load16(group, 2 * ways) <= number16(row, BOX + 3)) & (load16(group, 3 * ways) >= number16(row, BOX + 2))
    q = (load16(group, 4 * ways) <= number16(row, BOX + 5)) & (load16(group, 5 * ways) >= number16(row, BOX + 4))
    return u & v & q


@inlined
def _possible_boxes(group, row, ways, alive):
    found = bits(_overlaps(group, row, ways)) & alive
    if found == 0:
        return found
    own = _not_outside(group, row, OUTER + 12, CORNERS + 9)
    ab, bc = _not_outside(group, row, OUTER, CORNERS), _not_outside(group, row, OUTER + 4, CORNERS + 3)
    return found & bits(own & ab & bc & _not_outside(group, row, OUTER + 8, CORNERS + 6))


@inlined
def _inside(group, row, at, ways):
    """mask16 of the nodes whose nearest corner is on the positive side of an inner plane."""
    u = load16(group, (0 if number(row, at) > 0 else 1) * ways)
    v = load16(group, (2 if number(row, at + 1) > 0 else 3) * ways)
    q = load16(group, (4 if number(row, at + 3) > 0 else 5) * ways)
    return _height(row, at, u, v, q) > _F(0.0)


@inlined
def _covered_boxes(group, row, ways, among):
    u = (load16(group, 0) >= number16(row, BOX)) & (load16(group, ways) <= number16(row, BOX + 1))
    v = (load16(group, 2 * ways) >= number16(row, BOX + 2)) & (load16(group, 3 * ways) <= number16(row, BOX + 3))
    if bits(u & v) & among == 0 or whole(row, COVERS) == 0:  # early exit: few nodes lie in a triangle's box
        return np.int64(0)
    found = _inside(group, row, INNER, ways) & _inside(group, row, INNER + 4, ways)
    return bits(found & _inside(group, row, INNER + 8, ways) & _inside(group, row, INNER + 12, ways)) & among


@overload(names.write_row)
def _write_row(nodes, view, face, ways, shape, spheres, row):
    if nodes.instance_class is Boxes:
        return lambda nodes, view, face, ways, shape, spheres, row: write_box_row(view, face, ways, shape, spheres, row)


@overload(names.writes_sixteen)
def _writes_sixteen(nodes):
    if nodes.instance_class is Boxes:
        return lambda nodes: True


@overload(names.possible)
def _possible(nodes, group, row, ways, alive, spheres):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, row, ways, alive, spheres: _possible_boxes(group, row, ways, alive)


@overload(names.covered)
def _covered(nodes, group, row, ways, among):
    if nodes.instance_class is Boxes:
        return lambda nodes, group, row, ways, among: _covered_boxes(group, row, ways, among)
