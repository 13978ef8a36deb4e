"""Intervals of rays, their t and weights, and segments between points: each way of tracing rays against the oracle."""

from fractions import Fraction

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.bvh.nodes import tree_of
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.exact.filters import single_weights
from antumbra.kernels.exact.predicate import ray_along
from antumbra.kernels.jit import kernel
from antumbra.scene.triangles import HitFaces
from antumbra.trace.rays.ray_traversal import CLOSEST, walk
from cutout_scenes import meets as stops
from cutout_scenes import scene_with_cutouts
from ray_cases import KINDS, N, rays_of_kind


@kernel
def _walk_all(bvh, origins, directions, tmin, tmax, face, t, u, v):
    tree = tree_of(bvh)
    for i in range(len(origins)):
        o, d = origins[i], directions[i]
        ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], tmin[i], tmax[i])
        slot, found = walk(tree, ray, np.int64(-1), 0, np.int64(CLOSEST), None, None)
        if slot >= 0:
            face[i], t[i] = bvh.prim_ids[slot], found
            u[i], v[i] = single_weights(ray, tree.corners, slot)


class _Binary:
    """The walk over the binary BVH, to which other tracers leave their hardest rays, with the methods of a scene."""

    def __init__(self, scene):
        self.origin, self.triangles = scene.origin, scene.triangles
        self.bvh = BUILDERS["bsah"].build(scene.triangles().vertices, 1)

    def closest_hit(self, origins, directions, tmin=0.0, tmax=np.inf):
        n = len(origins)
        hit = HitFaces(np.full(n, np.inf), np.full(n, -1, np.int32), *np.zeros((2, n), np.float32))
        ends = (np.broadcast_to(np.asarray(end, float), n).copy() for end in (tmin, tmax))
        local = (origins - self.origin).astype(np.float32)
        _walk_all(self.bvh, local, directions, *ends, hit.face, hit.t, hit.u, hit.v)
        return hit

    def occluded(self, *rays, **ends):
        return self.closest_hit(*rays, **ends).face >= 0


def _in_memory(scene, tmp_path):
    return scene


def _in_a_store(scene, tmp_path):
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    return at.load(tmp_path / "a.antumbra")


def _by_walk(scene, tmp_path):
    return _Binary(scene)


TRACERS = {"memory": _in_memory, "store": _in_a_store, "walk": _by_walk}


class _Truth:
    """All hits of rays by brute force: for each ray t, as float64, and the first face there, sorted by t."""

    def __init__(self, scene, origins, directions, counts=lambda ray, face: True):
        self.triangles = scene.triangles()
        self.origins = (origins - scene.origin).astype(np.float32)
        self.directions, self.hits, self.exact = directions, [], {}
        for i, (o, d) in enumerate(zip(self.origins, directions)):
            found = {}
            for face, triangle in enumerate(self.triangles.vertices):
                side, t = oracle.meets_exactly(o, d, triangle)
                if side and counts(i, face):
                    found[float(t)] = min(found.get(float(t), (side, face)), (side, face))
                    self.exact[i, face] = t
            self.hits.append([(t, face) for t, (_, face) in sorted(found.items())])

    def column(self, k):
        """(t, face) of the k-th hits; infinity and -1 where there are fewer."""
        rows = [hits[k] if k < len(hits) else (np.inf, -1) for hits in self.hits]
        return np.array([t for t, _ in rows]), np.array([face for _, face in rows])


def _check_walk(engine, truth, world, directions):
    """Follow all rays from hit to hit."""
    tmin, longest = np.zeros(N), max(map(len, truth.hits))
    assert longest > 2 and sum(map(len, truth.hits)) > N // 3
    for k in range(longest + 1):
        hit = engine.closest_hit(world, directions, tmin=tmin)
        t, face = truth.column(k)
        np.testing.assert_array_equal(hit.t, t)
        np.testing.assert_array_equal(hit.face, face)
        np.testing.assert_array_equal(engine.occluded(world, directions, tmin=tmin), face >= 0)
        tmin = np.where(face >= 0, t, 1e300)  # rays without another hit stop


def _check_ends(engine, truth, world, directions):
    """Intervals whose ends are hits, and float64 neighbours of hits."""
    before = np.zeros(N)
    for k in range(max(map(len, truth.hits))):
        t, face = truth.column(k)
        there = face >= 0
        some = world[there], directions[there]
        t, face, begin = t[there], face[there], before[there]
        beyond, just_before = np.nextafter(t, np.inf), np.maximum(begin, np.nextafter(t, 0.0))
        for tmin, tmax, found in (
            (begin, t, False),
            (begin, beyond, True),
            (just_before, beyond, True),
            (t, beyond, False),
        ):
            hit = engine.closest_hit(*some, tmin=tmin, tmax=tmax)
            np.testing.assert_array_equal(hit.face, face if found else -1)
            np.testing.assert_array_equal(hit.t, t if found else np.inf)
            np.testing.assert_array_equal(engine.occluded(*some, tmin=tmin, tmax=tmax), found)
        before[there] = t


def _check_weights(engine, truth, world, directions):
    """The weights of the nearest hits, and the points that they give, against rational arithmetic."""
    hit = engine.closest_hit(world, directions)
    there = np.flatnonzero(hit.face >= 0)
    assert len(there) > N // 4 and (hit.u >= 0).all() and (hit.v >= 0).all() and (hit.u + hit.v <= 1 + 2.0**-23).all()
    for i in there.tolist():
        corners = [oracle.rational(v) for v in truth.triangles.vertices[hit.face[i]]]
        t, o, d = truth.exact[i, int(hit.face[i])], *map(oracle.rational, (truth.origins[i], directions[i]))
        weights = [Fraction(float(w)) for w in (hit.u[i], hit.v[i])]
        edges = [oracle.minus(corner, corners[0]) for corner in corners[1:]]
        bound = max(abs(x) for edge in edges for x in edge) / 2**22
        for k in range(3):
            given = corners[0][k] + sum(weight * edge[k] for weight, edge in zip(weights, edges))
            assert abs(given - (o[k] + t * d[k])) <= bound


@pytest.mark.parametrize("coherent", [True, False], ids=["coherent", "shuffled"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tracer", TRACERS)
def test_rays_find_all_hits_in_turn(tracer, kind, coherent, tmp_path):
    if tracer != "memory" and not coherent:
        pytest.skip("only memory has packets")
    scene, world, directions = rays_of_kind(kind, coherent)
    engine, truth = TRACERS[tracer](scene, tmp_path), _Truth(scene, world, directions)
    for check in _check_walk, _check_ends, _check_weights:
        check(engine, truth, world, directions)


def test_rays_find_all_hits_on_cutouts_in_turn():
    scene, rng = scene_with_cutouts(), np.random.default_rng(3)
    world = rng.uniform((-3, 0, -3), (3, 3, 3), (N, 3)).astype(np.float32) + scene.origin
    directions = rng.normal(size=(N, 3)).astype(np.float32)
    triangles, local = scene.triangles(), (world - scene.origin).astype(np.float32)
    exact = [oracle.rational(d) for d in directions]
    truth = _Truth(scene, world, directions, lambda ray, face: stops(triangles, local[ray], exact[ray], face))
    for check in _check_walk, _check_ends:
        check(scene, truth, world, directions)


def test_ends_that_float32_rounds():
    """Float32 would round 1 + 1e-9 to 1, and 1e-50 to 0, and 1e300 to infinity."""
    scene = at.Scene.from_arrays(np.float32([[[-1, -1, 0], [3, -1, 0], [-1, 3, 0]]]))
    o, d = np.array([0.25, 0.25, 2.0]), np.array([0.0, 0.0, -2.0])
    assert scene.closest_hit(o, d).t == 1.0
    for tmin, tmax, blocked in [
        (0, 1 + 1e-9, True), (1 - 1e-9, np.inf, True), (1 + 1e-9, np.inf, False), (0, 1 - 1e-9, False), (0, 1, False),
        (1e-50, 1e300, True), (1e300, np.inf, False), (0, 1e-50, False), (5e-324, 1 + 2.0**-52, True),
    ]:  # fmt: skip
        for each in (scene.occluded, lambda *a, **k: scene.closest_hit(*a, **k).mask):
            assert each(o, d, tmin=tmin, tmax=tmax) == blocked, (tmin, tmax)
    with pytest.raises(at.InputError, match="not negative"):
        scene.occluded(o, d, tmin=-1e-50)


def _segments(rng, vertices):
    """Pairs of points: random, towards and between corners, from and to the insides of triangles, without length."""
    m = 240
    pick, mix = rng.integers(0, len(vertices), (2, m)), rng.dirichlet((1, 1, 1), (2, m))
    inside = np.einsum("snk,snkc->snc", mix, vertices[pick].astype(np.float64))
    origins, targets = rng.normal(size=(2, m, 3)) * np.abs(vertices).max()
    targets[:80] = vertices[pick[0, :80], rng.integers(0, 3, 80)]
    origins[40:80] = vertices[pick[1, 40:80], rng.integers(0, 3, 40)]
    origins[80:120], targets[100:160] = inside[0, 80:120], inside[1, 100:160]
    targets[::20] = origins[::20]
    return origins.astype(np.float32), targets.astype(np.float32), np.where(rng.random(m) < 0.3, pick[0], -1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tracer", ["memory", "store"])
def test_segments_equal_the_oracle(tracer, kind, tmp_path):
    soup = KINDS[kind](np.random.default_rng(5))[0].astype(np.float32)
    scene = at.Scene.from_arrays(soup)
    vertices = scene.triangles().vertices
    origins, targets, skip = _segments(np.random.default_rng(6), vertices)
    world = [points + scene.origin for points in (origins, targets)]
    origins, targets = ((points - scene.origin).astype(np.float32) for points in world)
    truth = oracle.occluded(vertices, origins, ends=targets, skip=skip)
    assert 0.05 < truth.mean() < 0.95
    engine = TRACERS[tracer](scene, tmp_path)
    np.testing.assert_array_equal(engine.occluded(world[0], targets=world[1], skip_face=skip), truth)
    np.testing.assert_array_equal(engine.occluded(world[1], targets=world[0], skip_face=skip), truth)
    many = engine.occluded(world[0][:9, None], targets=world[1][None, :7])
    pairs = [np.broadcast_to(p, (9, 7, 3)).reshape(-1, 3) for p in (origins[:9, None], targets[None, :7])]
    np.testing.assert_array_equal(many.ravel(), oracle.occluded(vertices, pairs[0], ends=pairs[1]))


def test_segments_and_cutouts():
    scene, rng = scene_with_cutouts(), np.random.default_rng(4)
    world = [rng.uniform((-3, -2, -3), (3, 3, 3), (200, 3)).astype(np.float32) + scene.origin for _ in range(2)]
    triangles, (origins, ends) = scene.triangles(), ((p - scene.origin).astype(np.float32) for p in world)
    truth = np.zeros(200, bool)
    for i, row in enumerate(oracle.all_hits(triangles.vertices, origins, ends)):
        along = oracle.minus(oracle.rational(ends[i]), oracle.rational(origins[i]))
        truth[i] = any(stops(triangles, origins[i], along, int(f)) for f in np.flatnonzero(row))
    solid = oracle.occluded(triangles.vertices, origins, ends=ends)
    assert 0.1 < truth.mean() < solid.mean()
    np.testing.assert_array_equal(scene.occluded(world[0], targets=world[1]), truth)


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(directions=np.ones(3)), "either targets, which end the rays, or directions"),
        (dict(tmin=0.5), "either targets, which end the rays, or directions"),
        (dict(tmax=1.0), "either targets, which end the rays, or directions"),
        (dict(targets=np.ones((3, 2))), "targets must have shape"),
        (dict(targets=np.full(3, np.nan)), "targets hold NaN"),
        (dict(targets=np.full(3, 1e39)), "targets hold"),
        (dict(targets="abc"), "targets must be numbers"),
        (dict(targets=np.ones((5, 3))), "targets"),
    ],
)
def test_bad_targets_are_named(change, says):
    scene = at.Scene.from_arrays(np.float32([[[-1, -1, 0], [3, -1, 0], [-1, 3, 0]]]))
    with pytest.raises(at.InputError, match=says):
        scene.occluded(np.zeros((2, 3)), **(dict(targets=np.ones(3)) | change))
