"""Bounced light at a sparse grid of pixels: interpolation, its weights and borders, and its error."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.sparse_bounce import interpolated, sparse_grid, sparse_surfaces
from antumbra.query.gbuffer import GBuffer
from antumbra.query.shadow_query import Surfaces


def flat(height, width):
    """The G-buffer of a floor, seen from 10 above."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    position = np.stack([x, np.zeros_like(x), y], -1)
    normal = np.zeros_like(position)
    normal[..., 1] = 1.0
    whole = np.zeros((height, width), np.int32)
    return GBuffer(position, normal, whole, np.full_like(x, 10.0), np.ones((height, width), np.int8), np.zeros(3))


@pytest.mark.parametrize("step", [2, 4, 8])
@pytest.mark.parametrize("shape", [(16, 24), (13, 9), (1, 1)], ids=str)
def test_linear_light_on_a_floor_is_exact_inside_the_grid(step, shape):
    gbuffer, (height, width) = flat(*shape), shape
    light = np.repeat((2.0 + 0.1 * gbuffer.position[..., :1] + 0.3 * gbuffer.position[..., 2:]), 3, axis=-1)
    out = interpolated(gbuffer, sparse_grid(light, step), step)
    inside = (slice((height - 1) // step * step + 1), slice((width - 1) // step * step + 1))
    np.testing.assert_allclose(out[inside], light[inside], rtol=0.01)
    assert out.dtype == np.float32 and (out >= 0.99 * light.min()).all() and (out <= 1.01 * light.max()).all()


def test_light_does_not_cross_to_another_surface():
    gbuffer = flat(16, 16)
    wall = gbuffer.position[..., 0] >= 6
    gbuffer.normal[wall] = (1.0, 0.0, 0.0)
    gbuffer.position[wall, 1] = gbuffer.position[wall, 0] - 6.0
    gbuffer.position[wall, 0] = 6.0
    light = np.where(wall[..., None], np.float32(5.0), np.float32(1.0)) * np.ones(3, np.float32)
    np.testing.assert_allclose(interpolated(gbuffer, sparse_grid(light, 4), 4), light, rtol=1e-6)
    step_down = flat(16, 16)
    step_down.position[8:, :, 1] -= 3.0  # parallel, but 3 below: more than 2 % of the depth
    light = np.where(np.arange(16)[:, None, None] >= 8, np.float32(5.0), np.float32(1.0)) * np.ones((16, 16, 3), "f4")
    np.testing.assert_allclose(interpolated(step_down, sparse_grid(light, 4), 4), light, rtol=1e-6)


def test_a_surface_without_a_grid_pixel_takes_its_neighbours_and_background_is_black():
    gbuffer = flat(8, 8)
    gbuffer.normal[2, 2] = (1.0, 0.0, 0.0)
    gbuffer.face[6:] = -1
    out = interpolated(gbuffer, np.full((2, 2, 3), 3.0, np.float32), 4)
    np.testing.assert_allclose(out[:6], 3.0, rtol=1e-6)
    assert not out[6:].any()
    gbuffer.face[:] = -1
    assert not interpolated(gbuffer, np.ones((2, 2, 3), np.float32), 4).any()


def test_a_step_of_one_changes_nothing():
    scene = at.procedural("cellar", triangles=2000)
    surfaces = Surfaces(flat(4, 4), None, np.zeros((4, 4), np.int32))
    assert sparse_surfaces(surfaces, 1) is surfaces
    args = scene, scene.cameras[0].resized(20, 16), scene.lights
    first, again = (at.render(*args, spp=2, bounce=2, bounce_step=n) for n in (1, 1))
    np.testing.assert_array_equal(first.image, again.image)


@pytest.mark.parametrize("step, most", [(2, 1.3), (4, 0.8)])
def test_sparse_light_is_near_the_truth_for_as_many_rays(step, most):
    """In a picture this small, the filter's width costs about what the additional directions gain with a step of 2."""
    scene = at.procedural("cellar", triangles=2000)
    args, more = (scene, scene.cameras[0].resized(96, 72), scene.lights), {"spp": 4, "filter": True}
    truth = at.render(*args, bounce=256, **more)
    sparse = at.render(*args, bounce=16, bounce_step=step, **more)
    every = at.render(*args, bounce=16 // step**2, **more)
    direct, seen = at.render(*args, **more).rays, truth.mask
    sparse_off, off = (np.abs(f.indirect - truth.indirect)[seen].mean() for f in (sparse, every))
    assert 0.0 < sparse_off < most * off and sparse_off < 0.25 * truth.indirect[seen].mean()
    assert 0.7 < (sparse.rays - direct) / (every.rays - direct) < 1.3
    np.testing.assert_array_equal(sparse.bits[0], truth.bits[0])
