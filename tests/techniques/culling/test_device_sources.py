"""Receivers of each cell, bounded on devices: the boxes of the CPU, in its order."""

import numpy as np
import pytest

import antumbra as at
from antumbra.query.receivers import FREE, NOTHING
from antumbra.query.shadow_query import ShadowQuery
from antumbra.techniques.culling.culling_grid import bounds_of, grid_over, sources_of, tiles_of
from antumbra.techniques.culling.device_culling import read_sources
from antumbra.techniques.culling.device_sources import (
    SOURCE_KERNELS,
    ReceiverBuffer,
    bound_sources,
    box_of_receivers,
)
from antumbra.trace.device.device_kernels import KERNELS
from antumbra.trace.device.device_tracer import DeviceTracer
from asking import query_of
from devices import DEVICES, opened

UNIT = np.full(3, -8.0), np.full(3, 8.0)


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


def query_at(points, sides=None):
    """A query of receivers in a row."""
    origins = np.ascontiguousarray(points, np.float32).reshape(1, -1, 3)
    sides = np.full(origins.shape[:2], FREE, np.int8) if sides is None else sides.reshape(1, -1)
    none = np.full(sides.shape, -1, np.int32)
    return ShadowQuery(origins, none, sides, np.empty((0, 0, 3)), np.empty((0, 9), np.float32), None, None, 0, none)


def check(tracer, query, grid):
    """Compare the sources and the box of a query's receivers with those of the CPU; return the sources."""
    receivers = tracer.receivers(query, 2)
    buffer, tiles = ReceiverBuffer(receivers.memory.address, receivers.n), tiles_of(query, 2)
    box, expected_box = box_of_receivers(buffer, tracer.launches), bounds_of(tiles)
    assert (box is None) == (expected_box is None)
    if box is not None:
        np.testing.assert_array_equal(box, np.array(expected_box))
    found = read_sources(bound_sources(buffer, grid, tracer.launches), tracer.launches)
    np.testing.assert_array_equal(found, sources_of(tiles, grid, 2))
    return found


@pytest.mark.parametrize("n", [8, 32, 64])
def test_receivers_of_a_picture_have_the_sources_of_the_cpu(tracer, n):
    scene = at.procedural("atrium", triangles=3000)
    light = at.PointLight((0.3, 3.0, 0.1))
    _, query = query_of(scene, scene.cameras[0].resized(48, 40), light, 1)
    low, high = bounds_of(tiles_of(query, 1))
    assert len(check(tracer, query, grid_over(low, high, n))) > n


@pytest.mark.parametrize("n", [1, 2, 127, 1 << 14, (1 << 14) + 1, 40_000])
def test_any_number_of_receivers_is_bounded(tracer, n):
    rng = np.random.default_rng(n)
    points, sides = rng.normal(0, 4, (n, 3)), rng.choice(np.array([NOTHING, FREE, 1, -1], np.int8), n)
    sides[0] = FREE
    check(tracer, query_at(points, sides), grid_over(*UNIT, 16))  # some receivers lie beyond the grid


@pytest.mark.parametrize("scale", [2.0**-140, 2.0**-60, 1.0, 2.0**100])
def test_walls_of_cells_zeros_and_all_magnitudes_are_sorted_like_on_the_cpu(tracer, scale):
    rng = np.random.default_rng(5)
    points = rng.integers(-8, 9, (3000, 3)) * scale
    points[rng.random(points.shape) < 0.1] = -0.0
    points[1000:2000] += rng.normal(0, 1e-6, (1000, 3)) * scale
    low, high = UNIT
    sources = check(tracer, query_at(points), grid_over(low * scale, high * scale, 16))
    assert len(sources) > 999 or (len(sources) == 1 and scale < 2.0**-126)  # below, the grid has a single cell


@pytest.mark.parametrize("extent", [(1, 0, 1), (0, 0, 0)], ids=str)
def test_flat_grids_are_sorted_like_on_the_cpu(tracer, extent):
    points = np.random.default_rng(6).integers(-8, 9, (300, 3)) * np.array(extent)
    check(tracer, query_at(points), grid_over(*(corner * extent for corner in UNIT), 8))


def test_missing_receivers_have_no_box(tracer):
    rng = np.random.default_rng(7)
    assert not len(
        check(tracer, query_at(rng.normal(0, 1, (50, 3)), np.full(50, NOTHING, np.int8)), grid_over(*UNIT, 8))
    )
    assert box_of_receivers(ReceiverBuffer(0, 0), tracer.launches) is None


def test_only_minima_are_atomic():
    """Their result does not depend on the order of threads, as that of a count in a list does."""
    for name, kernel in SOURCE_KERNELS.items():
        lines = [
            line for line in kernel.code("ptx").code.decode().splitlines() if "\tatom." in line or "\tred." in line
        ]
        assert bool(lines) == (name == "bound_cells")
        assert all(".min.s32" in line for line in lines), lines


def test_devices_know_these_kernels():
    assert set(SOURCE_KERNELS) <= set(KERNELS)
