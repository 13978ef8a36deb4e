"""The state of a page, without a browser."""

import numpy as np
import pytest

import antumbra as at
from antumbra.viewer.viewer_model import Model
from pages import CAMERA, SUN, box_on_floor

LAMP = at.PointLight((0, 5, 0)).named("lamp")


@pytest.fixture
def model():
    return Model(box_on_floor(), [SUN, LAMP], CAMERA)


def names(model):
    return [lamp.name for lamp in model.active_lights]


def test_lights_are_switched_off(model):
    model.switch("sun", False)
    assert names(model) == ["lamp"] and [lamp.on for lamp in model.editable_lights] == [False, True]
    model.switch("lamp", False)
    assert [lamp.light.intensity for lamp in model.active_lights] == [0.0]  # dark, and no error
    model.switch("sun", True)
    assert names(model) == ["sun"]
    with pytest.raises(at.InputError, match="no light 'moon'; there are sun, lamp"):
        model.switch("moon", False)


def test_lights_move(model):
    model.move("lamp", model.page_frame.to_page((1, 2, 3)))
    np.testing.assert_allclose(model.editable_lights[1].light.position, (1, 2, 3))
    assert model.editable_lights[1].name == "lamp"


def test_a_sun_that_was_moved_sets():
    model = Model(box_on_floor(), [at.DirectionalLight((0, 1, 0)), LAMP])
    assert names(model) == ["sun", "lamp"]  # a distant light of a file may shine from anywhere
    model.aim_sun(90.0, 20.0)
    assert names(model) == ["sun", "lamp"]
    model.aim_sun(90.0, -5.0)
    assert names(model) == ["lamp"]


def test_the_sun_follows_the_clock():
    pytest.importorskip("pvlib", reason="no pvlib: the clock of the viewer is NOT tested")
    place = at.Place(52.0116, 4.3571, timezone="Europe/Amsterdam")
    model = Model(box_on_floor(), [SUN], place=place)
    bearing, elevation = model.aim_sun_at("2026-06-21", 13.75)  # about solar noon in summer time
    assert bearing == pytest.approx(180, abs=4) and elevation == pytest.approx(90 - 52.01 + 23.44, abs=0.2)
    np.testing.assert_allclose(model.sun.light.direction[1], -np.sin(np.radians(elevation)), atol=1e-6)
    assert model.aim_sun_at("2026-06-21", 0.5)[1] < 0.0
    with pytest.raises(at.InputError, match="write one such as 2026-06-21"):
        model.aim_sun_at("midsummer", 12.0)


def test_without_a_place_or_a_sun_there_is_a_cure(model):
    with pytest.raises(at.InputError, match="give --latitude and --longitude"):
        model.aim_sun_at("2026-06-21", 12.0)
    with pytest.raises(at.InputError, match="--light sun"):
        Model(box_on_floor(), LAMP).aim_sun(0.0, 10.0)


def test_moved_lights_stay_when_time_goes_on(tmp_path):
    vertices = np.array([[[0, 0, 0], [4, 0, 0], [0, 0, 4]], [[0, 1, 0], [4, 1, 0], [0, 1, 4]]], np.float32)
    np.save(tmp_path / "frames.npy", vertices)
    np.save(tmp_path / "faces.npy", [[0, 1, 2]])
    (tmp_path / "info.json").write_text('{"times": [0, 2]}')
    model = Model(at.load(tmp_path))
    model.aim_sun(10.0, 20.0)
    before = model.sun.light.direction
    model.go_to(9.0)
    assert model.time == 2.0 and (model.sun.light.direction == before).all()
    assert [lamp.name for lamp in model.editable_lights] == ["sun", "Sky"]


def test_the_first_camera_is_the_one_that_is_given(model):
    assert (model.first_camera(40, 30).position == CAMERA.position).all()
    own = Model(box_on_floor()).first_camera(40, 30)
    assert (own.position == box_on_floor().default_camera(40, 30).position).all()


def test_the_day_begins_and_ends_with_the_sun():
    place = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
    model = Model(box_on_floor(), place=place)
    hours = model.daylight("2026-06-21", 0.5)
    assert (hours[0], hours[-1]) == (5.5, 21.5) and len(hours) == 33
    assert all(model.aim_sun_at("2026-06-21", hour)[1] > 0.0 for hour in hours)
    assert model.daylight("2026-12-21", 0.5)[0] == 9.0
    assert model.follows_sun and not Model(box_on_floor(), [SUN], place=place).follows_sun
    assert not Model(box_on_floor()).follows_sun
