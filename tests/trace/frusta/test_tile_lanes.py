"""Rays of several tiles are gathered into full vectors, in the order of tiles and receivers."""

from typing import NamedTuple

import numpy as np

from antumbra.kernels.jit import F32Ptr, I32Ptr, kernel
from antumbra.kernels.simd import ptr, ptr_at
from antumbra.trace.frusta.tile_lanes import COMPACTED_FLOATS, compacted_at, gather

ROW = 17 * 16


class Rays(NamedTuple):
    """What `gather` reads of a tile."""

    origins: F32Ptr
    points: F32Ptr
    faces: I32Ptr
    number: int


@kernel
def _gather(origins, points, faces, s, receivers, memory):
    rays, n = compacted_at(ptr(memory)), np.int64(0)
    for k in range(len(receivers)):
        tile = Rays(
            ptr_at(ptr(origins), 48 * k), ptr_at(ptr(points), 16 * 48 * k), ptr_at(ptr(faces), 16 * k), np.int64(k)
        )
        n = gather(rays, n, tile, s, receivers[k])
    return n


def test_rays_are_gathered_without_gaps():
    rng, s = np.random.default_rng(1), 5
    origins, points = rng.normal(size=(16, 3, 16)).astype(np.float32), rng.normal(size=(16, 16, 3, 16))
    points, faces = points.astype(np.float32), rng.integers(0, 99, (16, 16)).astype(np.int32)
    receivers = rng.integers(0, 1 << 16, 16)
    receivers[3], receivers[4] = 0, 0xFFFF
    memory = np.full(COMPACTED_FLOATS, np.nan, np.float32)
    n = _gather(origins, points, faces, s, receivers, memory)
    tile, lane = np.nonzero(receivers[:, None] >> np.arange(16) & 1)
    assert n == len(tile) and 100 < n < 200
    gathered = memory.reshape(8, ROW)[:, :n]
    np.testing.assert_array_equal(gathered[:3], origins[tile, :, lane].T)
    np.testing.assert_array_equal(gathered[3:6], points[tile, s, :, lane].T)
    np.testing.assert_array_equal(gathered[6].view(np.int32), tile << 8 | s << 4 | lane)
    np.testing.assert_array_equal(gathered[7].view(np.int32), faces[tile, lane])
