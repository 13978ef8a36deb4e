"""Ray lists over terrain: the bits of brute force and of trees, for rays of all origins, directions and intervals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.engine.sources import terrain_shadows
from strength import examples
from terrain_scenes import PLACE, rasters, scene_of

HEIGHTS = rasters(18, 21, [0.0, 0.0, 0.25, 1.0, 3.0, 9.0, np.nan])
TREE = "bsah+wide"


@pytest.fixture(autouse=True, scope="module")
def _terrain_only():
    """No tree follows, however many rays there are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terrain_shadows, "build_seconds", lambda *_: np.inf)
        yield


def rays_in(scene, random, n=300):
    """Origins and directions, (n, 3) each: in, on, below and beside the surface; many along axes and diagonals."""
    low, high = scene.bounds
    grown = 3.0 + np.ptp(scene.bounds, axis=0).max()
    origins = random.uniform(low - grown, high + grown, (n, 3))
    origins[::2] = random.uniform(low - 1.0, high + 1.0, (len(origins[::2]), 3))
    vertices = scene.triangles().vertices.reshape(-1, 3).astype(np.float64) + scene.origin
    origins[::5] = vertices[random.integers(len(vertices), size=len(origins[::5]))]
    origins[::10, 2] += 2.0
    directions = random.normal(size=(n, 3)) * [1.0, 1.0, 0.4]
    directions[::3] = random.integers(-2, 3, (len(directions[::3]), 3))
    directions[~directions.any(1)] = 0.0, 0.0, -1.0
    aimed = slice(1, None, 4)
    directions[aimed] = vertices[random.integers(len(vertices), size=len(origins[aimed]))] - origins[aimed]
    directions[~directions.any(1)] = 0.0, 0.0, 1.0
    return origins, directions * 10.0 ** random.integers(-6, 7, (n, 1))


def in_frame(scene, origins, directions):
    return (origins - scene.origin).astype(np.float32), directions.astype(np.float32)


@examples(60)
@given(HEIGHTS, st.integers(0, 10_000))
def test_bits_are_those_of_trees_and_of_brute_force(heights, seed):
    scene, random = scene_of(heights), np.random.default_rng(seed)
    if scene is None:
        return
    origins, directions = rays_in(scene, random)
    n, length = len(origins), np.linalg.norm(directions, axis=1)
    tmin = np.where(random.random(n) < 0.5, 0.0, random.exponential(3.0, n)) / length
    tmax = np.where(random.random(n) < 0.5, np.inf, tmin + random.exponential(9.0, n) / length)
    trees = at.Engine(scene.data, plan=TREE)
    for facing in None, "front", "back":
        blocked = scene.occluded(origins, directions, tmin, tmax, cull_faces=facing)
        assert (blocked == trees.occluded(origins, directions, tmin, tmax, cull_faces=facing)).all()
    blocked = scene.occluded(origins, directions, tmin, tmax)
    expected = oracle.occluded(scene.triangles().vertices, *in_frame(scene, origins, directions), None, tmin, tmax)
    assert (blocked == expected).all()
    targets = np.concatenate([origins[1:], origins[:1]])
    targets[::7] = origins[::7]  # empty segments are not blocked
    blocked = scene.occluded(origins, targets=targets)
    assert (blocked == trees.occluded(origins, targets=targets)).all() and not blocked[::7].any()
    for facing in None, "front", "back":
        hit, nearest = (each.closest_hit(origins, directions, tmin, tmax, cull_faces=facing) for each in (scene, trees))
        for name in "mask", "t", "face", "u", "v", "normal", "position":
            one, other = (np.asarray(getattr(each, name)) for each in (hit, nearest))
            assert one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True), name
    hit = scene.closest_hit(origins, directions, tmin, tmax)
    t, face = oracle.closest_hit(scene.triangles().vertices, *in_frame(scene, origins, directions), tmin, tmax)
    assert (hit.face == face).all() and (hit.t == t).all()
    assert scene.engine.source.ray_lists.plan is None  # no tree was built


def hills():
    heights = np.random.default_rng(3).integers(0, 20, (40, 50)) / 4.0
    heights[5:9, 30:40] = np.nan
    return at.from_raster((heights, PLACE))


def test_both_outcomes_occur_and_one_ray_is_a_question_too():
    scene = hills()
    blocked = scene.occluded(*rays_in(scene, np.random.default_rng(1), 2000))
    assert 300 < blocked.sum() < 1700 and scene.engine.terrain.pyramid._tree is not None
    high = [84050.0, 445960.0, 90.0]
    assert scene.occluded(high, [0.0, 0.0, -1e-30]) and not scene.occluded(high, [0.0, 0.0, 1e30])
    assert not scene.occluded(high, [0.0, 0.0, -1.0], tmax=80.0) and not scene.occluded(high, [0.0, 1.0, 0.0])
    assert scene.occluded(np.broadcast_to(high, (4, 5, 3)), [0.0, 0.0, -2.0]).shape == (4, 5)
    assert scene.occluded(np.empty((0, 3)), [0.0, 0.0, -2.0]).shape == (0,)


def test_trees_answer_what_the_pyramid_does_not(monkeypatch):
    scene = hills()
    rays = rays_in(scene, np.random.default_rng(5), 400)
    expected = at.Engine(scene.data, plan=TREE).occluded(*rays)
    far = rays[0].copy()
    far[0] = 84050.0, 445960.0, 1e12  # beyond the squares that float64 resolves
    at_once = {
        "skipped faces": lambda each: each.occluded(*rays, skip_face=np.full(400, 3)),
        "far rays": lambda each: each.occluded(far, rays[1]),
        "another plan": lambda each: at.Engine(each.data, plan="lbvh+wide").occluded(*rays),
        "all hits": lambda each: each.all_hits(*rays),
        "after all hits": lambda each: (each.all_hits(*rays), each.closest_hit(*rays)),
    }
    for name, ask in at_once.items():
        other = hills()
        ask(other)
        assert other.engine.terrain.pyramid._tree is None, name
    monkeypatch.setattr(terrain_shadows, "_LISTED", 150)
    for seconds in np.inf, 0.0:
        monkeypatch.setattr(terrain_shadows, "build_seconds", lambda *_, seconds=seconds: seconds)
        scene = hills()
        for _ in range(2):
            assert (scene.occluded(*rays) == expected).all()
        assert scene.engine.terrain.pyramid._tree is not None  # the first rays at least
        assert (scene.engine.source.ray_lists.plan is None) == (seconds > 0.0)
    monkeypatch.setattr(terrain_shadows, "_SHARE", 0.0)  # no room for a tree
    scene = hills()
    assert (scene.occluded(*rays) == expected).all() and scene.engine.source.ray_lists.plan is None


@pytest.mark.parametrize(
    "rays, words",
    [
        (([np.nan, 0, 0], [0, 0, 1]), "origins hold NaN"),
        (([84000.0, 446000, 0], [0, 0, 0]), "direction of ray 0 is zero"),
        (([84000.0, 446000, 0], [0, 0, 1], -1.0), "tmin must be finite and not negative"),
        (([84000.0, 446000, 0], [0, 0, 1], 0.0, np.nan), "tmax is NaN"),
        (([84000.0, 446000, 0], [0, 0, 1e39]), "directions hold NaN or infinity"),
    ],
)
def test_faulty_rays_are_refused(rays, words):
    with pytest.raises(at.InputError, match=words):
        hills().occluded(*rays)
