"""Hard lights: with any number of equal samples, every plan and study finds what it finds with one, by one ray each."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.engine import Engine
from antumbra.engine.method_registry import find_method, own_methods
from antumbra.picture.frame_request import TimeSample
from antumbra.picture.renderer import Renderer
from antumbra.picture.traversal_steps import explain
from antumbra.query.light_samples import light_samples
from asking import query_of, true_occlusion, unpack
from cutout_scenes import scene_with_cutouts

POINT, SUN = at.PointLight((0, 7, 0)), at.DirectionalLight((0.3, -1, 0.2), 0.0)
SOFT = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))
LIGHTS = POINT, SOFT, SUN
ALL = np.uint64(0xFFFF)  # the bits of 16 samples
TRACERS = [*own_methods("trace"), "multifrusta:paper", "single:random", "cones:spheres"]
BUILDS = "lbvh", "srdh", "grid32+bsah", "bsah+srdh-order"


def _plan(tracer):
    return tracer if not find_method("trace", tracer)[1].builds or tracer == "auto" else f"bsah+{tracer}"


PLANS = [*map(_plan, TRACERS), *(f"{build}+packet16" for build in BUILDS)]


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


@pytest.fixture(scope="module")
def points(scene):
    rng = np.random.default_rng(0)
    return rng.uniform((-6, 0.1, -4), (6, 5, 4), (300, 3)), rng.normal(size=(300, 3))


def _camera(scene):
    return scene.cameras[0].resized(36, 28)


@pytest.fixture(scope="module")
def truth(scene):
    """Of POINT and SUN: (h, w) bool each, by brute force."""
    asked = [true_occlusion(*query_of(scene, _camera(scene), light, 1))[0][..., 0] for light in (POINT, SUN)]
    assert all(0 < each.sum() < each.size for each in asked)
    return asked


@pytest.mark.parametrize("plan", PLANS)
def test_every_plan_traces_one_ray_per_pixel_and_hard_light_beside_a_soft_one(scene, truth, plan):
    frame = at.render(scene, _camera(scene), LIGHTS, spp=16, plan=plan, counters=True)
    seen = int(frame.mask.sum())
    assert frame.rays == seen * (1 + 16 + 1) == frame.counters["rays"]
    for bits, blocked in zip(frame.bits[::2], truth):
        np.testing.assert_array_equal(bits[..., 0], np.where(blocked, ALL, np.uint64(0)))
    one = at.render(scene, _camera(scene), LIGHTS[::2], spp=1, plan=plan)
    for several, single in zip(frame.visibility[::2], one.visibility):
        np.testing.assert_array_equal(several, single)


OPTIONS = {
    "plain": {},
    "refined": {"adaptive": 64},
    "bounced": {"bounce": 2},
    "filtered": {"filter": True},
    "on a ground": {"ground": True},
    "in layers": {"layers": True},
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_pictures_are_the_same_with_any_number_of_equal_samples(scene, options):
    one, many = (at.render(scene, _camera(scene), [POINT, SUN], spp=spp, **options) for spp in (1, 16))
    np.testing.assert_array_equal(one.image, many.image)
    assert one.rays == many.rays > 0
    for few, copied in zip(one.bits, many.bits):
        np.testing.assert_array_equal(few * ALL, copied)


@pytest.mark.parametrize("spp", [16, 64, 130, 1024])
def test_points_answer_every_sample_of_a_hard_light(scene, points, spp):
    one, many = (at.visibility(scene, points[0], LIGHTS, points[1], spp=n) for n in (1, spp))
    assert many.bits.shape == (300, 3, -(-spp // 64))
    for k in (0, 2):
        np.testing.assert_array_equal(one.fraction[:, k], many.fraction[:, k])
        sees = unpack(many.bits[:, k], spp)
        np.testing.assert_array_equal(sees, np.broadcast_to(unpack(one.bits[:, k], 1), sees.shape))
        assert 0.0 < one.fraction[:, k].mean() < 1.0
    assert ((many.fraction[:, 1] > 0.0) & (many.fraction[:, 1] < 1.0)).any()


@pytest.mark.parametrize("what", ["shadow", "light", "sun"])
def test_bakes_are_the_same_and_say_how_many_rays_they_traced(scene, tmp_path, what):
    lights = [SUN] if what == "sun" else [POINT, SUN]
    made = [at.bake(scene, tmp_path / f"{spp}.glb", what, lights=lights, spp=spp, keep_hidden=True) for spp in (1, 16)]
    assert made[0].rays == made[1].rays == made[0].receivers * len(lights) > 0
    assert (tmp_path / "1.glb").read_bytes() == (tmp_path / "16.glb").read_bytes()


def test_data_sets_are_the_same(scene, tmp_path):
    for spp in (1, 16):
        at.dataset(scene, tmp_path / str(spp), [_camera(scene)], [POINT, SUN], spp=spp)
    files = {spp: sorted((tmp_path / spp).rglob("*.png")) for spp in ("1", "16")}
    assert files["1"] and [each.read_bytes() for each in files["1"]] == [each.read_bytes() for each in files["16"]]


@pytest.mark.parametrize("plan", ["auto", "bsah+single"])
def test_light_through_panes_is_the_same(plan):
    scene = scene_with_cutouts()
    rng = np.random.default_rng(0)
    points = rng.uniform((-3, -0.9, -3), (3, 2, 3), (400, 3))
    lights = [at.PointLight((0, 6, 0)), SUN]
    one, many = (at.visibility(scene, points, lights, spp=spp, plan=plan) for spp in (1, 16))
    np.testing.assert_array_equal(one.fraction, many.fraction)
    np.testing.assert_array_equal(one.bits * ALL, many.bits)
    assert 0 < (one.bits != 0).sum() < one.bits.size


def test_segments_known_to_be_blocked_stay_known(scene, points):
    receivers, samples = at.Receivers.of(*points, scene.origin), light_samples(POINT, 16)
    engine = Engine(scene, "bsah+single")
    (plain,) = engine.shadows(receivers, [POINT], [samples])
    known = plain.bits & np.uint64(1 << 3)  # one of the equal samples is known
    (again,) = engine.shadows(receivers, [POINT], [samples], known=[known])
    unknown = known == 0
    np.testing.assert_array_equal(again.bits[unknown], plain.bits[unknown])
    assert unknown.any() and not unknown.all()


def test_terrain_traces_equal_samples_once_too():
    rng = np.random.default_rng(0)
    scene = at.from_raster((10.0 * rng.random((20, 30)), (1.0, 0.0, 0.0, 0.0, -1.0, 20.0)))
    low, high = scene.bounds
    points = rng.uniform(low, high + (0, 0, 3), (200, 3))
    lights = [at.PointLight((15, 10, 14)), at.DirectionalLight((1, 0.5, -1), 0.0)]
    one, many, named = (
        at.visibility(scene, points, lights, spp=spp, plan=plan)
        for spp, plan in ((1, None), (16, None), (16, "bsah+single"))
    )
    np.testing.assert_array_equal(one.bits * ALL, many.bits)
    np.testing.assert_array_equal(named.bits, many.bits)
    assert 0 < (one.bits != 0).sum() < one.bits.size


def test_explanations_count_the_rays_that_are_traced(scene):
    moment = TimeSample(0.0, _camera(scene), [POINT, SUN])
    one, many = (explain(scene, [moment], ["bsah+single", "bsah+packet16"], spp=spp, threads=2) for spp in (1, 16))
    assert one.rays == many.rays > one.blocked == many.blocked > 0
    assert [each.box_tests for each in one.plans] == [each.box_tests for each in many.plans]


def test_the_default_plan_forecasts_and_chooses_as_for_one_sample(scene):
    one, many = (Renderer(scene).render(_camera(scene), [POINT, SUN], spp=spp) for spp in (1, 16))
    assert [choice.rays for choice in one.choices] == [choice.rays for choice in many.choices]
    assert one.tree == many.tree
