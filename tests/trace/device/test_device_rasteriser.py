"""The rasteriser of devices: the G-buffer of the CPU, bit for bit, of triangles that are hard to draw."""

import numpy as np
import pytest

import antumbra as at
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.engine.primary_visibility import primary_visibility
from antumbra.query.gbuffer import GBuffer
from antumbra.query.resident_gbuffer import ResidentGBuffer
from antumbra.trace.device import device_rasteriser
from antumbra.trace.device.device_rasteriser import draw_surfaces
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.device_tracer import DeviceTracer
from devices import DEVICES, opened

EYE = np.array([0.0, 1.0, 5.0])
TINY = Capacities(pairs=24, records=8, least=4)
VIEWS = {"normal": (50.0, 90, 70), "wide": (120.0, 131, 71), "narrow": (5.0, 67, 130)}
"""The vertical angle, the width and the height of a picture."""


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


# --- Triangles --------------------------------------------------------------------------------------------------------


def crossing(rng):
    """Triangles of all sizes, many of which cross the plane of the camera."""
    return rng.normal(0, 1, (150, 3, 3)) * 10.0 ** rng.uniform(-2, 3, (150, 1, 1)) + rng.normal(0, 3, (150, 1, 3))


def behind(rng):
    return rng.normal(0, 1, (20, 3, 3)) + [0.0, 0.0, 16.0]


def in_planes_of_the_eye(rng):
    """Triangles that the camera sees from the side, in float64, and a floor."""
    thin, share = rng.normal(0, 3, (40, 3, 3)), rng.normal(0, 1, (40, 1))
    thin[:, 2] = EYE + share * (thin[:, 0] - EYE) + (1 - share) * (thin[:, 1] - EYE)
    return np.concatenate([thin, [[[-9, -1, -9], [9, -1, -9], [0, -1, 9]]]])


def coincident(rng):
    """Each triangle six times, half of them turned around."""
    triangles = np.repeat(rng.normal(0, 2, (30, 3, 3)), 6, 0)
    triangles[1::2] = triangles[1::2, ::-1].copy()
    return triangles


def through_the_eye(rng):
    """Triangles with a corner in the eye, or with the eye inside."""
    triangles = rng.normal(0, 2, (30, 3, 3))
    triangles[:10, 0] = EYE
    triangles[10:20] += (EYE - triangles[10:20].mean(1))[:, None]
    return triangles


def small(rng):
    """Triangles of less than a pixel, many of them between the centres of pixels."""
    return rng.normal(0, 2, (4000, 1, 3)) + rng.normal(0, 0.01, (4000, 3, 3))


SHAPES = crossing, behind, in_planes_of_the_eye, coincident, through_the_eye, small


def expected_of(shape, view):
    """(triangles, camera, G-buffer of the CPU)."""
    vfov, width, height = VIEWS[view]
    triangles = at.Scene.from_arrays(shape(np.random.default_rng(3)).astype(np.float32)).triangles()
    camera = at.Camera(EYE, (0.0, 0.3, 0.0), vfov=vfov, width=width, height=height)
    return triangles, camera, primary_visibility(triangles, camera, None, 2)


def assert_drawn(tracer, triangles, camera, gbuffer):
    found = draw_surfaces(tracer, triangles, camera.rays(triangles.origin), None, 2)
    for ours, theirs, field in zip(ResidentGBuffer.of(found), gbuffer, GBuffer._fields):
        np.testing.assert_array_equal(ours, theirs, err_msg=field)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_hostile_triangles_are_drawn_as_by_the_cpu(device, shape, view):
    triangles, camera, gbuffer = expected_of(shape, view)
    assert_drawn(DeviceTracer(device), triangles, camera, gbuffer)
    assert (gbuffer.face >= 0).any() == (shape is not behind)


@pytest.mark.parametrize("shape", [crossing, coincident])
def test_lists_that_are_too_short_grow(device, shape, monkeypatch):
    triangles, camera, gbuffer = expected_of(shape, "wide")
    tracer = DeviceTracer(device, TINY)
    monkeypatch.setattr(device_rasteriser, "_PARTS", 1)
    assert_drawn(tracer, triangles, camera, gbuffer)
    assert tracer.undecided > 0
    parts, pairs = (tracer.launches.block(name, 0, "").size for name in ("parts of triangles", "pairs"))
    assert parts > 20
    assert pairs > 8 * TINY.pairs or shape is crossing


def test_lists_that_would_take_all_memory_are_refused(device, monkeypatch):
    triangles, camera, _ = expected_of(crossing, "wide")
    monkeypatch.setattr(device_rasteriser, "_PARTS", 1)
    monkeypatch.setattr(device_rasteriser, "_MOST", 8)
    with pytest.raises(OutOfDeviceMemory, match="lists of a rasteriser"):
        draw_surfaces(DeviceTracer(device), triangles, camera.rays(triangles.origin), None, 2)


def test_later_pictures_do_not_see_earlier_ones(device):
    tracer = DeviceTracer(device, CAPACITIES)
    for shape, view in (crossing, "wide"), (behind, "normal"), (small, "narrow"), (coincident, "normal"):
        assert_drawn(tracer, *expected_of(shape, view))


def test_rays_that_float32_hardly_tells_apart_are_left_to_the_cpu(device):
    triangles, _, _ = expected_of(small, "normal")
    tiny = at.Camera(EYE, (0.0, 0.3, 0.0), vfov=1e-5, width=64, height=64)
    assert draw_surfaces(DeviceTracer(device), triangles, tiny.rays(triangles.origin), None, 2) is None
