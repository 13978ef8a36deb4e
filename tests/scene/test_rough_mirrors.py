"""Directions in which rough surfaces mirror light, and skies blurred by them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.rough_mirrors import ROUGHNESSES, mirror_cone


def points(n=4096):
    rng = np.random.default_rng(1)
    return rng.random((n, 2))


@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_cones_hold_unit_vectors_above_the_surface(roughness):
    cone = mirror_cone(roughness, points())
    np.testing.assert_allclose(np.linalg.norm(cone, axis=1), 1.0, atol=1e-12)
    assert (cone[:, 2] >= 0.0).all()


def test_cones_widen_with_roughness():
    heights = [mirror_cone(roughness, points())[:, 2].mean() for roughness in ROUGHNESSES]
    assert heights[0] > 0.999 and np.all(np.diff(heights) < 0.0)


@pytest.mark.parametrize("roughness", [0.3, 0.7])
def test_half_vectors_are_distributed_as_ggx(roughness):
    """Half of those of at most 45 degrees are flatter than the median of the closed form."""
    alpha2 = roughness**4
    u = 0.5 / (1.0 + alpha2)
    median = 2.0 * (1.0 - u) / (1.0 + (alpha2 - 1.0) * u) - 1.0
    assert abs((mirror_cone(roughness, points())[:, 2] > median).mean() - 0.5) < 0.03


def test_a_uniform_sky_is_blurred_to_itself():
    sky = at.Sky((0.2, 0.5, 0.9), up="y")
    assert all((each.radiance([[0.3, 0.4, 0.5]]) == sky.radiance([[0.3, 0.4, 0.5]])).all() for each in sky.blurred)


def test_blurring_keeps_the_mean_and_turns_with_the_sky():
    image = np.random.default_rng(3).random((16, 32, 3))
    rough = at.Sky(image, up="y").blurred[-1]
    rows = np.sin(np.pi * (np.arange(32) + 0.5) / 32)[:, None, None]
    weight = np.sin(np.pi * (np.arange(16) + 0.5) / 16)[:, None, None]
    mean = (image * weight).mean((0, 1)) / weight.mean()
    np.testing.assert_allclose((rough.map * rows).mean((0, 1)) / rows.mean(), mean, rtol=0.02)
    assert rough.map.std() < 0.3 * image.std()
    turned = at.Sky(np.roll(image, 8, 1), up="y").blurred[-1]
    np.testing.assert_allclose(turned.map, np.roll(rough.map, 16, 1), atol=0.05)  # their rays differ
    assert (turned.map != rough.map).mean() > 0.9


def test_the_first_blurred_sky_is_the_sky():
    sky = at.Sky(up="y")
    assert sky.blurred[0] is sky and len(sky.blurred) == len(ROUGHNESSES)
