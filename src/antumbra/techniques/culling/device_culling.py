"""Pre-BVH culling on a device: marked cells, the triangles that overlap one, and the tree of those alone.

The CPU bounds receivers and light samples by boxes (`pre_bvh_culling.bound_segments`). Everything else happens on the
device: a thread marks the cells of a layer between two boxes as the CPU does, and prefix sums along each axis make the
summed-volume table. The triangles are tested by the CPU's function, and prefix sums of the answers place the indices of
those that remain [Selgrad et al. 2015, Sec. 3.2 and 3.3]. Importing this module adds its kernels to those of devices,
and their answers to the self-test of cards.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.triangle_bounds import corners_of
from ...devices.device import Device, DeviceMemory
from ...kernels.device import thread_index
from ...kernels.jit import inlined, kernel
from ...kernels.simd import extract, f32_at, f64_at, get, i32_at, maximum, minimum, put
from ...kernels.toolchain.device_code import DeviceKernel
from ...trace.device.build_kernels import Source, face_of
from ...trace.device.device_kernels import KERNELS
from ...trace.device.device_launches import DeviceLaunches
from ...trace.device.device_tracer import DeviceTracer
from ...trace.device.device_tree import DeviceTree
from ...trace.device.self_test import COMPARISONS, Comparison
from ...trace.device.tree_build import BuiltTree, keep_tagged, source_of
from .culling_grid import (
    GridPointers,
    HullPointers,
    Targets,
    cells_between,
    grid_over,
    mark_between,
    other_axes,
    pad_of,
    walls_of,
    while_within,
)
from .pre_bvh_culling import BoundedSegments, MarkedCells, Table, find_relevant, marked_cells_of, overlaps_marked

# --- Kernels ----------------------------------------------------------------------------------------------------------


class CellBuffers(NamedTuple):
    """Marked cells and their grid on a device: addresses, and the number of cells per axis."""

    cells: int  # int32, otherwise as `MarkedCells.cells`
    sums: int  # int32, as `MarkedCells.sums`
    bounds: int  # float32, as `CellGrid.bounds`
    scale: int  # float32, as `CellGrid.scale`
    n: int


@inlined
def _grid(marked):
    return GridPointers(f32_at(marked.bounds), f32_at(marked.scale), marked.n)


class PairBuffers(NamedTuple):
    """Pairs of a source box and a target box: addresses of float64, six per box, and numbers. Sources come first."""

    sources: int
    targets: int
    per_source: int  # number of targets
    relative: int  # 1: targets are relative to the receivers, as in `Targets`


class HullBuffers(NamedTuple):
    """`culling_grid.Hulls` in the order of the pairs: addresses of float64, three per pair, and of int32."""

    lower: int
    upper: int
    grow: int
    swell: int
    axes: int  # the main axis of each pair


@kernel
def make_hulls(pairs, hulls, n, marked):  # pairs: PairBuffers, hulls: HullBuffers, marked: CellBuffers
    """Write the hulls of n pairs, as `hulls_between`."""
    i = thread_index()
    if i >= n:
        return
    source, target = 6 * (i // pairs.per_source), 6 * (i % pairs.per_source)
    widest, main = np.float64(-1.0), 0
    for axis in range(3):
        lower, upper = get(f64_at(pairs.sources), source + axis), get(f64_at(pairs.sources), source + 3 + axis)
        first, last = get(f64_at(pairs.targets), target + axis), get(f64_at(pairs.targets), target + 3 + axis)
        if pairs.relative != 0:
            first, last = lower + first, upper + last
        put(f64_at(hulls.lower), 3 * i + axis, lower)
        put(f64_at(hulls.upper), 3 * i + axis, upper)
        put(f64_at(hulls.grow), 3 * i + axis, first - lower)
        put(f64_at(hulls.swell), 3 * i + axis, last - upper)
        width = abs((first - lower) + (last - upper)) * np.float64(get(f32_at(marked.scale), axis))
        if width > widest:
            widest, main = width, axis
    put(i32_at(hulls.axes), i, main)


@inlined
def _step(axis, n):
    """The distance of the numbers of neighbouring cells along an axis."""
    return n * n if axis == 0 else n if axis == 1 else 1


@kernel
def mark_layers(hulls, n, marked, pad):  # hulls: HullBuffers, marked: CellBuffers, pad: from `pad_of`
    """Mark the cells of n pairs: each thread those of one layer across the pair's main axis."""
    i, layer = thread_index() // marked.n, thread_index() % marked.n
    if i >= n:
        return
    axis, grid, cells = np.int64(get(i32_at(hulls.axes), i)), _grid(marked), i32_at(marked.cells)
    bounds = HullPointers(f64_at(hulls.lower), f64_at(hulls.upper), f64_at(hulls.grow), f64_at(hulls.swell))
    lower, upper = walls_of(grid, axis, layer, pad)
    low, high = while_within(bounds, 3 * i + axis, lower, upper)
    if low <= high:
        u, v = other_axes(axis)
        u0, u1 = cells_between(bounds, 3 * i + u, u, low, high, pad, grid)
        v0, v1 = cells_between(bounds, 3 * i + v, v, low, high, pad, grid)
        for a in range(u0, u1 + 1):
            at = layer * _step(axis, marked.n) + a * _step(u, marked.n)
            for b in range(v0, v1 + 1):
                put(cells, at + b * _step(v, marked.n), 1)


@kernel
def spread_marks(marked):  # marked: CellBuffers
    """Write each mark to its place in the table of sums, and zeros around them."""
    i, side = thread_index(), marked.n + 1
    if i < side * side * side:
        x, y, z = i // (side * side) - 1, i // side % side - 1, i % side - 1
        inside = x >= 0 and y >= 0 and z >= 0
        mark = get(i32_at(marked.cells), (x * marked.n + y) * marked.n + z) if inside else np.int32(0)
        put(i32_at(marked.sums), i, mark)


@kernel
def sum_lines(marked, axis):  # marked: CellBuffers
    """Replace the numbers of a line of the table of sums along an axis by their prefix sums."""
    k, side = thread_index(), marked.n + 1
    if k < side * side:
        u, v = other_axes(axis)
        at = k // side * _step(u, side) + k % side * _step(v, side)
        total = np.int64(0)
        for _ in range(side):
            total += get(i32_at(marked.sums), at)
            put(i32_at(marked.sums), at, total)
            at += _step(axis, side)


@inlined
def _overlaps(grid, low, high, axis):
    """Whether an interval overlaps the grid along an axis."""
    return low <= get(grid.bounds, 4 + axis) and high >= get(grid.bounds, axis)


@inlined
def _is_relevant(source, i, marked):
    """`pre_bvh_culling._is_relevant`, without masks, which devices lack."""
    grid = _grid(marked)
    a, b, c = corners_of(f32_at(source.vertices), face_of(source, i))
    low, high = minimum(minimum(a, b), c), maximum(maximum(a, b), c)
    for_x = _overlaps(grid, extract(low, 0), extract(high, 0), 0)
    for_y = _overlaps(grid, extract(low, 1), extract(high, 1), 1)
    if not (for_x and for_y and _overlaps(grid, extract(low, 2), extract(high, 2), 2)):
        return False
    return overlaps_marked(Table(i32_at(marked.cells), i32_at(marked.sums), grid), low, high)


@kernel
def tag_triangles(source, marked, tags):  # source: Source, marked: CellBuffers, tags: address of int32
    """Write 1 for each triangle that overlaps a marked cell, 0 for the others, and 0 after the last one."""
    i = thread_index()
    if i <= source.n:
        put(i32_at(tags), i, np.int32(i < source.n and _is_relevant(source, i, marked)))


_CELLS, _HULLS = CellBuffers(0, 0, 0, 0, 0), HullBuffers(0, 0, 0, 0, 0)

CULL_KERNELS = {
    "make_hulls": DeviceKernel(make_hulls, (PairBuffers(0, 0, 0, 0), _HULLS, 0, _CELLS)),
    "mark_layers": DeviceKernel(mark_layers, (_HULLS, 0, _CELLS, 0.0)),
    "spread_marks": DeviceKernel(spread_marks, (_CELLS,)),
    "sum_lines": DeviceKernel(sum_lines, (_CELLS, 0)),
    "tag_triangles": DeviceKernel(tag_triangles, (Source(0, 0, 0), _CELLS, 0)),
}
"""Name -> kernel."""

KERNELS.update(CULL_KERNELS)


# --- Launches ---------------------------------------------------------------------------------------------------------


def mark_cells(segments: BoundedSegments, launches: DeviceLaunches) -> CellBuffers:
    """Mark the cells that segments may enter; until the next call, on the same device."""
    grid, launch = segments.grid, launches.launch

    def sent(name: str, array: NDArray[np.generic]) -> int:
        return launches.sent(f"{name} of cells", np.ascontiguousarray(array), "the marked cells")

    n, side = grid.n, grid.n + 1
    cells = launches.block("marks", 4 * n**3, "the marked cells")
    sums = launches.block("sums of marks", 4 * side**3, "the marked cells")
    cells.fill()
    marked = CellBuffers(cells.address, sums.address, sent("bounds", grid.bounds), sent("scale", grid.scale), n)
    for sources, targets in segments.pairs:
        per_source = len(targets.boxes)
        count = len(sources) * per_source
        pairs = PairBuffers(sent("sources", sources), sent("targets", targets.boxes), per_source, int(targets.relative))
        block = launches.block("hulls", 100 * count, "the hulls of receivers and lights").address
        hulls = HullBuffers(*(block + 24 * count * k for k in range(5)))
        launch("make_hulls", (pairs, hulls, count, marked), count)
        launch("mark_layers", (hulls, count, marked, float(pad_of(grid))), count * n)
    launch("spread_marks", (marked,), side**3)
    for axis in range(3):
        launch("sum_lines", (marked, axis), side**2)
    return marked


def read_cells(marked: CellBuffers, launches: DeviceLaunches) -> MarkedCells:
    """The latest cells from `mark_cells`, on the host."""
    sides = (marked.n,) * 3, (marked.n + 1,) * 3
    cells, sums = (
        launches.block(name, 0, "").read(np.empty(shape, np.int32))
        for name, shape in zip(("marks", "sums of marks"), sides)
    )
    return MarkedCells(cells.astype(np.uint8), sums)


def keep_relevant(source: Source, marked: CellBuffers, launches: DeviceLaunches) -> Source:
    """The triangles of a source that overlap a marked cell; until the next call, on the same device."""
    n = source.n
    tags = launches.block("tags", 4 * (n + 1), "the tags of triangles")
    launches.launch("tag_triangles", (source, marked, tags.address), n + 1)
    return keep_tagged(source, tags, launches)


def kept_faces(kept: Source, launches: DeviceLaunches) -> NDArray[np.int32]:
    """(k,) int32: the triangles that the latest `keep_relevant` has left, on the host."""
    return launches.block("kept", 0, "").read(np.empty(kept.n, np.int32))


def build_relevant(
    tracer: DeviceTracer,
    vertices: NDArray[np.float32] | DeviceMemory,
    faces: NDArray[np.int32] | None,
    segments: BoundedSegments,
) -> DeviceTree:
    """The tree of the triangles that overlap a cell that segments may enter, as from `DeviceTracer.build` of them."""
    with tracer.lock:
        launches = tracer.launches
        kept = keep_relevant(source_of(vertices, faces, launches), mark_cells(segments, launches), launches)
        if kept.n < 2:
            return tracer.build(vertices, kept_faces(kept, launches))
        return BuiltTree(kept, launches)


# --- Self-test --------------------------------------------------------------------------------------------------------


def compared_tags(device: Device) -> Iterator[Comparison]:
    """(cells that a device marks and triangles that it keeps, those of the CPU), at whole and at random places."""
    rng, launches = np.random.default_rng(3), DeviceLaunches(device)
    whole, loose = rng.integers(-9, 10, (500, 3, 3)), rng.normal(0, 6, (1500, 1, 3)) + rng.normal(0, 1, (1500, 3, 3))
    vertices = np.concatenate([whole, loose]).astype(np.float32)
    boxes = np.sort(rng.integers(-8, 9, (40, 2, 3)), 1).astype(np.float64)
    boxes[20:, 1] = boxes[20:, 0] + rng.random((20, 3))
    grid, cells = grid_over(np.full(3, -8.0), np.array([8.0, 8.0, 0.0]), 16), np.zeros((16, 16, 16), np.uint8)
    pairs = [(boxes[24:28], Targets(boxes[38:], False)), (boxes[30:32], Targets(boxes[:1] / 8.0, True))]
    for sources, targets in pairs:
        mark_between(sources, targets, grid, cells, 1)
    expected = marked_cells_of(cells, 1)
    marked = mark_cells(BoundedSegments(grid, pairs), launches)
    yield from zip(read_cells(marked, launches), expected)
    found = kept_faces(keep_relevant(source_of(vertices, None, launches), marked, launches), launches)
    relevant = find_relevant(vertices.reshape(-1, 9), grid, expected, 1)
    yield found, relevant.ids[: int(relevant.counts[0])]


COMPARISONS.append(compared_tags)
