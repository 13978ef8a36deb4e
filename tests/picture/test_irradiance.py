"""Unshadowed irradiance in closed form, against sums over the light and formulas of textbooks."""

from dataclasses import replace

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.irradiance import irradiance
from antumbra.query.gbuffer import GBuffer
from reference_radiometry import irradiance as reference
from reference_radiometry import unit


def lit(light, points, normals, origin=(0.0, 0.0, 0.0)):
    """(n,) float32: what the package says, for intensity 1."""
    points, normals = np.broadcast_arrays(np.atleast_2d(np.asarray(points, float)), unit(normals))
    side = np.ones((1, len(points)), np.int8)
    depth, face = side.astype(np.float32), side.astype(np.int32)
    local = (points - origin)[None].astype(np.float32)
    gbuffer = GBuffer(local, normals[None].astype(np.float32), face, depth, side, np.asarray(origin, float))
    return irradiance(gbuffer, light.patch(np.asarray(origin, float), 10.0), light.domain)[0]


def some_lights(rng):
    """A light of each kind, anywhere around zero, but not within 0.3 of it."""
    place = unit(rng.normal(size=3)) * rng.uniform(0.8, 3.0)
    kinds = [
        at.PointLight(place),
        at.QuadLight(place, unit(rng.normal(size=3)) * 1.5, unit(rng.normal(size=3))),
        at.DiskLight(place, rng.normal(size=3), rng.uniform(0.1, 2.0)),
        at.SphereLight(place, rng.uniform(0.05, 0.95) * np.linalg.norm(place)),
        at.DirectionalLight(place, rng.uniform(1.0, 150.0)),
    ]
    return kinds


KINDS = range(5)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_light_in_any_position_against_a_sum(kind):
    rng = np.random.default_rng(kind)
    whole = cut = 0
    for _ in range(25):
        light, normal = some_lights(rng)[kind], unit(rng.normal(size=3))
        found = lit(light, (0, 0, 0), normal)[0]
        wanted, below = reference(light, (0, 0, 0), normal, n=200), reference(light, (0, 0, 0), -normal, n=200)
        cut += min(wanted, below) > 1e-3 * max(wanted, below)
        whole += below == 0.0 < wanted
        assert found == pytest.approx(wanted, rel=3e-3, abs=3e-4 * max(wanted, below))
    assert whole > 2 and (cut > 2 or kind == 0)


def test_a_whole_sphere_is_a_point_and_a_whole_sun_a_cosine():
    rng = np.random.default_rng(7)
    for ratio in (1.001, 1.1, 1.5, 2.0, 3.0, 1e3, 1e6):
        light = at.SphereLight((0, 0, ratio), 1.0)
        steepest = np.arccos(1 / ratio) * 0.999
        angle = steepest * rng.random(9)
        normals = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1)
        np.testing.assert_allclose(lit(light, (0, 0, 0), normals), np.cos(angle) / ratio**2, rtol=2e-6)
    for diameter in (0.0, 0.53, 40.0, 90.0, 170.0):
        angle = np.radians(90.0 - diameter / 2) * 0.999 * rng.random(9)
        normals = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], 1)
        found = lit(at.DirectionalLight((0, 0, -1), diameter), (0, 0, 0), normals)
        np.testing.assert_allclose(found, np.cos(angle), rtol=2e-6)


@pytest.mark.parametrize("s, t", [(0.3, 1.4), (0.8, 1.0), (0.8, 1.9), (1.2, 2.0), (1.5, 1.5)])
def test_a_sphere_and_a_sun_cut_by_the_horizon(s, t):
    """A cap of half-angle s, whose axis is at an angle t to the normal [Howell, configuration B-43]."""
    a = np.arccos(1 / (np.tan(s) * np.tan(t)))
    sine, cosine = np.sin(s), np.cos(s)
    wanted = sine**2 * np.cos(t) * (np.pi - a) - sine * cosine * np.sin(t) * np.sin(a) + np.arccos(cosine / np.sin(t))
    normal = (np.sin(t), 0, np.cos(t))
    sphere = lit(at.SphereLight((0, 0, 1 / sine), 1.0), (0, 0, 0), normal)[0]
    sun = lit(at.DirectionalLight((0, 0, -1), np.degrees(2 * s)), (0, 0, 0), normal)[0]
    np.testing.assert_allclose([sphere, sun * sine**2], wanted / np.pi, rtol=1e-6)


def test_a_disk_before_a_parallel_and_an_upright_surface():
    """[Howell, configurations B-13 and B-14]"""
    for r, h, x in ((1.0, 1.0, 0.0), (1.0, 0.5, 0.0), (0.5, 2.0, 1.3), (2.0, 0.3, 0.7), (0.05, 5.0, 3.0)):
        light = at.DiskLight((x, 0, h), (0, 0, -1), r)
        root = np.sqrt((x * x + h * h + r * r) ** 2 - 4 * r * r * x * x)
        level = (root - (x * x + h * h - r * r)) / (2 * root) / r**2
        assert lit(light, (0, 0, 0), (0, 0, 1))[0] == pytest.approx(level, rel=2e-6)
        if x > r:
            upright = h / (2 * x) * ((x * x + h * h + r * r) / root - 1) / r**2
            assert lit(light, (0, 0, 0), (1, 0, 0))[0] == pytest.approx(upright, rel=2e-6)


def test_a_rectangle_above_a_corner():
    """[Howell, configuration C-11]"""
    a, b, h = 1.2, 0.7, 0.9
    x, y = a / h, b / h
    wanted = x / np.hypot(1, x) * np.arctan(y / np.hypot(1, x)) + y / np.hypot(1, y) * np.arctan(x / np.hypot(1, y))
    corner = at.QuadLight((0, 0, h), (a, 0, 0), (0, b, 0))
    middle = at.QuadLight((-a, b, -h), (2 * a, 0, 0), (0, -2 * b, 0))
    for light, normal in ((corner, (0, 0, 1)), (middle, (0, 0, -1))):
        assert lit(light, (0, 0, 0), normal)[0] == pytest.approx(wanted / (2 * a * b), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_scale_and_place_change_nothing(kind):
    rng = np.random.default_rng(20 + kind)
    light, normals = some_lights(rng)[kind], unit(rng.normal(size=(30, 3)))
    here = lit(light, (0, 0, 0), normals)
    assert (here > 0).any() and (here == 0).any()
    changes = {name: getattr(light, name) for name in ("position", "corner", "center") if hasattr(light, name)}
    for scale in (1e-6, 1e6):
        fields = {name: scale * value for name, value in changes.items()}
        fields |= {name: scale * getattr(light, name) for name in ("u", "v", "radius") if hasattr(light, name)}
        far = lit(replace(light, **fields), (0, 0, 0), normals)
        np.testing.assert_allclose(far * (1.0 if kind == 4 else scale**2), here, rtol=1e-5, atol=1e-9)
    moved = replace(light, **{name: value + (64.0, -32.0, 8.0) for name, value in changes.items()})
    np.testing.assert_allclose(lit(moved, (64, -32, 8), normals, (64, -32, 8)), here, rtol=1e-5, atol=1e-9)


def test_no_receiver_gets_infinite_light_or_none():
    """On lights, inside of spheres, at centres, in planes, on edges and corners."""
    quad, disk = at.QuadLight((-1, -1, 0), (2, 0, 0), (0, 2, 0)), at.DiskLight((0, 0, 0), (0, 0, 1), 1.0)
    sphere = at.SphereLight((0, 0, 0), 1.0)
    points = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [3, 0, 0], [0.5, 0.2, 0], [0, 0, 1], [0, 0, 1 - 1e-7], [0, 0, 0.5]]
    )
    normals = np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 1]]])
    for light in (quad, disk, sphere):
        for point in points:
            found = lit(light, np.broadcast_to(point, normals.shape), normals)
            most = np.pi / (light.area() if light is not sphere else np.pi)
            assert np.isfinite(found).all() and (found >= 0).all() and (found <= most * (1 + 1e-5)).all()


def test_a_pixel_without_a_surface_gets_none():
    light = at.QuadLight((-1, 5, -1), (2, 0, 0), (0, 0, 2))
    zero = np.zeros((1, 2), np.float32)
    side = np.array([[0, 1]], np.int8)
    up = np.broadcast_to(np.float32([0, 1, 0]), (1, 2, 3)).copy()
    gbuffer = GBuffer(np.zeros((1, 2, 3), np.float32), up, zero.astype(np.int32), zero, side, np.zeros(3))
    found = irradiance(gbuffer, light.patch(np.zeros(3), 1.0), light.domain)
    assert found[0, 0] == 0.0 < found[0, 1]
