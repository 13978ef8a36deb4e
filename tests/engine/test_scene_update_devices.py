"""Updates from arrays on the device that traces: the bits of those from the host, without a way through it."""

import pickle

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.engine.engine import Engine
from antumbra.scene.resident_triangles import ResidentTriangles
from cutout_scenes import scene_with_cutouts
from devices import device_plans, on_device_of
from truths import soup_scene

PLANS = device_plans(text=True)
BUILT = pytest.mark.parametrize("plan", [plan for plan in PLANS if plan.values[0].startswith("lbvh")])
LAMP = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
CAMERA = at.Camera((0, 2, 9), (0, -0.5, 0), width=24, height=16)


def mesh_scene(seed=1):
    """A scene of indexed faces, and its vertices."""
    rng = np.random.default_rng(seed)
    points, faces = rng.normal(0, 2, (200, 3)), rng.integers(0, 200, (300, 3))
    return at.Scene.from_arrays(points, faces), points


def rays_in(scene, n=200, seed=1):
    low, high = np.asarray(scene.bounds)
    return low + np.random.default_rng(seed).random((2, n, 3)) * (high - low)


def answers(engine, scene):
    origins, targets = rays_in(scene)
    hit = engine.closest_hit(origins, targets - origins)
    return [engine.occluded(origins, targets=targets), hit.face, hit.t, hit.u, hit.v]


def moves(points, dtype, seed=2):
    rng = np.random.default_rng(seed)
    for amount in 0.01, 0.01, 3.0:
        points = (points + rng.normal(0, amount, points.shape)).astype(dtype)
        points.reshape(-1, 3)[:2] = points.reshape(-1, 3)[2]  # a triangle without area
        yield points


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("indexed", [False, True], ids=["corners", "mesh"])
def test_an_update_on_the_device_has_the_bits_of_one_on_the_host(plan, dtype, indexed):
    (scene, points), other = mesh_scene(), mesh_scene()[0]
    if not indexed:
        points = scene.triangles().vertices + scene.origin
    engine = Engine(scene, plan)
    for moved in moves(points, dtype):
        engine.update(on_device_of(engine, moved))
        other.update(moved)
        assert isinstance(scene.data.moved, ResidentTriangles)
        for ours, theirs in zip(answers(engine, other), answers(other, other)):
            np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(scene.bounds, other.bounds)
        ours, theirs = scene.triangles(), other.triangles()
        for name in ("vertices", "solid", "face_id", "origin"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert ours.solid is not None


@BUILT
def test_rays_on_the_device_never_bring_the_vertices_to_the_host(plan, monkeypatch):
    (scene, points), other = mesh_scene(), mesh_scene()[0]
    engine, (origins, targets) = Engine(scene, plan), rays_in(scene)
    with monkeypatch.context() as without:
        without.setattr(ResidentTriangles, "vertices", property(lambda self: pytest.fail("fetched")))
        for moved in moves(points, np.float32):
            engine.update(on_device_of(engine, moved))
            other.update(moved)
            blocked = engine.occluded(on_device_of(engine, origins), targets=on_device_of(engine, targets)).numpy()
            np.testing.assert_array_equal(blocked, other.occluded(origins, targets=targets))
            face = engine.closest_hit(on_device_of(engine, origins), on_device_of(engine, targets - origins)).face
            np.testing.assert_array_equal(face.numpy(), other.closest_hit(origins, targets - origins).face)
            assert 0 < blocked.mean() < 1
    np.testing.assert_array_equal(
        engine.closest_hit(*rays_in(scene)).position, other.closest_hit(*rays_in(scene)).position
    )


@pytest.mark.parametrize("plan", PLANS)
def test_pictures_points_and_pickles_read_the_vertices_of_an_update_on_the_device(plan):
    (scene, points), other = mesh_scene(), mesh_scene()[0]
    renderer, receivers = at.Renderer(scene, plan=plan), at.Receivers.in_space(rays_in(scene)[0], scene.origin)
    for moved in moves(points, np.float64):
        renderer.engine.update(on_device_of(renderer.engine, moved))
        other.update(moved)
        expected = at.render(other, CAMERA, LAMP, spp=4, plan="bsah+single")
        np.testing.assert_array_equal(renderer.render(CAMERA, LAMP, spp=4).bits[0], expected.bits[0])
        bits = [each.visibility(receivers, LAMP, spp=4).bits for each in (renderer.engine, Engine(other))]
        np.testing.assert_array_equal(*bits)
    copy = pickle.loads(pickle.dumps(scene))
    np.testing.assert_array_equal(copy.triangles().vertices, other.triangles().vertices)
    np.testing.assert_array_equal(copy.closest_hit(*rays_in(scene)).t, other.closest_hit(*rays_in(other)).t)


@pytest.mark.parametrize("plan", PLANS)
def test_cut_outs_and_a_plan_of_the_cpu_follow_an_update_on_the_device(plan):
    scene, other = scene_with_cutouts(), scene_with_cutouts()
    engine, moved = Engine(scene, plan), scene.triangles().vertices + scene.origin + 0.25
    engine.update(on_device_of(engine, moved))
    other.update(moved)
    for each in engine, scene, engine.with_options("bsah+single", None, None):
        for ours, theirs in zip(answers(each, other), answers(other, other)):
            np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("plan", PLANS)
def test_a_transform_applies_to_the_vertices_that_a_device_gave(plan):
    whole = np.round(8 * soup_scene(3).triangles().vertices).astype(np.float32) / 8
    scene, other = at.Scene.from_arrays(whole), at.Scene.from_arrays(whole)
    engine, turned = Engine(scene, plan), np.array([[0.0, 0, 1, 3], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    moved = whole + np.float64(0.5)
    engine.update(on_device_of(engine, moved))
    other.update(moved)
    for each in scene, other:
        each.update(transform=turned)
    np.testing.assert_array_equal(scene.triangles().vertices, other.triangles().vertices)
    engine.update(on_device_of(engine, moved + 1e-13))
    with pytest.raises(InputError, match="came from a device, in more digits than its frame has; give the vertices"):
        scene.update(transform=turned)
    scene.update(moved)
    scene.update(transform=turned)
    np.testing.assert_array_equal(scene.triangles().vertices, other.triangles().vertices)


@pytest.mark.parametrize("plan", PLANS)
def test_vertices_that_a_scene_cannot_have_leave_it_as_it_was(plan):
    scene, points = mesh_scene()
    engine = Engine(scene, plan)
    expected, bad = answers(engine, scene), points.copy()
    bad[17, 1] = np.nan
    for array, message in (
        (points[:-1], r"vertices have shape \(199, 3\); give \(300, 3, 3\)"),
        (bad, r"NaN or infinity, or are over 1e\+18 units"),
        (points.astype(np.int64), "int64; on a device it must be float32 or float64"),
    ):
        with pytest.raises(InputError, match=message):
            engine.update(on_device_of(engine, array))
    for ours, theirs in zip(answers(engine, scene), expected):
        np.testing.assert_array_equal(ours, theirs)
    assert scene.data.moved is None
    with pytest.raises(InputError, match="either vertices, or a transform"):
        engine.update(on_device_of(engine, points), transform=np.eye(4))


@BUILT
@pytest.mark.parametrize("cull", ["", "grid32+"], ids=["all", "culled"])
def test_points_are_answered_without_fetching_vertices(plan, cull):
    (scene, points), other = mesh_scene(), mesh_scene()[0]
    engine, rng = Engine(scene, cull + plan), np.random.default_rng(4)
    moved = next(moves(points, np.float64))
    engine.update(on_device_of(engine, moved))
    other.update(moved)
    receivers = at.Receivers.in_space(rng.uniform(*scene.bounds, (40, 3)), scene.origin)
    ours, theirs = (each.visibility(receivers, [LAMP], spp=4) for each in (engine, Engine(other, "bsah+single")))
    np.testing.assert_array_equal(ours.bits, theirs.bits)
    assert 0 < ours.bits.astype(bool).mean() < 1
    assert "_fetched" not in vars(scene.triangles())
