"""The frame of the page."""

import numpy as np
import pytest

import antumbra as at
from antumbra.viewer.viewer_model import RADIUS, PageFrame, rotation_matrix

CORNERS = np.array([[[5e5, 5.8e6, 3.0], [5e5 + 80, 5.8e6, 3.0], [5e5, 5.8e6 + 60, 3.0]]])


@pytest.fixture
def stage():
    return PageFrame.of(at.Scene.from_arrays(CORNERS, up="z"))


def test_a_scene_far_away_is_around_zero(stage):
    page = stage.to_page(CORNERS[0])
    assert np.abs(page).max() <= RADIUS and np.linalg.norm(page[1] - page[2]) == pytest.approx(2 * RADIUS)
    np.testing.assert_allclose(stage.to_world(page), CORNERS[0], rtol=0, atol=1e-8)
    assert stage.up.tolist() == [0, 0, 1]


def test_cameras_go_to_the_page_and_back(stage):
    camera = at.Camera((5e5, 5.8e6, 90.0), (5e5 + 40, 5.8e6, 0.0), (0, 0, 1), 35.0, 300, 200)
    there = stage.camera(stage.pose(camera))
    np.testing.assert_allclose(there.position, camera.position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(there.target, camera.target, rtol=0, atol=1e-8)
    assert (there.width, there.height, there.vfov) == (300, 200, pytest.approx(35.0))


def test_within_the_scene_the_pivot_comes_near():
    scene = at.Scene.from_arrays(np.array([[[-9, -9, -9], [9, 9, 9], [9, -9, 0.0]]]))
    stage = PageFrame.of(scene)
    pivot = lambda at_x: stage.first_pose(at.Camera((at_x, 0, 0), (at_x - 4, 0, 0))).target[0] / stage.scale
    assert pivot(0.0) == pytest.approx(-1.0) and pivot(30.0) == pytest.approx(26.0)


def test_quaternions_turn():
    half = np.sqrt(0.5)
    np.testing.assert_allclose(rotation_matrix(np.array([half, 0, 0, half])) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation_matrix(np.array([0.5, 0.5, 0.5, 0.5])) @ [1, 2, 3], [3, 1, 2], atol=1e-15)
