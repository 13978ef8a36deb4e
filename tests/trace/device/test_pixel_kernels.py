"""The rays of pixels on devices: those of the CPU's G-buffer."""

import numpy as np
import pytest

import antumbra as at
from antumbra.query.ray_passes import rays_through
from antumbra.trace.device.device_surfaces import parts_of, rays_of_pixels
from antumbra.trace.device.device_tracer import DeviceTracer
from devices import DEVICES, opened


@pytest.mark.parametrize("rows", [slice(0, 17), slice(5, 9)])
@pytest.mark.parametrize("name", DEVICES)
def test_the_rays_of_rows_are_those_of_the_cpu(name, rows):
    camera = at.Camera((0.3, 1e3, -7.0), (0.1, 0.2, 0.3), width=23, height=17).rays(np.array([1.0, -2.0, 0.1]))
    launches = DeviceTracer(opened(name)).launches
    (pixels,) = parts_of(camera, rows)
    rays_of_pixels(pixels, launches)
    mask = np.zeros((17, 23), np.bool_)
    mask[rows] = True
    expected = rays_through(camera, mask, 1)
    for block, array in ("origins", expected.origins), ("ends", expected.directions):
        found = launches.block(block, 0, "").read(np.empty((pixels.n, 3), np.float32))
        np.testing.assert_array_equal(found, np.broadcast_to(array, found.shape))
