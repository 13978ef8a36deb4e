"""The benchmark of SRDH: its rays, its counts, and the figures derived from them."""

import numpy as np
import pytest

from antumbra.engine.scene import procedural
from antumbra.errors import InputError
from antumbra.papers.benchmark_views import BenchmarkView, scene_view
from antumbra.papers.srdh import srdh_measurements as srdh
from antumbra.papers.srdh import srdh_tables as published_srdh
from antumbra.papers.srdh.srdh_measurements import (
    CONSTANT,
    METHODS,
    OURS,
    PRERENDER_SPP,
    PUBLISHED,
    SAH_ORDERS,
    BoxTests,
    BuildTimes,
    Workload,
    of,
)
from antumbra.scene.camera import Camera
from antumbra.techniques.srdh.representative_rays import segments_of
from antumbra.trace.rays.single_rays import FALSE, PATH, UNOCCLUDED

SIZE = 24


@pytest.fixture(scope="module")
def view() -> BenchmarkView:
    return scene_view("cellar", procedural("cellar", triangles=3000), (SIZE, SIZE))


@pytest.fixture(scope="module")
def rows(view):
    return srdh.count_view(Workload(view, PRERENDER_SPP, None), lambda text: None, (8, SIZE))


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
    assert all(srdh.saved(rows, of(rows, "cellar", m)) > 0.1 for m in METHODS)


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
    assert srdh.relative(rows, best) == 0.4
    assert srdh.saved(rows, best) == 0.6 and srdh.saved(rows, best, "rtsah") == 0.5
    assert srdh.saved_unoccluded(rows, best) == 0.5
    assert srdh.beyond_all(rows, sparse) == pytest.approx(0.05)
    assert srdh.scenes_of(rows) == ["room"]
    assert srdh.saved_unoccluded([made_row("random", (1, 1, 0))], made_row(CONSTANT, (1, 1, 0))) == 0.0


def test_ratios_of_build_times():
    t = BuildTimes("room", 16, 100, 10, 5, sah_single=2.0, sah=1.0, rays_by_sah=0.5, published=2.5,
                   rays_by_lbvh=0.25, srdh=1.25)  # fmt: skip
    assert t.both == 2.5 and t.instead == 1.5


def test_the_papers_mean_is_what_its_text_says():
    assert round(published_srdh.both_over_sah(16), 1) == 2.4
    assert published_srdh.both_over_sah(32) > published_srdh.both_over_sah(16)
