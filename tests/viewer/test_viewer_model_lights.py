"""Lights that are moved."""

import numpy as np
import pytest

import antumbra as at
from antumbra.viewer.viewer_model import (
    FAR,
    PageFrame,
    aim_sun_light,
    handle_position,
    light_outline,
    move_light,
    sun_angles,
)
from pages import box_on_floor

STAGE = PageFrame.of(box_on_floor())
LIGHTS = [
    at.PointLight((1, 2, 3)),
    at.QuadLight((1, 2, 3), (1, 0, 0), (0, 2, 0)),
    at.DiskLight((1, 2, 3), (0, 1, 0), 0.5),
    at.SphereLight((1, 2, 3), 0.5),
    at.DirectionalLight((0.0, -1.0, -1.0)),
]


@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: type(light).__name__)
def test_the_handle_is_where_the_light_was_moved_to(light):
    light = light.named("lamp")
    to = np.array([3.0, 4.0, -2.0])
    there = move_light(light, STAGE, to)
    assert type(there) is type(light) and there.name == "lamp" and there.intensity == light.intensity
    if isinstance(light, at.DirectionalLight):
        to = FAR * to / np.linalg.norm(to)
    np.testing.assert_allclose(handle_position(there, STAGE), to, atol=1e-12)
    assert np.abs(handle_position(light, STAGE) - to).max() > 0.5


def test_light_from_everywhere_has_no_handle():
    sky = at.Sky()
    assert (
        handle_position(sky, STAGE) is None
        and move_light(sky, STAGE, np.ones(3)) is sky
        and not len(light_outline(sky, STAGE))
    )


def test_outlines_show_the_extent():
    quad, disk, sphere = (light_outline(light, STAGE) / STAGE.scale + STAGE.centre for light in LIGHTS[1:4])
    assert quad.shape == (4, 2, 3) and quad[..., 1].min() == pytest.approx(2) and quad[..., 1].max() == pytest.approx(4)
    assert np.linalg.norm(disk - (1, 2, 3), axis=-1) == pytest.approx(np.full(disk.shape[:2], 0.5))
    assert len(sphere) == 3 * len(disk) and not len(light_outline(LIGHTS[0], STAGE))


@pytest.mark.parametrize("up", ["y", "z"])
def test_suns_have_a_bearing_and_an_elevation(up):
    sun = at.DirectionalLight((0, 0, -1), intensity=2.0).named("sun")
    for bearing, elevation in (0.0, 30.0), (90.0, 0.0), (180.0, 45.0), (300.0, -10.0):
        assert sun_angles(aim_sun_light(sun, bearing, elevation, up), up) == pytest.approx((bearing, elevation))
    east, north = (aim_sun_light(sun, bearing, 0.0, up).direction for bearing in (90.0, 0.0))
    np.testing.assert_allclose(east, [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(north, [0, -1, 0] if up == "z" else [0, 0, 1], atol=1e-12)
