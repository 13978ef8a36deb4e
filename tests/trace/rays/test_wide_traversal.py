"""Rays through the wide BVH, single and in packets, give the answers of `walk` in the binary BVH, and of the oracle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.bvh.nodes import tree_of
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.exact.predicate import ray_along
from antumbra.kernels.jit import kernel
from antumbra.query.ray_list import hit_arrays, rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.counters import COUNTERS, new_counters
from antumbra.trace.rays.ray_batches import RayTracer
from antumbra.trace.rays.ray_traversal import CLOSEST, walk
from strategies import soups
from strength import examples


@kernel
def _walk_all(bvh, origins, directions, tmin, tmax, skip, cull_faces, face, t):
    tree = tree_of(bvh)
    for i in range(len(origins)):
        o, d = origins[i], directions[i]
        ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], tmin, tmax)
        slot, found = walk(tree, ray, np.int64(skip[i]), cull_faces, CLOSEST, None, None)
        face[i], t[i] = (-1, np.inf) if slot < 0 else (bvh.prim_ids[slot], found)


def _compare(soup, origins, directions, tmin=0.0, tmax=np.inf, skip=None, cull_faces=None):
    """Compare both kinds of query with `walk`; return (share of hits, counters of the any-hit query)."""
    n = len(origins)
    bvh = BUILDERS["bsah"].build(soup, 1)
    wide = widen(bvh, 1)
    skip = np.full(n, -1, np.int32) if skip is None else skip.astype(np.int32)
    face, t = np.empty(n, np.int32), np.empty(n)
    rays, tracer = (
        rays_of(origins, directions, HitFilter(tmin, tmax, skip, cull_faces), (0.0, 0.0, 0.0), len(soup)),
        RayTracer(wide),
    )
    _walk_all(bvh, origins, directions, float(tmin), float(tmax), skip, rays.cull_faces, face, t)
    any_hit, nearest, counters = hit_arrays(n, True), hit_arrays(n, False), new_counters()
    assert tracer.trace(rays, True, any_hit, 2, counters)
    np.testing.assert_array_equal(any_hit.blocked, face >= 0)
    assert tracer.trace(rays, False, nearest, 2, new_counters())
    np.testing.assert_array_equal(nearest.face, face)
    np.testing.assert_array_equal(nearest.t, t)
    return (face >= 0).mean(), dict(zip(COUNTERS, counters.tolist()))


def _bundles(rng, size, n=40, each=16):
    """(origins, directions) of n bundles of rays with similar origins and directions."""
    origins = rng.normal(size=(n, 1, 3)) * size + rng.normal(size=(n, each, 3)) * size * 1e-3
    directions = rng.normal(size=(n, 1, 3)) * size + rng.normal(size=(n, each, 3)) * size * 1e-2
    return origins.reshape(-1, 3).astype(np.float32), directions.reshape(-1, 3).astype(np.float32)


@given(soups(), st.integers(0, 2**32 - 1), st.sampled_from(["random", "16", "64", "to a point"]))
@examples(60)
def test_random_soups(soup, seed, kind):
    rng = np.random.default_rng(seed)
    size = np.abs(soup).max()
    if kind in ("16", "64"):
        origins, directions = (a[:617] for a in _bundles(rng, size, each=int(kind)))  # the last block is not full
    elif kind == "to a point":
        origins = (rng.normal(size=(300, 3)) * size).astype(np.float32)
        directions = (rng.normal(size=3) * size).astype(np.float32) - origins
        directions[~directions.any(1)] = 1
    else:
        origins, directions = (rng.normal(size=(2, 203, 3)) * size).astype(np.float32)
        corner = soup[rng.integers(0, len(soup), 100), rng.integers(0, 3, 100)]
        directions[:100] = corner - origins[:100]
        directions[::4, 0] = 0
        directions[::8, 1:] = [0, size]
        directions[~directions.any(1)] = 1
    skip = np.where(rng.uniform(size=len(origins)) < 0.3, rng.integers(0, len(soup), len(origins)), -1)
    tmin, tmax = rng.uniform(0, 0.5), rng.choice([1.0, 2.0, np.inf])
    cull_faces = rng.choice([None, "front", "back"])
    _compare(soup, origins, directions, tmin, tmax, skip, cull_faces)


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e6, 1e20])
@pytest.mark.parametrize("coherent", [False, True])
def test_scales(scale, coherent):
    rng = np.random.default_rng(5)
    soup = (rng.normal(size=(500, 1, 3)) + rng.normal(size=(500, 3, 3)) * 0.2) * scale
    soup = soup.astype(np.float32)
    origins, directions = (
        _bundles(rng, scale) if coherent else (rng.normal(size=(2, 640, 3)) * scale).astype(np.float32)
    )
    hit, _ = _compare(soup, origins, directions, tmax=1.0 if scale < 1 else np.inf)
    assert 0.1 < hit < 0.95


def test_packets_share_nodes():
    rng = np.random.default_rng(6)
    soup = (rng.normal(size=(5000, 1, 3)) + rng.normal(size=(5000, 3, 3)) * 0.02).astype(np.float32)
    origins, directions = _bundles(rng, 1.0, 100)
    hit, together = _compare(soup, origins, directions)
    order = rng.permutation(len(origins))
    _, alone = _compare(soup, origins[order], directions[order])
    assert 0.05 < hit < 0.95 and together["nodes"] < alone["nodes"] / 4


def test_blocks_share_nodes():
    rng = np.random.default_rng(8)
    soup = (rng.normal(size=(5000, 1, 3)) + rng.normal(size=(5000, 3, 3)) * 0.02).astype(np.float32)
    origins, directions = _bundles(rng, 1.0, 50, 64)
    hit, together = _compare(soup, origins, directions)
    order = np.arange(len(origins)).reshape(50, 4, 16).swapaxes(0, 1).ravel()  # one block of each bundle at a time
    _, apart = _compare(soup, origins[order], directions[order])
    assert 0.05 < hit < 0.95 and together["nodes"] < apart["nodes"] / 2


@pytest.mark.parametrize("spread", [0.01, 0.1])
def test_packets_whose_directions_differ_in_sign(spread):
    """Each packet leads from one point along an axis, some of its rays exactly so: no box that it meets is culled."""
    rng = np.random.default_rng(9)
    soup = (rng.normal(size=(5000, 1, 3)) + rng.normal(size=(5000, 3, 3)) * 0.05).astype(np.float32)
    origins = np.repeat(rng.normal(size=(60, 3)), 64, 0).astype(np.float32)
    directions = rng.uniform(-spread, spread, (60, 64, 3))
    directions[:, ::7] = 0.0
    for axis in range(3):
        directions[axis::3, :, axis] += (-1.0, 1.0, 1.0)[axis]
    directions = directions.reshape(-1, 3).astype(np.float32)
    hit, together = _compare(soup, origins, directions)
    order = rng.permutation(len(origins))
    _, alone = _compare(soup, origins[order], directions[order])
    assert 0.1 < hit < 0.95 and together["nodes"] < alone["nodes"] / 4


def test_parallel_rays_along_axes_through_a_grid_of_corners():
    """Origins and directions lie on planes of boxes and on edges of triangles."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(8.0), np.arange(8.0)))
    corner = np.stack([x, y, np.zeros(64)], 1)[:, None]
    soup = np.concatenate([corner + [[0, 0, 0], [1, 0, 0], [1, 1, 0]], corner + [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
    at_corners = np.stack(np.meshgrid(np.arange(-1.0, 10.0), np.arange(-1.0, 10.0)), -1).reshape(-1, 2)
    origins = np.concatenate([at_corners, np.full((len(at_corners), 1), -3.0)], 1).astype(np.float32)
    directions = np.tile(np.float32([0, 0, 1]), (len(origins), 1))
    hit, _ = _compare(np.ascontiguousarray(soup, np.float32), origins, directions)
    assert hit == 81 / 121


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_triangles(n):
    soup = np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 0, 1], [0, 1, 1]]])[:n]
    origins = np.tile(np.float32([0.25, 0.25, -1]), (35, 1))
    origins[::2, 0] = 3
    directions = np.tile(np.float32([0, 0, 1]), (35, 1))
    assert _compare(soup, origins, directions)[0] == (0 if n == 0 else 17 / 35)


@pytest.mark.parametrize("dtypes", [("f4", "f8"), ("f8", "f4"), ("f4", "f4"), ("i4", "f8"), (">f4", ">f8")])
@pytest.mark.parametrize("layout", ["rows", "six", "every second", "columns", "read-only"])
def test_every_layout_and_dtype(dtypes, layout):
    rng = np.random.default_rng(7)
    soup = (rng.normal(size=(300, 1, 3)) * 4 + rng.normal(size=(300, 3, 3))).astype(np.float32)
    scene = at.Scene.from_arrays(soup)
    o, d = (np.round(rng.normal(size=(2, 100, 3)) * 6)) + 0.0
    d[~d.any(1)] = 1
    truth = oracle.occluded(scene.triangles().vertices, (o - scene.origin).astype(np.float32), d, tmax=2.0)
    o, d = o.astype(dtypes[0]), d.astype(dtypes[1])
    if layout == "six":
        o, d = np.concatenate([o, d], 1), None
    elif layout == "every second":
        o, d = np.repeat(o, 2, 0)[::2], np.repeat(d, 2, 0)[::-2][::-1]
    elif layout == "columns":
        o, d = np.asfortranarray(o), np.asfortranarray(d)
    elif layout == "read-only":
        o.setflags(write=False)
    assert 0.1 < truth.mean() < 0.9
    np.testing.assert_array_equal(scene.occluded(o, d, tmax=2.0), truth)


def test_one_bad_ray_among_many_is_named():
    scene = at.Scene.from_arrays(np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]))
    origins, directions = np.zeros((50_000, 3)), np.ones((50_000, 3))
    directions[41_234, 1] = np.inf
    with pytest.raises(at.InputError, match="ray 41234"):
        scene.occluded(origins, directions)
