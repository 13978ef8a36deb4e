"""Where points lie in pictures: the inverse of a camera's rays."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.false_colours import false_colours, project_points

CAMERAS = [
    at.Camera((3, 4, 5), (0, 1, 0), width=60, height=40),
    at.Camera((3, 4, 5), (0, 1, 0), width=60, height=40, projection="orthographic", extent=4.0),
    at.Camera((3, 4, 5), (0, 1, 0), width=60, height=40, projection="panoramic"),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.projection)
def test_points_on_a_pixels_ray_lie_in_it(camera):
    places = np.random.default_rng(2).uniform((0, 0), (60, 40), (50, 2))
    if camera.listed:
        origins, directions = camera.view(np.zeros(3)).through(*places.T)
    else:
        origins, directions = camera.position, camera.rays(np.zeros(3)).directions(*places.T)
    np.testing.assert_allclose(project_points(camera, origins + 7.0 * directions), places, atol=1e-3)
    behind = project_points(camera, camera.position - (camera.target - camera.position)[None])
    assert np.isnan(behind).all() or camera.projection == "panoramic"


@pytest.mark.parametrize("sensors", ["face", "grid:0.5"])
def test_surfaces_that_a_study_leaves_out_are_grey(sensors):
    """A floor and a wall that meet: without the wall's sensors, the wall does not take the colours of the floor."""
    floor = np.array([[[0.0, 0, 0], [9, 0, 0], [9, 9, 0]], [[0, 0, 0], [9, 9, 0], [0, 9, 0]]])
    wall = floor[..., [0, 2, 1]][:, ::-1] + (0, 9, 0)
    scene = at.Scene.from_arrays(np.concatenate([floor, wall]), up="z")
    table = at.sun_hours(scene, sensors, "2026-06-21", place=at.Place(52.0, 4.4), tilt="0:45")
    assert set(table.sensors.faces) == {0, 1}
    table.camera = at.Camera((4.5, -9.0, 9.0), (4.5, 9.0, 3.0), (0, 0, 1), width=64, height=48)
    picture = false_colours(table, "sun_hours")
    assert np.ptp(picture[45, 45].astype(int)) == 0 < np.ptp(picture[66, 45].astype(int))
