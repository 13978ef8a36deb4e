"""The benchmark of ray hierarchies against building."""

import numpy as np
import pytest

import rebuild as bench
from antumbra.base.errors import InputError
from antumbra.engine.plan import parse_plan
from rebuild import PLANS, REFERENCE, Rebuilt, crossings, curve, overview, ratio

SIZE = 24


def silent(text: str) -> None:
    pass


@pytest.fixture(scope="module")
def view():
    return bench.sized("atrium", 7000, (SIZE, SIZE))


def without_embree(monkeypatch):
    def library():
        raise InputError("Embree is not installed")

    monkeypatch.setattr(bench.embree, "library", library)


def test_ours_without_embree(view, monkeypatch):
    without_embree(monkeypatch)
    rows = bench.rebuild(view, "atrium", 1, 2, 1, silent)
    assert bench.embree_version() == "" and [r.method for r in rows] == list(PLANS)
    assert all(r.differs == 0 and r.triangles == view.scene.n_triangles and r.family == "atrium" for r in rows)
    assert all(r.image > r.shadows == pytest.approx(r.cull + r.build + r.trace) for r in rows)
    assert ratio(rows, rows[0]) is None
    assert {r.method: r.how for r in rows if r.method != "auto"} == {plan: plan for plan in PLANS if plan != "auto"}
    (chosen,) = (r.how for r in rows if r.method == "auto")
    assert chosen != "auto" and str(parse_plan(chosen)) == chosen


def test_embree_answers_nearly_the_same(view):
    pytest.importorskip("embreex", reason="Embree is not installed: pip install 'antumbra[peers]'")
    rows = bench.rebuild(view, "atrium", 1, 2, 1, silent)
    peers = [r for r in rows if r.method not in PLANS]
    assert [r.method for r in rows[: len(PLANS)]] == list(PLANS)
    assert {r.method for r in peers} >= {"Embree rtcOccluded1"}
    assert all(r.build > 0 and r.cull == 0 and r.differs <= 0.01 * SIZE * SIZE for r in peers)
    assert max(ratio(rows, r) for r in peers) == 1.0 and all(ratio(rows, r) > 0 for r in rows)


def test_answers_of_embree_are_not_all_alike(view):
    """Otherwise the comparison above could not fail."""
    frame_input, seconds = bench.input_of(bench.Renderer(view.scene, REFERENCE, 2), view, 0.0)
    _, bits = bench.Ours(REFERENCE, 2).shadows(frame_input)
    assert 0 < np.count_nonzero(bits) < bits.size and seconds > 0


def test_sizes_are_about_what_is_asked(view):
    assert abs(view.scene.n_triangles - 7000) <= 700 and view.name == "atrium, 7,000"


def test_curves_cross_between_what_is_measured():
    ((n, seconds),) = crossings([100, 10_000], [1.0, 100.0], [10.0, 10.0])
    assert (n, seconds) == (pytest.approx(1000), pytest.approx(10.0))
    assert crossings([100, 10_000], [1.0, 2.0], [3.0, 4.0]) == [] == crossings([100], [1.0], [2.0])
    assert len(crossings([1, 10, 100], [1.0, 3.0, 1.0], [2.0, 2.0, 2.0])) == 2


def row(scene, method, shadows, triangles=100, made="atrium") -> Rebuilt:
    return Rebuilt(scene, triangles, made, method, "", 0.0, shadows, 0.0, shadows, shadows, 0)


def test_the_best_of_embree_is_what_counts():
    rows = [row("a", "cones", 1.0), row("a", "Embree rtcOccluded1", 4.0), row("a", "Embree rtcOccluded16", 2.0)]
    rows += [row("b", "cones", 5.0, 10), row("c", "cones", 7.0, 50, "")]
    assert [ratio(rows, r) for r in rows] == [2.0, 0.5, 1.0, None, None]
    assert curve(rows, "atrium", "cones") == ([10, 100], [5.0, 1.0])


def test_the_overview_shows_each_scene_and_marks_the_fastest_method():
    rows = [row("a", "cones", 1.0), row("a", "auto", 0.5), row("b", "cones", 0.25), row("b", "auto", 4.0)]
    head, table = overview(rows)
    assert head == ["scene", "triangles", "cones", "auto"]
    assert table == [["a", "100", "1,000.0", "500.0*"], ["b", "100", "250.0*", "4,000.0"]]
