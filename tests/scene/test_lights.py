"""Cameras and lights: rays through pixels, and invalid arguments."""

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
    "change, says",
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
    "make, says",
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
        (
            lambda: at.DirectionalLight((0, -1, 0), 179.9999).patch(np.zeros(3), 1e34),
            "179.9999. smaller",
        ),
        (lambda: at.DirectionalLight((0, -1, 0)).patch(np.zeros(3), 1e38), "make the scene"),
        (lambda: at.PointLight((0, 0, 0), intensity=-1.0), "intensity"),
        (lambda: at.PointLight((0, 0, 0), colour=(1, 2)), "colour"),
        (lambda: at.AmbientOcclusion(0.0), "radius"),
        (lambda: at.AmbientOcclusion(-1), "radius"),
        (lambda: at.AmbientOcclusion(np.nan), "radius"),
        (lambda: at.AmbientOcclusion("far"), "radius"),
        (lambda: at.AmbientOcclusion(spp=0), "spp"),
        (lambda: at.AmbientOcclusion(spp=1025), "1024"),
        (lambda: at.AmbientOcclusion(intensity=np.nan), "intensity"),
        (lambda: at.PointLights(np.zeros((0, 3))), "at least one"),
        (lambda: at.PointLights(np.zeros(3)), "positions"),
        (lambda: at.PointLights("lamps"), "positions"),
        (lambda: at.PointLights(np.full((2, 3), np.inf)), "positions"),
        (lambda: at.PointLights(np.zeros((1025, 3))), "interleave=True"),
        (lambda: at.PointLights(np.zeros((16385, 3))), "drop"),
        (lambda: at.PointLights(np.zeros((16385, 3)), interleave=True), "drop"),
        (lambda: at.PointLights(np.zeros((4, 3)), (1, 2, 3)), "intensities"),
        (lambda: at.PointLights(np.zeros((4, 3)), -1.0), "intensities"),
        (lambda: at.PointLights(np.zeros((4, 3)), colours=np.ones((3, 3))), "colours"),
        (lambda: at.PointLights(np.zeros((4, 3)), normals=np.zeros((4, 3))), "normals"),
        (lambda: at.PointLights(np.zeros((4, 3)), nearest=-1.0), "nearest"),
    ],
)
def test_bad_lights(make, says):
    with pytest.raises(at.InputError, match=says):
        make()


@pytest.mark.parametrize("k", [1, 5, 16, 20, 37, 160, 16384])
def test_interleaved_lights_are_dealt_evenly_and_weighed_without_bias(k):
    rng = np.random.default_rng(k)
    lights = at.PointLights(
        rng.normal(size=(k, 3)), rng.uniform(size=k), rng.uniform(size=(k, 3)), interleave=True, intensity=2.0
    )
    sets, weights = lights.sets, lights.weights()
    assert sets.shape == (16, -(-k // 16)) == (16, lights.samples(99)) and weights.shape == (*sets.shape, 3)
    assert np.array_equal(np.unique(sets), np.arange(k))
    assert all(len(np.unique(row)) == len(row) for row in sets)
    assert np.ptp(np.bincount(sets.ravel())) <= 1
    total = np.zeros((k, 3))
    np.add.at(total, sets, weights)
    np.testing.assert_allclose(total / 16, 2.0 * lights.intensities[:, None] * lights.colours)


def test_every_set_is_a_spread_of_the_lights():
    positions = np.random.default_rng(3).uniform(size=(4096, 3))
    sets = at.PointLights(positions, interleave=True).sets
    counts = np.array([np.bincount((positions[row] * 4).astype(int) @ (1, 4, 16), minlength=64) for row in sets])
    assert counts.min() >= 1 and counts.max() <= 7  # 4 on average; a random choice would give 0 to 12


def test_lights_that_are_not_interleaved_keep_their_order():
    lights = at.PointLights(np.eye(3), (1, 2, 3))
    assert (lights.sets == (0, 1, 2)).all()
    np.testing.assert_allclose(lights.weights()[7], np.array([1, 2, 3])[:, None] * np.ones(3))


NEAR, FAR = 2.0**124, 1e39  # float32 holds sums of the first, and not the second


@pytest.mark.parametrize(
    "make",
    [
        lambda x: at.PointLight((0, x, 0)),
        lambda x: at.SphereLight((0, x, 0), 1.0),
        lambda x: at.SphereLight((0, 0, 0), x),
        lambda x: at.DiskLight((0, 0, -x), (0, 1, 0), 1.0),
        lambda x: at.DiskLight((0, 0, 0), (0, 1, 0), x),
        lambda x: at.QuadLight((x, 0, 0), (1, 0, 0), (0, 1, 0)),
        lambda x: at.QuadLight((0, 0, 0), (x, 0, 0), (0, 1, 0)),
        lambda x: at.QuadLight((0, 0, 0), (1, 0, 0), (0, -x, 0)),
        lambda x: at.PointLights([[0, 0, 0], [0, x, 0]]),
    ],
)
def test_lights_lie_where_float32_reaches(make):
    assert isinstance(make(NEAR), at.Light)
    for far in (FAR, 1e200, 1e308):
        with pytest.raises(at.InputError, match=r"beyond|must lie between"):
            make(far)


@pytest.mark.parametrize("scale", [1e-320, 1e-200, 1e-30, 1.0, 1e30, 1e200, 1e308])
def test_directions_have_any_length(scale):
    for way in ([1.0, 1.0, 0.0], [0.0, -1.0, 0.0], [-0.5, 0.25, 0.75]):
        vector, unit = np.array(way) * scale, np.array(way) / np.linalg.norm(way)
        found = [
            at.DirectionalLight(vector).direction,
            at.DirectionalLights([vector]).directions[0],
            at.DiskLight((0, 0, 0), vector, 1.0).normal,
            at.PointLights([[0, 0, 0]], normals=vector).normals[0],
            at.point_sensors([[0, 0, 0]], [vector]).normals[0],
        ]
        tolerance = 1e-3 if scale < 1e-300 else 1e-15  # subnormal numbers have few digits
        np.testing.assert_allclose(found, np.broadcast_to(unit, (5, 3)), atol=tolerance)
