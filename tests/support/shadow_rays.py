"""Helpers for tests of structures for rays: segments through a soup, their intersections, and counted traversals."""

import numpy as np

from antumbra.bvh import lbvh
from antumbra.bvh.nodes import EMPTY, tree_of
from antumbra.kernels.exact.predicate import segment
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import stack_array
from antumbra.trace.counters import BOX_TESTS, N_COUNTERS
from antumbra.trace.rays.ray_hits import intersections
from antumbra.trace.rays.ray_traversal import walk


def segments_in(vertices, m, seed=0):
    """(origins, ends) of m segments, float32, between points near the triangles.

    Every other segment is aimed at the centre of a triangle.
    """
    rng = np.random.default_rng(seed)
    if len(vertices) == 0:
        return rng.normal(size=(2, m, 3)).astype(np.float32)
    corners = vertices.astype(np.float64)
    low, high = corners.min((0, 1)), corners.max((0, 1))
    origins, ends = (low + (high - low) * rng.uniform(-0.2, 1.2, (m, 3)) for _ in range(2))
    inside = corners[rng.integers(0, len(corners), m)].mean(1)
    ends[::2] = inside[::2] + (inside[::2] - origins[::2]) * rng.uniform(-0.1, 1, (len(ends[::2]), 1))
    return origins.astype(np.float32), ends.astype(np.float32)


def met(vertices, origins, ends, threads=1):
    """The `Intersections` of segments that skip no triangle."""
    skip = np.full(len(origins), -1, np.int32)
    return intersections(lbvh.build(vertices, threads), origins, ends, skip, threads)


def met_in(vertices, m=64, seed=0):
    """The `Intersections` of m segments through a soup."""
    return met(vertices, *segments_in(vertices, m, seed))


@kernel
def _walk_all(bvh, order, origins, ends, slots, far, tests):
    tree, counters = tree_of(bvh), stack_array(np.int64, N_COUNTERS)
    for i in range(len(origins)):
        counters[:] = 0
        o, e = origins[i], ends[i]
        ray = segment(o[0], o[1], o[2], e[0], e[1], e[2])
        slots[i], far[i] = walk(tree, ray, np.int64(-1), np.int64(0), order, None, counters)
        tests[i] = counters[BOX_TESTS]


def walked(bvh, order, origins, ends):
    """(triangle or -1, t, boxes tested) of each segment, traced in an order of `orders`. No triangle is skipped."""
    slots, far, tests = np.empty(len(origins), np.int64), np.empty(len(origins)), np.empty(len(origins), np.int64)
    _walk_all(bvh, np.int64(order), origins, ends, slots, far, tests)
    return np.where(slots >= 0, bvh.prim_ids[slots], -1), far, tests


def nested(bvh, node=0):
    """A tree as `reference_srdh.visit` takes it: [triangles] for a leaf, (left, right, word 14) for a node."""
    sides = []
    for link in bvh.links[node, 12:14].tolist():
        assert link != EMPTY
        first = ~link >> 3
        sides.append(nested(bvh, link) if link >= 0 else bvh.prim_ids[first : first + (~link & 7) + 1].tolist())
    return (*sides, int(bvh.links[node, 14]))
