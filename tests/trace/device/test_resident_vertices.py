"""New vertices on a device: the triangles, bounds and areas that the CPU finds, and the same refusals."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.devices.arrays import DeviceArray
from antumbra.scene.scene_bounds import NEAREST, flush_to_zero
from antumbra.scene.triangle_setup import survey
from antumbra.trace.device.build_kernels import Source
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.resident_vertices import ResidentVertices, surveyed
from bvh_scenes import HAZARDS, terrain
from devices import DEVICES, opened

ORIGIN = np.array([0.25, -1.0, 1e3])


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


def on(tracer, array):
    return DeviceArray(tracer.device.upload(array), array.shape, array.dtype, tracer.device.queue)


def framed(tracer, array, corners=None, origin=ORIGIN):
    return ResidentVertices(tracer, on(tracer, array)).in_frame(corners, origin, "it")


@pytest.mark.parametrize("name", [name for name, vertices in HAZARDS.items() if len(vertices)])
def test_the_survey_of_triangles_is_that_of_the_cpu(tracer, name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    expected = survey(vertices, 1)
    with tracer.device.upload(vertices) as memory:
        bounds, with_area = surveyed(Source(memory.address, 0, len(vertices)), tracer.launches)
    np.testing.assert_array_equal(bounds, expected.bounds)
    assert (with_area is None) == (expected.with_area is None)
    if with_area is not None:
        np.testing.assert_array_equal(with_area, expected.with_area)


@pytest.mark.parametrize("n", [1, 2, 127, 1 << 14, (1 << 14) + 1, 40_000])
def test_the_survey_of_any_number_of_triangles_finds_those_without_area(tracer, n):
    vertices, flat = terrain(2 * n, seed=n)[:n].copy(), np.arange(0, n, 7)
    vertices[flat, 2] = 0.5 * (vertices[flat, 0] + vertices[flat, 1])  # lines, and some that only rounding makes none
    expected = survey(vertices, 1)
    with tracer.device.upload(vertices) as memory:
        bounds, with_area = surveyed(Source(memory.address, 0, n), tracer.launches)
    np.testing.assert_array_equal(bounds, expected.bounds)
    np.testing.assert_array_equal(with_area, expected.with_area)
    assert n < 8 or 0 < len(with_area) < n


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("indexed", [False, True])
def test_vertices_are_recentred_as_on_the_cpu(tracer, dtype, indexed):
    rng = np.random.default_rng(2)
    points = (rng.normal(0, 9, (300, 3)) + ORIGIN).astype(dtype)
    points[5] = ORIGIN + [NEAREST / 4, 0, 0]
    corners = rng.integers(0, 300, 900).astype(np.int32) if indexed else None
    local = flush_to_zero((points.astype(np.float64) - ORIGIN).astype(np.float32))
    expected = (local if corners is None else local[corners]).reshape(-1, 3, 3)
    found = framed(tracer, points if indexed else points.reshape(-1, 3, 3), corners)
    np.testing.assert_array_equal(found.fetch(), expected)
    np.testing.assert_array_equal(found.bounds, survey(expected, 1).bounds)


def test_it_is_known_whether_the_frame_holds_all_digits(tracer):
    points = np.random.default_rng(3).integers(-99, 99, (8, 3, 3)).astype(np.float64)
    assert framed(tracer, points).exact and framed(tracer, points.astype(np.float32)).exact
    points[7, 2, 1] += 2.0**-40
    assert not framed(tracer, points).exact
    assert not framed(tracer, points, origin=np.full(3, 1 / 3)).exact


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e19, 1e300])
def test_vertices_that_no_scene_has_are_refused(tracer, value):
    points = np.zeros((6, 3, 3))
    points[4, 1, 2] = value
    used = tracer.device.used
    with pytest.raises(InputError, match=r"it: vertices hold NaN or infinity, or are over 1e\+18 .* \(vertex 13\)"):
        framed(tracer, points)
    assert tracer.device.used <= used + 4096  # blocks that are kept


def test_arrays_that_are_no_points_are_refused(tracer):
    for array, message in (np.zeros((4, 2)), "shape"), (np.zeros((3, 3), np.int32), "int32"):
        with pytest.raises(InputError, match=message):
            ResidentVertices(tracer, on(tracer, array))
