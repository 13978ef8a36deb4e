"""Least visible heights over rasters of heights: exact lines of sight just above and below, and closed forms."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import antumbra as at
from strength import examples
from terrain_scenes import PLACE, rasters, scene_of

LEVELS = [0.0, 0.0, 0.25, 1.0, 3.0, 9.0]
HEIGHTS, HEIGHTS_WITH_HOLES = rasters(22, 22, LEVELS), rasters(22, 22, [*LEVELS, np.nan])
SLACK = 2e-3  # float32 rounding of coordinates, at a slope of the steepest edge
TREE = "bsah+wide"
PEAK_BETWEEN_HOLES = np.zeros((21, 18))
PEAK_BETWEEN_HOLES[3:6, 15] = np.nan, 3.0, np.nan
PEAK = np.nan_to_num(PEAK_BETWEEN_HOLES)


def least(scene, eyes, **options):
    """(n,) heights, and (n, 3) cells."""
    table = at.viewshed(scene, "raster", eyes, least_height=True, **options).table
    return table["least_height"], table.sensors.points


def seen_at(scene, points, eye):
    """(n,) bool: exact lines of sight."""
    there = at.visibility(scene, points, at.PointLights(np.atleast_2d(eye)), plan=TREE)
    return there.seen_samples.reshape(-1)


def bounds_of_heights(scene, cells, eye):
    """Two (n,) arrays about the least z over the cells, from every edge in plan; free ends of edges may differ."""
    triangles = scene.triangles().vertices.astype(np.float64) + scene.origin
    first, last = triangles.reshape(-1, 3), np.roll(triangles, -1, 1).reshape(-1, 3)
    along = last - first
    lower, upper = np.empty(len(cells)), np.empty(len(cells))
    for i, cell in enumerate(cells):
        to_eye, off = eye - cell, first - cell
        cross = to_eye[0] * along[:, 1] - to_eye[1] * along[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (off[:, 0] * along[:, 1] - off[:, 1] * along[:, 0]) / cross
            u = (off[:, 0] * to_eye[1] - off[:, 1] * to_eye[0]) / cross
        needs = (first[:, 2] + u * along[:, 2] - eye[2] * t) / (1.0 - t)
        for bound, margin in ((lower, 1e-9), (upper, -1e-9)):
            crosses = (cross != 0.0) & (u >= margin) & (u <= 1.0 - margin) & (t > margin) & (t < 1.0 - 1e-9)
            bound[i] = max([cell[2], *needs[crosses]])
    return lower, upper


@examples(60)
@given(heights=HEIGHTS | HEIGHTS_WITH_HOLES, seed=st.integers(0, 10_000))
@example(heights=PEAK_BETWEEN_HOLES, seed=1173)
@example(heights=PEAK, seed=1173)
def test_cells_are_seen_just_above_and_hidden_just_below(heights, seed):
    scene, random = scene_of(heights), np.random.default_rng(seed)
    if scene is None:
        return
    eye = random.uniform(scene.bounds[0] - [3, 3, 0], scene.bounds[1] + [3, 3, 0])
    eye[2] = random.choice([9.5, 12.0, 30.0])
    found, cells = least(scene, eye)
    there = ~np.isnan(heights.reshape(-1))
    assert (np.isnan(found) == ~there).all() and (found[there] >= 0.0).all()
    cells[:, 2] = heights.reshape(-1)
    lower, upper = bounds_of_heights(scene, cells[there], eye)
    z = (cells[:, 2] + found)[there]
    assert (z >= lower - 1e-4).all() and (z <= upper + 1e-4).all()
    over = cells + np.stack([0.0 * found, 0.0 * found, found], 1)
    assert seen_at(scene, over[there] + [0.0, 0.0, SLACK], eye).all()
    raised = found > 2.0 * SLACK
    if there.all() and raised.any():  # beside a hole, lines of sight also pass below the surface
        assert not seen_at(scene, over[raised] - [0.0, 0.0, SLACK], eye).any()


def test_heights_of_a_larger_surface():
    y, x = np.mgrid[:150, :170]
    random = np.random.default_rng(0)
    heights = 20.0 * np.sin(x / 11.0) * np.cos(y / 9.0) + random.normal(size=x.shape)
    scene = at.from_raster((heights, PLACE))
    eye = np.array([84101.3, 445890.7, 0.0])
    found, _ = least(scene, eye, on_surface=True, eye_height=2.0)
    seen = at.viewshed(scene, "raster", eye, on_surface=True, eye_height=2.0)
    cells = at.sensors_of("raster", scene).points
    raised = found > 0.02
    assert 0.3 < raised.mean() < 0.999
    for shift, expected in ((-0.01, False), (0.01, True)):
        over = cells[raised] + np.stack([0.0 * found, 0.0 * found, found + shift], 1)[raised]
        assert (seen_at(scene, over, seen.observers[0]) == expected).all()
    assert not seen.table["seen"][raised].any()


def test_a_wall_casts_a_closed_form():
    """Behind a wall of the height w at the distance d, a cell at the distance x needs e + (w - e) x / d."""
    heights = np.zeros((5, 60))
    heights[:, 20] = 10.0
    scene = at.from_raster((heights, PLACE))
    eye = (84001.0, 446000.0 - 5.0, 4.0)  # over column 0, row 2
    found = least(scene, eye)[0].reshape(5, 60)[2]
    x = 2.0 * np.arange(60)
    assert np.allclose(found[21:], 4.0 + 6.0 * x[21:] / 40.0, atol=1e-5)
    assert (found[:19] == 0.0).all() and found[20] == 0.0


def test_the_curved_earth_lowers_far_cells():
    heights = np.zeros((3, 2000))
    scene = at.from_raster((heights, (50.0, 0.0, 0.0, 0.0, -50.0, 0.0)))
    found = least(scene, (25.0, -75.0, 2.0), curvature=True, refraction=0.13)[0].reshape(3, 2000)[1]
    drop, x = (1.0 - 0.13) / (2.0 * 6_371_000.0), 50.0 * np.arange(2000)
    horizon = np.sqrt(2.0 / drop)
    expected = np.where(x > horizon, drop * (x - horizon) ** 2, 0.0)
    assert found[-1] > 500.0 and np.allclose(found, expected, rtol=1e-3, atol=0.06)


def test_the_least_of_several_observers_within_their_limits():
    heights = np.zeros((5, 60))
    heights[:, 20] = 10.0
    scene = at.from_raster((heights, PLACE))
    west, east = (84001.0, 445995.0, 4.0), (84119.0, 445995.0, 4.0)
    one, other, both = (least(scene, eyes)[0] for eyes in (west, east, [west, east]))
    assert (both == np.minimum(one, other)).all() and (both < one).any() and (both < other).any()
    near = least(scene, west, max_distance=30.0)[0].reshape(5, 60)[2]
    assert np.isnan(near[17:]).all() and (near[:14] == 0.0).all()
    buried = least(scene, (84041.0, 445995.0, 4.0))[0]
    assert np.isnan(buried).all()


@pytest.mark.parametrize(
    "scene, sensors",
    [
        (at.procedural("city", triangles=2000), [[0.0, 0.0, 0.0]]),
        (at.from_raster((np.zeros((4, 4)), PLACE)), "raster:1"),
    ],
    ids=["triangles", "other cells"],
)
def test_other_scenes_and_cells_have_no_least_heights(scene, sensors):
    with pytest.raises(at.InputError, match="single raster of heights"):
        at.viewshed(scene, sensors, (0.0, 9.0, 9.0), least_height=True)
