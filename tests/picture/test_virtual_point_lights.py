"""Virtual point lights: photons carry the power of the lights in shading, and bounce as on diffuse surfaces."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.irradiance import irradiance
from antumbra.picture.virtual_point_lights import emit_photons
from antumbra.query.gbuffer import GBuffer
from antumbra.query.sobol_sequence import scrambled_sobol

LIGHTS = {
    "point": at.PointLight((0, 0, 0), intensity=3.0),
    "quad": at.QuadLight((-0.2, -0.1, 0), (0.4, 0, 0), (0, 0.2, 0), intensity=3.0),
    "disk": at.DiskLight((0, 0, 0), (0, 0, 1), 0.2, intensity=3.0),
    "sphere": at.SphereLight((0, 0, 0), 0.2, intensity=3.0),
}
RADIUS = 10.0  # radius of a sphere around the lights


def _shells(z):
    return np.digitize(np.abs(z) / RADIUS, (0.3, 0.6, 0.9))


@pytest.mark.parametrize("name", LIGHTS)
def test_photons_carry_the_power_that_shading_sees_and_spread_alike(name):
    light = LIGHTS[name]
    origins, directions, power = emit_photons(light, scrambled_sobol(4096, 4, 1), np.zeros(3), RADIUS)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    along = (origins * directions).sum(1)
    z = (origins + (np.sqrt(along**2 - (origins**2).sum(1) + RADIUS**2) - along)[:, None] * directions)[:, 2]
    photons = power * np.bincount(_shells(z), minlength=4) / len(z)

    n = 4000  # points spread evenly on the sphere, facing inwards
    h, angle = 1 - (2 * np.arange(n) + 1) / n, np.arange(n) * np.pi * (3 - np.sqrt(5))
    outward = np.stack([np.sqrt(1 - h * h) * np.cos(angle), np.sqrt(1 - h * h) * np.sin(angle), h], 1)[None]
    side = np.ones((1, n), np.int8)
    position, normal = (outward * RADIUS).astype(np.float32), (-outward).astype(np.float32)
    gbuffer = GBuffer(position, normal, side.astype(np.int32), side.astype(np.float32), side, np.zeros(3))
    arriving = light.intensity * irradiance(gbuffer, light.patch(np.zeros(3), 1.0), light.domain)[0]
    shaded = 4 * np.pi * RADIUS**2 * np.bincount(_shells(position[0, :, 2]), arriving, 4) / n
    np.testing.assert_allclose(photons, shaded, rtol=0.03)


def test_sunlight_reflected_by_a_floor_reaches_a_ceiling():
    """The irradiance is compared with the integral over the floor."""
    floor = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    ceiling = np.array([[-0.01, 1, -0.01], [0.01, 1, -0.01], [0.01, 1, 0.01], [-0.01, 1, 0.01]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    colours = np.array([(0.5, 0.25, 1.0)] * 2 + [(1.0, 1.0, 1.0)] * 2)
    scene = at.Scene.from_arrays(np.concatenate([floor, ceiling]), faces, colours)
    sun = at.DirectionalLight((0, -1, 0), 0.5, intensity=7.0, colour=(1, 1, 0.5))
    lights = at.virtual_point_lights(scene, sun, 8192)
    assert lights.indirect and lights.interleave and 0 < lights.nearest < 0.1
    assert 0.3 * 8192 < len(lights.positions) < 8192
    on_floor = np.abs(lights.positions[:, 1]) < 1e-5
    assert on_floor.mean() > 0.99 and (lights.normals[on_floor] == (0, 1, 0)).all()
    camera = at.Camera((0, 0.5, 0), (0, 1, 0), up=(0, 0, 1), vfov=2, width=8, height=8)
    frame = at.render(scene, camera, [lights])
    assert (frame.gbuffer.face >= 2).all() and frame.visibility[0].min() > 0.99
    x = (np.arange(400) + 0.5) / 200 - 1
    r2 = x[:, None] ** 2 + x**2 + 1
    form_factor = (1 / (np.pi * r2**2)).sum() * (x[1] - x[0]) ** 2
    wanted = 7.0 * form_factor * np.array([0.5, 0.25, 0.5]) / np.pi
    np.testing.assert_allclose(frame.image.mean((0, 1)), wanted, rtol=0.03)


def test_photons_of_a_wide_sun_have_its_power_and_its_directions():
    sun = at.DirectionalLight((0, -1, 0), 100.0, intensity=7.0)
    _, directions, power = emit_photons(sun, scrambled_sobol(4096, 4, 1), np.zeros(3), RADIUS)
    lux = power / (np.pi * RADIUS**2)  # on a disk that each photon meets head-on
    for normal in ((0, 1, 0), (0.6, 0.8, 0)):  # sees all of it
        found = lux * np.maximum(-directions @ normal, 0.0).mean()
        assert found == pytest.approx(7.0 * normal[1], rel=2e-3)
    half = np.radians(50.0)
    share = (-directions[:, 1] > np.cos(half / 2)).mean()
    assert share == pytest.approx((1 - np.cos(half / 2)) / (1 - np.cos(half)), abs=2e-3)


def test_skylight_reflected_by_a_floor_reaches_a_ceiling():
    """The irradiance is compared with sums over the sky and the floor."""
    floor = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    ceiling = np.array([[-0.01, 1, -0.01], [0.01, 1, -0.01], [0.01, 1, 0.01], [-0.01, 1, 0.01]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    colours = np.array([(0.5, 0.25, 1.0)] * 2 + [(1.0, 1.0, 1.0)] * 2)
    scene = at.Scene.from_arrays(np.concatenate([floor, ceiling]), faces, colours)
    image = np.random.default_rng(5).random((8, 16, 3)) * np.linspace(3, 0.2, 16)[:, None]
    image[4:] = 0.0  # no light from below
    sky = at.Sky(image, intensity=2.0, colour=(1, 0.5, 1), count=1024)
    lights = at.virtual_point_lights(scene, sky, 8192)
    camera = at.Camera((0, 0.5, 0), (0, 1, 0), up=(0, 0, 1), vfov=2, width=8, height=8)
    frame = at.render(scene, camera, [lights])
    sine = np.sin(np.pi * np.arange(9) / 8)
    share = 2 * np.pi / 16 * np.maximum(sine[1:] ** 2 - sine[:-1] ** 2, 0) / 2  # integral of the cosine over a texel
    on_floor = (image * share[:, None, None]).sum((0, 1)) * 2.0 * (1, 0.5, 1)
    x = (np.arange(400) + 0.5) / 200 - 1
    form_factor = (1 / (np.pi * (x[:, None] ** 2 + x**2 + 1) ** 2)).sum() * (x[1] - x[0]) ** 2
    wanted = on_floor * form_factor * (0.5, 0.25, 1.0) / np.pi
    np.testing.assert_allclose(frame.image.mean((0, 1)), wanted, rtol=0.04)


def test_lights_are_off_their_surface_on_the_lit_side_and_depend_on_the_seed_only():
    scene = at.procedural("atrium", triangles=3000)
    one, same, other = (at.virtual_point_lights(scene, scene.lights[0], 200, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.positions, same.positions)
    assert one.positions.shape != other.positions.shape or (one.positions != other.positions).any()
    back = scene.closest_hit(one.positions + 1e-3 * one.normals, -one.normals)
    assert (back.t < 2e-3).mean() > 0.9 and (one.colours <= 1).all()
    every = at.virtual_point_lights(scene, scene.lights[0], 200, interleave=False)
    assert not every.interleave and every.samples(1) == len(every.positions) <= 200


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(light=at.AmbientOcclusion()), "AmbientOcclusion"),
        (dict(light=at.PointLights([(0, 1, 0)])), "PointLights"),
        (dict(light="lamp"), "light"),
        (dict(n=0), "n is 0"),
        (dict(n=2000, interleave=False), "1024"),
        (dict(light=at.QuadLight((0, 0, 5), (0, 0, 1), (0, 1, 0)), n=2), "none of the 2 photons"),
        (dict(time=float("nan")), "time"),
    ],
)
def test_bad_arguments(change, says):
    scene = at.Scene.from_arrays(np.eye(3)[None] * 1e-3)
    with pytest.raises(at.InputError, match=says):
        at.virtual_point_lights(**(dict(scene=scene, light=at.PointLight((0, 1, 0)), n=16) | change))
