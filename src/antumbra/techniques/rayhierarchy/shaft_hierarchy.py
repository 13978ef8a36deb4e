"""Shaft nodes, and their traversal by clusters of triangles, for lights as large as the lit surfaces.

Shafts [Haines and Wallace 1991]. If a light is as large as the lit surfaces, a cone with one apex bounds the segments
poorly. A shaft bounds them well: the segments of a few receivers to a small part of the light lie in the hull of two
small boxes, one around the receivers and one around the ends of their segments.

The hull is the set of all (1 - t) R + t L for t in [0, 1], Eq. (4) of docs/design/rayhierarchy.md. A box meets the hull
if the boxes overlap along all axes for some t. Each axis gives two conditions that are linear in t. Together they leave
an interval of t, and the box misses the hull if it is empty.

Clusters. If rays diverge, a leaf's shaft meets many triangles far from all its rays. Therefore 256 triangles descend
together, represented by their bounding box. The 16 rays of a leaf are tested against that box. Each ray that hits it is
tested against the boxes of 16 clusters, and against the 16 triangles of each cluster that it hits. Triangles are in
Morton order, so these boxes are small.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.exact.predicate import segment
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overload
from ...kernels.parallel import shares
from ...kernels.simd import (
    absolute,
    atomic_or,
    bits,
    gather,
    get,
    iota16,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ...kernels.vec3 import broadcasts, rows, subtract3
from ...trace.counters import BOX_TESTS, N_COUNTERS, NODES, TRIANGLE_TESTS, add_counters, cleared, count
from ...trace.rays.ray_traversal import settle
from ...trace.triangle_tests import ray_meets
from ..culling.pre_bvh_culling import Soup
from . import ray_tree
from .ray_leaves import block_of, ends_in, leaves_of, origins_in
from .ray_tree import LEVELS, group_at, groups_of, tree_pointers
from .shadow_planes import LANES
from .triangle_traversal import finish

# --- Nodes ------------------------------------------------------------------------------------------------------------

ROWS = 12  # numbers per node: lowest and highest x, y and z of the receivers, then of the ends
_ENDS = 6
_F = np.float32
_E = _F(2.0**-20)  # exceeds the rounding error of t


class ShaftNodes(NamedTuple):
    """The node class of shafts; see `ray_tree`."""

    rows: int = ROWS  # float32 per node


@inlined
def _put_range(group, k, ways, lane, there, x):
    inf = _F(np.inf)
    put(group, k * ways + lane, reduce_min(select(there, x, inf)))
    put(group, (k + 1) * ways + lane, reduce_max(select(there, x, -inf)))


@kernel
def _shaft_of_leaf(leaves, leaf, group, lane):
    """Write the shaft around the segments of a leaf; False if it has no rays."""
    ways, lanes = leaves.ways, get(leaves.lanes, leaf)
    if lanes == 0:
        return False
    there, block = mask_from_bits16(lanes), block_of(leaves, leaf)
    o, ends = origins_in(leaves, block), ends_in(leaves, leaf, block)
    _put_range(group, 0, ways, lane, there, o.x)
    _put_range(group, 2, ways, lane, there, o.y)
    _put_range(group, 4, ways, lane, there, o.z)
    for k in range(3):
        low, high = _F(np.inf), _F(-np.inf)
        for s in range(leaves.n_samples):
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


@overload(ray_tree.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is ShaftNodes:
        return lambda nodes, view, face, leaves, leaf, group, lane: _shaft_of_leaf(leaves, leaf, group, lane)


@overload(ray_tree.bound_node)
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


# --- Traversal by clusters of triangles -------------------------------------------------------------------------------

BATCH = LANES * LANES
"""Triangles that descend together."""

_TINY, _LEAST = _F(1e-37), _F(1e-42)  # exceed the underflow of a product and of a length
_NUMBERS = 9 * LANES  # per cluster: the first corners of its triangles, and the two edges from each
_ALL_NUMBERS = LANES * _NUMBERS
_BOXES = 6 * LANES
_WAITING = 2 * (15 * LEVELS + 1)
_HALF = _F(0.5)


class Clusters(NamedTuple):
    """16 clusters of 16 triangles, as pointers. The last triangle is repeated if there are fewer."""

    numbers: F32Ptr  # float32: for each cluster the first corners, the edges to the second corners, then to the third
    boxes: F32Ptr  # (6, 16) float32: lowest and highest x, y and z of the 16 clusters
    box: F32Ptr  # (6,) float32: the box around all clusters
    slots: I32Ptr  # (256,) int32: indices of the triangles in the soup
    prims: I32Ptr  # (256,) int32: ids of the triangles in the scene


@kernel
def _write_cluster(soup, slots, clusters, i):
    """Write cluster i: the triangles in these slots, i32x16."""
    store(clusters.slots, LANES * i, slots)
    store(clusters.prims, LANES * i, gather(soup.ids, slots))
    for k in range(3):
        a = gather(soup.corners, slots * 9 + np.int32(k))
        b, c = gather(soup.corners, slots * 9 + np.int32(k + 3)), gather(soup.corners, slots * 9 + np.int32(k + 6))
        store(clusters.numbers, _NUMBERS * i + LANES * k, a)
        store(clusters.numbers, _NUMBERS * i + LANES * (k + 3), b - a)
        store(clusters.numbers, _NUMBERS * i + LANES * (k + 6), c - a)
        put(clusters.boxes, LANES * 2 * k + i, reduce_min(minimum(minimum(a, b), c)))
        put(clusters.boxes, LANES * (2 * k + 1) + i, reduce_max(maximum(maximum(a, b), c)))


@kernel
def _write_clusters(soup, picked, first, last, clusters):
    """Write the `Clusters` of some picked triangles, at most BATCH."""
    for i in range(LANES):
        at = minimum(np.int32(first + LANES * i) + iota16(), np.int32(last - 1))
        _write_cluster(soup, gather(picked, at), clusters, i)
    for k in range(0, 6, 2):
        put(clusters.box, k, reduce_min(load16(clusters.boxes, LANES * k)))
        put(clusters.box, k + 1, reduce_max(load16(clusters.boxes, LANES * (k + 1))))


@inlined
def _test_axis(o, d, low, high):
    """On one axis: (segment midpoint relative to box centre, half size of the box with margin, mask: disjoint)."""
    low, high, along = low * _HALF, high * _HALF, d * _HALF
    middle = low + high
    at = (o - middle) + along
    half = (absolute(at) + absolute(d) + (absolute(middle) + (high - low))) * _E + ((high - low) + _LEAST)
    return at, half, absolute(at) > half + absolute(along)


@inlined
def _is_separated(c, d, h, e, g, k):
    """mask16 of the rays that miss a box in the plane of two axes, with midpoints c and e and half sizes h and k."""
    return absolute(c * g - e * d) > h * absolute(g) + k * absolute(d) + _TINY


@inlined
def _hit_boxes(o, d, low, high, unit):
    """Bits of the segments from o to o + d that may hit boxes: a separating axis test in f32x16.

    The axes are the coordinate axes and their cross products with d.

    unit : a power of two that scales the largest d to at most 1, so no product overflows
    """
    x, half_x, gone_x = _test_axis(o.x, d.x, low.x, high.x)
    y, half_y, gone_y = _test_axis(o.y, d.y, low.y, high.y)
    z, half_z, gone_z = _test_axis(o.z, d.z, low.z, high.z)
    u, v, w = d.x * unit, d.y * unit, d.z * unit
    gone = gone_x | gone_y | gone_z | _is_separated(x, u, half_x, y, v, half_y)
    return bits(gone | _is_separated(y, v, half_y, z, w, half_z) | _is_separated(z, w, half_z, x, u, half_x)) ^ 0xFFFF


@kernel
def _exactly_blocked(o, ends, ways, lane, soup, clusters, first, facing, unsure, counters):
    """Exact test: whether an `unsure` triangle blocks a lane's segment. Bit i of `unsure` is triangle `first` + i."""
    ray = segment(
        get(o, lane), get(o, ways + lane), get(o, 2 * ways + lane),
        get(ends, lane), get(ends, ways + lane), get(ends, 2 * ways + lane),
    )  # fmt: skip
    while unsure != 0:
        side = settle(ray, soup.corners, get(clusters.slots, first + lowest_bit(unsure)), counters)
        if side != 0 and side != facing:
            return True
        unsure &= unsure - 1
    return False


@kernel
def _is_blocked(origins, ends, ways, own_prim, lane, soup, clusters, facing, unit, counters):
    """Whether a triangle of the clusters blocks the segment of a lane. own_prim: the receiver's own triangle."""
    o, boxes = broadcasts(origins, lane, ways), clusters.boxes
    d = subtract3(broadcasts(ends, lane, ways), o)
    low, high = rows(boxes, 0, 2 * LANES), rows(boxes, LANES, 2 * LANES)
    count(counters, BOX_TESTS, 1)
    hit_clusters = _hit_boxes(o, d, low, high, unit)
    while hit_clusters != 0:
        i = lowest_bit(hit_clusters)
        hit_clusters &= hit_clusters - 1
        count(counters, TRIANGLE_TESTS, 1)
        hit, unsure = ray_meets(o, d, ptr_at(clusters.numbers, _NUMBERS * i), facing, None)
        if (hit | unsure) != 0:
            others = ~bits(load16(clusters.prims, LANES * i) == np.int32(own_prim))
            if hit & others != 0:
                return True
            unsure &= others
            if unsure != 0 and _exactly_blocked(
                origins, ends, ways, lane, soup, clusters, LANES * i, facing, unsure, counters
            ):
                return True
    return False


@kernel
def _block_rays(leaves, leaf, soup, clusters, facing, unit, counters):
    """Mark the segments of a leaf that the clusters block as dead; True if all are dead now. A lane has one segment."""
    ways = leaves.ways
    live = ~get(leaves.dead, leaf) & (1 << ways) - 1
    if live == 0:
        return True
    block, blocked, box = block_of(leaves, leaf), 0, clusters.box
    o, points = origins_in(leaves, block), ends_in(leaves, leaf, block)
    d = subtract3(rows(points, 0, ways), o)
    count(counters, BOX_TESTS, 1)
    candidates = _hit_boxes(o, d, broadcasts(box, 0, 2), broadcasts(box, 1, 2), unit) & live
    origins = ptr_at(leaves.origins, 3 * block * ways)
    while candidates != 0:
        lane = lowest_bit(candidates)
        candidates &= candidates - 1
        own_prim = get(leaves.own, block * ways + lane)
        if _is_blocked(origins, points, ways, own_prim, lane, soup, clusters, facing, unit, counters):
            blocked |= 1 << lane
    if blocked != 0:
        atomic_or(leaves.dead, leaf, blocked)
    return live == blocked


@kernel
def _descend(tree, leaves, soup, clusters, facing, unit, waiting, counters):
    """Traverse the hierarchy with clusters, from the root to the leaves that they may block."""
    put(waiting, 0, 0)
    put(waiting, 1, get(tree.heights, 0) - 1)
    n = 1
    while n > 0:
        n -= 1
        g, level = get(waiting, 2 * n), get(waiting, 2 * n + 1)
        group = groups_of(tree, 0, level) + g
        alive = get(tree.alive, group)
        count(counters, NODES, popcount(alive))
        hit_nodes = meet_shafts(group_at(tree, group), clusters.box, tree.ways) & alive
        while hit_nodes != 0:
            node = g * tree.ways + lowest_bit(hit_nodes)
            hit_nodes &= hit_nodes - 1
            if level > 0:
                put(waiting, 2 * n, node)
                put(waiting, 2 * n + 1, level - 1)
                n += 1
            elif _block_rays(leaves, node, soup, clusters, facing, unit, counters):
                finish(tree, node, leaves)


@kernel
def trace_clusters(ticket, triangles, picks, arrays, rays, facing, unit, counters):
    """Worker: traverse a hierarchy of shafts with batches of the picked triangles. The hierarchy has one part.

    facing : triangles with this sign of d . n do not block
    unit : a power of two that scales every segment to at most 1 along each axis
    """
    tree, leaves = tree_pointers(arrays), leaves_of(rays)
    soup, picked = Soup(ptr(triangles.corners), ptr(triangles.ids)), ptr(picks)
    thread_counters, waiting = cleared(stack_i64(N_COUNTERS)), stack_i64(_WAITING)
    clusters = Clusters(stack_f32(_ALL_NUMBERS), stack_f32(_BOXES), stack_f32(6), stack_i32(BATCH), stack_i32(BATCH))
    for first, last in shares(ticket):
        _write_clusters(soup, picked, first, last, clusters)
        _descend(tree, leaves, soup, clusters, facing, unit, waiting, thread_counters)
    add_counters(counters, thread_counters)
