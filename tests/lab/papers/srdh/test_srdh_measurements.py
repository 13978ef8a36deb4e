"""The benchmark of SRDH: its views, its rays, its counts, and RTSAH with the lines that it assumes."""

import json

import numpy as np
import pytest
import trimesh

from antumbra.base.errors import InputError
from antumbra.bvh import binned_sah
from antumbra.bvh.tree_quality import validate
from antumbra.engine.scene import procedural
from antumbra.lab.papers import benchmark_views
from antumbra.lab.papers.benchmark_views import BenchmarkView, scene_view
from antumbra.lab.papers.srdh import srdh_measurements, srdh_published
from antumbra.lab.papers.srdh.srdh_measurements import (
    CONSTANT,
    METHODS,
    OURS,
    PRERENDER_SPP,
    PUBLISHED,
    SAH_ORDERS,
    BoxTests,
    BuildTimes,
    Workload,
    check_rtsah,
    even_lines,
    of,
    opposite,
)
from antumbra.lab.papers.srdh.srdh_workloads import SCENES
from antumbra.query.shadow_query import segments
from antumbra.scene.camera import Camera
from antumbra.techniques.srdh.representative_rays import segments_of
from antumbra.trace.rays.single_rays import FALSE, PATH, UNOCCLUDED

# --- Views ------------------------------------------------------------------------------------------------------------


INFO = {"up": [0, 1, 0], "camera": {"position": [0, 1, 5], "target": [0, 1, 0], "vfov": 50}, "light": [1.0, 2.0, 3.0]}


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """A folder of scenes with a single scene, zdm2. Its info.json can be changed."""
    monkeypatch.setenv("ANTUMBRA_SCENES", str(tmp_path))
    folder = tmp_path / "zdm2"
    folder.mkdir()
    trimesh.creation.box(extents=(3, 4, 12)).export(folder / "scene.glb")  # a diagonal of 13

    def tell(**more):
        (folder / "info.json").write_text(json.dumps({**INFO, **more}))
        return folder

    tell()
    return tell


def test_real_scenes_where_they_are(scenes, monkeypatch):
    assert SCENES.default_names() == ["zdm2", *SCENES.beside_real]
    monkeypatch.delenv("ANTUMBRA_SCENES")
    assert SCENES.default_names() == list(SCENES.without_real)


def test_camera_and_light_are_those_of_info(scenes):
    view = SCENES.view("zdm2", (40, 30))
    assert (view.camera.width, view.camera.height, view.camera.vfov) == (40, 30, 50)
    assert view.camera.position.tolist() == [0, 1, 5]
    (light,) = view.lights
    assert np.allclose(light.corner + (light.u + light.v) / 2, [1, 2, 3])
    assert np.isclose(np.linalg.norm(light.u), 1.3) and np.isclose(np.linalg.norm(light.v), 1.3)
    assert np.allclose(np.cross(light.u, light.v) / 1.69, [0, 1, 0])


def test_a_direction_is_a_square_far_away_that_faces_the_scene(scenes):
    scenes(light=[0.0, 3.0, 4.0, 0.0])
    (light,) = SCENES.view("zdm2", (40, 30)).lights
    middle = light.corner + (light.u + light.v) / 2
    assert np.allclose(middle, 13 * np.array([0, 0.6, 0.8]))
    assert np.allclose(np.abs(np.cross(light.u, light.v)) / 1.69, [0, 0.6, 0.8])


def test_z_up(scenes):
    scenes(up=[0, 0, 1], camera={"position": [5, 0, 1], "target": [0, 0, 1], "vfov": 50})
    view = SCENES.view("zdm2", (40, 30))
    assert view.scene.up == "z" and view.camera.up.tolist() == [0, 0, 1]


def test_files_without_notes_have_default_lights(scenes, tmp_path):
    folder = scenes()
    (folder / "info.json").unlink()
    view = SCENES.view(str(folder / "scene.glb"), (40, 30))
    assert view.camera.height == 30 and len(view.lights) == 1


def test_procedural_scenes_have_their_own(monkeypatch):
    whole = benchmark_views.procedural
    monkeypatch.setattr(benchmark_views, "procedural", lambda name: whole(name, triangles=2000))
    view = SCENES.view("cellar", (40, 30))
    assert view.scene.name == "cellar" and (view.camera.width, view.camera.height) == (40, 30)


def test_what_is_not_there_is_named(scenes):
    with pytest.raises(InputError, match=r"sponza_crytek: .*zdm2.*cellar"):
        SCENES.view("sponza_crytek", (40, 30))


# --- Counts and the figures derived from them -------------------------------------------------------------------------


SIZE = 24


@pytest.fixture(scope="module")
def view() -> BenchmarkView:
    return scene_view("cellar", procedural("cellar", triangles=3000), (SIZE, SIZE))


@pytest.fixture(scope="module")
def rows(view):
    return srdh_measurements.count_view(Workload(view, PRERENDER_SPP, None), lambda text: None, (8, SIZE))[0]


def test_all_methods_find_the_same_rays_blocked(rows):
    assert {(r.method, r.pixels) for r in rows} == {
        *((m, None) for m in (*SAH_ORDERS, *METHODS)),
        *((m, k) for m in (PUBLISHED, OURS) for k in (8, SIZE)),
    }
    assert len({(r.rays, r.blocked) for r in rows}) == 1
    assert 0 < rows[0].blocked < rows[0].rays
    assert all(r.boxes[PATH] > 0 and r.boxes[FALSE] > 0 and r.tested > 0 for r in rows)


def test_order_makes_no_difference_to_rays_that_nothing_blocks(rows):
    assert len({of(rows, "cellar", order).boxes[UNOCCLUDED] for order in SAH_ORDERS}) == 1
    assert len({of(rows, "cellar", order).total for order in SAH_ORDERS}) > 1


def test_as_many_pixels_as_the_picture_has_are_all_rays(rows):
    for method in (PUBLISHED, OURS):
        assert of(rows, "cellar", method, SIZE).boxes == of(rows, "cellar", method).boxes
        assert of(rows, "cellar", method, 8).boxes != of(rows, "cellar", method).boxes


def test_trees_for_shadow_rays_are_cheaper(rows):
    assert all(srdh_measurements.saved(rows, of(rows, "cellar", m)) > 0.1 for m in METHODS)


def test_rays_start_at_what_is_seen_and_at_what_bounces_meet(view, rows):
    work = Workload(view, PRERENDER_SPP, None)
    queries = work.queries()
    assert len(queries) == 2 * len(view.lights)
    all_, some = segments_of(queries), work.representative_rays(8, work.sah).segments
    assert len(all_.origins) == rows[0].rays
    assert 0 < len(some.origins) <= 2 * 8 * 8 * PRERENDER_SPP  # surfaces, pixels, samples
    seen = {row.tobytes() for row in queries[0].origins.reshape(-1, 3)}
    from_seen = [row.tobytes() in seen for row in some.origins]
    assert any(from_seen) and not all(from_seen)


def test_what_a_lbvh_finds_is_what_the_sah_tree_finds(view):
    work = Workload(view, 1, None)
    vertices = work.triangles.vertices
    by_sah, by_lbvh = (work.representative_rays(8, bvh).among(vertices, None, work.threads) for bvh in (work.sah, None))
    assert len(by_sah.prims) > 0
    np.testing.assert_array_equal(by_sah.origins, by_lbvh.origins)
    np.testing.assert_array_equal(by_sah.first, by_lbvh.first)
    owner = np.repeat(np.arange(len(by_sah.origins)), np.diff(by_sah.first))
    assert {*zip(owner, by_sah.prims)} == {*zip(owner, by_lbvh.prims)}


def test_scenes_of_which_nothing_is_seen_are_refused(view):
    away = Camera((1e4, 1e4, 1e4), (2e4, 2e4, 2e4), width=SIZE, height=SIZE)
    with pytest.raises(InputError, match="cellar: the camera sees nothing"):
        Workload(view._replace(camera=away), 1, None)


def made_row(method, boxes, pixels=None):
    return BoxTests("room", method, pixels, 100, 10, 4, boxes, 12)


def test_shares():
    rows = [
        made_row("random", (10, 40, 50)), made_row("rtsah", (10, 20, 50)),
        made_row(PUBLISHED, (8, 7, 25)), made_row(PUBLISHED, (8, 9, 25), 16),
    ]  # fmt: skip
    best, sparse = rows[2:]
    assert srdh_measurements.relative(rows, best) == 0.4
    assert srdh_measurements.saved(rows, best) == 0.6 and srdh_measurements.saved(rows, best, "rtsah") == 0.5
    assert srdh_measurements.saved_unoccluded(rows, best) == 0.5
    assert srdh_measurements.beyond_all(rows, sparse) == pytest.approx(0.05)
    assert srdh_measurements.scenes_of(rows) == ["room"]
    assert srdh_measurements.saved_unoccluded([made_row("random", (1, 1, 0))], made_row(CONSTANT, (1, 1, 0))) == 0.0


def test_ratios_of_build_times():
    t = BuildTimes("room", 16, 100, 10, 5, sah_single=2.0, sah=1.0, rays_by_sah=0.5, published=2.5,
                   rays_by_lbvh=0.25, srdh=1.25)  # fmt: skip
    assert t.both == 2.5 and t.instead == 1.5


def test_the_papers_mean_is_what_its_text_says():
    assert round(srdh_published.both_over_sah(16), 1) == 2.4
    assert srdh_published.both_over_sah(32) > srdh_published.both_over_sah(16)


# --- RTSAH saves box tests of evenly spread lines, and the opposite order wastes some ---------------------------------


@pytest.fixture(scope="module", params=["cellar", "atrium", "blinds"])
def work(request):
    return Workload(scene_view(request.param, procedural(request.param, triangles=3000), (24, 24)), 1, None)


def test_the_order_is_right_for_its_lines(work):
    found = check_rtsah(work)
    assert found.lines < 0.97 and found.lines_reversed > 1.03
    assert 0.3 < found.rays < 3.0 and 0.3 < found.rays_reversed < 3.0


def test_lines_go_between_points_of_a_sphere_around_the_scene(work):
    query = even_lines(work.triangles)
    ends, above = segments(query)
    assert above.all() and np.prod(above.shape) > 50_000
    corners = work.triangles.vertices.reshape(-1, 3).astype(float)
    middle, reach = (corners.min(0) + corners.max(0)) / 2, np.linalg.norm(np.ptp(corners, axis=0)) / 2
    for points in query.origins, ends:
        away = np.linalg.norm(points - middle, axis=-1)
        np.testing.assert_allclose(away, 1.002 * reach, rtol=1e-3)


def test_the_opposite_order_is_the_same_tree(work):
    vertices = work.triangles.vertices
    bvh = binned_sah.build(vertices, 1)
    turned = opposite(bvh)
    validate(turned, vertices)
    np.testing.assert_array_equal(turned.links[:, 12], bvh.links[:, 13])
    np.testing.assert_array_equal(opposite(turned).nodes, bvh.nodes)
