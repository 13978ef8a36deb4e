"""Where points lie in pictures: the inverse of a camera's rays."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.false_colours import project_points

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
