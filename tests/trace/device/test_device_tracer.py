"""Rays and shadow queries on devices: the bits and the numbers of the CPU, whatever the lists can hold."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah, lbvh
from antumbra.query.light_samples import light_samples
from antumbra.query.ray_list import HitFilter, rays_of
from antumbra.query.receivers import Receivers
from antumbra.query.shadow_query import new_bits
from antumbra.trace.device.device_launches import DeviceLaunches
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.rays.single_rays import as_built, trace_shadow
from asking import query_of
from devices import DEVICES, opened
from ray_cases import KINDS, rays_of_kind
from truths import LIGHTS, soup_scene

TINY = Capacities(pairs=24, records=8, least=4)
"""Lists that a few hostile rays fill."""


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.fixture(scope="module", params=[CAPACITIES, TINY], ids=["large lists", "tiny lists"])
def tracer(request, device):
    return DeviceTracer(device, request.param)


def hostile_rays(scene, n, seed=1):
    """(origins, targets): segments in a scene's box; half of them through its corners and edges, or along them."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(scene.bounds)
    origins, targets = (low + rng.random((n, 3)) * (high - low) for _ in range(2))
    a, b, c = (scene.triangles().vertices[rng.integers(0, scene.n_triangles, n)] + scene.origin).swapaxes(0, 1)
    s, kind = rng.random((n, 1)), rng.integers(0, 8, n)[:, None]
    on_edge = [kind == 0, kind == 1, kind == 2, kind == 3]
    targets = np.select(on_edge, [a, (a + b) / 2, 2 * a - origins, b + (b - a) * s], targets)
    origins = np.where(kind == 3, a + (a - b) * s, np.where(kind == 4, c, origins))
    return origins, np.where((targets - origins).astype(np.float32).any(1)[:, None], targets, targets + 1.0)


def traced(tracer, scene, any_hit, origins, directions=None, targets=None, **hits):
    """The `HitArrays` of rays of a scene on a device."""
    frame = tuple(scene.origin.tolist())
    rays = rays_of(origins, directions, HitFilter(**hits), frame, scene.n_triangles, targets)
    tree = tracer.tree(binned_sah.build(scene.triangles().vertices, 2))
    return tracer.trace_rays(tree, rays, any_hit, 2)


def check_nearest(tracer, scene, origins, directions, **hits):
    ours, theirs = (
        traced(tracer, scene, False, origins, directions, **hits),
        scene.closest_hit(origins, directions, **hits),
    )
    for name in ("face", "t", "u", "v"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    return theirs.face >= 0


# --- Ray lists --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cull_faces", [None, "front", "back"])
def test_segments_are_blocked_where_they_are_on_the_cpu(tracer, cull_faces):
    scene = soup_scene(3)
    origins, targets = hostile_rays(scene, 600)
    blocked = traced(tracer, scene, True, origins, targets=targets, cull_faces=cull_faces).blocked
    np.testing.assert_array_equal(blocked, scene.occluded(origins, targets=targets, cull_faces=cull_faces))
    assert 0.1 < blocked.mean() < 0.9


@pytest.mark.parametrize("cull_faces", [None, "back"])
def test_rays_have_the_hits_of_the_cpu_within_their_intervals(tracer, cull_faces):
    scene, rng = soup_scene(4), np.random.default_rng(2)
    origins, targets = hostile_rays(scene, 600)
    skip = np.where(rng.random(600) < 0.5, rng.integers(0, scene.n_triangles, 600), -1)
    hits = {"tmin": 0.25, "tmax": rng.choice([0.5, 1.0, 2.0, np.inf], 600), "skip_face": skip, "cull_faces": cull_faces}
    found = check_nearest(tracer, scene, origins, targets - origins, **hits)
    np.testing.assert_array_equal(traced(tracer, scene, True, origins, targets - origins, **hits).blocked, found)
    assert 0.1 < found.mean() < 0.9


@pytest.mark.parametrize("kind", KINDS)
def test_rays_with_many_hits_at_one_t_have_the_same_nearest_face(tracer, kind):
    scene, origins, directions = rays_of_kind(kind, True)
    found = check_nearest(tracer, scene, origins, directions)
    np.testing.assert_array_equal(traced(tracer, scene, True, origins, directions).blocked, found)
    assert found.any()


@pytest.mark.parametrize("scale", [1e-12, 1e-6, 1e6, 1e12])
def test_scenes_of_any_size_have_the_hits_of_the_cpu(tracer, scale):
    soup = soup_scene(5).triangles().vertices.astype(np.float64) * scale
    scene = at.Scene.from_arrays(soup)
    origins, targets = hostile_rays(scene, 200)
    found = check_nearest(tracer, scene, origins, targets - origins)
    assert 0.1 < found.mean() < 1.0


@pytest.mark.parametrize("length", [1e-20, 1e20])
def test_directions_of_any_length_have_the_hits_of_the_cpu(tracer, length):
    scene = soup_scene(6)
    origins, targets = hostile_rays(scene, 200)
    found = check_nearest(tracer, scene, origins, (targets - origins) * length)
    assert 0.1 < found.mean() < 1.0


@pytest.mark.parametrize("n", [0, 1, 2])
def test_scenes_of_hardly_any_triangles(tracer, n):
    corners = np.array([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]])
    bvh = binned_sah.build(np.array([corners + (0, 0, k) for k in range(n)], np.float32).reshape(n, 3, 3), 1)
    origins = np.array([[0.25, 0.5, 9.0], [9.0, 9.0, 9.0], [-1, -1, 9.0]])
    rays = rays_of(origins, (0.0, 0.0, -1.0), HitFilter(), (0.0, 0.0, 0.0), max(n, 1))
    nearest = tracer.trace_rays(tracer.tree(bvh), rays, False, 1)
    hit = np.array([n > 0, False, n > 0])
    np.testing.assert_array_equal(nearest.face, np.where(hit, n - 1, -1))
    np.testing.assert_array_equal(nearest.t, np.where(hit, 9.0 - (n - 1), np.inf))
    np.testing.assert_array_equal(tracer.trace_rays(tracer.tree(bvh), rays, True, 1).blocked, hit)


def test_no_rays_have_no_hits(tracer):
    scene = soup_scene(3)
    assert traced(tracer, scene, True, np.zeros((0, 3)), np.zeros((0, 3))).blocked.shape == (0,)
    assert traced(tracer, scene, False, np.zeros((0, 3)), np.zeros((0, 3))).t.shape == (0,)


# --- Shadow queries ---------------------------------------------------------------------------------------------------


def check_query(tracer, triangles, query):
    bvh = binned_sah.build(triangles.vertices, 2)
    truth, tree = new_bits(query), tracer.tree(bvh)
    trace_shadow(as_built(bvh), query, truth, 2)
    for shafts in False, True:
        bits = new_bits(query)
        tracer.trace_shadow(tree, query, bits, 2, shafts=shafts)
        np.testing.assert_array_equal(bits, truth, err_msg=f"shafts={shafts}")
    return np.bitwise_count(truth).sum() / (query.sides.size * query.samples.shape[1])


@pytest.mark.parametrize("spp", [1, 5, 8, 16, 33, 64, 100])
def test_a_bit_per_sample_whatever_their_number(tracer, spp):
    camera = at.Camera((0, 2, 9), (0, -0.5, 0), width=9, height=7)
    assert 0 < check_query(tracer, *query_of(soup_scene(7), camera, LIGHTS["quad"], spp)) < 1


@pytest.mark.parametrize("name", LIGHTS)
def test_samples_of_every_light_are_those_of_the_cpu(tracer, name):
    camera = at.Camera((0, 2, 9), (0, -0.5, 0), width=12, height=10)
    assert check_query(tracer, *query_of(soup_scene(8), camera, LIGHTS[name], 5)) > 0


QUAD = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))


@pytest.mark.parametrize(
    "light, free",
    [(QUAD, True), (QUAD, False), (at.AmbientOcclusion(4.0), False)],
    ids=["in space", "lit", "ambient"],
)
def test_points_without_faces(tracer, light, free):
    scene, rng = soup_scene(9), np.random.default_rng(3)
    low, high = np.asarray(scene.bounds)
    points = low + rng.random((40, 3)) * (high - low)
    normals = rng.normal(size=(40, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    origin = scene.triangles().origin
    receivers = Receivers.in_space(points, origin) if free else Receivers.on_surface(points, normals, origin)
    query = scene.engine.queries(receivers, [light], [light_samples(light, 16)])[0]
    assert 0 < check_query(tracer, scene.triangles(), query) < 1


def test_receivers_in_the_plane_of_the_light_and_of_all_blockers(tracer):
    """Float64 can decide no horizon and no test, so the CPU decides them all."""
    x, z = (a.ravel() for a in np.meshgrid(np.arange(6.0), np.arange(6.0)))
    floor = np.stack([x, 0 * x, z], 1)[:, None] + [[0, 0, 0], [1, 0, 0], [0, 0, 1]]
    scene = at.Scene.from_arrays(np.concatenate([floor, [[[3.0, -1, -9], [3, -1, 9], [3, 2, 0]]]]))
    light = at.QuadLight((9, 0, 1), (3, 0, 0), (0, 0, 3))
    camera = at.Camera((2, 6, 2), (2.5, 0, 2.5), width=8, height=8)
    assert check_query(tracer, *query_of(scene, camera, light, 16)) > 0


def test_the_receivers_triangles_are_sent_again_only_if_they_are_others(device, monkeypatch):
    camera, tracer, sent, done = at.Camera((0, 2, 9), (0, -0.5, 0), width=9, height=7), DeviceTracer(device), [], []
    send = DeviceLaunches.sent_triangles

    def counted(self, corners):
        sent.append(len(done))
        return send(self, corners)

    monkeypatch.setattr(DeviceLaunches, "sent_triangles", counted)
    scenes = [query_of(soup_scene(seed), camera, LIGHTS["quad"], 4) for seed in (7, 8)]
    for triangles, query in (scenes[0], scenes[0], scenes[1], scenes[0]):
        assert 0 < check_query(tracer, triangles, query) < 1
        done.append(query)
    assert sent == [0, 2, 3]


def test_triangles_that_a_tree_was_built_from_are_those_of_the_receivers(device, monkeypatch):
    camera, tracer = at.Camera((0, 2, 9), (0, -0.5, 0), width=9, height=7), DeviceTracer(device)
    triangles, query = query_of(soup_scene(7), camera, LIGHTS["quad"], 4)
    expected, bits = new_bits(query), new_bits(query)
    tracer.trace_shadow(tracer.tree(lbvh.build(triangles.vertices)), query, expected, 2)
    tree = tracer.build(triangles.vertices)
    monkeypatch.setattr(DeviceLaunches, "sent_triangles", None)
    tracer.trace_shadow(tree, query, bits, 2)
    np.testing.assert_array_equal(bits, expected)
    assert bits.any()


def test_triangles_of_a_view_with_gaps_are_sent_each_time(device):
    launches, corners = DeviceTracer(device).launches, np.arange(180, dtype=np.float32).reshape(20, 9)
    for part in corners[:10], corners[::2], corners[:10], corners[10:], corners[::2]:
        assert launches.kept_triangles(part)
        found = launches.block("triangles of the scene", 0, "").read(np.empty((10, 9), np.float32))
        np.testing.assert_array_equal(found, part)
