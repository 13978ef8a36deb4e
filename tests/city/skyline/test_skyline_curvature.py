"""Skylines over a curved earth: the closed form of far walls, and bounds near each azimuth."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.curved_earth import Earth, lowered_scene

RADIUS, K = 6_371_000.0, 0.13
DROP = (1.0 - K) / (2.0 * RADIUS)


def far_walls(up, height=900.0):
    """Walls of 900 m, 40 km to the north and 25 km to the east of the origin, and flat ground between them."""
    north = [[-9e3, 40e3, 0], [9e3, 40e3, 0], [9e3, 40e3, height], [-9e3, 40e3, height]]
    east = [[25e3, -9e3, 0], [25e3, 9e3, 0], [25e3, 9e3, height], [25e3, -9e3, height]]
    corners = np.array(north + east, float)
    corners = corners if up == "z" else np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], 1)
    return at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], up=up)


@pytest.mark.parametrize("up", ["y", "z"])
def test_far_walls_stand_lower_by_their_drop(up):
    eyes = np.array([[0.0, 0.0, 2.0], [-3_000.0, 5_000.0, 150.0], [8_000.0, -6_000.0, 30.0]])
    points = eyes if up == "z" else np.stack([eyes[:, 0], eyes[:, 2], -eyes[:, 1]], 1)
    found = at.skyline(far_walls(up), points, azimuth_step=90.0, curvature=True, refraction=K)
    for column, distance in ((0, 40e3 - eyes[:, 1]), (1, 25e3 - eyes[:, 0])):
        expected = np.degrees(np.arctan((900.0 - eyes[:, 2]) / distance - DROP * distance))
        assert np.abs(found.elevation[:, column] - expected).max() < 2e-6
    assert (found.elevation[:, 2:] == -90.0).all() and found.about["refraction"] == K
    flat = at.skyline(far_walls(up), points, azimuth_step=90.0)
    assert (flat.elevation[:, :2] - found.elevation[:, :2] > 0.06).all() and "refraction" not in flat.about


def test_the_highest_of_a_bin_stays_an_upper_bound():
    scene, rng = far_walls("z"), np.random.default_rng(1)
    for eye in rng.uniform([-8e3, -8e3, 1.0], [8e3, 8e3, 400.0], (3, 3)):
        found = at.skyline(scene, eye[None], azimuth_step=5.0, curvature=True, refraction=K)
        own = at.skyline(lowered_scene(scene, Earth(DROP, eye, 2)), eye[None], azimuth_step=5.0)
        there = own.highest > -90.0
        assert np.abs(found.elevation - own.elevation)[own.elevation > -90.0].max() < 1e-4
        over = (found.highest - own.highest)[there]
        assert over.min() > -1e-4 and over.max() < 0.02 and there.sum() > 8
