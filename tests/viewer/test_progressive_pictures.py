"""Traced pictures of a page."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.image_files import frame_exposure, screen_picture
from antumbra.picture.render_options import EngineOptions
from antumbra.viewer.progressive_pictures import (
    MOST_PIXELS,
    PICTURE_STEPS,
    Step,
    scaled_camera,
    steps_of,
    trace_picture,
    with_quality,
)
from antumbra.viewer.viewer_model import BOX_TESTS, LIGHT_SHARE, Model, metered_exposure
from pages import CAMERA, SUN, box_on_floor

FINE, SIZE = Step(1, 4), (80, 80)


@pytest.fixture
def model():
    return Model(box_on_floor(), SUN, CAMERA)


@pytest.fixture
def camera():
    return CAMERA.resized(*SIZE)


def brightness(picture, row, column):
    return int(picture.image[row, column].astype(int).sum())


def test_the_picture_is_the_one_that_render_makes(model, camera):
    picture = trace_picture(model, camera, FINE)
    frame = at.render(model.scene, camera, SUN, spp=4, filter=True, ground=True)
    assert (picture.image == screen_picture(frame, model.exposure)).all() and picture.rays == frame.rays
    assert frame.ground is not None and model.ground(camera) == model.scene.ground_height()
    inside = at.Camera((0.0, 0.5, 0.0), (0.0, 0.5, -1.0))
    assert model.ground(inside) is False


@pytest.mark.parametrize("step", [FINE, PICTURE_STEPS[-1]])
def test_a_picture_of_a_device_is_the_same_and_has_the_times_of_its_steps(camera, step):
    models = [Model(box_on_floor(), SUN, CAMERA, engine=EngineOptions(device=name)) for name in ("host", None)]
    ours, theirs = (trace_picture(model, camera, step) for model in models)
    np.testing.assert_array_equal(ours.image, theirs.image)
    assert re.fullmatch(r", host:0: .*surfaces [\d.]+, shadows [\d.]+, shading [\d.]+ ms", ours.cost), ours.cost
    assert theirs.cost == ""


def test_behind_a_scene_without_a_sky_is_daylight_as_in_png_files(model):
    wide = at.Camera((0.0, 3.0, 40.0), (0.0, 3.0, 0.0), vfov=60.0, width=40, height=40)
    frame = at.render(model.scene, wide, SUN, spp=4, filter=True)
    behind = ~frame.mask & (frame.coverage == 0.0)
    assert 0.2 < behind.mean() < 1.0 and not frame.image[behind].any()
    assert trace_picture(model, wide, FINE).image[behind].min() > 100


def test_shadows_follow_the_sun(model, camera):
    north, south = (28, 40), (52, 40)  # rows count from the top of the picture, which is north
    picture = trace_picture(model, camera, FINE)
    assert brightness(picture, *south) > 2 * brightness(picture, *north)
    model.aim_sun(0.0, 45.0)
    picture = trace_picture(model, camera, FINE)
    assert brightness(picture, *north) > 2 * brightness(picture, *south)


def test_pictures_become_finer(model, camera):
    sizes = [trace_picture(model, camera, step).image.shape[:2] for step in PICTURE_STEPS]
    assert sizes == [(10, 10), (20, 20), (40, 40), (80, 80), (80, 80), (80, 80)]
    assert [step.spp for step in PICTURE_STEPS] == sorted(step.spp for step in PICTURE_STEPS)


def test_large_pages_get_smaller_pictures():
    small = scaled_camera(CAMERA.resized(8000, 4000), 1)
    assert small.width * small.height == pytest.approx(
        MOST_PIXELS, rel=0.01
    ) and small.width / small.height == pytest.approx(2, rel=0.01)
    assert (scaled_camera(CAMERA.resized(8000, 4000), 8).width, scaled_camera(CAMERA.resized(3, 3), 8).height) == (
        1000,
        1,
    )


def test_a_share_is_white_where_all_of_a_light_is_seen(model, camera):
    model.display = model.display._replace(show=LIGHT_SHARE + "sun")
    picture = trace_picture(model, camera, FINE)
    assert picture.image[52, 40].tolist() == [255] * 3 and picture.image[28, 40].tolist() == [0] * 3
    assert "sun" in picture.note
    model.switch("sun", False)
    assert (
        trace_picture(model, camera, FINE).image[52, 40].tolist() == [255] * 3
    )  # lights that are off can be studied, too


def test_the_share_of_a_sky_is_smooth(camera):
    model = Model(box_on_floor(), [SUN, at.Sky()], CAMERA)
    model.display = model.display._replace(show=LIGHT_SHARE + "Sky")
    grey = trace_picture(model, camera, FINE).image[..., 0].astype(int)
    near, far = grey[31:33, 38:42], grey[12:14, 38:42]  # of the box
    assert 20 < near.max() < far.min() and np.ptp(far) < 25


def test_work_is_shown_with_a_legend(model, camera):
    model.display = model.display._replace(show=BOX_TESTS)
    picture = trace_picture(model, camera, steps_of(model)[1])
    assert picture.image.shape == (20, 20, 3) and len(np.unique(picture.image.reshape(-1, 3), axis=0)) > 2
    assert "bsah+single" in picture.note and picture.legend.shape[1] == 320
    model.display = model.display._replace(plan="bsah+nothing")
    with pytest.raises(at.InputError, match="nothing"):
        trace_picture(model, camera, FINE)


def test_the_exposure_is_steady_until_the_light_changes_much(model, camera):
    trace_picture(model, camera, FINE)
    first = model.exposure
    model.aim_sun(170.0, 44.0)
    trace_picture(model, camera, FINE)
    assert model.exposure == first
    trace_picture(model, at.Camera((0.0, 3.0, 40.0), (0.0, 3.0, 0.0), width=40, height=40), FINE)
    assert model.exposure == first  # that of the scene, not of the view
    model.display = model.display._replace(stops=1.0)
    assert model.exposure == 2.0 * first
    model.reset_exposure()
    assert model.exposure is None and model.display.stops == 0.0
    trace_picture(model, camera, FINE)
    first = model.exposure
    model.aim_sun(170.0, 5.0)
    trace_picture(model, camera, FINE)
    assert model.exposure > first


def test_a_light_that_changes_while_a_picture_is_traced_is_metered_in_the_next_one(model, camera):
    trace_picture(model, camera, FINE)
    first, late = model.exposure, []

    def sink(*_):
        if not late:
            late.append(model.aim_sun(170.0, 5.0))

    model.aim_sun(170.0, 44.0)
    trace_picture(model, camera, FINE, sink)
    assert late and model.exposure == first
    trace_picture(model, camera, FINE)
    assert model.exposure > first


def test_sunlight_in_a_shady_place_keeps_its_shades():
    def frame(sun, shade):
        image = np.concatenate([np.full((40, 3), sun), np.full((360, 3), shade)]).astype(np.float32).reshape(20, 20, 3)
        return SimpleNamespace(image=image, mask=np.ones((20, 20), bool), ground=None)

    contrast, more, even, dark = frame(10.0, 0.05), frame(10.0, 0.0001), frame(0.6, 0.4), frame(0.0, 0.0)
    assert metered_exposure(contrast) == pytest.approx(0.16) and frame_exposure(contrast) > 0.17
    assert metered_exposure(more) >= 0.7 * frame_exposure(more)  # the shade stays visible
    assert metered_exposure(even) == frame_exposure(even) and metered_exposure(dark) == frame_exposure(dark)


def test_coarse_pictures_have_coarse_skies():
    sky = at.Sky(count=256).named("sky")
    assert [with_quality(sky, spp).count for spp in (1, 4, 64)] == [16, 64, 256] and with_quality(sky, 1).name == "sky"
    assert with_quality(SUN, 1) is SUN


def test_a_picture_can_be_interrupted(model):
    class Stop(Exception):
        pass

    def check(*_):
        raise Stop

    with pytest.raises(Stop):
        trace_picture(model, CAMERA.resized(256, 256), Step(1, 16), check)
    assert trace_picture(model, CAMERA.resized(*SIZE), FINE).image.max() > 0


def test_a_picture_can_be_interrupted_after_its_last_ray(model, camera):
    class Stop(Exception):
        pass

    calls = []

    def check(*progress):
        calls.append(progress)
        if len(calls) == last:
            raise Stop

    last = 0
    trace_picture(model, camera, PICTURE_STEPS[-1], check)
    passes = [k for k, progress in enumerate(calls, 1) if not progress]
    assert len(passes) > 5 and any(calls[: passes[-1]])  # tracing reports its progress, too
    last = passes[-1]
    calls.clear()
    with pytest.raises(Stop):
        trace_picture(model, camera, PICTURE_STEPS[-1], check)
