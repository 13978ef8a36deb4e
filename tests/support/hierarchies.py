"""Helpers for tests of ray hierarchies: queries of points, hierarchies over their rays, and the answers of nodes."""

from typing import NamedTuple

import numpy as np

from antumbra.kernels.exact.filters import meets
from antumbra.kernels.exact.predicate import segment
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import get, ptr, ptr_at, stack_array
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import reach
from antumbra.query.receivers import FREE
from antumbra.query.shadow_query import ShadowQuery, segments
from antumbra.scene.triangles import Triangles
from antumbra.techniques.culling.pre_bvh_culling import Soup
from antumbra.techniques.rayhierarchy.leaf_packing import rays_of
from antumbra.techniques.rayhierarchy.light_beams import Beam, view_of
from antumbra.techniques.rayhierarchy.ray_leaves import PAD, LeafRays
from antumbra.techniques.rayhierarchy.ray_tree import (
    RayTree,
    covered,
    group_at,
    groups_of,
    possible,
    tree_of,
    tree_pointers,
)
from antumbra.techniques.rayhierarchy.receiver_order import Order, order_of
from antumbra.techniques.rayhierarchy.shadow_planes import LANES, NUMBERS
from antumbra.techniques.rayhierarchy.triangle_traversal import BATCH, PAIRS, TraversalOptions, row_at, write_rows


def triangles_of(vertices) -> Triangles:
    """The `Triangles` of a soup, (n, 3, 3), in world space."""
    vertices = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3, 3)
    n = len(vertices)
    return Triangles(vertices, np.zeros(3), np.arange(n, dtype=np.int32), np.ones((n, 3), np.float32))


def points_query(triangles, points, light, spp, normals=None) -> ShadowQuery:
    """The query of points, (m, 3), which are not moved. They float freely, or lie on surfaces with unit normals."""
    points = np.ascontiguousarray(points, np.float32)
    m = len(points)
    no_faces = np.full((1, m), -1, np.int32)
    return ShadowQuery(
        points[None],
        no_faces,
        np.full((1, m), FREE if normals is None else 1, np.int8),
        np.empty((0, 0, 3)) if normals is None else np.ascontiguousarray(normals, np.float64)[None],
        triangles.vertices.reshape(-1, 9),
        light.patch(triangles.origin, reach(triangles, points)),
        light_samples(light, spp),
        0,
        no_faces,
    )


class Hierarchy(NamedTuple):
    """A hierarchy over the rays of one beam, with all that it is made from."""

    query: ShadowQuery
    beam: Beam
    bits: np.ndarray
    order: Order
    rays: LeafRays
    tree: RayTree


def hierarchy(kind, query, beam, ways=16, sort=True, threads=1) -> Hierarchy | None:
    """The hierarchy of `kind` (`Boxes` or `Cones`) over a beam's rays; None if there are no rays."""
    bits = np.zeros((*query.sides.shape, -(-query.samples.shape[1] // 64)), np.uint64)
    order = order_of(query, beam, bits, sort, threads)
    if not len(order.ids):
        return None
    rays = rays_of(query, beam, order, ways, bits, threads)
    return Hierarchy(query, beam, bits, order, rays, tree_of(kind, beam, rays, threads))


@kernel
def _say(arrays, beam, triangles, how, may, full, memory, found):
    """Ask each node about each triangle: whether it may block one of the node's rays, and whether it blocks all.

    may, full : the answers
    memory, found : scratch memory: the rows of a batch, float32, and a mask for each face, int32
    """
    tree, parts, view, ways = tree_pointers(arrays), len(arrays.faces), view_of(beam), np.int64(arrays.ways)
    soup = Soup(ptr(triangles.corners), ptr(triangles.ids))
    slots, n = stack_array(np.int32, LANES), len(triangles.corners)
    for first in range(0, n, LANES):
        for lane in range(LANES):
            slots[lane] = min(first + lane, n - 1)
        write_rows(tree, parts, view, soup, ptr(slots), min(n - first, LANES), how, ptr(memory), ptr(found))
        for part in range(parts):
            start, last = groups_of(tree, part, 0), groups_of(tree, part, get(tree.heights, part) - 1)
            for lane in range(min(n - first, LANES)):
                row = row_at(ptr_at(memory, part * BATCH * NUMBERS), lane)
                for g in range(start, last + 1):
                    if found[part] >> lane & 1 == 0:
                        continue
                    alive, group = np.int64(get(tree.alive, g)), group_at(tree, g)
                    some = possible(tree.nodes, group, row, ways, alive, how.spheres)
                    all_of = covered(tree.nodes, group, row, ways, some)
                    for k in range(ways):
                        may[first + lane, g * ways + k], full[first + lane, g * ways + k] = (
                            some >> k & 1,
                            all_of >> k & 1,
                        )


@kernel
def _meet(origins, ends, corners, out):
    for k in range(len(corners)):
        for i in range(len(origins)):
            for s in range(ends.shape[1]):
                o, l = origins[i], ends[i, s]
                out[k, i, s] = meets(segment(o[0], o[1], o[2], l[0], l[1], l[2]), corners, k) != 0


def met_by(query, corners) -> np.ndarray:
    """(n, m, spp) bool: whether each triangle meets each segment of a query's m receivers, exactly."""
    ends, _ = segments(query)
    origins = query.origins.reshape(-1, 3)
    out = np.zeros((len(corners), len(origins), ends.shape[2]), bool)
    _meet(origins, ends.reshape(len(origins), -1, 3), corners, out)
    return out


def receivers_in(rays: LeafRays) -> np.ndarray:
    """(leaves, ways) int32: the receivers of each leaf; -1: none."""
    if rays.width:  # projected
        y, x = np.divmod(rays.blocks[:, None], -(-rays.width // 4))
        ids = (4 * y + np.arange(16) // 4) * rays.width + 4 * x + np.arange(16) % 4
    else:
        ids = rays.ids[:-PAD].reshape(-1, rays.ways)[rays.blocks]
    return np.where(rays.lanes[:, None] >> np.arange(rays.ways) & 1, ids, -1)


class Node(NamedTuple):
    part: int
    level: int
    index: int
    receivers: np.ndarray  # (r,) int32: receivers whose rays are in the node


def nodes_in(made: Hierarchy):
    """Yield all nodes of a hierarchy: level by level, leaves first."""
    tree, ways = made.tree, made.rays.ways
    ids = receivers_in(made.rays)
    for part in range(len(tree.faces)):
        leaves = ids[tree.leaves[part] : tree.leaves[part + 1]]
        for level in range(tree.heights[part]):
            for index in range(tree.sizes[part, level]):
                below = leaves[index * ways**level : (index + 1) * ways**level].ravel()
                yield Node(part, level, index, below[below >= 0])


class Said(NamedTuple):
    """A node's answers for each triangle."""

    may: np.ndarray  # (n,) bool: whether the triangle may block a ray of the node
    full: np.ndarray  # (n,) bool: whether the triangle blocks all rays of the node


def said(made: Hierarchy, soup: Soup, spheres=False):
    """Yield (Node, `Said`) of all nodes that hold rays, by the functions of the traversal."""
    tree, ways = made.tree, made.rays.ways
    shape = len(soup.corners), (len(tree.alive) - PAD) * ways
    may, full = np.zeros(shape, bool), np.zeros(shape, bool)
    parts = len(tree.faces)
    memory, found = np.zeros(parts * BATCH * NUMBERS, np.float32), np.zeros(parts, np.int32)
    _say(tree, made.beam, soup, TraversalOptions(spheres, True, 0, False, PAIRS), may, full, memory, found)
    for node in nodes_in(made):
        if len(node.receivers):
            k = tree.groups[node.part, node.level] * ways + node.index
            yield node, Said(may[:, k], full[:, k])
