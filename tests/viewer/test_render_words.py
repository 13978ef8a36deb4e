"""The command that renders what a page shows, read back as the command line reads it."""

import shlex

import numpy as np
import pytest

import antumbra as at
from antumbra.cli.arguments import make_camera, make_picture_lights, parse_camera, parse_light, parse_sky
from antumbra.viewer.render_words import left_out, light_word, render_command
from antumbra.viewer.viewer_model import Model
from pages import CAMERA, SUN, box_on_floor

LIGHTS = [
    at.DirectionalLight((1.0, -2.0, 0.25), 2.0, intensity=3.0),
    at.PointLight((0.0, 3.0, 0.5), intensity=50.0),
    at.SphereLight((0.0, 3.0, 0.5), 0.25, intensity=7.0),
    at.DiskLight((0.0, 3.0, 0.5), (0.0, -1.0, 0.0), 0.5, intensity=2.0),
    at.QuadLight((0.0, 3.0, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, 2.0), intensity=5.0),
]
FIELDS = "direction", "position", "center", "corner", "u", "v", "normal", "radius", "angular_diameter", "image"


def read(command, scene):
    """The camera and the lights of a command."""
    words = [word.partition("=") for word in shlex.split(command)[3:]]
    options = [(name, value) for name, _, value in words]
    pairs = [option for option in options if option[1]]
    plain = [name for name, value in options if not value]
    pairs += list(zip(plain[::2], plain[1::2]))
    values = dict(pairs)
    size = tuple(map(int, values["--size"].split("x")))
    camera = make_camera(parse_camera(values["--camera"]), scene, 0.0, size)
    sky = None if "--sky" not in values else parse_sky(values["--sky"])
    lights = [parse_light(value) for name, value in pairs if name == "--light"]
    return camera, make_picture_lights(lights, sky, scene, 0.0)


def same(a, b):
    assert type(a) is type(b) and a.intensity == pytest.approx(b.intensity)
    for name in FIELDS:
        x, y = getattr(a, name, None), getattr(b, name, None)
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_allclose(x, y, atol=1e-7)


@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: type(light).__name__)
def test_a_light_is_read_back(light):
    same(parse_light(light_word(light).removeprefix("--light=")), light)


def test_the_camera_and_default_lights_are_those_of_the_page():
    scene = box_on_floor()
    model = Model(scene, camera=CAMERA)
    camera, lights = read(render_command(model, CAMERA), scene)
    np.testing.assert_allclose(camera.position, CAMERA.position, rtol=1e-7)
    np.testing.assert_allclose(camera.target, CAMERA.target, atol=1e-7)
    assert (camera.vfov, camera.width, camera.height) == pytest.approx((CAMERA.vfov, CAMERA.width, CAMERA.height))
    assert "--light" not in render_command(model, CAMERA) and len(lights) == len(scene.default_lights())


def test_a_moved_sun_stays_with_its_sky_and_lights_that_are_off_stay_off():
    scene = box_on_floor()
    model = Model(scene, camera=CAMERA)
    model.aim_sun(100.0, 20.0)
    for lights in [model.active_lights, None]:
        if lights is None:
            model.switch("Sky", False)
        _, found = read(render_command(model, CAMERA), scene)
        assert len(found) == len(model.active_lights)
        for light, lamp in zip(found, model.active_lights):
            same(light, lamp.light)


def test_what_the_command_line_cannot_say_is_beside_the_command():
    red = at.PointLight((0.0, 3.0, 0.0), colour=(1.0, 0.0, 0.0)).named("lamp")
    bright = at.Sky(intensity=2.0).named("bright")
    model = Model(box_on_floor(), [red, SUN, bright], CAMERA)
    assert left_out(model) == ["bright", "the colour of lamp"]
    command = render_command(model, CAMERA)  # not every shell reads comments
    assert command.count("--light=") == 2 and "#" not in command and "bright" not in command
    assert left_out(Model(box_on_floor(), camera=CAMERA)) == []


def test_places_are_exact_far_from_the_origin():
    far = np.array([5e5, 5e6, 10.0])
    corners = far + np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.3]]])
    lamp = at.PointLight(far + (0.123456, 0.234567, 0.75))
    model = Model(at.Scene.from_arrays(corners, up="z"), lamp)
    shown = at.Camera(far + (1.234567, 2.345678, 2.0), far + 0.3456789, (0, 0, 1), 40.0, 64, 48)
    camera, (light,) = read(render_command(model, shown), model.scene)
    np.testing.assert_allclose(camera.position, shown.position, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(camera.target, shown.target, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(light.position, lamp.position, rtol=0.0, atol=1e-6)
