"""The benchmark of hostile scenes."""

import numpy as np
import pytest

import hostile
from hostile import Timed


def test_the_table_and_the_rows(run):
    sizes = ["--triangles", 40, "--points", 9, "--threads", 1, "--limit", 60]
    found = run("hostile", "--scenes", "lines", "copies", "--plans", "auto", "bsah+single", *sizes)
    assert [(row["scene"], row["plan"]) for row in found.rows] == [
        (scene, plan) for scene in ("lines", "copies") for plan in ("auto", "bsah+single")
    ]
    assert all(row["seconds"] > 0 and row["occluded"] > 0 for row in found.rows)
    assert "plans differ on: no scene" in found.out and "copies: " in found.out


def test_times_are_compared_with_the_best_plan():
    rows = [Timed("x", "a", 1.0, 3), Timed("x", "b", 11.0, 3), Timed("x", "c", np.inf, -1)]
    assert hostile.ratios(rows) == {"a": 1.0, "b": 11.0, "c": np.inf}
    short = [Timed("x", "a", 0.001, 3), Timed("x", "b", hostile.LEAST, 3)]
    assert hostile.ratios(short) == {"a": 1.0, "b": 1.0}


@pytest.mark.parametrize("name", hostile.SCENES)
def test_scenes_are_exact_in_float32(name):
    made = hostile.hostile_scene(name, 90, 25)
    assert made.triangles.shape == (192, 3, 3) and made.points.shape == (25, 3)
    np.testing.assert_array_equal(made.triangles, made.triangles.astype(np.float32))
    np.testing.assert_array_equal(made.points, made.points.astype(np.float32))
