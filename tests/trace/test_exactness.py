"""Every plan against the brute-force oracle: not one bit may differ."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
from antumbra.plan import Plan, covering_plans
from antumbra.scene.procedural import PROCEDURAL
from asking import answer, query_of, true_occlusion

PLANS = covering_plans()
FAMILIES = "single:", "cones:"  # orders and options; their own tests, and those of other plans below, have them all
FOR_ALL = "cones:SpheresSorted", "cones:PreciseSEATP"
TRACING = [
    p for p in PLANS if p == Plan(trace=p.trace) and (p.trace in FOR_ALL or not p.trace.startswith(FAMILIES))
]  # over the default tree
LIT = TRACING + [p for p in PLANS if p.cull == "grid32"]  # what looks at lights; tests/cull does so for all cullers
TRIANGLES = 3000
SIZE = (96, 68)  # pixels: with 16 samples more than 100 000 rays


def _soup(seed=3):
    rng = np.random.default_rng(seed)
    n = TRIANGLES
    soup = rng.normal(size=(n, 1, 3)) * (2, 1, 2) + rng.normal(size=(n, 3, 3)) * 0.15
    soup[: n // 4] = np.round(soup[: n // 4] * 4) / 4
    floor = np.array([[[-9, -3, -9], [-9, -3, 9], [9, -3, 9]], [[-9, -3, -9], [9, -3, 9], [9, -3, -9]]])
    return at.Scene.from_arrays(np.concatenate([soup, floor]), name="soup")


def _case(name, size):
    if name == "soup":
        scene = _soup()
        return scene, at.Camera((0, 2, 9), (0, -0.5, 0), width=size[0], height=size[1]), None
    scene = at.procedural(name, triangles=TRIANGLES)
    return scene, scene.cameras[0].resized(*size), scene.lights[0]


def _with_truth(name, size):
    scene, camera, light = _case(name, size)
    triangles, query = query_of(scene, camera, light or at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2)), 16)
    truth, asked = true_occlusion(triangles, query)
    print(f"{name}: {asked.sum()} rays, {truth[asked].mean():.1%} occluded")
    assert asked.sum() > 7 * size[0] * size[1]
    assert 0.02 < truth[asked].mean() < 0.98
    return triangles, query, truth


@pytest.fixture(scope="module", params=["soup", *PROCEDURAL])
def case(request):
    return _with_truth(request.param, SIZE)


@pytest.fixture(scope="module", params=["soup", "cellar"])
def small_case(request):
    return _with_truth(request.param, (48, 34))


@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_no_bit_differs_from_the_oracle(case, plan):
    triangles, query, truth = case
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("plan", [p for p in PLANS if p not in TRACING], ids=str)
def test_no_bit_differs_by_other_builders_cullers_and_orders(small_case, plan):
    triangles, query, truth = small_case
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


LIGHTS = {
    "point": at.PointLight((0.5, 5, 0.25)),
    "quad": at.QuadLight((-2, 5, -2), (4, 1, 0), (0, 0, 4)),
    "disk": at.DiskLight((0, 5, 1), (0.2, -1, 0), 1.5),
    "sphere": at.SphereLight((1, 5, 0), 1.0),
    "sphere around everything": at.SphereLight((0, 0, 0), 20.0),
    "sun": at.DirectionalLight((0.3, -1, 0.2)),
    "wide sun": at.DirectionalLight((0.3, -1, 0.2), angular_diameter=60),
    "parallel sun": at.DirectionalLight((0, -1, 0), angular_diameter=0),
    "light inside the geometry": at.QuadLight((-1, -0.5, -1), (2, 0, 0), (0, 0, 2)),
    "ambient": at.AmbientOcclusion(),
    "ambient nearby": at.AmbientOcclusion(0.5, spp=7),
    "list": at.PointLights(np.random.default_rng(1).uniform((-3, 1, -3), (3, 5, 3), (9, 3))),
    "interleaved list": at.PointLights(np.random.default_rng(1).uniform(-3, 5, (37, 3)), interleave=True),
    "light in the floor's plane": at.QuadLight((-1, -3, -1), (2, 0, 0), (0, 0, 2)),
}


@cache
def _asked(seed, size, light, spp, scale=1.0):
    """(triangles, query, truth, asked) of a soup: the oracle answers once, for all plans."""
    scene = _soup(seed)
    if scale != 1.0:
        scene = at.Scene.from_arrays(scene.triangles().vertices.astype(np.float64) * scale)
        light = at.QuadLight((-scale, 6 * scale, -scale), (2 * scale, 0, 0), (0, 0, 2 * scale))
    camera = at.Camera((0, 2 * scale, 9 * scale), (0, -0.5 * scale, 0), width=size[0], height=size[1])
    triangles, query = query_of(scene, camera, light, spp)
    return triangles, query, *true_occlusion(triangles, query)


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("plan", LIT, ids=str)
def test_every_light_shape(plan, name):
    triangles, query, truth, asked = _asked(7, (24, 20), LIGHTS[name], 5)
    assert truth[asked].any() and (name == "light in the floor's plane" or not truth[asked].all())
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("spp", [1, 3, 64, 65, 130])
@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_every_number_of_samples(plan, spp):
    triangles, query, truth, asked = _asked(9, (12, 9), LIGHTS["quad"], spp)
    assert truth[asked].any() and not truth[asked].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("spp", [5, 21])
@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_few_samples_of_receivers_that_lie_apart(plan, spp):
    """A chunk of at most 8 samples at silhouettes, with neighbours on all sides that hold receivers."""
    triangles, query, truth, asked = _asked(3, (24, 20), LIGHTS["quad"], spp)
    assert truth[asked].any() and not truth[asked].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6])
@pytest.mark.parametrize("plan", LIT, ids=str)
def test_scales(plan, scale):
    triangles, query, truth, asked = _asked(11, (24, 20), None, 8, scale)
    assert truth[asked].any() and not truth[asked].all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


@pytest.mark.parametrize("plan", LIT, ids=str)
def test_threads_and_tiles_do_not_matter(plan):
    triangles, query = query_of(_soup(13), at.Camera((0, 2, 9), (0, -0.5, 0), width=45, height=37), LIGHTS["quad"], 4)
    one = answer(plan, triangles, query, threads=1)
    np.testing.assert_array_equal(answer(plan, triangles, query, threads=3), one)


@pytest.mark.parametrize("plan", LIT, ids=str)
def test_an_offset_of_a_map_grid_changes_no_bit(plan):
    """UTM-sized coordinates: the same bits as the centred scene (coordinates that float64 can shift exactly)."""
    soup = np.round(_soup(15).triangles().vertices.astype(np.float64) * 2**20) / 2**20
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
    """Float32 can say nothing about any of them: all is left to exact arithmetic, at once."""
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
