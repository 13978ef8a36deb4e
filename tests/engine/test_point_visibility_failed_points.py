"""A bad point or normal fails alone: its answer is marked, and all others are those of the same call without it."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import Plan, covering_plans

SCENE = at.procedural("atrium", triangles=2000)
RNG = np.random.default_rng(2)
POINTS = RNG.uniform(*SCENE.bounds, (40, 3))
NORMALS = RNG.normal(size=(40, 3))
LAMP = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
LISTS = [LAMP, at.DirectionalLights(RNG.normal((0, -1, 0), 0.4, (70, 3))), at.AmbientOcclusion()]
BAD = {"zero": (0, 0, 0), "NaN": (np.nan, 1, 0), "infinite": (0, np.inf, 0)}
PLANS = [p for p in covering_plans() if p == Plan(trace=p.trace)]


@pytest.mark.parametrize("normal", BAD)
@pytest.mark.parametrize("lights", [LAMP, LISTS], ids=["one light", "lights"])
def test_a_bad_normal_fails_its_point_alone(normal, lights):
    normals, good = NORMALS.copy(), np.arange(40) % 7 != 3
    normals[~good] = BAD[normal]
    found = at.visibility(SCENE, POINTS, lights, normals, spp=20)
    alone = at.visibility(SCENE, POINTS, lights, NORMALS, spp=20)
    for name in ("bits", "fraction", "seen", "seen_samples"):
        np.testing.assert_array_equal(getattr(found, name)[good], getattr(alone, name)[good], name)
    assert np.isnan(found.fraction[~good]).all() and not np.isnan(found.fraction[good]).any()
    assert not found.seen[~good].any() and not found.seen_samples[~good].any() and alone.seen[~good].any()
    assert np.array_equal(found.samples, alone.samples)


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_every_plan_marks_the_same_points(plan):
    points = POINTS.copy()
    points[[0, 5, 39]] = np.nan
    found, auto = (at.visibility(SCENE, points, LAMP, NORMALS, plan=each) for each in (plan, None))
    np.testing.assert_array_equal(found.bits, auto.bits)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(found.fraction)), [0, 5, 39])


def test_points_in_free_space_and_in_any_shape_fail_alone(tmp_path):
    points = POINTS.reshape(5, 8, 3).copy()
    points[2, 3, 1] = np.inf
    at.build_store(SCENE, tmp_path / "a.antumbra")
    for scene in (SCENE, at.load(tmp_path / "a.antumbra")):
        found = at.visibility(scene, points, LAMP)
        assert found.fraction.shape == (5, 8) and np.argwhere(np.isnan(found.fraction)).tolist() == [[2, 3]]


def test_a_colour_of_a_failed_point_is_nan():
    scene = at.Scene.from_arrays(SCENE.triangles().vertices)
    scene.set_transmittance({"*": (0.5, 0.25, 0.0)})
    points = POINTS.copy()
    points[4] = np.nan
    found = at.visibility(scene, points, LAMP)
    assert (
        found.colour is not None
        and np.isnan(found.colour[4]).all()
        and np.isfinite(np.delete(found.colour, 4, 0)).all()
    )


def test_calls_of_which_nothing_remains_are_refused():
    for points, normals, words in (
        (POINTS, (0, 0, 0), "is zero"), (POINTS * np.nan, None, "NaN or infinity"), (POINTS, NORMALS * np.nan, "NaN"),
        (POINTS, NORMALS[:7], "broadcast"),
    ):  # fmt: skip
        with pytest.raises(at.InputError, match=words):
            at.visibility(SCENE, points, LAMP, normals)
