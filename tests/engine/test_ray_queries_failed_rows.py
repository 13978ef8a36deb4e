"""A bad ray or point fails alone where its answer is a number, which is NaN; others refuse the call."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import Plan, covering_plans

SCENE = at.procedural("atrium", triangles=2000)
BALL = at.load(pytest.importorskip("trimesh").creation.icosphere(2))
RNG = np.random.default_rng(3)
ORIGINS, DIRECTIONS = RNG.uniform(*SCENE.bounds, (40, 3)), RNG.normal(size=(40, 3))
BAD = {"NaN": np.nan, "infinite": np.inf, "beyond float32": 1e39}
FAILED = [0, 5, 39]
PLANS = [None, *(p for p in covering_plans() if p == Plan(trace=p.trace))]


def spoilt(rows, value, column=1):
    """A copy of the rows in which those of `FAILED` hold a bad number."""
    rows = rows.copy()
    rows[FAILED, column] = value
    return rows


def same_but_failed(found, alone):
    """Check that rows are marked, and others those of the call without bad numbers."""
    good = np.setdiff1d(np.arange(40), FAILED)
    for name in ("t", "face", "u", "v", "position", "normal", "object", "corners"):
        np.testing.assert_array_equal(getattr(found, name)[good], getattr(alone, name)[good], name)
    assert np.isnan(found.t[FAILED]).all() and not np.isnan(found.t[good]).any() and alone.mask[FAILED].any()
    assert (found.face[FAILED] == -1).all() and not found.mask[FAILED].any() and (found.object[FAILED] == -1).all()
    for name in ("position", "normal", "corners"):
        assert np.isnan(getattr(found, name)[FAILED]).all()


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_a_bad_ray_fails_alone_in_every_plan(plan, bad):
    engine = SCENE.engine.with_options(plan, 2, None)
    alone = engine.closest_hit(ORIGINS, DIRECTIONS)
    same_but_failed(engine.closest_hit(spoilt(ORIGINS, BAD[bad]), DIRECTIONS), alone)
    same_but_failed(engine.closest_hit(ORIGINS, spoilt(DIRECTIONS, BAD[bad])), alone)


def test_a_zero_direction_fails_alone_in_stores_and_instances(tmp_path):
    triangles = SCENE.triangles()
    copies = at.Scene.from_instances([triangles.vertices + triangles.origin], [np.eye(4)[None]])
    at.build_store(SCENE, tmp_path / "a.antumbra")
    directions = spoilt(DIRECTIONS, 0.0, slice(None))
    for scene in (SCENE, copies, at.load(tmp_path / "a.antumbra")):
        same_but_failed(scene.closest_hit(ORIGINS, directions), scene.closest_hit(ORIGINS, DIRECTIONS))


def test_rays_of_any_shape_fail_alone():
    origins = ORIGINS.reshape(5, 8, 3).copy()
    origins[2, 3, 0] = np.nan
    hit = SCENE.closest_hit(origins, (0.0, -1.0, 0.0), tmax=np.full((5, 8), 50.0), skip_face=np.full(8, -1))
    assert hit.t.shape == (5, 8) and np.argwhere(np.isnan(hit.t)).tolist() == [[2, 3]] and hit.mask.any()
    rows = SCENE.closest_hit(ORIGINS[:2], [[0, 0, 0], [0, -1, 0]])
    assert np.isnan(rows.t).tolist() == [True, False]


@pytest.mark.parametrize("bad", BAD)
def test_a_bad_point_fails_alone(bad):
    points = RNG.uniform(-1.5, 1.5, (40, 3))
    found, alone = BALL.closest_points(spoilt(points, BAD[bad])), BALL.closest_points(points)
    signed = BALL.signed_distance(spoilt(points, BAD[bad]))
    good = np.setdiff1d(np.arange(40), FAILED)
    for one, other in zip(found, alone):
        np.testing.assert_array_equal(one[good], other[good])
    np.testing.assert_array_equal(signed[good], BALL.signed_distance(points)[good])
    assert (signed[good] < 0).any() and (signed[good] > 0).any()
    assert np.isnan(found.distance[FAILED]).all() and np.isnan(signed[FAILED]).all()
    assert np.isnan(found.position[FAILED]).all() and (found.face[FAILED] == -1).all()


def test_answers_that_cannot_be_marked_refuse_the_call():
    origins, points = spoilt(ORIGINS, np.nan), spoilt(ORIGINS, np.inf)
    for query in (SCENE.occluded, SCENE.count_hits, SCENE.all_hits):
        with pytest.raises(at.InputError, match=r"NaN or infinity, or are beyond float32 \(ray 0\)"):
            query(origins, DIRECTIONS)
    with pytest.raises(at.InputError, match=r"\(point 0\)"):
        BALL.contains(points)


def test_calls_of_which_nothing_remains_are_refused():
    for origins, directions, words in (
        (ORIGINS * np.nan, DIRECTIONS, "origins hold NaN"), (ORIGINS, 0.0 * DIRECTIONS, "zero"),
        (ORIGINS[0], [0.0, np.inf, 0.0], "directions hold NaN"),
    ):  # fmt: skip
        with pytest.raises(at.InputError, match=words):
            SCENE.closest_hit(origins, directions)
    with pytest.raises(at.InputError, match="tmin"):
        SCENE.closest_hit(spoilt(ORIGINS, np.nan), DIRECTIONS, tmin=-1.0)
    for query in (BALL.closest_points, BALL.signed_distance):
        with pytest.raises(at.InputError, match="NaN"):
            query(ORIGINS * np.nan)
