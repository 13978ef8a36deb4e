"""The benchmark of instances."""

import numpy as np
import pytest

import instances as bench


@pytest.fixture(scope="module")
def both():
    return tuple(bench.forest(9, 400, choice) for choice in (True, False))


def test_a_forest_has_the_trees_and_triangles_that_are_asked_for(both):
    scene, flat = both
    assert len(scene.objects) == 1 + 9 and abs(scene.n_triangles / (9 * 400) - 1) < 0.2
    np.testing.assert_array_equal(scene.bounds, flat.bounds)
    assert scene.bounds[0, 1] < 0.1 and scene.bounds[1, 1] > 6.0


def test_all_kinds_of_queries_are_compared(both):
    rows = bench.compared(*both, 100, 1)
    assert [row.query for row in rows] == list(bench.queries(both[0], 100))
    assert all(row.rays == 100 and row.ratio == pytest.approx(row.instances / row.flattened) for row in rows)


def test_queries_have_both_outcomes(both):
    """Otherwise the comparison of answers could not fail."""
    for name, ask in bench.queries(both[0], 400).items():
        first = ask(both[0])[0]
        hits = first if first.dtype == bool else np.isfinite(first)
        assert 0 < hits.mean() <= 1, name
    assert not bench.queries(both[0], 400)["occluded, random segments"](both[0])[0].all()


def test_answers_that_differ_are_an_error(both):
    with pytest.raises(RuntimeError, match="differ"):
        bench.compared(both[0], bench.forest(4, 400, False), 100, 1)


def test_the_whole_benchmark(run):
    small = ("--trees", 4, "--triangles", 300, "--size", 16, 12, "--fits", 9, "--rays", 200, "--rounds", 1)
    done = run("instances", *small)
    assert len(done.rows) == len(bench.queries(bench.forest(4, 300, True), 10)) and "second" in done.out


def test_the_picture_of_a_forest():
    row = bench.picture(4, 300, (16, 12), 1)
    assert row.trees == 4 and row.rays > 0 and (row.peak is None or row.peak > 0)
