import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.picture import image_files
from antumbra.picture.image_files import automatic_exposure, percentiles, roll_off, to_srgb8
from antumbra.scene.materials import linear_to_srgb


def grey(values, shape=None):
    values = np.asarray(values, np.float32)
    return np.repeat(values.reshape(shape or (1, -1))[..., None], 3, axis=-1)


def everywhere(image):
    return np.ones(image.shape[:2], bool)


def expected_srgb8(image, exposure):
    """The result by the definition, in float64, without a table."""
    x = np.asarray(image, np.float64) * exposure
    return 255.0 * linear_to_srgb(roll_off(x))


def test_the_curve_shows_dark_and_middle_light_as_it_is():
    x = np.linspace(0.0, image_files.SHOULDER, 50)
    assert (roll_off(x) == x).all()
    # IEC 61966-2-1: sRGB 128 / 255 is linear 0.21586; the linear part ends at 0.0031308 -> 0.04045
    np.testing.assert_allclose(
        linear_to_srgb(np.array([0.0, 0.21586050, 0.0031308, 1.0])), [0, 128 / 255, 0.04045, 1], atol=2e-5
    )


def test_the_curve_rolls_highlights_off_without_a_corner_or_a_step():
    x = np.linspace(0.0, 5.0, 50_001)
    y = roll_off(x)
    slope = np.diff(y) / np.diff(x)
    assert (slope > 0.0).all() and (np.diff(slope) < 1e-6).all(), "it bends one way only"
    assert slope[0] == pytest.approx(1.0) and slope[-1] < 1e-3
    assert y[-1] <= 1.0 and roll_off(np.array([1.0]))[0] < 0.9, "white is kept for light beyond 1"


@given(st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_pixels_are_the_curve_to_an_eighth_of_a_step(exposure, seed):
    image = (np.random.default_rng(seed).exponential(size=(70, 3, 3)) / exposure).astype(np.float32)
    shown = to_srgb8(image, exposure)
    assert shown.dtype == np.uint8 and shown.shape == image.shape
    assert np.abs(shown - expected_srgb8(image, exposure)).max() <= 0.625


def test_black_is_black_and_much_light_is_white():
    image = np.array([[[0.0, 0.0, 0.0], [1e30, 1e30, 1e30], [np.inf, np.nan, -1.0]]], np.float32)
    assert to_srgb8(image, 1.0).tolist() == [[[0, 0, 0], [255, 255, 255], [255, 0, 0]]]
    assert to_srgb8(image, 1e38)[0, :2].tolist() == [[0, 0, 0], [255, 255, 255]]


@given(st.integers(1, 300), st.integers(0, 2**32 - 1), st.lists(st.floats(0.0, 100.0), min_size=1, max_size=4))
def test_percentiles_are_those_of_numpy(n, seed, percentages):
    values = np.random.default_rng(seed).lognormal(size=n).astype(np.float32)
    assert (percentiles(values, percentages) == np.percentile(values, percentages)).all()


def test_automatic_exposure_shows_bright_parts_bright_but_not_clipped():
    image = grey(np.random.default_rng(1).uniform(0.0, 1.0, 10_000))
    for scale in (1e-6, 1.0, 1e6):
        scaled = (image * scale).astype(np.float32)
        shown = to_srgb8(scaled, automatic_exposure(scaled, everywhere(image)))
        assert 200 < np.percentile(shown, image_files.PERCENTILE) < 250
        assert shown.max() < 255
        assert np.abs(shown.astype(int) - to_srgb8(image, automatic_exposure(image, everywhere(image)))).max() <= 1


def test_a_few_very_bright_pixels_do_not_darken_the_picture():
    image = grey(np.full(1000, 0.2))
    plain = automatic_exposure(image, everywhere(image))
    image[0, :5] = 1e9
    assert automatic_exposure(image, everywhere(image)) == pytest.approx(plain)


def test_exposure_looks_only_at_pixels_that_see_something():
    image = grey([0.0] * 99 + [0.5])
    seen = np.zeros((1, 100), bool)
    seen[0, 99] = True
    assert automatic_exposure(image, seen) == pytest.approx(image_files.BRIGHT / 0.5)


def test_exposure_of_a_picture_that_is_dark_but_for_a_spot():
    image = grey([0.0] * 999 + [0.25])
    assert automatic_exposure(image, everywhere(image)) == pytest.approx(image_files.BRIGHT / 0.25)


@pytest.mark.parametrize("values", [[0.0, 0.0], [np.nan, np.inf], [-1.0, 0.0]])
def test_exposure_without_any_light_is_one(values):
    image = grey(values)
    assert automatic_exposure(image, everywhere(image)) == 1.0
    assert automatic_exposure(image, ~everywhere(image)) == 1.0


@given(st.lists(st.floats(0.0, 2.0**127, width=32), min_size=1, max_size=20))
def test_exposure_is_always_a_positive_number(values):
    image = grey(values)
    exposure = automatic_exposure(image, everywhere(image))
    assert 0.0 < exposure < np.inf
    assert to_srgb8(image, exposure).shape == image.shape


def test_a_wide_bright_floor_keeps_its_shades():
    """A dark picture is made brighter, but not so far that a quarter of it is white."""
    image = np.full((40, 40, 3), 0.02, np.float32)
    image[30:] = np.linspace(0.5, 1.0, 40)[:, None]
    floor = to_srgb8(image, automatic_exposure(image, np.ones((40, 40), bool)))[30:, :, 0]
    assert floor.max() < 245 and np.ptp(floor.astype(int)) > 30
    image[30:38] = 0.02  # a few bright pixels may roll off
    narrow = to_srgb8(image, automatic_exposure(image, np.ones((40, 40), bool)))[38:, :, 0]
    assert narrow.mean() > floor.mean() + 3
