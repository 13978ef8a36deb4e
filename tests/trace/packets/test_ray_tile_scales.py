"""Coordinates of all magnitudes. Squares of 1e20 and cubes of 1e13 exceed float32, and yet no bit may differ."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import Plan, covering_plans
from antumbra.query.shadow_query import segments
from antumbra.trace.packets.ray_tile import is_far
from asking import answer, true_occlusion
from beam_scenes import lit

FAMILIES = "single:", "cones:"  # orders and options, with the formulas of other methods
PLANS = [
    plan
    for plan in covering_plans()
    if plan == Plan(trace=plan.trace)
    and (not plan.trace.startswith(FAMILIES) or plan.trace in ("cones:SpheresSorted", "cones:PreciseSEATP"))
]

LIGHTS = {
    "point": lambda k: at.PointLight(np.array([0.3, 2.5, -0.4]) * k),
    "quad": lambda k: at.QuadLight(*np.array([[-0.5, 2.0, 0.1], [1, 0.2, 0], [0, 0.1, 1]]) * k),
    "sphere": lambda k: at.SphereLight(np.array([1.5, 2.0, 1.0]) * k, 0.4 * k),
    "list": lambda k: at.PointLights(np.random.default_rng(3).normal(size=(5, 3)) * k + np.array([0, 3.0, 0]) * k),
    "ambient": lambda k: at.AmbientOcclusion(1.5 * k),
}


def _scene(scale):
    """(scene, points, normals of the points): small and large triangles, scattered and clustered points."""
    rng = np.random.default_rng(292)
    size = 10.0 ** rng.uniform(-2.5, 0.3, (60, 1, 1))
    soup = rng.normal(size=(60, 1, 3)) * (1, 0.3, 1) + rng.normal(size=(60, 3, 3)) * size
    middles = np.repeat(rng.normal(size=(8, 3)) * (1, 0.3, 1) - (0, 1, 0), 12, 0)
    points = middles + rng.normal(size=(96, 3)) * 10.0 ** rng.uniform(-6, 0, (96, 1))
    return at.Scene.from_arrays(soup * scale), points * scale, rng.normal(size=(96, 3))


@cache
def _ordinary_bits(name):
    scene, points, normals = _scene(1.0)
    bits = at.visibility(scene, points, LIGHTS[name](1.0), normals, spp=8, plan="bsah+single").bits
    assert 0.05 < np.bitwise_count(bits).sum() / (96 * 8) < 0.95
    return bits


@pytest.mark.parametrize("exponent", [-100, -66, -43, 38, 42, 50, 56])
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_a_power_of_two_changes_no_bit(plan, exponent):
    """It changes only the exponents of float32 numbers, so the query is the same. Scenes are 1e-30 to 5e17 wide."""
    scale = 2.0**exponent
    scene, points, normals = _scene(scale)
    for name, light in LIGHTS.items():
        bits = at.visibility(scene, points, light(scale), normals, spp=8, plan=plan).bits
        np.testing.assert_array_equal(bits, _ordinary_bits(name))


@pytest.mark.parametrize("distance", [1e9, 1e14, 1e19, 1e25, 1e36])
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_points_and_lights_that_are_far_from_an_ordinary_scene(plan, distance):
    bits = [at.visibility(*_far_away(distance), spp=8, plan=p).bits for p in (plan, "bsah+single")]
    np.testing.assert_array_equal(*bits)
    assert 0 < np.bitwise_count(bits[0]).sum() < 96 * 8


def _far_away(distance):
    """(scene, points, light). A triangle separates half of the points from the light."""
    scene, points, _ = _scene(1.0)
    wall = np.array([[[-9.0, -2, -9], [9, -2, -9], [0, -2, 9]]])
    soup = np.concatenate([scene.triangles().vertices + scene.origin, wall])
    points[::2] *= 3.0
    points[::2, 1] = -distance
    return at.Scene.from_arrays(soup), points, at.QuadLight((-1, distance, -1), (2, 0, 0), (0, 0, 2))


WRONG_BEFORE = [
    (0, "quad", "near and far", 1e10),
    (0, "sun", "a narrow cone", 1e10),
    (0, "interleaved list", "near and far", 1e10),
    (1, "sphere", "a plane", 1e10),
    (1, "ambient", "a wide cone", 1e10),
    (0, "point", "near and far", 1e13),
    (0, "quad", "a plane", 1e17),
    (0, "list", "at the light, and around", 1e17),
    (0, "list", "near and far", 1e-20),
    (1, "quad", "near and far", 1e-30),
]
"""Seeds, lights, receivers and scales of `beam_scenes.lit`. Several tracers had wrong bits in all but the last two."""


@cache
def _asked(seed, light, receivers, scale):
    triangles, query = lit(seed, light, receivers, scale)
    return triangles, query, true_occlusion(triangles, query)[0]


@pytest.mark.parametrize("case", WRONG_BEFORE, ids=str)
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_triangles_aimed_at_segments(plan, case):
    triangles, query, truth = _asked(*case)
    assert truth.any() and np.isfinite(segments(query)[0]).all()
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


def test_what_is_far():
    """`is_far` considers all coordinates of shafts: of triangles, of receivers, and of all samples of the light."""
    near, far = _asked(0, "quad", "a plane", 1e-20)[1], _asked(0, "quad", "a plane", 1e17)[1]
    box = np.array([[-1.0, -1, -1], [1, 1, 1]])
    assert not is_far(near, box) and is_far(near, 2.0**41 * box)
    assert is_far(far, box) and is_far(near._replace(origins=far.origins), box)
    assert is_far(near._replace(light=far.light), box) and is_far(near, np.nan * box)
