"""The animation of Table 4: all triangles above the ground move, and so does the camera."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.accelerator import Accelerator
from antumbra.lab.papers.pre_bvh_culling.culling_measurements import (
    OURS,
    PUBLISHED,
    REGION,
    USUAL,
    CullingEffort,
    GridRow,
    figure_times,
    grid_rows,
    mean_rows,
)
from antumbra.lab.papers.pre_bvh_culling.culling_views import CullingView, video_views
from antumbra.picture.renderer import Renderer

EFFORT = CullingEffort(threads=2, rounds=1, limit=1.0, say=lambda text: None)


@pytest.fixture(scope="module")
def views():
    return video_views(6000, 4, (32, 24))


def test_everything_above_the_ground_moves(views):
    first, second = (view.scene.triangles(view.time).vertices for view in views[:2])
    assert first.shape == second.shape and views[0].scene.animated
    above = first.min(1)[:, 1] > first[:, :, 1].min() + 1.0
    moved = np.abs(first - second).max((1, 2)) > 0.0
    assert moved[above].mean() > 0.99 and above.mean() > 0.2
    places = {tuple(view.camera.position) for view in views}
    assert len(places) == len({view.time for view in views}) == 4


@pytest.mark.parametrize("plan", ["grid32+lbvh+multifrusta", "grid32+bsah+refit+single", "grid32:convex+lbvh+single"])
def test_no_plan_changes_a_bit(views, plan):
    one, other = (Renderer(views[0].scene, name) for name in ("bsah+single", plan))
    blocked = []
    for view in views:
        a, b = (r.render(view.camera, view.lights, spp=4, time=view.time) for r in (one, other))
        np.testing.assert_array_equal(a.bits[0], b.bits[0])
        blocked.append(a.bits[0].any())
    assert sum(blocked) >= 3


def test_every_picture_builds_its_tree():
    """A renderer keeps the tree of a still scene; the paper's scenes change."""
    scene = at.procedural("blinds", triangles=2000)
    view, built = CullingView("blinds", scene, scene.cameras[0].resized(24, 16), list(scene.lights)), []
    execute = Accelerator.execute
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Accelerator, "execute", lambda self, *args: built.append(self) or execute(self, *args))
        rows, _ = figure_times(view, "single", EFFORT._replace(rounds=3))
    assert len(rows) == 3 and len(built) == 3 * 3


def test_a_convex_region_leaves_the_most(views):
    rows = grid_rows(views[-1], USUAL, (), EFFORT)
    left = {row.marked: row.remaining for row in rows}
    assert set(left) == {OURS, PUBLISHED, REGION} and 0 < left[OURS] <= left[REGION] <= 1
    assert all(row.build == row.trace == {} for row in rows)


def test_means():
    row = lambda grid, left, ms: GridRow("video", grid, OURS, left, {"mark": ms}, {"lbvh+single": 2 * ms}, {})
    mean, other = mean_rows([row(16, 0.5, 1.0), row(32, 0.25, 4.0), row(16, 0.25, 3.0)])
    assert mean == ("mean", 16, OURS, 0.375, {"mark": 2.0}, {"lbvh+single": 4.0}, {}, 2)
    assert other.grid == 32 and other.steps == {"mark": 4.0} and other.views == 1


def test_the_still_scene_stays(views):
    still = at.procedural("city", triangles=6000)
    np.testing.assert_array_equal(views[0].scene.triangles(0.0).vertices, still.triangles().vertices)
