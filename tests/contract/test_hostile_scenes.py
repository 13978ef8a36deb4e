"""The scenes of benchmarks/hostile.py, small: no plan may differ from the oracle by a bit."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
import hostile
import oracle
from antumbra.engine.plan import covering_plans
from devices import device_plans

TRIANGLES, POINTS = 60, 16


@cache
def _asked(name):
    """(scene, points, lights of a list, truth (points, lights)) of a hostile scene."""
    made = hostile.hostile_scene(name, TRIANGLES, POINTS)
    scene = at.Scene.from_arrays(made.triangles)
    assert not scene.origin.any()
    light = made.lights[0].position
    ends = np.concatenate([light[None], light + np.random.default_rng(1).normal(size=(3, 3)) / 4]).astype(np.float32)
    vertices, points = scene.triangles().vertices, made.points.astype(np.float32)
    np.testing.assert_array_equal(vertices, made.triangles)
    truth = np.stack([oracle.occluded(vertices, points, ends=np.broadcast_to(end, points.shape)) for end in ends], 1)
    return scene, points, ends, truth


@pytest.mark.parametrize("name", hostile.SCENES)
@pytest.mark.parametrize("plan", [*covering_plans(), *device_plans()], ids=str)
def test_no_bit_differs(plan, name):
    scene, points, ends, truth = _asked(name)
    seen = at.visibility(scene, points, at.PointLights(ends), plan=plan).seen_samples
    np.testing.assert_array_equal(~seen, truth)


def test_both_outcomes_occur():
    truths = [_asked(name)[3] for name in hostile.SCENES]
    assert all(truth.any() for truth in truths) and sum(not truth.all() for truth in truths) > len(truths) / 2


@pytest.mark.parametrize("name", hostile.SCENES)
def test_ray_lists(name):
    """Towards the light, and beyond it."""
    scene, points, ends, _ = _asked(name)
    directions = ends[0] - points
    vertices = scene.triangles().vertices
    hit = scene.closest_hit(points, directions)
    np.testing.assert_array_equal(scene.occluded(points, directions), oracle.occluded(vertices, points, directions))
    np.testing.assert_array_equal(hit.face, oracle.closest_hit(vertices, points, directions)[1])


@pytest.mark.parametrize("name", ["lines", "junk at light", "points at light"])
def test_what_has_no_area_is_in_no_tree(name):
    assert len(_asked(name)[0].triangles().solid) == 102  # the ordinary ones, and those at the bounds
