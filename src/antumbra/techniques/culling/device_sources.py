"""Sources of pre-BVH culling on a device: a box around the receivers of each cell, as `culling_grid.sources_of`.

One thread per receiver lowers six numbers of its cell, by `atomic_min`: minima do not depend on the order of threads.
An int32 that is ordered as a float32 is its *key*. The cells with receivers are tagged, and prefix sums of the tags
place their boxes in the order of the CPU [Selgrad et al. 2015, Sec. 3.1].
"""

from typing import NamedTuple

import numpy as np

from ...kernels.device import atomic_min, load4_aligned, thread_index
from ...kernels.jit import inlined, kernel
from ...kernels.simd import f32_at, f64_at, get, i32_at, join, minimum, put, splat8, store
from ...kernels.toolchain.device_code import DeviceKernel
from ...query.receivers import NOTHING
from ...trace.device.device_launches import DeviceLaunches
from ...trace.device.device_rays import SIDE
from ...trace.device.tree_build import add_up, join_all, strips_of
from .culling_grid import FINEST, CellGrid, GridPointers, cell_at, divided

# --- Kernels ----------------------------------------------------------------------------------------------------------

_INF = np.float32(np.inf)
_SIGN, _REST = np.int32(-(2**31)), np.int32(2**31 - 1)  # of the bits of a float32
_EMPTY = _REST  # the keys of a cell without receivers: above that of infinity
_KEYS = 6  # per cell: of the lower corner, and of minus the upper one


class ReceiverBuffer(NamedTuple):
    """Receivers on a device: an address and a number."""

    address: int  # 16 bytes each, as `SampleBuffers.receivers`
    n: int


class CellKeys(NamedTuple):
    """The cells of a grid and the boxes of their receivers: addresses, and the number of cells per axis."""

    keys: int  # int32, _KEYS per cell
    bounds: int  # float32, as `CellGrid.bounds`
    scale: int  # float32, as `CellGrid.scale`
    n: int


@inlined
def _is_there(receivers, i):
    return (get(i32_at(receivers.address), 4 * i + 3) & SIDE) != NOTHING + 1


@kernel
def bound_receivers(receivers, strips, n):  # receivers: ReceiverBuffer, strips: address of float32
    """Write the boxes, 8 float32 each, of n strips: every n-th receiver."""
    k = thread_index()
    if k < n:
        box, i = splat8(_INF), k
        while i < receivers.n:
            if _is_there(receivers, i):
                point = load4_aligned(f32_at(receivers.address), 4 * i)  # the fourth lane is not a number of a box
                box = minimum(box, join(point, -point))
            i += n
        store(f32_at(strips), 8 * k, box)


@kernel
def empty_cells(cells):  # cells: CellKeys
    """Empty all cells."""
    i = thread_index()
    if i < _KEYS * cells.n * cells.n * cells.n:
        put(i32_at(cells.keys), i, _EMPTY)


@inlined
def _key(bits):
    """The key of the bits of a float32; the bits of a key."""
    return bits ^ _REST if bits < 0 else bits


@inlined
def _lower(cells, at, bits):
    """Lower a key, unless it is lower already: most receivers change nothing."""
    key = _key(bits)
    if key < get(cells, at):
        atomic_min(cells, at, key)


@kernel
def bound_cells(receivers, cells):  # receivers: ReceiverBuffer, cells: CellKeys
    """Grow the boxes of cells to enclose their receivers."""
    i = thread_index()
    if i >= receivers.n or not _is_there(receivers, i):
        return
    grid, points = GridPointers(f32_at(cells.bounds), f32_at(cells.scale), cells.n), receivers.address
    cell = np.int64(0)
    for axis in range(3):
        cell = cell * cells.n + cell_at(grid, axis, get(f32_at(points), 4 * i + axis))
    for axis in range(3):
        x = get(i32_at(points), 4 * i + axis)
        _lower(i32_at(cells.keys), _KEYS * cell + axis, x)
        _lower(i32_at(cells.keys), _KEYS * cell + 3 + axis, x ^ _SIGN)


@kernel
def tag_cells(cells, tags):  # cells: CellKeys, tags: address of int32
    """Write 1 for each cell with receivers, 0 for the others, and 0 after the last one."""
    i, last = thread_index(), cells.n * cells.n * cells.n
    if i <= last:
        put(i32_at(tags), i, np.int32(i < last and get(i32_at(cells.keys), _KEYS * i) != _EMPTY))


@inlined
def _number_at(keys, i):
    """The float64 of key i, which becomes its bits."""
    put(i32_at(keys), i, _key(get(i32_at(keys), i)))
    return np.float64(get(f32_at(keys), i))


@kernel
def write_sources(cells, places, boxes):  # cells: CellKeys, places: address of int32, boxes: of float64
    """Write the boxes of the tagged cells, whose `places` are the prefix sums of all tags."""
    i, at = thread_index(), i32_at(places)
    if i < cells.n * cells.n * cells.n and get(at, i + 1) > get(at, i):
        place = 6 * np.int64(get(at, i))
        for axis in range(3):
            put(f64_at(boxes), place + axis, _number_at(cells.keys, _KEYS * i + axis))
            put(f64_at(boxes), place + 3 + axis, -_number_at(cells.keys, _KEYS * i + 3 + axis))


_RECEIVERS, _CELLS = ReceiverBuffer(0, 0), CellKeys(0, 0, 0, 0)

SOURCE_KERNELS = {
    "bound_receivers": DeviceKernel(bound_receivers, (_RECEIVERS, 0, 0)),
    "empty_cells": DeviceKernel(empty_cells, (_CELLS,)),
    "bound_cells": DeviceKernel(bound_cells, (_RECEIVERS, _CELLS)),
    "tag_cells": DeviceKernel(tag_cells, (_CELLS, 0)),
    "write_sources": DeviceKernel(write_sources, (_CELLS, 0, 0)),
}
"""Name -> kernel."""


# --- Launches ---------------------------------------------------------------------------------------------------------


class SourceBoxes(NamedTuple):
    """Boxes of sources on a device: an address and a number."""

    address: int  # float64, six per box: lower and upper corner
    n: int


def box_of_receivers(receivers: ReceiverBuffer, launches: DeviceLaunches) -> np.ndarray | None:
    """(2, 3) float64: lower and upper corner of the box of receivers, on the host; None if there are none."""
    if not receivers.n:
        return None
    strips, boxes = strips_of(receivers.n, launches)
    launches.launch("bound_receivers", (receivers, boxes, strips), strips)
    box = join_all(boxes, strips, launches).astype(np.float64)
    return np.stack([box[:3], -box[4:7]]) if box[0] < np.inf else None


def bound_sources(receivers: ReceiverBuffer, grid: CellGrid, launches: DeviceLaunches) -> SourceBoxes:
    """`culling_grid.sources_of` on the device, until the next call."""
    grid, launch = divided(grid.bounds, min(grid.n, FINEST)), launches.launch
    count, what = grid.n**3, "the cells of receivers"
    bounds, scale = (launches.sent(f"{name} of sources", getattr(grid, name), what) for name in ("bounds", "scale"))
    keys = launches.block("keys", 4 * _KEYS * count, what).address
    tags = launches.block("tags of cells", 4 * (count + 1), what)
    cells = CellKeys(keys, bounds, scale, grid.n)
    launch("empty_cells", (cells,), _KEYS * count)
    launch("bound_cells", (receivers, cells), receivers.n)
    launch("tag_cells", (cells, tags.address), count + 1)
    add_up(launches, tags.address, count + 1)
    n = int(tags.read(np.empty(1, np.int32), offset=4 * count)[0])
    boxes = launches.block("sources", 48 * n, what).address
    launch("write_sources", (cells, tags.address, boxes), count)
    return SourceBoxes(boxes, n)
