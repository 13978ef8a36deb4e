"""Shading: the effect of ambient occlusion and lists of point lights on a picture."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.light_list_irradiance import list_irradiance
from antumbra.query.gbuffer import GBuffer
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import shadow_queries
from antumbra.trace.transmission import TracedQuery

LAMP = at.QuadLight((-1, 5, -1), (2, 0, 0), (0, 0, 2), intensity=20.0)
BLACK = at.AmbientOcclusion(intensity=0.0, spp=1)


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(2)
    soup = rng.normal(size=(200, 1, 3)) * (2, 0.7, 2) + rng.normal(size=(200, 3, 3)) * 0.3
    floor = np.array([[[-9, -2, -9], [-9, -2, 9], [9, -2, 9]], [[-9, -2, -9], [9, -2, 9], [9, -2, -9]]])
    return at.Scene.from_arrays(np.concatenate([soup, floor]), colours=rng.uniform(size=(202, 3)))


def _frame(scene, *lights, spp=16, size=(40, 32)):
    camera = at.Camera((0, 3, 9), (0, -0.5, 0), width=size[0], height=size[1])
    return at.render(scene, camera, lights, spp=spp, antialias=False)


def test_ambient_occlusion_scales_the_ambient_light_and_nothing_else(scene):
    plain, black = _frame(scene, LAMP), _frame(scene, LAMP, BLACK)
    frame = _frame(scene, LAMP, at.AmbientOcclusion(1.5, spp=40, intensity=2.0, colour=(1, 0.5, 0)))
    seen = plain.gbuffer.face >= 0
    assert [b.shape[-1] for b in frame.bits] == [1, 1] and frame.rays == seen.sum() * (16 + 40)
    np.testing.assert_array_equal(frame.bits[0], plain.bits[0])
    ambient = plain.image - black.image
    wanted = ambient * frame.visibility[1][..., None] * (2, 1, 0)
    assert ambient[seen].min() > 0 and 0.3 < frame.visibility[1][seen].mean() < 0.99
    np.testing.assert_allclose(frame.image - black.image, wanted, atol=1e-6 * plain.image.max())


def test_several_ambient_occlusions_multiply(scene):
    near, far = at.AmbientOcclusion(0.5), at.AmbientOcclusion()
    a, b, both = (_frame(scene, *lights).image for lights in ([near], [far], [near, far]))
    np.testing.assert_array_equal(_frame(scene, far, near).visibility, _frame(scene, near, far).visibility[::-1])
    bare = _frame(scene, at.AmbientOcclusion(1e-5)).image  # nothing is that near
    np.testing.assert_allclose(both * bare, a * b, rtol=1e-5, atol=1e-9)
    assert (both < a).any() and (both < b).any()


def test_ambient_occlusion_alone_lights_the_picture(scene):
    frame = _frame(scene, at.AmbientOcclusion())
    assert frame.image[frame.gbuffer.face >= 0].mean() > 0.02


def test_a_list_gives_the_light_of_its_lights(scene):
    rng = np.random.default_rng(5)
    k = 70
    positions, candela, colours = (
        rng.uniform((-4, 1, -4), (4, 4, 4), (k, 3)),
        rng.uniform(size=k),
        rng.uniform(size=(k, 3)),
    )
    lights = at.PointLights(positions, candela, colours, intensity=3.0, colour=(1, 0.5, 1))
    frame = _frame(scene, lights, BLACK, spp=1, size=(20, 16))
    wanted = _frame(
        scene,
        *[at.PointLight(p, intensity=3 * i, colour=c * (1, 0.5, 1)) for p, i, c in zip(positions, candela, colours)],
        BLACK,
        spp=1,
        size=(20, 16),
    )
    assert frame.bits[0].shape == (16, 20, 2) and frame.rays == wanted.rays
    assert 0.1 < frame.visibility[0].mean() < 0.9
    np.testing.assert_allclose(frame.visibility[0], np.mean(wanted.visibility[:-1], axis=0), atol=1e-6)
    np.testing.assert_allclose(frame.image, wanted.image, rtol=1e-4, atol=1e-6 * wanted.image.max())


def test_indirect_lights_replace_the_ambient_light(scene):
    lights = at.PointLights([(0, 3, 0), (1, 3, 1)])
    indirect = at.PointLights([(0, 3, 0), (1, 3, 1)], indirect=True)
    ambient = _frame(scene, LAMP, lights).image
    np.testing.assert_array_equal(_frame(scene, LAMP, indirect).image, _frame(scene, LAMP, lights, BLACK).image)
    assert (ambient > _frame(scene, LAMP, indirect).image).mean() > 0.5


def test_interleaved_lights_give_each_block_of_pixels_the_light_of_all():
    """On a floor far below the lights, neighbouring pixels get nearly the same irradiance from each light."""
    floor = np.array([[[-50, 0, -50], [-50, 0, 50], [50, 0, 50]], [[-50, 0, -50], [50, 0, 50], [50, 0, -50]]], float)
    scene = at.Scene.from_arrays(floor)
    rng = np.random.default_rng(6)
    positions, candela = rng.uniform((-9, 8, -9), (9, 20, 9), (100, 3)), rng.uniform(size=100)
    camera = at.Camera((0, 2, 0.1), (0, 0, 0), width=32, height=32, vfov=40)
    every, some = (
        at.render(scene, camera, at.PointLights(positions, candela, interleave=i, indirect=True)) for i in (False, True)
    )
    assert some.rays * 100 == every.rays * 7
    blocks = lambda image: image.reshape(8, 4, 8, 4, 3).mean((1, 3))
    np.testing.assert_allclose(blocks(some.image), blocks(every.image), rtol=0.02)
    assert np.abs(some.image / every.image - 1).mean() > 0.05


def _one_pixel(lights, position=(0, 0, 0), normal=(0, 1, 0)):
    pixel = lambda v, dtype: np.array(v, dtype).reshape(1, 1, -1)
    side = np.ones((1, 1), np.int8)
    gbuffer = GBuffer(
        pixel(position, np.float32), pixel(normal, np.float32), np.zeros((1, 1), np.int32), side.astype(np.float32),
        side, np.zeros(3),
    )  # fmt: skip
    scene = at.Scene.from_arrays(np.eye(3)[None])
    (query,) = shadow_queries(scene.triangles(), gbuffer, [lights], [light_samples(lights, 1)])
    return list_irradiance(gbuffer, lights, TracedQuery(query, np.zeros((1, 1, 1), np.uint64)))[0, 0, 0]


def test_falloff_of_lights_with_normals():
    down = dict(normals=(0, -2, 0))
    assert _one_pixel(at.PointLights([(0, 2, 0)])) == pytest.approx(1 / 4)
    assert _one_pixel(at.PointLights([(0, 2, 0)], **down)) == pytest.approx(1 / 4)
    assert _one_pixel(at.PointLights([(2, 2, 0)])) == pytest.approx(np.sqrt(0.5) / 8)
    assert _one_pixel(at.PointLights([(2, 2, 0)], **down)) == pytest.approx(0.5 / 8)
    assert _one_pixel(at.PointLights([(0, 2, 0)], normals=(0, 1, 0))) == 0
    assert _one_pixel(at.PointLights([(0, -2, 0)])) == 0
    assert _one_pixel(at.PointLights([(0, 0, 0)])) == 0


def test_light_is_never_nearer_than_nearest():
    assert _one_pixel(at.PointLights([(0, 0.01, 0)], nearest=0.5)) == pytest.approx(4)
    assert _one_pixel(at.PointLights([(0, 2, 0)], nearest=0.5)) == pytest.approx(1 / 4)
