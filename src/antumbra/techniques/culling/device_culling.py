"""Pre-BVH culling on a device: marked cells, the triangles that overlap one, and the tree of those alone.

The device bounds the receivers of each cell (`device_sources`), and the CPU the samples of each light, which are few. A
thread marks the cells of a layer between two boxes as the CPU does, and prefix sums along each axis make the
summed-volume table. The triangles are tested by the CPU's function, and prefix sums of the answers place the indices of
those that remain [Selgrad et al. 2015, Sec. 3.2 and 3.3]. Receivers are uploaded once, and neither they nor cells nor
triangles come back. Importing this module adds its kernels to those of devices, and their answers to the self-test.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.triangle_bounds import corners_of
from ...devices.device import Device, DeviceMemory
from ...kernels.device import thread_index
from ...kernels.jit import inlined, kernel
from ...kernels.simd import extract, f32_at, f64_at, get, i32_at, maximum, minimum, put
from ...kernels.toolchain.device_code import DeviceKernel
from ...query.light_samples import light_samples
from ...query.query_bounds import bounds
from ...query.receivers import FREE, NOTHING
from ...query.shadow_query import ShadowQuery
from ...scene.lights import DirectionalLight, Light, QuadLight
from ...scene.triangles import Triangles
from ...trace.device.build_kernels import Source, face_of
from ...trace.device.device_kernels import add_kernels
from ...trace.device.device_launches import DeviceLaunches
from ...trace.device.device_receivers import DeviceReceivers
from ...trace.device.device_tracer import BUILDERS, DeviceTracer
from ...trace.device.device_tree import DeviceTree
from ...trace.device.self_test import COMPARISONS, Comparison
from ...trace.device.tree_build import keep_tagged, source_of
from .culling_grid import (
    CellGrid,
    GridPointers,
    HullPointers,
    Targets,
    cell_size,
    cells_between,
    grid_over,
    other_axes,
    pad_of,
    sources_of,
    targets_of,
    tiles_of,
    walls_of,
    while_within,
)
from .device_sources import SOURCE_KERNELS, ReceiverBuffer, SourceBoxes, bound_sources, box_of_receivers
from .pre_bvh_culling import (
    CullRequest,
    MarkedCells,
    Table,
    box_of_segments,
    mark_segments,
    overlaps_marked,
    select_relevant,
    with_shared_receivers,
)

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

add_kernels(CULL_KERNELS)
add_kernels(SOURCE_KERNELS)


# --- Launches ---------------------------------------------------------------------------------------------------------


class Segments(NamedTuple):
    """Segments from sources to targets, on a device."""

    sources: SourceBoxes
    targets: Sequence[Targets]


def mark_cells(grid: CellGrid, groups: Iterable[Segments], launches: DeviceLaunches) -> CellBuffers:
    """Mark the cells that segments may enter; until the next call, on the same device.

    groups : those of one need only stay on the device until the next one is taken
    """
    launch = launches.launch

    def sent(name: str, array: NDArray[np.generic]) -> int:
        return launches.sent(f"{name} of cells", np.ascontiguousarray(array), "the marked cells")

    n, side = grid.n, grid.n + 1
    cells = launches.block("marks", 4 * n**3, "the marked cells")
    sums = launches.block("sums of marks", 4 * side**3, "the marked cells")
    cells.fill()
    marked = CellBuffers(cells.address, sums.address, sent("bounds", grid.bounds), sent("scale", grid.scale), n)
    for sources, all_targets in groups:
        for targets in all_targets:
            per_source = len(targets.boxes)
            count = sources.n * per_source
            pairs = PairBuffers(sources.address, sent("targets", targets.boxes), per_source, int(targets.relative))
            block = launches.block("hulls", 100 * count, "the hulls of receivers and lights").address
            hulls = HullBuffers(*(block + 24 * count * k for k in range(5)))
            launch("make_hulls", (pairs, hulls, count, marked), count)
            launch("mark_layers", (hulls, count, marked, float(pad_of(grid))), count * n)
    launch("spread_marks", (marked,), side**3)
    for axis in range(3):
        launch("sum_lines", (marked, axis), side**2)
    return marked


def mark_queries(
    groups: Sequence[tuple[DeviceReceivers, Sequence[ShadowQuery]]],
    triangles: NDArray[np.float32],
    n: int,
    launches: DeviceLaunches,
) -> CellBuffers | None:
    """`mark_segments` by the method HULLS, on the device. None: no segment can meet a triangle.

    The host sees one box per group, from which it makes the grid and the targets, and the number of sources.

    groups : receivers, and the queries that share them
    triangles : (2, 3) float32, the box of all triangles
    n : cells of the grid per axis
    """
    there, boxes = [], []
    for receivers, queries in groups:
        buffer = ReceiverBuffer(receivers.memory.address, receivers.n)
        box = box_of_receivers(buffer, launches)
        if box is not None:
            there.append((buffer, queries))
            boxes.append((box, queries))
    box_of_all = box_of_segments(boxes, triangles)
    if box_of_all is None:
        return None
    grid = grid_over(*box_of_all, n)
    size = cell_size(grid)
    segments = (
        Segments(bound_sources(buffer, grid, launches), [targets_of(query, size) for query in queries])
        for buffer, queries in there
    )
    return mark_cells(grid, segments, launches)


def read_cells(marked: CellBuffers, launches: DeviceLaunches) -> MarkedCells:
    """The latest cells from `mark_cells`, on the host."""
    sides = (marked.n,) * 3, (marked.n + 1,) * 3
    cells, sums = (
        launches.block(name, 0, "").read(np.empty(shape, np.int32))
        for name, shape in zip(("marks", "sums of marks"), sides)
    )
    return MarkedCells(cells.astype(np.uint8), sums)


def read_sources(sources: SourceBoxes, launches: DeviceLaunches) -> NDArray[np.float64]:
    """(m, 2, 3) float64: the latest boxes from `bound_sources`, on the host."""
    return launches.block("sources", 0, "").read(np.empty((sources.n, 2, 3)))


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
    request: CullRequest,
    triangles: NDArray[np.float32],
    builder: str = "lbvh",
) -> DeviceTree:
    """The tree of the triangles that segments can meet, as from `DeviceTracer.build` of those that `cull` keeps.

    triangles : (2, 3) float32, the box of all triangles
    builder : as for `DeviceTracer.build`

    The receivers stay with the tree, so that tracing does not upload them again.
    """
    launches = tracer.launches
    with tracer.lock:
        groups = [
            (tracer.receivers(queries[0], request.threads), queries)
            for queries in with_shared_receivers(request.queries)
        ]
        marked = mark_queries(groups, triangles, request.n, launches)
        kept = None if marked is None else keep_relevant(source_of(vertices, faces, launches), marked, launches)
        request.lap("cull")
        if kept is None or kept.n < 2:
            tree = tracer.build(vertices, np.empty(0, np.int32) if kept is None else kept_faces(kept, launches))
        else:
            tree = BUILDERS[builder](kept, launches)
        tree.receivers = tuple(receivers for receivers, _ in groups)
        return tree


# --- Self-test --------------------------------------------------------------------------------------------------------


def _random_query(rng: np.random.Generator, light: Light, shape: tuple[int, int]) -> ShadowQuery:
    """Receivers at whole and at random places, some of them missing, and a light."""
    origins = np.where(rng.random((*shape, 1)) < 0.5, rng.integers(-8, 9, (*shape, 3)), rng.uniform(-8, 8, (*shape, 3)))
    sides = rng.choice(np.array([NOTHING, FREE], np.int8), shape)
    none, patch = np.full(shape, -1, np.int32), light.patch(np.zeros(3), 100.0)
    return ShadowQuery(
        origins.astype(np.float32), none, sides, np.empty((0, 0, 3)), np.empty((0, 9), np.float32), patch,
        light_samples(light, 4), 0, none,
    )  # fmt: skip


def compared_tags(device: Device) -> Iterator[Comparison]:
    """(sources, cells and triangles that a device finds, those of the CPU), at whole and at random places."""
    rng, tracer = np.random.default_rng(3), DeviceTracer(device)
    launches = tracer.launches
    whole, loose = rng.integers(-9, 10, (500, 3, 3)), rng.normal(0, 6, (1500, 1, 3)) + rng.normal(0, 1, (1500, 3, 3))
    vertices = np.concatenate([whole, loose]).astype(np.float32)
    lights = QuadLight((-3, 9, 5), (6, 1, 0), (0, 2, -10)), DirectionalLight((1.0, 2.0, 0.5), 5.0)
    shapes = (20, 30), (1, 9)
    queries = [_random_query(rng, light, shape) for light, shape in zip(lights, shapes)]
    ids, colour = np.arange(len(vertices), dtype=np.int32), np.ones((len(vertices), 3), np.float32)
    triangles = Triangles(vertices, np.zeros(3), ids, colour)
    marking = mark_segments(triangles, queries, 1, n=16)
    assert marking is not None
    receivers = [tracer.receivers(query, 1) for query in queries]
    for query, each in zip(queries, receivers):
        sources = bound_sources(ReceiverBuffer(each.memory.address, each.n), marking.grid, launches)
        yield read_sources(sources, launches), sources_of(tiles_of(query, 1), marking.grid, 1)
    box = np.stack(bounds(vertices, 1))
    marked = mark_queries([(each, [query]) for each, query in zip(receivers, queries)], box, 16, launches)
    assert marked is not None
    yield from zip(read_cells(marked, launches), marking.cells)
    found = kept_faces(keep_relevant(source_of(vertices, None, launches), marked, launches), launches)
    yield found, select_relevant(triangles, marking, 1).kept


COMPARISONS.append(compared_tags)
