"""Nearest hits in tree lists on devices: those of one tree, however triangles are shared out over trees and calls."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.bvh.wide_bvh import widen
from antumbra.query.ray_list import RayArguments, hit_arrays
from antumbra.query.shadow_query import CULL_FACES
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_traversal import COUNTS, REST
from antumbra.trace.device.nearest_list_tracer import RayGrid, RayVectors, TiledRays
from antumbra.trace.device.part_trees import part_tree
from antumbra.trace.device.tree_list_tracer import TiledTracer, TreeLists
from antumbra.trace.primary.primary_rays import trace_primary
from antumbra.trace.rays.ray_batches import RayTracer
from antumbra.trace.tree_list import no_hits
from devices import DEVICES, opened
from truths import soup_scene

TREES, TILE = 5, 16
SIZES = {"large lists": CAPACITIES, "tiny lists": Capacities(16, 8, 4), "no lists": Capacities(16, 1, 4)}


def _soup():
    """Triangles that meet each other, some of them twice or the other way round, and all in front of a wall."""
    vertices = soup_scene(3).triangles().vertices.copy()
    vertices[100:160] = vertices[:60]
    vertices[160:200] = vertices[60:100, ::-1]
    wall = np.array([[[-5, -6, -9], [5, -6, -9], [0, 8, -9]]], np.float32)
    return np.concatenate([vertices, wall, wall[:, ::-1]])


VERTICES = _soup()
WHOLE = binned_sah.build(VERTICES, 1)


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.fixture(scope="module")
def trees(device):
    """(trees of shares of the triangles, whose boxes overlap; their table)."""
    share = np.random.default_rng(7).integers(0, TREES, len(VERTICES))
    found = []
    for k in range(TREES):
        ids = np.flatnonzero(share == k).astype(np.int32)
        bvh = binned_sah.build(VERTICES[ids], 1)
        found.append((part_tree(bvh._replace(prim_ids=ids[bvh.prim_ids]), device), ids[bvh.prim_ids]))
    return found, np.stack([tree.row for tree, _ in found])


def _trace(rays, trees, shape, turns=([0, 1], [2], [4, 3])):
    """Trace all tiles through some trees at a time, in any order."""
    rng, across = np.random.default_rng(1), -(-shape[1] // TILE)
    tiles = np.arange(across * -(-shape[0] // TILE), dtype=np.int32)
    for turn in turns:
        items = [rng.permutation(len(turn)) for _ in tiles]
        starts = np.cumsum([0, *map(len, items)]).astype(np.int32)
        lists = TreeLists(trees[1][turn], starts, np.concatenate(items).astype(np.int32), 1)
        rays.trace_nearest(tiles, lists, np.array(turn, np.int32), 2)


def _check(hits, trees, face, t):
    np.testing.assert_array_equal(hits.face, face)
    np.testing.assert_array_equal(hits.t, t)
    hit = face >= 0
    assert 0.02 < hit.mean() < 1.0
    for (_, ids), k in zip(trees[0], range(TREES)):
        there = hit & (hits.part == k)
        np.testing.assert_array_equal(ids[hits.slot[there]], face[there])
    assert (hits.part[~hit] == -1).all()
    np.testing.assert_allclose(np.abs(hits.signed_t[hit]), t[hit], 1e-8)  # exact; pictures round otherwise


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("rows", [slice(0, 45), slice(16, 32)], ids=str)
def test_hits_of_a_camera(device, trees, sizes, rows):
    camera, shape = at.Camera((0, 2, 9), (0, -0.5, 0), width=37, height=45), (45, 37)
    view, hits, tracer = camera.rays(np.zeros(3)), no_hits(shape), TiledTracer(device, SIZES[sizes])
    face, t = trace_primary(WHOLE, view, 1)
    _trace(TiledRays(tracer, RayGrid(TILE, 3, shape, rows), view, hits), trees, shape)
    others = np.ones(shape[0], bool)
    others[rows] = False
    assert (hits.face[others] == -1).all()
    face[others], t[others] = -1, np.inf
    _check(hits, trees, face, t)
    assert {1, -1} == set(np.sign(hits.signed_t[hits.face >= 0]))


def _rays(rng, n):
    """Rays through corners and along edges, in planes of triangles, and anywhere; some without a direction."""
    origins = VERTICES[rng.integers(0, len(VERTICES), n), 0] + rng.normal(size=(n, 3)) * (rng.random((n, 1)) < 0.7)
    targets = VERTICES[rng.integers(0, len(VERTICES), n), 1]
    directions = (targets.astype("f4") - origins.astype("f4")) * 2.0 ** rng.integers(-3, 4, (n, 1))
    directions[rng.random(n) < 0.05] = 0.0
    return origins.astype(np.float32), directions.astype(np.float32)


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("shape", [(40, 50), (1, 800)], ids=str)
@pytest.mark.parametrize("each", [False, True], ids=["endless", "spans"])
def test_hits_of_rays_that_point_anywhere(device, trees, sizes, shape, each):
    rng, n = np.random.default_rng(3), shape[0] * shape[1]
    (origins, directions), skip = _rays(rng, n), rng.integers(-1, len(VERTICES), n).astype(np.int32)
    spans = np.array([[0.0, np.inf]])
    if each:
        spans = np.stack([rng.uniform(0, 0.5, n), rng.uniform(0.5, 2, n)], 1)
        spans[rng.random(n) < 0.3] = 0.0, np.inf
    cull, tracer, hits = CULL_FACES["front"] if each else 0, TiledTracer(device, SIZES[sizes]), no_hits(shape)
    vectors = RayVectors(origins, directions, skip, spans, cull)
    grid = RayGrid(TILE, -(-shape[1] // TILE), shape, slice(0, shape[0]))
    _trace(TiledRays(tracer, grid, vectors, hits), trees, shape)
    moving = directions.any(1)
    face, t = np.full(n, -1), np.full(n, np.inf)
    face[moving], t[moving] = _truth(origins[moving], directions[moving], skip[moving], spans, moving, cull)
    _check(hits, trees, face.reshape(shape), t.reshape(shape))
    assert tracer.on_cpu > 0


def _truth(origins, directions, skip, spans, moving, cull):
    """(face, t) of rays by the tracer of ray lists."""
    tmin, tmax = (spans[moving] if len(spans) > 1 else np.repeat(spans, len(origins), 0)).T
    n, wide = len(origins), (origins.astype(float), directions.astype(float))
    rays, out = RayArguments(*wide, tmin, tmax, skip, (n,), cull, False, (0.0, 0.0, 0.0)), hit_arrays(n, False)
    assert RayTracer(widen(WHOLE, 1)).trace(rays, False, out, 1)
    return out.face, out.t


def test_the_count_of_undecided_tests_is_at_most_one_per_ray_beyond_the_list(device, monkeypatch):
    """Each ray meets a corner of many equal triangles; counted without an end, their tests would wrap an int32."""
    n, copies, capacity = 64, 300, 4
    corner, towards = np.array([0.5, 0.25, 0.75], np.float32), np.array([-1.0, -2.0, -3.0], np.float32)
    vertices = np.repeat(np.array([[corner, [1.5, 0.3, 0.1], [0.2, 1.3, 0.4]]], np.float32), copies, 0)
    bvh = binned_sah.build(vertices, 1)
    tracer, hits, counts = TiledTracer(device, Capacities(16, 8, capacity)), no_hits((1, n)), []
    launch = tracer.launches.launch

    def counted(name, arguments, threads):
        launch(name, arguments, threads)
        if name == "find_listed":
            work = arguments[2]
            left = int(tracer.launches.block("counts", 0, "").read(np.empty(COUNTS, np.int32))[REST])
            counts.append((left, work.rest_capacity, work.n))

    monkeypatch.setattr(tracer.launches, "launch", counted)
    origins, directions = np.tile(corner - towards, (n, 1)), np.tile(towards, (n, 1))
    vectors = RayVectors(origins, directions, np.full(n, -1, np.int32), np.array([[0.0, np.inf]]), 0)
    tree = part_tree(bvh, device)
    rays = TiledRays(tracer, RayGrid(n, 1, (1, n), slice(0, 1)), vectors, hits)
    lists = TreeLists(tree.row[None], np.array([0, 1], np.int32), np.zeros(1, np.int32), 1)
    rays.trace_nearest(np.zeros(1, np.int32), lists, np.zeros(1, np.int32), 2)
    assert max(left for left, _, _ in counts) > capacity
    assert all(left <= room + rays for left, room, rays in counts)
    assert tracer.on_cpu >= n * copies // 2
    assert (hits.face == 0).all() and (hits.t == 1.0).all()  # of equal hits, the first face


def test_memory_is_freed_with_the_rays(device):
    tracer, hits = TiledTracer(device), no_hits((16, 16))
    vectors = RayVectors(
        np.zeros((256, 3), np.float32), np.ones((256, 3), np.float32), np.full(256, -1, np.int32), np.ones((256, 2)), 0
    )
    grid, sizes = RayGrid(16, 1, (16, 16), slice(0, 16)), []
    for _ in range(3):
        rays = TiledRays(tracer, grid, vectors, hits)
        sizes.append(device.used)
        del rays
    assert sizes[1] == sizes[2] > device.used
