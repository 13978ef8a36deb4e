"""Light in pictures and bakes is the closed form times the share that arrives, for every kind of light."""

import numpy as np
import pytest

import antumbra as at
from antumbra.baking.bake_input import default_bake_lights
from antumbra.baking.surface_meter import Meter, MeterSettings, ReceiverPoints
from antumbra.picture.irradiance import PixelNormals
from antumbra.picture.light_visibility import irradiance_shares
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import segments, shadow_queries
from antumbra.scene.light_lists import LightList
from antumbra.trace.transmission import TracedQuery
from reference_radiometry import irradiance as reference

FLOOR = np.array([[[-50, 0, -50], [-50, 0, 50], [50, 0, 50]], [[-50, 0, -50], [50, 0, 50], [50, 0, -50]]], float)
CARD = FLOOR[:, :, [2, 1, 0]] * (1, 0, 1) * (0.5, 1, 1) + (-25.0, 0.2, 0.0)  # hides what lies at x < 0
DARK = at.AmbientOcclusion(intensity=0.0, spp=1)  # no ambient light
LIGHTS = {
    "point": at.PointLight((0.1, 2, 0.1)),
    "quad": at.QuadLight((-0.7, 0.9, -0.8), (1.5, 0.2, 0), (0, 0.1, 1.6)),
    "quad below the horizon": at.QuadLight((1.5, -1, -1), (0, 2, 0), (0, 0, 2)),
    "disk": at.DiskLight((0.1, 0.8, 0), (0.2, 1, 0), 0.9),
    "disk below the horizon": at.DiskLight((-1.5, 0.2, 0), (1, 0.3, 0), 1.0),
    "sphere": at.SphereLight((0, 1.4, 0), 1.0),
    "sphere below the horizon": at.SphereLight((2.0, 0.4, 0), 0.9),
    "small sun": at.DirectionalLight((0.3, -1, 0.1), 0.53),
    "wide sun": at.DirectionalLight((0.1, -1, 0.1), 90.0),
    "sun below the horizon": at.DirectionalLight((1, -0.3, 0), 60.0),
}
OVERHEAD = [name for name in LIGHTS if "horizon" not in name and name not in ("point", "small sun")]


def kinds(base=at.Light):
    for kind in base.__subclasses__():
        if kind.__module__.startswith("antumbra.scene") and not issubclass(kind, LightList):
            yield from [kind, *kinds(kind)]


def test_every_kind_of_light_is_tested():
    assert set(kinds()) == {type(light) for light in LIGHTS.values()} | {at.AmbientOcclusion}


def camera(width=16, height=8, extent=1.0):
    """Just above the floor."""
    up = (0, 0, -1)
    return at.Camera((0, 0.05, 0), (0, 0, 0), up, width=width, height=height, projection="orthographic", extent=extent)


def pictured(soup, light, view, **options):
    scene = at.Scene.from_arrays(soup, colours=np.ones(3))
    return at.render(scene, view, [light, DARK], plan="bsah+single", **{"antialias": False, **options})


def points_of(frame):
    return frame.gbuffer.position.reshape(-1, 3).astype(float) + frame.gbuffer.origin


def baked(soup, what, light, points, spp, normal=(0.0, 1.0, 0.0)):
    scene = at.Scene.from_arrays(soup)
    asked = MeterSettings(what, [light], spp, "larcher-pillichshammer", "bsah+single", 0.0, 1)
    return Meter(scene, asked, len(points)).values(ReceiverPoints(points, np.broadcast_to(normal, points.shape)))[:, 0]


@pytest.mark.parametrize("name", LIGHTS)
def test_lit_surfaces_have_the_closed_form_without_noise(name):
    light, view = LIGHTS[name], camera()
    plain = pictured(FLOOR, light, view, spp=16, filter=False, layers=True)
    lit, points = np.pi * plain.image[..., 0].ravel(), points_of(plain)
    for k in range(0, len(points), 17):
        assert lit[k] == pytest.approx(reference(light, points[k], (0, 1, 0), n=300), rel=1e-3)
    for options in (dict(spp=4), dict(spp=16, filter=True), dict(spp=4, adaptive=16), dict(spp=16, ground=True)):
        np.testing.assert_allclose(pictured(FLOOR, light, view, **options).image, plain.image, rtol=1e-6)
    np.testing.assert_allclose(plain.layers.lights[0], plain.image, rtol=1e-6)
    for what in ("light", "sun") if isinstance(light, at.DirectionalLight) else ("light",):
        np.testing.assert_allclose(baked(FLOOR, what, light, points, 16), lit, rtol=1e-5)
    assert (lit > 0.0).any()


@pytest.mark.parametrize("name", OVERHEAD)
def test_penumbrae_are_consistent(name):
    """The error falls with the samples. That of the unweighted fraction would stay."""
    light, view = LIGHTS[name], camera(width=24, height=4, extent=0.05)

    def seen_from(point):
        return lambda ends: point[0] + (CARD[0, 0, 1] / ends[:, 1]) * (ends[:, 0] - point[0]) >= 0.0

    soup, frames = np.concatenate([FLOOR, CARD]), {}
    for spp in (64, 256, 1024):
        frames[spp] = pictured(soup, light, view, spp=spp, filter=False)
    fraction = frames[1024].visibility[0].ravel()
    some, points = np.flatnonzero((fraction > 0.02) & (fraction < 0.98))[::4], points_of(frames[64])
    truth = np.array([reference(light, p, (0, 1, 0), seen_from(p), n=300) for p in points[some]])
    assert len(some) > 12
    error = lambda found: np.abs(found.ravel()[some] - truth).mean() / truth.mean()
    first, second, third = (error(np.pi * frame.image[..., 0]) for frame in frames.values())
    assert second < 0.02 and third < 0.006 and third < 0.5 * first
    assert error(baked(soup, "light", light, points, 256)) < 0.02
    assert error(np.pi * pictured(FLOOR, light, view).image[..., 0].ravel() * fraction) > 3 * third


def test_shares_are_weighted_means():
    rng = np.random.default_rng(4)
    for light in LIGHTS.values():
        frame = pictured(FLOOR, light, camera(), spp=16)
        triangles = at.Scene.from_arrays(FLOOR).triangles()
        (query,) = shadow_queries(triangles, frame.gbuffer, [light], [light_samples(light, 16)])
        normal = frame.gbuffer.normal + 0.2 * rng.normal(size=frame.gbuffer.normal.shape)
        normal = (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)
        bits = rng.integers(0, 1 << 16, (*query.sides.shape, 1)).astype(np.uint64)
        bits[0, 0], bits[0, 1] = 0, (1 << 16) - 1
        found = irradiance_shares(PixelNormals(normal, normal, frame.gbuffer.depth, False), TracedQuery(query, bits))
        directions = segments(query)[0].astype(float) - query.origins[:, :, None]
        r = np.linalg.norm(directions, axis=-1)
        weight = np.maximum((directions * normal[:, :, None]).sum(-1) / r, 0.0)
        if isinstance(light, at.SphereLight):
            axis = light.center - points_of(frame).reshape(*r.shape[:2], 1, 3)
        elif isinstance(light, at.DirectionalLight):
            axis = light.direction
        elif isinstance(light, at.PointLight):
            axis = directions
        else:
            axis = np.cross(query.light.u, query.light.v)
        weight *= np.abs((directions * axis).sum(-1)) / np.linalg.norm(axis, axis=-1) / r**3
        open_ = (bits >> np.arange(16, dtype=np.uint64) & np.uint64(1)) == 0
        total = weight.sum(-1)
        wanted = np.divide((weight * open_).sum(-1), total, out=np.zeros_like(total), where=total > 0.0)
        wanted[0, 0] = 1.0
        np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=1e-5)
        assert found[0, 0] == 1.0 and found[0, 1] == 0.0


def test_a_light_below_the_horizon_gives_nothing():
    light = at.QuadLight((-1, -2, -1), (2, 0, 0), (0, 0, 2))
    frame = pictured(FLOOR, light, camera(), spp=16)
    assert not frame.image.any() and not frame.visibility[0].any()


def test_each_baked_point_gets_all_lights_of_a_sky():
    """The sky is one of the default lights. Sixteenths of it are off by a third."""
    scene, rng = at.Scene.from_arrays(FLOOR), np.random.default_rng(3)
    points = rng.uniform(-1, 1, (64, 3)) * (1, 0, 1)
    (sky,) = (light for light in default_bake_lights(scene, "light", 0.0) if isinstance(light, at.Sky))
    found = baked(FLOOR, "light", sky, points, 16)
    sets = (np.maximum(sky.points[:, 1], 0.0) * sky.intensities) @ sky.colours
    np.testing.assert_allclose(found, sky.intensity * sets[0], rtol=1e-5)
