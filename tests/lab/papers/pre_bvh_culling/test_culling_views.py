"""The views of the paper, and random views beside them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.lab.papers.pre_bvh_culling.culling_measurements import (
    OURS,
    PUBLISHED,
    REGION,
    CullingEffort,
    RandomShares,
    random_shares,
    remaining_shares,
)
from antumbra.lab.papers.pre_bvh_culling.culling_published import REMAINING
from antumbra.lab.papers.pre_bvh_culling.culling_views import culling_views, random_views
from scenes import scene_path

SIZE = 64, 36


@pytest.fixture(scope="module")
def box():
    """A closed box as large as Sponza."""
    corners = np.array([[x, y, z] for x in (-1900, 1800) for y in (-120, 1430) for z in (-1180, 1100)], float)
    faces = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
    ]
    return at.Scene.from_arrays(corners, np.array([*faces, [1, 5, 7], [1, 7, 3]]))


def test_random_views_are_the_same_in_every_run(box):
    views, again = (random_views(box, 5, SIZE) for _ in range(2))
    assert [v.figure for v in views] == 5 * ["court"] + 5 * ["gallery"]
    places = np.array([v.camera.position for v in views])
    np.testing.assert_array_equal(places, [v.camera.position for v in again])
    assert len(np.unique(places, axis=0)) == 10 and (np.abs(places[5:, 2]) >= 280).all()
    assert (places[5:, 2] > 0).any() and (places[5:, 2] < 0).any()
    ahead = np.array([v.camera.target for v in views]) - places
    assert (np.abs(ahead[:, 1]) <= 100 * np.sin(np.radians(20)) + 1e-6).all()


def test_the_views_of_sponza_share_their_lights(box):
    *sponza, cellar = culling_views(box, SIZE, 2000)
    assert [v.figure for v in sponza] == ["Figure 3", "Figure 4", "Figure 5"] and cellar.figure == "Figure 6"
    above, behind = sponza[0].lights
    assert all(v.lights == [above, behind] for v in sponza)
    position, target = (np.asarray(p, float) for p in (sponza[0].camera.position, sponza[0].camera.target))
    assert (behind.corner + behind.u / 2 + behind.v / 2 - position) @ (target - position) < 0


def test_shares_of_random_views(box):
    rows = random_shares(random_views(box, 3, SIZE), CullingEffort(2, 1, 1.0, lambda text: None))
    assert {(r.part, r.marked) for r in rows} == {
        (p, m) for p in ("court", "gallery") for m in (PUBLISHED, OURS, REGION)
    }
    assert all(len(r.shares) == 3 and 0 <= min(r.shares) <= r.quartiles[1] <= 1 for r in rows)
    assert all(min(r.shares) > 0 for r in rows if r.marked == PUBLISHED)
    assert RandomShares("court", OURS, [0.5, 0.1, 0.3]).quartiles == pytest.approx([0.2, 0.3, 0.4])


def test_what_is_left_in_sponza_is_about_what_the_captions_state():
    scene = at.load(scene_path("sponza_crytek/scene.glb"))
    for view in culling_views(scene, (160, 90), 2000)[:3]:
        left = remaining_shares(view, 2)
        assert abs(left[PUBLISHED] - REMAINING[view.figure]) < 0.06 and left[OURS] < left[PUBLISHED]
