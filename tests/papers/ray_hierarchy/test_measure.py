"""The benchmark of ray hierarchies: measurements, variants left out, and the figures derived from them."""

import math

import pytest

from antumbra.engine.plan import parse_plan
from antumbra.engine.scene import procedural
from antumbra.errors import InputError
from antumbra.papers.benchmark_views import agree, scene_view
from antumbra.papers.ray_hierarchy import ray_hierarchy_measurements as bench
from antumbra.papers.ray_hierarchy import ray_hierarchy_measurements as paper
from antumbra.papers.ray_hierarchy.ray_hierarchy_measurements import (
    PLANS,
    Cost,
    PictureCase,
    PictureRays,
    pictures,
    with_point,
)
from antumbra.scene.camera import Camera

SIZE = 24


@pytest.fixture(scope="module")
def picture() -> PictureCase:
    (only,) = pictures(with_point(scene_view("cellar", procedural("cellar", triangles=3000), (SIZE, SIZE))), 5)
    return only


def silent(text: str) -> None:
    pass


def test_all_variants_answer_the_same(picture):
    seen, costs = bench.measure(picture, bench.Effort(2, 2, math.inf), silent)
    assert [c.variant for c in costs] == list(PLANS) == [bench.OURS, *paper.VARIANTS]
    assert 0 < seen.blocked < seen.rays == SIZE * SIZE
    assert len(bench.answers([seen], costs)) == 1 + len(PLANS) and agree(bench.answers([seen], costs))
    assert all(c.nodes > 0 and c.tests > 0 and c.seconds > 0 for c in costs)
    assert all(c.predicted_nodes > 0 and c.predicted > 0 for c in costs)


def test_face_culling_drops_nodes_and_keeps_answers_the_same(picture):
    seen, costs = bench.measure(picture, bench.Effort(2, 1, math.inf, "back"), silent)
    assert agree(bench.answers([seen], costs)) and all(0 < c.passed < c.nodes for c in costs)
    both = bench.measure(picture, bench.Effort(2, 1, math.inf), silent)[1]
    assert sum(c.nodes for c in costs) < sum(c.nodes for c in both)
    rows = bench.relative_costs([seen], costs, paper.FIGURE7)
    assert [r.variant for r in rows] == list(paper.FIGURE7) and rows[0].nodes == rows[0].passed == 1.0


def test_what_would_take_too_long_is_left_out(picture):
    seen, costs = bench.measure(picture, bench.Effort(2, 1, 0.0), silent)
    assert all((c.nodes, c.tests, c.seconds, c.bits) == (None,) * 4 for c in costs)
    assert all(c.predicted > 0 and c.predicted_nodes > 0 for c in costs)
    assert bench.answers([seen], costs) == [("cellar", seen.bits)]


def test_pictures_of_nothing_are_refused(picture):
    away = Camera((1e4, 1e4, 1e4), (2e4, 2e4, 2e4), width=SIZE, height=SIZE)
    with pytest.raises(InputError, match="cellar: the camera sees nothing"):
        bench.measure(picture._replace(camera=away), bench.Effort(2, 1, 1.0), silent)


def test_variants_are_plans():
    for plans in PLANS, bench.CULLING_PLANS:
        assert [str(parse_plan(plan)) for plan in plans.values()] == list(plans.values())


def made_costs(picture: str, **nodes: int | None) -> list[Cost]:
    """Costs of all variants: the given nodes, or 9, and a second for each variant; None: left out."""
    found = {name: nodes.get(name, 9) for name in PLANS}
    return [
        Cost(picture, name, 1.0, 9.0) if n is None else Cost(picture, name, 1.0, 9.0, n, 5, float(n), b"1")
        for name, n in found.items()
    ]


def seen_in(picture: str, frame: int | None = None, of: str = "film") -> PictureRays:
    return PictureRays(picture, of, frame, 100, 10, 4, b"1")


def test_what_sorting_cuts():
    costs = made_costs("a", Spheres=40, SpheresSorted=4) + made_costs("b", Spheres=30, SpheresSorted=2)
    costs += made_costs("c", Spheres=None) + made_costs("d", SpheresSorted=None) + made_costs("e", SpheresSorted=0)
    assert bench.cut(costs, "Spheres", "SpheresSorted") == (15.0, "b", True)
    assert bench.cut(made_costs("a", Spheres=None, SpheresSorted=3), "Spheres", "SpheresSorted") == (3.0, "a", False)
    times, picture, measured = bench.cut(made_costs("a", PreciseSorted=None), "Precise", "PreciseSorted")
    assert math.isnan(times) and picture == "" and not measured


def test_fewest_nodes():
    costs = made_costs("a", PreciseSorted=2, PreciseSEATP=1, Spheres=None)
    assert bench.fewest(costs, "a", paper.MEASURED) == "PreciseSorted"
    assert bench.fewest(costs, "a", PLANS) == "PreciseSEATP"
    assert bench.fewest(costs, "a", ("Spheres",)) == ""


def test_spreads_are_those_of_animations():
    seen = [seen_in("1", 0), seen_in("2", 1), seen_in("3", 2), seen_in("wall", None, "museum"), seen_in("x", 0, "one")]
    costs = made_costs("1", Precise=2, Spheres=None) + made_costs("2", Precise=4, Spheres=None)
    costs += made_costs("3", Precise=6) + made_costs("wall") + made_costs("x")
    found = {s.variant: s for s in bench.spreads(seen, costs)}
    assert set(found) == set(PLANS) - {"Spheres"} and {s.of for s in found.values()} == {"film"}
    varied = found["Precise"]
    assert (varied.frames, varied.missing, varied.median, varied.ratio, varied.quartiles) == (3, 0, 4.0, 3.0, 2.0)
    assert varied.deviation == pytest.approx(math.sqrt(8 / 3) / 4)
    assert found["cones"].ratio == 1.0 and found["cones"].deviation == 0.0


def test_spreads_say_how_many_frames_are_missing():
    seen = [seen_in(str(k), k) for k in range(3)]
    costs = [c for k in range(3) for c in made_costs(str(k), Spheres=None if k == 1 else 3)]
    (row,) = (s for s in bench.spreads(seen, costs) if s.variant == "Spheres")
    assert (row.frames, row.missing) == (2, 1)


def test_the_reports_ratios_are_what_its_text_says():
    assert paper.published_cut("Precise", "PreciseSorted") > 1000  # "up to three orders of magnitude fewer nodes"
    slow, fast = (paper.MILLISECONDS[name] for name in ("Precise", "PreciseSorted"))
    assert max(a / b for a, b in zip(slow, fast)) > 100  # "over two orders of magnitude faster"
    assert set(paper.NODES) == set(paper.MILLISECONDS) == set(paper.MEASURED) < set(paper.VARIANTS)
