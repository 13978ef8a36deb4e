"""The kernels of the rasteriser of devices: triangles that pictures cannot show, and cells that triangles miss."""

import numpy as np
import pytest

import antumbra as at
from antumbra.query.raster_bins import make_padding
from antumbra.query.raster_setup import make_view
from antumbra.trace.device.build_kernels import Source
from antumbra.trace.device.device_rasteriser import SeenTriangles
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.raster_kernels import CELL, CELLS, PART, RASTER_KERNELS, RasterCamera
from devices import DEVICES, opened

CAMERA = at.Camera((0, 0, 0), (0, 0, -1), vfov=90.0, width=64, height=64)


def seen_of(name, triangles):
    """The indices of the triangles that `CAMERA` may see."""
    launches = DeviceTracer(opened(name)).launches
    rays = CAMERA.rays(np.zeros(3))
    view = make_view(rays)
    camera = RasterCamera(view, make_padding(view), 0, 64 * 64)
    source = Source(launches.sent_triangles(triangles), 0, len(triangles))
    box = np.stack([triangles.min((0, 1)), triangles.max((0, 1))])
    seen = SeenTriangles(source, camera, box, launches)
    return seen.some(np.arange(seen.n, dtype=np.int32)).prim_ids.tolist()


@pytest.mark.parametrize("name", DEVICES)
def test_triangles_that_hold_no_pixel_are_left_out(name):
    at_depth = lambda x, y, size: np.float32([[x, y, -64.0], [x + size, y, -64.0], [x, y + size, -64.0]])
    triangles = np.stack(
        [
            at_depth(0.5, 0.5, 4.0),  # some pixels: their centres lie at odd numbers
            at_depth(0.25, 0.25, 0.5),  # between the centres
            at_depth(200.0, 0.0, 4.0),  # beyond the right edge
            -at_depth(0.5, 0.5, 4.0),  # behind the camera
            at_depth(-500.0, -500.0, 1500.0),  # larger than the picture
            at_depth(0.5, 0.5, 1.0),  # one pixel
            np.float32([[0, -1, 1], [0, -1, -9], [1, -1, -9]]),  # through the plane of the camera
        ]
    )
    assert seen_of(name, triangles) == [0, 4, 5, 6]


def test_cells_fill_a_part():
    assert CELL * CELL * CELLS == PART * PART
    assert set(RASTER_KERNELS) == {"tag_seen", "draw_triangles", "draw_parts"}
