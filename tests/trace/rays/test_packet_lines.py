"""Triangles that a packet culls are met by none of its rays, also where these pass through edges and vertices."""

import numpy as np
import pytest

import oracle
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.query.ray_list import hit_arrays, rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.counters import TRIANGLE_TESTS, new_counters
from antumbra.trace.rays.ray_batches import RayTracer

_CELLS, _FINE = 8, 8  # of the grid, along each side; points of a packet along each side, of which eight are a cell


def _grid(rng):
    """(n, 3, 3) float32: triangles in the plane z = 0, between whole numbers. Some are left out."""
    x, y = np.meshgrid(np.arange(_CELLS), np.arange(_CELLS))
    corners = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 1, 3)
    halves = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    soup = (corners[:, None] + halves).reshape(-1, 3, 3).astype(np.float32)
    return soup[rng.uniform(size=len(soup)) < 0.5]


def _patches(rng, n):
    """(n * 64, 3) float32: squares of points in the plane, on vertices, edges and diagonals of the grid, and beside."""
    x, y = np.meshgrid(np.arange(_FINE), np.arange(_FINE))
    patch = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(1, -1, 3)
    first = np.append(rng.integers(-_FINE, _CELLS * _FINE, (n, 1, 2)), np.zeros((n, 1, 1), int), axis=2)
    return ((first + patch) / _FINE).reshape(-1, 3).astype(np.float32)


def _bundle(kind, points, rng):
    """(origins, directions) of rays through points: from one point, to one, or parallel."""
    if kind == "parallel":
        directions = np.broadcast_to(np.float32([1, 2, -4]), points.shape)
        return points - directions, directions
    apex = np.float32([3, -2, 16])
    directions = points - apex
    if kind == "from one point":
        return np.broadcast_to(apex, points.shape), directions
    return points + directions / 2, -directions


@pytest.mark.parametrize("kind", ["from one point", "to one point", "parallel"])
def test_rays_through_edges_and_vertices(kind):
    rng = np.random.default_rng(3)
    soup, points = _grid(rng), _patches(rng, 24)
    origins, directions = (np.ascontiguousarray(a) for a in _bundle(kind, points, rng))
    tracer, n = RayTracer(widen(BUILDERS["bsah"].build(soup, 1), 1)), len(points)
    rays = rays_of(origins, directions, HitFilter(0.0, 1.5), (0.0, 0.0, 0.0), len(soup))
    blocked, nearest = hit_arrays(n, True), hit_arrays(n, False)
    assert tracer.trace(rays, True, blocked, 1)
    truth = oracle.occluded(soup, origins, directions, tmax=1.5)
    assert 0.2 < truth.mean() < 0.8
    np.testing.assert_array_equal(blocked.blocked, truth)
    assert tracer.trace(rays, False, nearest, 1)
    t, face = oracle.closest_hit(soup, origins, directions, 0.0, 1.5)
    np.testing.assert_array_equal(nearest.t, t)
    np.testing.assert_array_equal(nearest.face >= 0, face >= 0)


def test_a_leaf_is_tested_where_the_packet_is():
    soup = np.array([[[k, 0, 0], [k + 0.9, 0, 0], [k, 1, 0]] for k in range(8)], np.float32)
    points = np.stack([*np.meshgrid(np.linspace(5.1, 5.2, 8), np.linspace(0.1, 0.2, 8)), np.zeros((8, 8))], axis=-1)
    origins = np.tile(np.float32([4, 0.5, 9]), (64, 1))
    directions = (points.reshape(-1, 3) - origins).astype(np.float32)
    tracer = RayTracer(widen(BUILDERS["bsah"].build(soup, 1), 1))
    out, counters = hit_arrays(64, True), new_counters()
    rays = rays_of(origins, directions, HitFilter(0.0, np.inf), (0.0, 0.0, 0.0), len(soup))
    assert tracer.trace(rays, True, out, 1, counters)
    assert out.blocked.all()
    assert counters[TRIANGLE_TESTS] == 64
