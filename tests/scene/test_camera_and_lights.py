"""Cameras and lights: rays through pixels, and arguments that make no sense."""

import numpy as np
import pytest

import antumbra as at


def test_rays_go_through_pixel_centres():
    camera = at.Camera((1, 2, 3), (1, 2, -7), vfov=90, width=8, height=4)
    rays = camera.rays((1, 1, 1))
    np.testing.assert_array_equal(rays.origin, np.float32([0, 1, 2]))
    d = lambda x, y: rays.corner + (x + 0.5) * rays.dx + (y + 0.5) * rays.dy
    np.testing.assert_allclose(d(3.5, 1.5), (0, 0, -1), atol=1e-12)  # the middle, along the view axis
    np.testing.assert_allclose(d(-0.5, -0.5), (-2, 1, -1), atol=1e-12)  # upper left corner: 90 degrees high, 2:1
    np.testing.assert_allclose(d(7.5, 3.5), (2, -1, -1), atol=1e-12)


def test_z_up():
    rays = at.Camera((0, -5, 1), (0, 0, 1), up=(0, 0, 1), width=3, height=3).rays(np.zeros(3))
    assert rays.dx[0] > 0 and rays.dy[2] < 0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (dict(target=(0, 0, 0)), "target"),
        (dict(up=(0, 0, 2)), "up"),
        (dict(up=(0, 0, 0)), "up"),
        (dict(vfov=0), "vfov"),
        (dict(vfov=180), "vfov"),
        (dict(vfov=float("nan")), "vfov"),
        (dict(width=0), "width"),
        (dict(height=1.5), "height"),
        (dict(height=40000), "height"),
        (dict(position=(0, 0)), "position"),
        (dict(position=(0, np.nan, 0)), "position"),
        (dict(target="north"), "target"),
    ],
)
def test_bad_cameras(change, says):
    with pytest.raises(at.InputError, match=says):
        at.Camera(**(dict(position=(0, 0, 0), target=(0, 0, -1)) | change))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: at.QuadLight((0, 0, 0), (1, 0, 0), (2, 0, 0)), "no area"),
        (lambda: at.QuadLight((0, 0, 0), (1, 0, 0), (0, 0, 0)), "no area"),
        (lambda: at.QuadLight((0, 0), (1, 0, 0), (0, 1, 0)), "corner"),
        (lambda: at.DiskLight((0, 0, 0), (0, 0, 0), 1.0), "normal"),
        (lambda: at.DiskLight((0, 0, 0), (0, 1, 0), 0.0), "radius"),
        (lambda: at.SphereLight((0, 0, 0), -1.0), "radius"),
        (lambda: at.SphereLight((0, 0, np.inf), 1.0), "center"),
        (lambda: at.PointLight("lamp"), "position"),
        (lambda: at.DirectionalLight((0, 0, 0)), "direction"),
        (lambda: at.DirectionalLight((0, -1, 0), 180.0), "angular_diameter"),
        (lambda: at.PointLight((0, 0, 0), intensity=-1.0), "intensity"),
        (lambda: at.PointLight((0, 0, 0), colour=(1, 2)), "colour"),
    ],
)
def test_bad_lights(make, says):
    with pytest.raises(at.InputError, match=says):
        make()
