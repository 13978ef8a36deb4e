"""The benchmark of ray hierarchies: its views, measurements, variants that are not run, and comparisons."""

import json
import math

import numpy as np
import pytest
import trimesh

from antumbra.base.errors import InputError
from antumbra.engine.plan import parse_plan
from antumbra.engine.scene import procedural
from antumbra.lab.bench_parts import BenchParts
from antumbra.lab.papers.benchmark_views import agree, scene_view
from antumbra.lab.papers.ray_hierarchy import ray_hierarchy_measurements, ray_hierarchy_published
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_measurements import PLANS, Cost, Measured, PictureRays
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_plot import write_plot
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_published import RayHierarchyTable
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_tables import print_tables
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_views import (
    MUSEUM,
    MUSEUM_SECONDS,
    ROBOTS,
    SCENES,
    WALL_PICTURE,
    PictureCase,
    film,
    open_view,
    open_views,
    pictures,
    read_camera_path,
    times_of,
    with_point,
)
from antumbra.scene.camera import Camera
from antumbra.scene.lights import PointLight
from scenes import scene_path

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
    assert [view.name for view in open_views(None, (8, 8), silent)] == [ROBOTS, "synthetic_garden_foxes"]
    monkeypatch.delenv("ANTUMBRA_SCENES")
    assert SCENES.default_names() == list(SCENES.without_real)


def test_vertex_frames_have_a_picture_and_small_frames(scenes):
    folder = scenes("walk")
    view = open_view(str(folder), (40, 30))
    (large,), small = pictures(view), film(view, 5, (16, 12))
    assert (large.name, large.time, large.frame) == ("walk, 1.00 s", 1.0, None)
    assert [p.time for p in small] == [0.0, 0.5, 1.0, 1.5, 2.0] and [p.frame for p in small] == list(range(5))
    assert len({p.name for p in (large, *small)}) == 6 and {p.of for p in (large, *small)} == {"walk"}
    assert all(p.camera.position.tolist() == [0, 1, 5] and p.light.position.tolist() == [1, 2, 3] for p in small)
    assert {(p.camera.width, p.camera.height) for p in small} == {(16, 12)} and large.camera.width == 40
    assert not np.array_equal(small[0].scene.triangles(0.0).vertices, small[0].scene.triangles(2.0).vertices)
    assert film(view, 0, (16, 12)) == []
    with pytest.raises(InputError, match=r"none: .*atrium"):
        open_view("none", (40, 30))


PATH = {
    "times": [0.0, 1.0, 4.0],
    "position": [[0, 0, 5], [2, 0, 5], [2, 3, 5]], "target": [[0, 0, 0], [2, 0, 0], [2, 3, 0]],
    "up": [[0, 1, 0], [0, 1, 0], [1, 1, 0]], "vfov": 45.0,
}  # fmt: skip


def test_the_museum_is_seen_by_the_camera_beside_it(scenes):
    folder = scenes(MUSEUM)
    static = pictures(open_view(MUSEUM, (40, 30)))
    assert [p.time for p in static] == list(MUSEUM_SECONDS)
    assert {tuple(p.camera.position) for p in static} == {(0, 1, 5)}
    (folder / "camera.json").write_text(json.dumps(PATH))
    view = open_view(MUSEUM, (40, 30))
    shown = pictures(view)
    assert len({p.name for p in shown}) == len(shown) == 4 and {p.frame for p in shown} == {None}
    assert len({tuple(p.camera.position) for p in shown}) == 4
    assert {(p.camera.vfov, p.camera.width, p.camera.height) for p in shown} == {(45.0, 40, 30)}
    assert film(view, 5, (8, 8)) == [] and len(times_of(view.scene, 5)) == 5


def test_cameras_move_between_keys(tmp_path):
    file = tmp_path / "camera.json"
    file.write_text(json.dumps(PATH))
    path = read_camera_path(file)
    half, between, after = (path.at(time, (40, 30)) for time in (0.5, 2.5, 9.0))
    assert half.position.tolist() == [1, 0, 5] and half.target.tolist() == [1, 0, 0] and half.up.tolist() == [0, 1, 0]
    assert between.position.tolist() == [2, 1.5, 5] and between.up.tolist() == [0.5, 1, 0]
    assert after.position.tolist() == [2, 3, 5] and (after.width, after.height) == (40, 30)


def test_barts_own_film_of_the_robots(monkeypatch):
    folder = scene_path(f"{ROBOTS}/animated.glb").parent
    monkeypatch.setenv("ANTUMBRA_SCENES", str(folder.parent))
    view = open_view(ROBOTS, (40, 30))
    assert view.scene.n_triangles == 71_706 and view.lights[0].position.tolist() == [1, 500, 1]
    shown = pictures(view)
    assert [round(p.time, 2) for p in shown] == [6.26, 10.01, 31.29] and shown[-1].name == WALL_PICTURE
    frames = film(view, 200, (16, 16))
    assert [p.frame for p in frames] == list(range(0, 800, 4)) and frames[-1].time < view.scene.duration == 50
    keys = read_camera_path(folder / "camera.json")
    for picture in (*shown, *frames[::20]):  # the file has 20 keys per second, and camera.json has 10
        ours, theirs = picture.camera, keys.at(picture.time, (16, 16))
        assert np.linalg.norm(ours.position - theirs.position) < 0.05
        assert np.linalg.norm(ours.axes - theirs.axes) < 0.02


def test_other_scenes_stand_still(scenes):
    scenes("synthetic_garden_foxes", light=[0.0, 3.0, 4.0, 0.0])
    view = open_view("synthetic_garden_foxes", (40, 30))
    (only,) = pictures(view)
    assert (only.frame, only.time, times_of(only.scene, 5), film(view, 5, (8, 8))) == (None, 0.0, [0.0], [])
    assert np.allclose(only.light.position, 13 * np.array([0, 0.6, 0.8]))


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
    (only,) = pictures(with_point(scene_view("cellar", procedural("cellar", triangles=3000), (SIZE, SIZE))))
    return only


def silent(text: str) -> None:
    pass


def test_all_variants_answer_the_same(picture):
    measured = ray_hierarchy_measurements.measure_all(
        [picture], ray_hierarchy_measurements.Effort(2, 2, math.inf), silent
    )
    ((seen,), costs) = measured
    assert (
        [c.variant for c in costs]
        == list(PLANS)
        == [ray_hierarchy_measurements.OURS, *ray_hierarchy_published.VARIANTS]
    )
    assert 0 < seen.blocked < seen.rays == SIZE * SIZE
    assert len(measured.answers()) == 1 + len(PLANS) and agree(measured.answers())
    assert all(c.nodes > 0 and c.tests > 0 and c.seconds > 0 for c in costs)
    assert ray_hierarchy_measurements.never_more(measured, "Precise", "Spheres") == (1, 1)


def test_face_culling_drops_nodes_and_keeps_answers_the_same(picture):
    measured = ray_hierarchy_measurements.measure_all(
        [picture], ray_hierarchy_measurements.Effort(2, 1, None, "back"), silent
    )
    assert agree(measured.answers()) and all(0 < c.passed < c.nodes for c in measured.costs)
    both = ray_hierarchy_measurements.measure(picture, ray_hierarchy_measurements.Effort(2, 1, None), silent)[1]
    assert sum(c.nodes for c in measured.costs) < sum(c.nodes for c in both)
    rows = ray_hierarchy_measurements.relative_costs(measured, ray_hierarchy_published.FIGURE7)
    assert [r.variant for r in rows] == list(ray_hierarchy_published.FIGURE7) and rows[0].nodes == rows[0].passed == 1.0


def test_what_would_take_too_long_is_not_run(picture, capsys):
    measured = ray_hierarchy_measurements.measure_all([picture], ray_hierarchy_measurements.Effort(2, 1, 0.0), silent)
    assert [c.variant for c in measured.costs] == list(PLANS)
    assert all((c.nodes, c.passed, c.tests, c.seconds, c.bits) == (None,) * 5 for c in measured.costs)
    assert measured.answers() == [("cellar", measured.pictures[0].bits)]
    assert (
        ray_hierarchy_measurements.claims(measured)
        == ray_hierarchy_measurements.relative_costs(measured, ray_hierarchy_published.FIGURE7)
        == []
    )
    print_tables(measured, Measured([], []), [], [], [], True)
    out = capsys.readouterr().out
    assert "not run: predicted" in out and "about" not in out and "fewest nodes of Table 1" in out


def test_a_film_gets_further_frames(picture, tmp_path, monkeypatch):
    measured, size = [], (SIZE, SIZE)

    def measure(cases, effort, say):
        measured.extend(case.frame for case in cases)
        rays = [PictureRays(each.name, each.of, each.frame, 1, 1, 0, b"") for each in cases]
        return Measured(rays, [Cost(each.name, "Precise") for each in cases])

    monkeypatch.setattr(ray_hierarchy_measurements, "measure_all", measure)
    film, effort = RayHierarchyTable.film, ray_hierarchy_measurements.Effort(1, 1, None)
    for frames in ((0, 400), (0, 200, 400, 600), (0, 400)):
        parts = BenchParts({film: {"size": size}}, ray_hierarchy_measurements.ROWS, folder=tmp_path)
        cases = [picture._replace(name=f"frame {k}", frame=k, time=k / 10) for k in frames]
        ray_hierarchy_measurements.add_pictures(parts, film, cases, effort, silent)
    assert measured == [0, 400, 200, 600]
    shown = ray_hierarchy_measurements.joined(parts.values(film))
    assert [rays.frame for rays in shown.pictures] == [0, 200, 400, 600]


def test_pictures_of_nothing_are_refused(picture):
    away = Camera((1e4, 1e4, 1e4), (2e4, 2e4, 2e4), width=SIZE, height=SIZE)
    with pytest.raises(InputError, match="cellar: the camera sees nothing"):
        ray_hierarchy_measurements.measure(
            picture._replace(camera=away), ray_hierarchy_measurements.Effort(2, 1, 1.0), silent
        )


def test_variants_are_plans():
    for plans in PLANS, ray_hierarchy_measurements.CULLING_PLANS:
        assert [str(parse_plan(plan)) for plan in plans.values()] == list(plans.values())


# --- Comparisons ------------------------------------------------------------------------------------------------------


def made(costs: dict[str, dict[str, int | None]], of: str = "film", frames: bool = False) -> Measured:
    """Pictures of a scene, and all variants in each: the given nodes, half of them passed and a second for each.

    The other variants have 18 nodes. None: not run.
    """
    pictures = [PictureRays(name, of, k if frames else None, 100, 10, 4, b"1") for k, name in enumerate(costs)]
    rows = []
    for name, nodes in costs.items():
        for variant in PLANS:
            n = nodes.get(variant, 18)
            ran = Cost(name, variant, n, n // 2, 5, float(n), b"1") if n is not None else Cost(name, variant)
            rows.append(ran)
    return Measured(pictures, rows)


VIEWS = {
    "museum, 1": {"Spheres": 40, "SpheresSorted": 4, "Precise": 20, "PreciseSorted": 2},
    "museum, 2": {"Spheres": 80, "SpheresSorted": 4, "Precise": 40, "PreciseSorted": 4},
}


def test_claims_compare_like_with_like():
    found = {c.text: c for c in ray_hierarchy_measurements.claims(made(VIEWS, MUSEUM))}
    nodes = found["sorting, Spheres: fewer nodes"]
    assert (nodes.ours, nodes.picture) == (20.0, "museum, 2")
    assert nodes.published == pytest.approx(2199.22 / 6.60)
    assert found["sorting, Precise: less time"].ours == 10.0
    assert found["sorting, Precise: less time"].published == pytest.approx(4172.61 / 12.60)
    assert found["precise test: fewer nodes, rays in image order"].ours == pytest.approx(2.0)
    assert found["precise test: fewer nodes, rays sorted"].ours == pytest.approx(math.sqrt(2.0))
    assert len(found) == 6


def test_claims_need_all_views_of_the_museum():
    found = {c.text for c in ray_hierarchy_measurements.claims(made({**VIEWS, "museum, 3": {"Spheres": None}}, MUSEUM))}
    assert found == {
        "sorting, Precise: fewer nodes", "sorting, Precise: less time", "precise test: fewer nodes, rays sorted"
    }  # fmt: skip
    assert ray_hierarchy_measurements.claims(made(VIEWS)) == []  # of another scene


def test_the_claim_about_the_wall():
    (claim,) = ray_hierarchy_measurements.claims(
        made({"corridor": {}, WALL_PICTURE: {"Spheres": 1000, "Precise": 10}}, ROBOTS)
    )
    assert (claim.ours, claim.published, claim.picture) == (100.0, 250_000.0, WALL_PICTURE)
    assert ray_hierarchy_measurements.claims(made({WALL_PICTURE: {"Spheres": None}}, ROBOTS)) == []


def test_fewest_nodes():
    measured = made({"a": {"PreciseSorted": 2, "PreciseSEATP": 1, "Spheres": None}})
    assert ray_hierarchy_measurements.fewest(measured, "a", ray_hierarchy_published.MEASURED) == "PreciseSorted"
    assert ray_hierarchy_measurements.fewest(measured, "a", PLANS) == "PreciseSEATP"
    assert ray_hierarchy_measurements.fewest(measured, "a", ("Spheres",)) == ""


def test_how_often_a_variant_tests_no_more_nodes():
    measured = made({"a": {"Spheres": 18}, "b": {"Spheres": 2}, "c": {"Spheres": None}, "d": {"Spheres": 20}})
    assert ray_hierarchy_measurements.never_more(measured, "Precise", "Spheres") == (2, 3)


def test_spreads_are_those_of_animations():
    film = made({"1": {"Precise": 2}, "2": {"Precise": 4}, "3": {"Precise": 6}}, frames=True)
    found = {s.variant: s for s in ray_hierarchy_measurements.spreads(film)}
    assert set(found) == set(PLANS) and {s.of for s in found.values()} == {"film"}
    varied = found["Precise"]
    assert (varied.frames, varied.nodes, varied.most_nodes, varied.passed) == (3, 4, 6, 2)
    assert (varied.median, varied.ratio, varied.quartiles) == (4.0, 3.0, 2.0)
    assert varied.deviation == pytest.approx(math.sqrt(8 / 3) / 4)
    assert found["cones"].ratio == 1.0 and found["cones"].deviation == 0.0
    assert ray_hierarchy_measurements.spreads(made({"1": {}}, frames=True)) == []


def test_the_plot_has_gaps_where_variants_were_not_run(tmp_path):
    pytest.importorskip("matplotlib")
    measured = made({**VIEWS, "museum, 3": {"Spheres": None}, "museum, 4": {}}, MUSEUM)
    write_plot(measured, Measured([], []), ray_hierarchy_measurements.claims(measured), tmp_path / "with.png")
    write_plot(made({"a": {}}), made({"1": {}, "2": {}}, frames=True), [], tmp_path / "without.png")
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in ("with", "without"))


def test_the_reports_ratios_are_what_its_text_says():
    assert (
        max(ray_hierarchy_published.ratios("Precise", "PreciseSorted")) > 1000
    )  # "up to three orders of magnitude fewer nodes"
    times = ray_hierarchy_published.ratios("Precise", "PreciseSorted", ray_hierarchy_published.MILLISECONDS)
    assert max(times) > 100  # "over two orders of magnitude faster"
    assert (
        set(ray_hierarchy_published.NODES)
        == set(ray_hierarchy_published.MILLISECONDS)
        == set(ray_hierarchy_published.MEASURED)
        < set(ray_hierarchy_published.VARIANTS)
    )
