"""The kernels that build trees on devices: bounds and cells of Morton codes, prefix sums, and their launches' code."""

import numpy as np
import pytest

from antumbra.bvh.morton_sort import grid_of
from antumbra.bvh.triangle_bounds import scene_bounds
from antumbra.trace.device.build_kernels import BITS, BUILD_KERNELS, ROW, Source
from antumbra.trace.device.device_launches import DeviceLaunches
from antumbra.trace.device.tree_build import add_up, write_grid
from bvh_scenes import HAZARDS
from devices import DEVICES, opened


@pytest.fixture(scope="module", params=DEVICES)
def launches(request):
    return DeviceLaunches(opened(request.param))


@pytest.mark.parametrize("n", [1, 2, ROW, 1024, 1025, 1024 * ROW, 1024 * ROW + 1])
def test_prefix_sums_are_those_of_numpy(launches, n):
    numbers = np.random.default_rng(n).integers(0, 9, n).astype(np.int32)
    with launches.device.upload(numbers) as memory:
        add_up(launches, memory.address, n)
        np.testing.assert_array_equal(memory.read(np.empty_like(numbers)), np.cumsum(numbers) - numbers)


@pytest.mark.parametrize("name", [name for name, vertices in HAZARDS.items() if len(vertices) > 1])
def test_the_grid_of_codes_is_that_of_the_cpu_to_the_bit(launches, name):
    flat = np.ascontiguousarray(HAZARDS[name], np.float32).reshape(-1, 9)
    expected = grid_of(scene_bounds(flat, 1)[1], BITS)
    with launches.device.upload(flat) as memory:
        grid = write_grid(launches, Source(memory.address, 0, len(flat)))
        strips = launches.block("strips", 0, "")
        numbers = strips.read(np.empty(5, np.float32), offset=grid - strips.address)
    np.testing.assert_array_equal(numbers[:3], expected.origin[:3])
    assert numbers[4] == expected.factor


def test_no_launch_of_a_build_waits_for_threads_or_counts_atomically():
    """Then the launches need no assumption about which threads of a card run at a time."""
    for name, kernel in BUILD_KERNELS.items():
        text = kernel.code("ptx").code.decode()
        assert not [word for word in ("bar.", "atom.", "red.", "shfl.", "vote.", "membar") if f"\t{word}" in text], name
