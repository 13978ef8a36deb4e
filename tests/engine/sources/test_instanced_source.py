"""Scenes of instances give the answers of the flattened scene, bit by bit."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.engine.sources.in_memory_source import InMemory
from antumbra.engine.sources.instanced_source import Instanced
from instance_scenes import blob, block, both, random_scenes, random_transforms, rays_to_corners, whole_scenes
from strength import examples

SCENES = {
    "random": random_scenes,
    "far": lambda: random_scenes(3, 5e6),
    "whole": whole_scenes,
    "one copy": lambda: both([block()], [np.eye(4)[None]]),
    "flat mesh": lambda: both([(block()[0] * (1.0, 0.0, 1.0), block()[1])], [random_transforms(7, 5)]),
}


@pytest.fixture(scope="module", params=SCENES)
def scenes(request):
    """(instances, flattened)."""
    return SCENES[request.param]()


def _same(hit, other):
    for name in ("face", "t", "u", "v"):
        np.testing.assert_array_equal(getattr(hit, name), getattr(other, name))


def test_instances_are_traced_and_not_flattened(scenes):
    inside, flat = scenes
    assert isinstance(inside.engine.source, Instanced) and isinstance(flat.engine.source, InMemory)
    assert "_flat" not in vars(inside.data)
    for name in ("bounds", "origin"):
        np.testing.assert_array_equal(getattr(inside, name), getattr(flat, name))
    assert inside.n_triangles == flat.n_triangles and inside.objects == flat.objects and inside.meshes == flat.meshes


@pytest.mark.parametrize("facing", [None, "front", "back"])
def test_rays_meet_what_they_meet_flattened(scenes, facing):
    inside, flat = scenes
    origins, directions = rays_to_corners(inside, flat, 3000, 1)
    rng = np.random.default_rng(2)
    n = len(origins)
    skip = rng.integers(-1, flat.n_triangles, n)
    tmin, tmax = rng.choice([0.0, 0.0, 0.2], n), rng.choice([0.9, 1.0, 2.0, np.inf], n)
    rays = origins, directions, tmin, tmax, skip
    truth = flat.occluded(*rays, cull_faces=facing)
    assert 0.02 < truth.mean() < 0.98
    np.testing.assert_array_equal(inside.occluded(*rays, cull_faces=facing), truth)
    hit, other = (scene.closest_hit(*rays, cull_faces=facing) for scene in (inside, flat))
    _same(hit, other)
    np.testing.assert_array_equal(hit.corners, other.corners)
    np.testing.assert_array_equal(hit.object, other.object)
    assert (hit.face >= 0).any()


@pytest.mark.parametrize("facing", [None, "front", "back"])
def test_segments_are_blocked_as_if_flattened(scenes, facing):
    inside, flat = scenes
    origins, directions = rays_to_corners(inside, flat, 2000, 3)
    targets = origins + directions * np.random.default_rng(4).choice([0.5, 1.0, 1.5], (len(origins), 1))
    truth = flat.occluded(origins, targets=targets, cull_faces=facing)
    assert 0.02 < truth.mean() < 0.98
    np.testing.assert_array_equal(inside.occluded(origins, targets=targets, cull_faces=facing), truth)


def test_next_hits_visit_all_distances(scenes):
    """Hits at the same t are found once, by the lowest face."""
    inside, flat = scenes
    origins, directions = rays_to_corners(inside, flat, 200, 5)
    t, further = np.zeros(len(origins)), 0
    for _ in range(6):
        hit, other = (scene.closest_hit(origins, directions, tmin=t) for scene in (inside, flat))
        _same(hit, other)
        further += hit.mask.sum()
        t = np.where(hit.mask, hit.t, t)
    assert further > 40


@pytest.mark.parametrize("kind", ["random", "whole"])
def test_rays_equal_the_oracle(kind):
    inside, flat = SCENES[kind]()
    vertices = flat.triangles().vertices
    origins, directions = rays_to_corners(inside, flat, 150, 6)
    local = (origins - inside.origin).astype(np.float32)
    skip = np.random.default_rng(7).integers(-1, len(vertices), len(origins))
    blocked = inside.occluded(origins, directions, 0.1, 1.5, skip)
    np.testing.assert_array_equal(blocked, oracle.occluded(vertices, local, directions, tmin=0.1, tmax=1.5, skip=skip))
    hit = inside.closest_hit(origins, directions, 0.1, 1.5, skip)
    t, face = oracle.closest_hit(vertices, local, directions, 0.1, 1.5, skip)
    np.testing.assert_array_equal(hit.t, t)
    np.testing.assert_array_equal(hit.face, face)
    assert 0 < blocked.mean() < 1


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-12, 1e-3, 1.0, 1e4, 1e6]), st.sampled_from([0.0, 1.0, 1e6]))
@examples(25)
def test_any_transforms_at_any_scale(seed, scale, offset):
    """Also nearly flat transforms, and meshes far from their origin."""
    rng = np.random.default_rng([seed, 1])
    vertices, faces = blob(20, seed)
    transforms = random_transforms(6, seed)
    transforms[0, 2, :3] = transforms[0, 1, :3] * (1.0 + 1e-9) + 1e-7 * rng.normal(size=3)
    transforms[1, :, :3] *= 1e-4
    transforms[:, :, 3] += rng.normal(size=3) * offset
    inside, flat = both(
        [((vertices + offset) * scale, faces), block()], [transforms * scale**0.5, transforms[:2] * scale]
    )
    origins, directions = rays_to_corners(inside, flat, 300, seed)
    hit, other = (scene.closest_hit(origins, directions) for scene in (inside, flat))
    _same(hit, other)
    np.testing.assert_array_equal(
        inside.occluded(origins, directions, tmax=1.0), flat.occluded(origins, directions, tmax=1.0)
    )


def _bundles(scene, flat, n, seed):
    """(origins, directions): 64 rays at a time that run close together, many of them to corners and edges."""
    origins, directions = rays_to_corners(scene, flat, n, seed)
    rng, size = np.random.default_rng(seed), np.abs(directions).max(1, keepdims=True)
    lead = np.arange(n) // 64 * 64
    near = origins[lead] + 0.003 * np.ptp(scene.bounds, axis=0).max() * rng.normal(size=(n, 3))
    along = directions[lead] + 0.02 * size[lead] * rng.normal(size=(n, 3))
    near[::5] = origins[lead][::5]
    along[::5] = directions[lead][::5]
    local = (near - scene.origin).astype(np.float32)
    return local.astype(np.float64) + scene.origin, along.astype(np.float32)


@pytest.mark.parametrize("facing", [None, "front"])
def test_coherent_rays_meet_what_they_meet_flattened(scenes, facing):
    inside, flat = scenes
    origins, directions = _bundles(inside, flat, 64 * 60 + 7, 21)
    rng, n = np.random.default_rng(3), len(origins)
    rays = origins, directions, rng.choice([0.0, 0.3], n), rng.choice([1.0, np.inf], n), rng.integers(-1, 12, n)
    hit, other = (scene.closest_hit(*rays, cull_faces=facing) for scene in (inside, flat))
    _same(hit, other)
    truth = flat.occluded(*rays, cull_faces=facing)
    np.testing.assert_array_equal(inside.occluded(*rays, cull_faces=facing), truth)
    assert 0.02 < truth.mean() < 0.98
    towards = np.repeat(origins[::64], 64, 0)[:n]
    blocked = [scene.occluded(origins + directions, targets=towards, cull_faces=facing) for scene in (inside, flat)]
    np.testing.assert_array_equal(*blocked)
    assert 0.02 < blocked[0].mean() < 0.98


def test_lengths_of_directions_do_not_matter():
    inside, flat = random_scenes(11)
    origins, directions = rays_to_corners(inside, flat, 500, 8)
    for length in 1e-30, 1e-12, 1e12, 1e30:
        rays = origins, (directions * length).astype(np.float32)
        _same(inside.closest_hit(*rays), flat.closest_hit(*rays))
    for length in 1e-11, 1e11:  # close to the limits of float32 tests
        origins, directions = _bundles(inside, flat, 640, 22)
        rays = origins, (directions * length).astype(np.float32)
        _same(inside.closest_hit(*rays), flat.closest_hit(*rays))


def test_rays_from_far_away():
    inside, flat = random_scenes(12)
    origins, directions = rays_to_corners(inside, flat, 500, 9)
    away = origins - 1e5 * directions
    hit, other = (scene.closest_hit(away, directions) for scene in (inside, flat))
    _same(hit, other)
    assert hit.mask.mean() > 0.05


# --- Pictures, points and plans ---------------------------------------------------------------------------------------


def _grove():
    """(instances, flattened) of boxes on a ground, under light."""
    ground = np.array([[-9.0, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]]), np.array([[0, 2, 1], [0, 3, 2]])
    transforms = random_transforms(14, 20, 6.0)
    transforms[:, :, :3] *= 0.3
    transforms[:, 1, 3] = 1.5
    return both(
        [ground, block(), blob(30, 2)], [np.eye(4)[None], transforms[:8], transforms[8:]], [None, (0.9, 0.2, 0.1), None]
    )


CAMERA = at.Camera((4, 6, 14), (0, 0.5, 0), width=64, height=48)
LIGHTS = [at.DirectionalLight((0.4, -1, 0.3)), at.QuadLight((-2, 8, -2), (2, 0, 0), (0, 0, 2)), at.Sky()]


def _equal_frames(frame, other):
    for name in ("position", "normal", "face", "depth", "side"):
        np.testing.assert_array_equal(getattr(frame.gbuffer, name), getattr(other.gbuffer, name))
    for a, b in zip(frame.bits, other.bits, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(frame.image, other.image)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"adaptive": 16, "ground": True},
        {"bounce": 2, "filter": True},
        {"antialias": True, "layers": True, "cull_faces": "back"},
    ],
    ids=str,
)
def test_pictures_are_those_of_the_flattened_scene(options):
    inside, flat = _grove()
    frame, other = (at.render(scene, CAMERA, LIGHTS, spp=4, threads=2, **options) for scene in (inside, flat))
    _equal_frames(frame, other)
    assert frame.plan == "bsah+wide" and (frame.gbuffer.face >= 0).mean() > 0.1
    assert all(0.0 < v.mean() < 1.0 for v in frame.visibility)


def test_pictures_by_cameras_with_other_projections():
    inside, flat = _grove()
    for kind in "orthographic", "panoramic":
        camera = flat.default_camera(40, 30, kind)
        _equal_frames(*(at.render(scene, camera, LIGHTS[:1], spp=1, threads=2) for scene in (inside, flat)))


def test_rows_of_a_picture():
    from antumbra.picture.renderer import Renderer

    inside, flat = _grove()
    parts = []
    for scene in inside, flat:
        renderer = Renderer(scene, threads=2)
        bands = renderer.rows(renderer.request(CAMERA, LIGHTS[:2], at.RenderOptions(spp=2, adaptive=16)))
        parts.append([bands.band(first, first + 24) for first in (24, 0)])
    for band, other in zip(*parts):
        assert band.keys() == other.keys()
        for name in band:
            np.testing.assert_array_equal(band[name], other[name])


def test_points_see_lights_as_if_flattened():
    inside, flat = _grove()
    points = np.random.default_rng(3).uniform((-6, 0.1, -6), (6, 3, 6), (500, 3))
    seen = [at.visibility(scene, points, LIGHTS, (0.0, 1.0, 0.0), spp=8) for scene in (inside, flat)]
    np.testing.assert_array_equal(seen[0].bits, seen[1].bits)
    assert 0.05 < seen[0].fraction.mean() < 0.95


def test_a_plan_that_cannot_trace_instances_flattens_them():
    inside, flat = _grove()
    one = at.render(inside, CAMERA, LIGHTS, spp=2, plan="bsah+multifrusta")
    _equal_frames(one, at.render(flat, CAMERA, LIGHTS, spp=2))
    assert isinstance(at.Engine(inside, "auto").source, InMemory)
    assert isinstance(at.Engine(inside, "sweep-sah+reinsert+wide").source, Instanced)
    np.testing.assert_array_equal(inside.triangles().vertices, flat.triangles().vertices)
    np.testing.assert_array_equal(inside.colours, flat.colours)


def test_other_builders_of_the_trees_of_meshes():
    inside, flat = random_scenes(30)
    origins, directions = rays_to_corners(inside, flat, 500, 9)
    truth = flat.closest_hit(origins, directions)
    for plan in "lbvh+wide", "sweep-sah+reinsert+wide":
        _same(at.Engine(inside, plan).closest_hit(origins, directions), truth)


def test_a_plan_says_when_it_would_need_too_much_memory(monkeypatch):
    inside, _ = random_scenes(31)
    monkeypatch.setattr("antumbra.scene.instance_data._machine_memory", lambda: 1000)
    with pytest.raises(at.InputError, match=r"triangles with all copies take about .*plan bsah\+wide"):
        at.Engine(inside, "bsah+single")
    with pytest.raises(at.InputError, match="with all copies"):
        inside.triangles()


def test_copies_take_no_memory():
    vertices, faces = blob(4000, 1)
    transforms = random_transforms(5000, 2, 1000.0)
    tracemalloc.start()
    try:
        scene = at.Scene.from_instances([(vertices, faces)], [transforms])
        hit = scene.closest_hit(scene.bounds.mean(0), np.random.default_rng(1).normal(size=(100, 3)))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert scene.n_triangles == 20_000_000 and hit.mask.any()
    assert peak < 40e6, "the corners alone of all copies take 720 MB"


# --- All hits ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("max_hits", [None, 2])
def test_all_hits_are_those_of_the_flattened_scene(scenes, max_hits):
    inside, flat = scenes
    origins, directions = rays_to_corners(inside, flat, 600, 13)
    skip = np.random.default_rng(1).integers(-1, flat.n_triangles, len(origins))
    options = {"tmin": 0.1, "skip_face": skip, "max_hits": max_hits, "cull_faces": "front"}
    hits, other = (scene.all_hits(origins, directions, **options) for scene in (inside, flat))
    for name in ("ray_offsets", "t", "face", "u", "v"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(other, name))
    assert len(hits.t) > 50


@pytest.mark.parametrize("merge", ["none", "surface"])
def test_counts_are_those_of_the_flattened_scene(scenes, merge):
    inside, flat = scenes
    origins, directions = rays_to_corners(inside, flat, 600, 14)
    counts, other = (scene.count_hits(origins, directions, merge=merge) for scene in (inside, flat))
    np.testing.assert_array_equal(counts, other)
    assert counts.max() > 1


def test_points_are_inside_as_if_flattened():
    inside, flat = whole_scenes(3)
    points = np.random.default_rng(2).uniform(*flat.bounds, (800, 3))
    points[::3] = np.round(points[::3])
    truth = flat.contains(points)
    np.testing.assert_array_equal(inside.contains(points), truth)
    assert 0.02 < truth.mean() < 0.98


# --- Unusual scenes ---------------------------------------------------------------------------------------------------


def test_meshes_without_copies_and_single_triangles():
    triangle = np.array([[[0.0, 0, 0], [2, 0, 0], [0, 2, 0]]])
    inside, flat = both([block(), triangle], [np.zeros((0, 4, 4)), np.eye(4)[None]])
    assert inside.n_triangles == 1 and len(inside.objects) == 1
    origins, directions = rays_to_corners(inside, flat, 100, 1)
    hit, other = (scene.closest_hit(origins, directions) for scene in (inside, flat))
    _same(hit, other)
    assert hit.mask.any()


def test_copies_that_coincide():
    """The lowest face wins everywhere, and no stack overflows."""
    inside, flat = both([block()], [np.repeat(random_transforms(1, 4), 700, 0)])
    origins, directions = rays_to_corners(inside, flat, 300, 2)
    hit, other = (scene.closest_hit(origins, directions) for scene in (inside, flat))
    _same(hit, other)
    assert hit.mask.any() and hit.face.max() < 12
    np.testing.assert_array_equal(inside.occluded(origins, directions), flat.occluded(origins, directions))


def test_meshes_that_lie_on_a_point_or_a_line():
    """A copy of a triangle without area may have an area, since its corners are rounded."""
    point, line = np.ones((3, 3, 3)), np.linspace(0, 1, 9).reshape(3, 3, 1) * np.ones(3)
    transforms = [random_transforms(3, 5), random_transforms(3, 6), random_transforms(3, 7)]
    inside, flat = both([point, line, block()], transforms)
    origins, directions = rays_to_corners(inside, flat, 500, 3)
    hit, other = (scene.closest_hit(origins, directions) for scene in (inside, flat))
    _same(hit, other)
    slivers = np.isin(hit.face, np.arange(9, 18)) & (np.arange(len(origins)) % 7 != 0)
    assert (hit.face[hit.mask] >= 9).all() and slivers.any()


def test_rays_that_are_refused():
    inside, _ = random_scenes(40)
    for origins, directions, error in (
        (np.full((3, 3), np.nan), np.ones(3), "origins hold NaN or infinity"),
        (np.zeros((3, 3)), np.zeros(3), "direction of ray 0 is zero"),
    ):
        with pytest.raises(at.InputError, match=error):
            inside.occluded(origins, directions)
        with pytest.raises(at.InputError, match=error):
            inside.all_hits(origins, directions)
    assert inside.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert not inside.occluded(np.zeros(3), targets=np.zeros(3))
