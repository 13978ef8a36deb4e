"""The kernels that build the tree of `bvh.ploc` on a device, node by node, and refit it.

No thread waits for another, and nothing is atomic: prefix sums give places [Meister and Bittner 2018b].

1. Ranges: `cut_ranges` tags the first slots of the ranges that the CPU's threads cluster, by the nodes of the radix
   tree that are too large for one thread. `begin_ranges` numbers the ranges.
2. Clusters: `begin_clusters` makes one of each triangle. In a round, `find_nearest` finds the nearest neighbour of
   each, `tag_merges` tags those that are nearest to each other, and `merge_pairs` merges them and closes the gaps. It
   also counts triangles and nodes, and decides which subtrees are leaves, since the children of a cluster are complete.
   All ranges take part, and then the roots of the ranges are clustered as one (`begin_roots`).
3. Nodes: `place_children` proceeds from the last round to the first. It numbers nodes depth first by the counts of
   their subtrees, gives triangles their slots, and writes links.
4. Boxes: `refit_nodes`, from the first round to the last. A refit is this step alone, with the links of the old tree
   (`copy_links`).
"""

from typing import NamedTuple

import numpy as np

from ...bvh.lbvh import split_position
from ...bvh.nodes import bvh_link, link_at, order_at
from ...bvh.ploc import RADIUS
from ...bvh.triangle_bounds import corners_of
from ...kernels.device import thread_index
from ...kernels.jit import inlined, kernel
from ...kernels.simd import extract, f32_at, get, i32_at, load8, minimum, put, store
from ...kernels.toolchain.device_code import DeviceKernel
from .build_kernels import box_of, height, other_end

CLUSTER = 4  # words of a cluster: its children, or ~slot of a triangle; triangles; nodes of its subtree
LEFT, RIGHT, TRIANGLES, NODES = range(CLUSTER)

_INF = np.float32(np.inf)


class ClusterBuffers(NamedTuple):
    """All clusters: the triangles in the order of their codes, then those made of two, children first. Addresses."""

    boxes: int  # float32, 8 per cluster: lower corner, and minus the upper one
    words: int  # int32, CLUSTER per cluster
    costs: int  # float32: SAH cost of the subtree
    slots: int  # int32: the first slot
    numbers: int  # int32: the number of the node; -1: it is in a leaf
    n: int  # number of triangles
    max_leaf: int  # 0: clusters of ranges' roots, which are no leaves
    scale: np.float32  # of coordinates, so that no area overflows


class ActiveBuffers(NamedTuple):
    """The clusters that are yet to be merged, range by range. Addresses of int32, and numbers."""

    ids: int
    ranges: int  # the range of each
    begins: int  # the first one of each range, and the end
    offsets: int  # from a cluster to its nearest neighbour; 0: it is alone
    n: int
    n_ranges: int


# --- 1. Ranges --------------------------------------------------------------------------------------------------------


@kernel
def cut_ranges(codes, n, largest, tags):  # codes, tags: addresses of int32
    """Tag the first slots of ranges of n triangles: slot 0, and right children of nodes of more than `largest`."""
    i, keys = thread_index(), i32_at(codes)
    if i == 0:
        put(i32_at(tags), 0, 1)
    if i < n - 1:
        step = np.int64(1 if height(keys, i, i + 1, n) < height(keys, i, i - 1, n) else -1)
        other = other_end(keys, i, step, n)
        first, end = min(i, other), max(i, other) + 1
        if end - first > largest:
            put(i32_at(tags), split_position(keys, first, end, 0), 1)


@kernel
def begin_ranges(places, active):  # places: address of int32, prefix sums of the tags; active: ActiveBuffers
    """Write the range of each triangle, and where ranges begin."""
    i, at = thread_index(), i32_at(places)
    if i < active.n:
        before, r = np.int64(get(at, i)), np.int64(get(at, i + 1)) - 1
        put(i32_at(active.ranges), i, r)
        put(i32_at(active.ids), i, i)
        if r == before:
            put(i32_at(active.begins), r, i)
    if i == active.n:
        put(i32_at(active.begins), active.n_ranges, i)


@kernel
def begin_roots(active):  # active: ActiveBuffers
    """Let all clusters be of one range."""
    i = thread_index()
    if i < active.n:
        put(i32_at(active.ranges), i, 0)
    if i == 0:
        put(i32_at(active.begins), 0, 0)
        put(i32_at(active.begins), 1, active.n)


# --- 2. Clusters ------------------------------------------------------------------------------------------------------


@kernel
def begin_clusters(vertices, faces, clusters):  # clusters: ClusterBuffers
    """Write a cluster for each triangle.

    vertices, faces : addresses of float32, 9 for each triangle of the scene, and of int32
    """
    k = thread_index()
    if k < clusters.n:
        a, b, c = corners_of(f32_at(vertices), np.int64(get(i32_at(faces), k)))
        store(f32_at(clusters.boxes), 8 * k, box_of(a, b, c))
        put(i32_at(clusters.words), CLUSTER * k + LEFT, ~k)
        put(i32_at(clusters.words), CLUSTER * k + TRIANGLES, 1)
        put(i32_at(clusters.words), CLUSTER * k + NODES, 0)


@inlined
def _half_area(box, scale):
    """Half the area of a box, as `bvh.ploc` computes it."""
    x = (extract(box, 0) + extract(box, 4)) * scale
    y = (extract(box, 1) + extract(box, 5)) * scale
    z = (extract(box, 2) + extract(box, 6)) * scale
    return x * (y + z) + y * z


@inlined
def _box_at(active, clusters, i):
    return load8(f32_at(clusters.boxes), 8 * np.int64(get(i32_at(active.ids), i)))


@inlined
def _nearest(active, clusters, i, first, end, partner):
    """The nearest neighbour of cluster i in the range from `first` to `end` - 1. Of equals, `partner`, or the first."""
    box, least, nearest = _box_at(active, clusters, i), _INF, partner
    if partner < end:
        least = _half_area(minimum(box, _box_at(active, clusters, partner)), clusters.scale)
    for k in range(max(i - RADIUS, first), min(i + RADIUS + 1, end)):
        if k != i:
            area = _half_area(minimum(box, _box_at(active, clusters, k)), clusters.scale)
            if area < least:
                least, nearest = area, k
    return nearest


@kernel
def find_nearest(active, clusters, further):  # active: ActiveBuffers, clusters: ClusterBuffers
    """Find the nearest neighbour of each cluster in its range.

    further : rounds after this one; where they might not suffice, clusters 2 k and 2 k + 1 are neighbours
    """
    i = thread_index()
    if i >= active.n:
        return
    r = np.int64(get(i32_at(active.ranges), i))
    first, end = np.int64(get(i32_at(active.begins), r)), np.int64(get(i32_at(active.begins), r + 1))
    nearest = first + (i - first ^ 1)
    if end - first > 1 and (end - first - 1) >> further == 0:
        nearest = _nearest(active, clusters, i, first, end, nearest)
    put(i32_at(active.offsets), i, nearest - i if nearest < end else 0)


@kernel
def tag_merges(active, merges, stays):  # active: ActiveBuffers, merges, stays: addresses of int32
    """Tag each cluster that merges with a later one, and each that keeps a place; none after the last one."""
    i = thread_index()
    if i > active.n:
        return
    offset = np.int64(get(i32_at(active.offsets), i)) if i < active.n else np.int64(0)
    merges_too = offset != 0 and np.int64(get(i32_at(active.offsets), i + offset)) == -offset
    put(i32_at(merges), i, np.int32(merges_too and offset > 0))
    put(i32_at(stays), i, np.int32(i < active.n and not (merges_too and offset < 0)))


@inlined
def _word(clusters, k, word):
    return np.int64(get(i32_at(clusters.words), CLUSTER * k + word))


@inlined
def _cost_of(clusters, k):
    if k < clusters.n:
        return _half_area(load8(f32_at(clusters.boxes), 8 * k), clusters.scale)
    return get(f32_at(clusters.costs), k)


@inlined
def _merge(clusters, left, right, k):
    """Write cluster k. A node and a triangle cost 1 each to visit; of equals, the leaf is chosen."""
    boxes, words = f32_at(clusters.boxes), i32_at(clusters.words)
    box = minimum(load8(boxes, 8 * left), load8(boxes, 8 * right))
    area, size = _half_area(box, clusters.scale), _word(clusters, left, TRIANGLES) + _word(clusters, right, TRIANGLES)
    nodes = _word(clusters, left, NODES) + _word(clusters, right, NODES) + 1
    cost, cost_of_leaf = area + _cost_of(clusters, left) + _cost_of(clusters, right), area * np.float32(size)
    if size <= clusters.max_leaf and cost_of_leaf <= cost:
        cost, nodes = cost_of_leaf, np.int64(0)
    store(boxes, 8 * k, box)
    put(words, CLUSTER * k + LEFT, left)
    put(words, CLUSTER * k + RIGHT, right)
    put(words, CLUSTER * k + TRIANGLES, size)
    put(words, CLUSTER * k + NODES, nodes)
    put(f32_at(clusters.costs), k, cost)


@kernel
def merge_pairs(active, clusters, merges, stays, next_id, rest):  # clusters: ClusterBuffers
    """Merge clusters, the new ones from `next_id` on, and write what is left to `rest`, without gaps.

    active, rest : ActiveBuffers
    merges, stays : addresses of int32, the prefix sums of the tags
    """
    i, merged, at = thread_index(), i32_at(merges), i32_at(stays)
    if i <= active.n_ranges:
        put(i32_at(rest.begins), i, get(at, get(i32_at(active.begins), i)))
    if i >= active.n or get(at, i + 1) == get(at, i):
        return
    id_, place = np.int64(get(i32_at(active.ids), i)), np.int64(get(at, i))
    if get(merged, i + 1) > get(merged, i):
        partner = i + np.int64(get(i32_at(active.offsets), i))
        k = next_id + np.int64(get(merged, i))
        _merge(clusters, id_, np.int64(get(i32_at(active.ids), partner)), k)
        id_ = k
    put(i32_at(rest.ids), place, id_)
    put(i32_at(rest.ranges), place, get(i32_at(active.ranges), i))


# --- 3. Nodes ---------------------------------------------------------------------------------------------------------


@kernel
def seat_roots(active, firsts, clusters):  # clusters: ClusterBuffers
    """Give the root of each range the first slot of its range.

    active : ActiveBuffers of the ranges' roots
    firsts : address of int32
    """
    i = thread_index()
    if i < active.n:
        put(i32_at(clusters.slots), get(i32_at(active.ids), i), get(i32_at(firsts), i))


@inlined
def _link(clusters, k):
    if _word(clusters, k, NODES) == 0:
        return bvh_link(np.int64(get(i32_at(clusters.slots), k)), _word(clusters, k, TRIANGLES))
    return np.int64(get(i32_at(clusters.numbers), k))


@kernel
def place_children(clusters, first, n, nodes):  # clusters: ClusterBuffers, nodes: address of int32
    """Place the children of n clusters from the `first` on: their slots, and the numbers and links of nodes.

    Roots of ranges have their slots already.
    """
    k = first + thread_index()
    if k >= first + n:
        return
    left, right = _word(clusters, k, LEFT), _word(clusters, k, RIGHT)
    if clusters.max_leaf > 0:
        slot = np.int64(get(i32_at(clusters.slots), k))
        put(i32_at(clusters.slots), left, slot)
        put(i32_at(clusters.slots), right, slot + _word(clusters, left, TRIANGLES))
    numbers = i32_at(clusters.numbers)
    number = np.int64(get(numbers, k))
    if number < 0:  # it is a leaf, or part of one
        return
    if _word(clusters, left, NODES) > 0:
        put(numbers, left, number + 1)
    if _word(clusters, right, NODES) > 0:
        put(numbers, right, number + 1 + _word(clusters, left, NODES))
    links = i32_at(nodes)
    put(links, link_at(number, 0), _link(clusters, left))
    put(links, link_at(number, 1), _link(clusters, right))
    put(links, order_at(number), 0)
    put(links, order_at(number) + 1, 0)


@kernel
def seat_triangles(clusters, faces, out):  # clusters: ClusterBuffers, faces, out: addresses of int32
    """Write the index in the scene of each slot's triangle."""
    k = thread_index()
    if k < clusters.n:
        put(i32_at(out), get(i32_at(clusters.slots), k), get(i32_at(faces), k))


@kernel
def copy_links(source, n, target):  # source, target: addresses of int32
    """Copy the links of n nodes."""
    i = thread_index()
    if i < n:
        for word in (link_at(i, 0), link_at(i, 1), order_at(i), order_at(i) + 1):
            put(i32_at(target), word, get(i32_at(source), word))


_CLUSTERS, _ACTIVE = ClusterBuffers(0, 0, 0, 0, 0, 0, 0, np.float32(1.0)), ActiveBuffers(0, 0, 0, 0, 0, 0)

PLOC_KERNELS = {
    "cut_ranges": DeviceKernel(cut_ranges, (0, 0, 0, 0)),
    "begin_ranges": DeviceKernel(begin_ranges, (0, _ACTIVE)),
    "begin_roots": DeviceKernel(begin_roots, (_ACTIVE,)),
    "begin_clusters": DeviceKernel(begin_clusters, (0, 0, _CLUSTERS)),
    "find_nearest": DeviceKernel(find_nearest, (_ACTIVE, _CLUSTERS, 0)),
    "tag_merges": DeviceKernel(tag_merges, (_ACTIVE, 0, 0)),
    "merge_pairs": DeviceKernel(merge_pairs, (_ACTIVE, _CLUSTERS, 0, 0, 0, _ACTIVE)),
    "seat_roots": DeviceKernel(seat_roots, (_ACTIVE, 0, _CLUSTERS)),
    "place_children": DeviceKernel(place_children, (_CLUSTERS, 0, 0, 0)),
    "seat_triangles": DeviceKernel(seat_triangles, (_CLUSTERS, 0, 0)),
    "copy_links": DeviceKernel(copy_links, (0, 0, 0)),
}
"""Name -> kernel."""
