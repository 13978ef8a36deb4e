"""The benchmark of ray hierarchies: its views, measurements, variants left out, and the figures derived from them."""

import json
import math

import numpy as np
import pytest
import trimesh

from antumbra.engine.plan import parse_plan
from antumbra.engine.scene import procedural
from antumbra.errors import InputError
from antumbra.papers.benchmark_views import agree, scene_view
from antumbra.papers.ray_hierarchy import ray_hierarchy_measurements as bench
from antumbra.papers.ray_hierarchy.ray_hierarchy_measurements import (
    MUSEUM,
    PLANS,
    ROBOTS,
    SCENES,
    Cost,
    PictureCase,
    PictureRays,
    pictures,
    times_of,
    with_point,
)
from antumbra.scene.camera import Camera
from antumbra.scene.lights import PointLight

# --- Views ------------------------------------------------------------------------------------------------------------


INFO = {
    "up": [0, 1, 0], "camera": {"position": [0, 1, 5], "target": [0, 1, 0], "vfov": 50},
    "light": [1.0, 2.0, 3.0], "frames": "3 frames, t=0.0..2.0",
}  # fmt: skip


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """Writes a moving scene to a folder of $ANTUMBRA_SCENES: scenes("bart_robots", fields of info.json) -> folder."""
    monkeypatch.setenv("ANTUMBRA_SCENES", str(tmp_path))
    box = trimesh.creation.box(extents=(3, 4, 12))  # a diagonal of 13

    def write(name: str, **more):
        folder = tmp_path / name
        folder.mkdir()
        np.save(folder / "frames.npy", np.stack([box.vertices + [k, 0, 0] for k in range(3)]).astype(np.float32))
        np.save(folder / "faces.npy", box.faces.astype(np.uint32))
        box.export(folder / "scene.glb")
        (folder / "info.json").write_text(json.dumps({**INFO, **more}))
        return folder

    return write


def test_scenes_that_are_there(scenes, monkeypatch):
    assert SCENES.default_names() == list(SCENES.without_real)
    scenes("synthetic_garden_foxes")
    scenes(ROBOTS)
    assert SCENES.default_names() == [ROBOTS, "synthetic_garden_foxes"]
    monkeypatch.delenv("ANTUMBRA_SCENES")
    assert SCENES.default_names() == list(SCENES.without_real)


def test_robots_move(scenes):
    scenes(ROBOTS)
    shown = pictures(SCENES.view(ROBOTS, (40, 30)), 5)
    assert [p.time for p in shown] == [0.0, 0.5, 1.0, 1.5, 2.0] and [p.frame for p in shown] == list(range(5))
    assert len({p.name for p in shown}) == 5 and {p.of for p in shown} == {ROBOTS}
    assert all(p.camera.position.tolist() == [0, 1, 5] and p.light.position.tolist() == [1, 2, 3] for p in shown)
    assert not np.array_equal(shown[0].scene.triangles(0.0).vertices, shown[0].scene.triangles(2.0).vertices)


def test_the_museum_is_seen_from_four_places(scenes):
    scenes(MUSEUM)
    shown = pictures(SCENES.view(MUSEUM, (40, 30)), 5)
    assert len({p.name for p in shown}) == 4 and {p.frame for p in shown} == {None}
    assert len({tuple(p.camera.position) for p in shown}) == 4
    assert shown[0].camera.position.tolist() == [0, 1, 5]
    assert {(p.camera.width, p.camera.height) for p in shown} == {(40, 30)}
    assert len(times_of(shown[0].scene, 5)) == 5


def test_other_scenes_stand_still(scenes):
    scenes("synthetic_garden_foxes", light=[0.0, 3.0, 4.0, 0.0])
    (only,) = pictures(SCENES.view("synthetic_garden_foxes", (40, 30)), 5)
    assert (only.frame, only.time, times_of(only.scene, 5)) == (None, 0.0, [0.0])
    assert np.allclose(only.light.position, 13 * np.array([0, 0.6, 0.8]))


def test_folders_of_vertex_frames_by_path(scenes):
    folder = scenes("walk")
    view = SCENES.view(str(folder), (40, 30))
    assert view.name == "walk" and len(pictures(view, 2)) == 2
    with pytest.raises(InputError, match=r"none: .*atrium"):
        SCENES.view("none", (40, 30))


def test_points_in_the_middle_of_lights():
    view = scene_view("cellar", procedural("cellar", triangles=2000), (40, 30))
    (light,) = view.lights
    (point,) = with_point(view).lights
    assert isinstance(point, PointLight)
    np.testing.assert_allclose(point.position, light.corner + (light.u + light.v) / 2, atol=1e-9)
    (again,) = with_point(view._replace(lights=[point])).lights
    np.testing.assert_allclose(again.position, point.position, atol=1e-9)


# --- Measurements -----------------------------------------------------------------------------------------------------


SIZE = 24


@pytest.fixture(scope="module")
def picture() -> PictureCase:
    (only,) = pictures(with_point(scene_view("cellar", procedural("cellar", triangles=3000), (SIZE, SIZE))), 5)
    return only


def silent(text: str) -> None:
    pass


def test_all_variants_answer_the_same(picture):
    seen, costs = bench.measure(picture, bench.Effort(2, 2, math.inf), silent)
    assert [c.variant for c in costs] == list(PLANS) == [bench.OURS, *bench.VARIANTS]
    assert 0 < seen.blocked < seen.rays == SIZE * SIZE
    assert len(bench.answers([seen], costs)) == 1 + len(PLANS) and agree(bench.answers([seen], costs))
    assert all(c.nodes > 0 and c.tests > 0 and c.seconds > 0 for c in costs)
    assert all(c.predicted_nodes > 0 and c.predicted > 0 for c in costs)


def test_face_culling_drops_nodes_and_keeps_answers_the_same(picture):
    seen, costs = bench.measure(picture, bench.Effort(2, 1, math.inf, "back"), silent)
    assert agree(bench.answers([seen], costs)) and all(0 < c.passed < c.nodes for c in costs)
    both = bench.measure(picture, bench.Effort(2, 1, math.inf), silent)[1]
    assert sum(c.nodes for c in costs) < sum(c.nodes for c in both)
    rows = bench.relative_costs([seen], costs, bench.FIGURE7)
    assert [r.variant for r in rows] == list(bench.FIGURE7) and rows[0].nodes == rows[0].passed == 1.0


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
    assert bench.fewest(costs, "a", bench.MEASURED) == "PreciseSorted"
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
    assert bench.published_cut("Precise", "PreciseSorted") > 1000  # "up to three orders of magnitude fewer nodes"
    slow, fast = (bench.MILLISECONDS[name] for name in ("Precise", "PreciseSorted"))
    assert max(a / b for a, b in zip(slow, fast)) > 100  # "over two orders of magnitude faster"
    assert set(bench.NODES) == set(bench.MILLISECONDS) == set(bench.MEASURED) < set(bench.VARIANTS)
