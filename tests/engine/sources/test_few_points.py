"""Few points: traced as rays, with the bits of shadow queries, and in few calls."""

import numpy as np
import pytest

import antumbra as at
import wasm_kernels
from antumbra.engine.sources.few_points import MOST_SEGMENTS, FewPoints
from python_calls import python_calls

SCENE = at.procedural("atrium", triangles=3000)
LOW, HIGH = SCENE.bounds
MIDDLE, RNG = (LOW + HIGH) / 2, np.random.default_rng(5)
POINTS, NORMALS = RNG.uniform(LOW, HIGH, (12, 3)), RNG.normal(size=(12, 3))
LIGHTS = {
    "point": at.PointLight(MIDDLE),
    "quad": at.QuadLight(MIDDLE, [2.0, 0.0, 0.0], [0.0, 0.3, 2.0]),
    "disk": at.DiskLight(MIDDLE, [0.0, -1.0, 0.1], 1.5),
    "sun": at.DirectionalLight([0.2, -1.0, 0.3]),
    "wide sun": at.DirectionalLight([0.2, -1.0, 0.3], angular_diameter=20.0),
    "points": at.PointLights(RNG.uniform(LOW, HIGH, (70, 3))),
    "suns": at.DirectionalLights(RNG.normal(size=(9, 3))),
}
OTHER = "bsah+single"  # traces points by shadow queries


@pytest.fixture
def answered(monkeypatch):
    """Whether each query of points so far was answered as one of few."""
    found, trace = [], FewPoints.visibility

    def recorded(self, *args):
        answer = trace(self, *args)
        found.append(answer is not None)
        return answer

    monkeypatch.setattr(FewPoints, "visibility", recorded)
    return found


def same(a, b):
    return all(np.array_equal(x, y) and x.dtype == y.dtype and x.shape == y.shape for x, y in zip(a[:3], b[:3]))


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("spp", [1, 5, 70])
def test_few_points_have_the_bits_of_shadow_queries(light, spp, answered):
    seen = []
    for n in (1, 3, 12):
        for normals in (None, NORMALS[:n]):
            for cull_faces in (None, "front"):
                options = {"spp": spp, "cull_faces": cull_faces}
                few = at.visibility(SCENE, POINTS[:n], LIGHTS[light], normals, **options)
                assert same(few, at.visibility(SCENE, POINTS[:n], LIGHTS[light], normals, plan=OTHER, **options))
                seen.append(few.fraction)
    assert any(answered) and 0.0 < np.concatenate(seen).mean() < 1.0


@pytest.mark.parametrize("light", ["point", "sun"])
def test_points_outside_the_scene_move_no_distant_light(light, answered):
    points = POINTS[:5] + [[3.0, 1.0, -2.0]] * (HIGH - LOW)
    assert same(at.visibility(SCENE, points, LIGHTS[light]), at.visibility(SCENE, points, LIGHTS[light], plan=OTHER))
    assert all(answered)


def test_a_light_that_moves_in_place_is_placed_anew():
    light, points = at.PointLight(MIDDLE), np.random.default_rng(6).uniform(LOW, HIGH, (MOST_SEGMENTS, 3))
    before = at.visibility(SCENE, points, light).bits
    light.position[:] = LOW + 0.3 * (HIGH - LOW)
    after = at.visibility(SCENE, points, light)
    assert same(after, at.visibility(SCENE, points, light, plan=OTHER)) and not np.array_equal(after.bits, before)


def test_an_update_of_the_scene_reaches_few_points():
    scene = at.procedural("atrium", triangles=3000)
    before = at.visibility(scene, POINTS, LIGHTS["quad"])
    scene.update(scene.triangles().vertices * [1.0, 0.4, 1.0])
    after = at.visibility(scene, POINTS, LIGHTS["quad"])
    assert same(after, at.visibility(scene, POINTS, LIGHTS["quad"], plan=OTHER)) and not same(before, after)


def test_a_point_that_fails_fails_alone():
    points = POINTS.copy()
    points[3, 1] = np.nan
    some = at.visibility(SCENE, points, LIGHTS["point"])
    assert np.isnan(some.fraction[3]) and np.isfinite(np.delete(some.fraction, 3)).all()
    assert same(some, at.visibility(SCENE, points, LIGHTS["point"], plan=OTHER)) is False  # NaN equals nothing
    assert np.array_equal(some.bits, at.visibility(SCENE, points, LIGHTS["point"], plan=OTHER).bits)


def test_no_second_tree_is_built_for_few_points(answered):
    scene = at.procedural("atrium", triangles=3000)
    every = at.visibility(scene, np.resize(POINTS, (10 * MOST_SEGMENTS, 3)), LIGHTS["point"])
    few = at.visibility(scene, POINTS, LIGHTS["point"])
    assert answered == [False, False] and scene.engine.source.ray_lists.plan is None
    scene.occluded(POINTS, NORMALS)  # builds the tree of rays
    assert same(few, at.visibility(scene, POINTS, LIGHTS["point"])) and answered == [False, False, True]
    assert np.array_equal(every.bits[: len(POINTS)], few.bits)


@pytest.mark.skipif(wasm_kernels.wanted(), reason="WebAssembly is called through Python")
@pytest.mark.parametrize("light, most", [("point", 100), ("quad", 120), ("sun", 145)])
def test_one_point_takes_few_calls_within_python(light, most):
    assert 30 < python_calls(lambda: at.visibility(SCENE, POINTS[:1], LIGHTS[light])) <= most
