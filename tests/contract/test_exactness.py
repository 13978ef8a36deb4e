"""Every plan against the brute-force oracle: not one bit may differ."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import Plan, covering_plans, parse_plan
from antumbra.generate.procedural_scenes import PROCEDURAL
from asking import answer, query_of
from devices import device_plans
from truths import LIGHTS, SIZE, asked_of, case_of, soup_scene

PLANS = covering_plans()
TRACING = [
    *(p for p in PLANS if p == Plan(trace=p.trace)),  # with the default tree; tests/lab/papers tests the others
    *device_plans(),
    pytest.param(parse_plan("bsah+multifrusta+device:opencl"), marks=pytest.mark.device("opencl")),
]
LIT = TRACING + [
    p for p in PLANS if p.cull == "grid32"
]  # methods that depend on lights; tests/techniques/culling tests all cullers


@pytest.fixture(scope="module", params=["soup", *PROCEDURAL])
def case(request):
    return case_of(request.param, SIZE)


@pytest.fixture(scope="module", params=["soup", "cellar"])
def small_case(request):
    return case_of(request.param, (48, 34))


@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_no_bit_differs_from_the_oracle(case, plan):
    triangles, query, truth = case
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("plan", [p for p in PLANS if p not in TRACING], ids=str)
def test_no_bit_differs_by_other_builders_cullers_and_orders(small_case, plan):
    triangles, query, truth = small_case
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("plan", LIT, ids=str)
def test_every_light_shape(plan, name):
    triangles, query, truth, active = asked_of(7, (24, 20), LIGHTS[name], 5)
    assert truth[active].any() and (name == "light in the floor's plane" or not truth[active].all())
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("spp", [1, 3, 64, 65, 130])
@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_every_number_of_samples(plan, spp):
    triangles, query, truth, active = asked_of(9, (12, 9), LIGHTS["quad"], spp)
    assert truth[active].any() and not truth[active].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("spp", [5, 21])
@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_few_samples_of_receivers_that_lie_apart(plan, spp):
    """A chunk of at most 8 samples at silhouettes, with receivers in the neighbours on all sides."""
    triangles, query, truth, active = asked_of(3, (24, 20), LIGHTS["quad"], spp)
    assert truth[active].any() and not truth[active].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("plan", LIT, ids=str)
def test_scales(plan, scale):
    triangles, query, truth, active = asked_of(11, (24, 20), None, 8, scale)
    assert truth[active].any() and not truth[active].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("plan", LIT, ids=str)
def test_threads_and_tiles_do_not_matter(plan):
    triangles, query = query_of(
        soup_scene(13), at.Camera((0, 2, 9), (0, -0.5, 0), width=45, height=37), LIGHTS["quad"], 4
    )
    one = answer(plan, triangles, query, threads=1)
    np.testing.assert_array_equal(answer(plan, triangles, query, threads=3), one)


@pytest.mark.parametrize("plan", LIT, ids=str)
def test_an_offset_of_a_map_grid_changes_no_bit(plan):
    """UTM-sized coordinates, which float64 can shift exactly, give the bits of the centred scene."""
    soup = np.round(soup_scene(15).triangles().vertices.astype(np.float64) * 2**20) / 2**20
    images = []
    for offset in (np.zeros(3), np.array([5e6, 120.0, 4.5e5])):
        scene = at.Scene.from_arrays(soup + offset)
        camera = at.Camera(np.array([0, 2.0, 9]) + offset, np.array([0, -0.5, 0]) + offset, width=40, height=30)
        light = at.QuadLight(np.array([-1.0, 6, -1]) + offset, (2, 0, 0), (0, 0, 2))
        images.append(at.render(scene, camera, light, spp=16, plan=plan).bits[0])
    np.testing.assert_array_equal(images[0], images[1])
    assert images[0].any()


@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_receivers_blockers_and_light_in_one_plane(plan):
    """Float32 can decide none of these rays, so exact arithmetic decides all at once."""
    rng = np.random.default_rng(17)
    x, z = (a.ravel() for a in np.meshgrid(np.arange(24.0), np.arange(24.0)))
    floor = np.stack([x, 0 * x, z], 1)[:, None] + [[0, 0, 0], [1, 0, 0], [0, 0, 1]]
    wall = np.array([[[12.0, -1, -9], [12, -1, 9], [12, 2, 0]]])
    scene = at.Scene.from_arrays(np.concatenate([floor, wall]))
    points = rng.uniform(0, 10, (500, 3)) * (1, 0, 1)
    light = at.QuadLight((20, 0, 4), (3, 0, 0), (0, 0, 3))
    ours, plain = (at.visibility(scene, points, light, spp=16, plan=p).bits for p in (plan, "bsah+single"))
    np.testing.assert_array_equal(ours, plain)
    assert 0 < np.bitwise_count(ours).sum() < 500 * 16
