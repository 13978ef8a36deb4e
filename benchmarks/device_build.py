"""Trees that a device builds from new vertices, beside the CPU's `lbvh`: the part `build` of benchmarks/device.py.

The scene is a height field of triangles whose waves move. Cases, for each of --triangles:

- `build`: the tree of `lbvh`, from vertices on the device or on the host. `differs` counts the words of nodes,
  triangles and indices that are not the CPU's.
- `ploc`: the tree of `ploc`, in the same way
- `refit`: the same tree after the waves have moved, with its SAH cost, by which plans choose refits
- `update`: new vertices, from an array on the device, recentred and surveyed
- `raster`: what a camera sees of the triangles, without a tree, from vertices on the host. `differs` counts pixels.
- `cull`: the tree of what `grid32` leaves for the shadow rays of a picture, from receivers on the host
- `frame`: the tree of new triangles, and the shadow rays of a picture in it: receivers and vertices on the host before,
  bits on the host after. `differs` counts receivers.
- `culled`: the same frame with `grid32`, from vertices on the device

The rows of `cull` and `culled` have the bytes that one call copies to the device and from it.

Steps: each kernel of a build, a refit, an update, of rasterisation and of culling with its launches, the time between
the events before and after them, and the bytes that it must move at least once: what a kernel reads again comes from
caches.
"""

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import antumbra
from antumbra.bvh import lbvh, ploc, refit
from antumbra.bvh.nodes import LINK, Bvh
from antumbra.bvh.tree_quality import AREA_ROW
from antumbra.devices.arrays import DeviceArray
from antumbra.devices.device import Device, DeviceMemory
from antumbra.engine.primary_visibility import primary_visibility
from antumbra.query.query_bounds import triangle_box
from antumbra.query.shadow_query import ShadowQuery, new_bits, ray_count
from antumbra.scene.camera import Camera
from antumbra.scene.lights import QuadLight
from antumbra.scene.resident_triangles import FramedVertices
from antumbra.scene.triangle_setup import survey
from antumbra.scene.triangles import Triangles
from antumbra.techniques.culling.device_culling import build_relevant
from antumbra.techniques.culling.pre_bvh_culling import CullRequest, cull
from antumbra.trace.device.build_kernels import DIGIT
from antumbra.trace.device.device_launches import DeviceLaunches
from antumbra.trace.device.device_rasteriser import draw_surfaces
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.device_tree import DeviceTree
from antumbra.trace.device.ploc_build import PlocTree
from antumbra.trace.device.resident_vertices import ResidentVertices
from antumbra.trace.device.tree_build import BuiltTree, LbvhTree, source_of
from antumbra.trace.tracer import TRACERS
from peers.ray_contest import query_of

MOVED: dict[str, Callable[..., int]] = {
    "bound_strips": lambda source, strips, n, summary: 36 * source.n + 32 * n,
    "join_strips": lambda strips, n, out, m: 32 * (n + m),
    "make_grid": lambda strips, n, grid: 32 * n,
    "write_codes": lambda source, grid, codes, faces: 44 * source.n,
    "count_digits": lambda source, shift, counts: 4 * source.n + (4 << DIGIT) * source.parts,
    "sum_rows": lambda numbers, n, sums, m: 4 * (n + m),
    "scan_rows": lambda numbers, n, row, starts, m: 8 * n + 4 * m,
    "scatter_keys": lambda source, shift, places, keys, values: 16 * source.n + (4 << DIGIT) * source.parts,
    "split_nodes": lambda codes, spines: 12 * spines.n,
    "count_spines": lambda spines: 12 * spines.n,
    "write_nodes": lambda spines, nodes, ranges: 12 * spines.n,
    "write_triangles": lambda tree, faces, step, vertices, n: 88 * n,
    "bound_slots": lambda tree, n, pyramid: 48 * n + 32 * pyramid.lowest,
    "join_pairs": lambda pyramid, first, end: 96 * (end - first),
    "bound_nodes": lambda tree, nodes, ranges, pyramid, n: 84 * n + 64 * pyramid.lowest,
    "survey_strips": lambda source, strips, n, tags: 40 * source.n + 32 * n,
    "keep_tagged": lambda source, places, faces: 4 * source.n,
    "frame_points": lambda points, n, out, faults: (24 + 12 * points.double) * n,
    "cut_ranges": lambda codes, n, largest, tags: 4 * n,
    "begin_ranges": lambda places, active: 12 * active.n,
    "begin_roots": lambda active: 4 * active.n,
    "begin_clusters": lambda vertices, faces, clusters: 84 * clusters.n,
    "find_nearest": lambda active, clusters, further: 44 * active.n,
    "tag_merges": lambda active, merges, stays: 12 * active.n,
    "merge_pairs": lambda active, clusters, merges, stays, next_id, rest: 128 * active.n,
    "seat_roots": lambda active, firsts, clusters: 12 * active.n,
    "place_children": lambda clusters, first, n, nodes: 72 * n,
    "seat_triangles": lambda clusters, faces, out: 12 * clusters.n,
    "copy_links": lambda source, n, target: 32 * n,
    "refit_nodes": lambda tree, order, first, n: 120 * n,
    "bound_receivers": lambda receivers, strips, n: 16 * receivers.n + 32 * n,
    "empty_cells": lambda cells: 24 * cells.n**3,
    "bound_cells": lambda receivers, cells: 16 * receivers.n + 48 * cells.n**3,
    "tag_cells": lambda cells, tags: 8 * cells.n**3,
    "write_sources": lambda cells, places, boxes: 4 * cells.n**3,
    "make_hulls": lambda pairs, hulls, n, marked: 100 * n,
    "mark_layers": lambda hulls, n, marked, pad: 100 * n,
    "spread_marks": lambda marked: 4 * marked.n**3 + 4 * (marked.n + 1) ** 3,
    "sum_lines": lambda marked, axis: 8 * (marked.n + 1) ** 3,
    "tag_triangles": lambda source, marked, tags: 40 * source.n,
    "write_pixel_rays": lambda pixels, origins, directions: 24 * pixels.n,
    "tag_seen": lambda source, camera, tags: 40 * source.n,
    "draw_triangles": lambda drawn, camera, rays, work, targets: 48 * drawn.n + 32 * camera.n,
    "draw_parts": lambda drawn, camera, rays, work, targets, n: 20 * n,
    "settle_nearest": lambda tree, rays, work, first, n: 84 * n,
    "report_hits": lambda tree, rays, work, hits, first, n: 96 * n,
    "use_picture_t": lambda tree, rays, work, hits: 84 * work.n,
    "write_numbers": lambda hits, rays, t, u, v, n: 36 * n,
    "mark_rays": lambda out, marks, n: 12 * n,
    "gather_points": lambda points, places, n, out: 28 * n,
    "write_surfaces": lambda pixels, hits, vertices, out: 80 * pixels.n,
    "move_receivers": lambda surfaces, vertices, work, first, n: 76 * n,
    "sum_areas": lambda tree, n, sums: 64 * n + 16 * (n // AREA_ROW + 1),
    "join_areas": lambda sums, n, out, m: 16 * (n + m),
}
"""Name of a kernel -> the bytes that a launch moves at least, by its arguments, if the triangles cover the picture."""


class Timings(NamedTuple):
    """How the caller times, and makes rows."""

    timed: Callable[[Callable[[], Any], int], Any]
    row: Callable[..., dict[str, Any]]
    rounds: int
    threads: int


# --- The scene --------------------------------------------------------------------------------------------------------


def waves(n: int, time: float) -> np.ndarray:
    """(n, 3, 3) float32: a height field of n triangles over 20 x 20, with waves that move."""
    side = int(np.ceil(np.sqrt(n / 2)))
    x, z = np.meshgrid(*2 * [np.linspace(-10, 10, side + 1)])
    y = np.sin(2.0 * x + time) * np.cos(1.7 * z - time) + 0.1 * np.sin(31 * x) * np.sin(29 * z)
    p = np.stack([x, y, z], axis=-1).astype(np.float32)
    a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
    return np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 3)[:n].copy()


def camera_of(size: tuple[int, int]) -> Camera:
    """The camera above the waves."""
    return Camera((0.0, 7.0, 14.0), (0.0, -1.0, 0.0), width=size[0], height=size[1])


def shadow_query_of(
    vertices: np.ndarray, size: tuple[int, int], spp: int, threads: int
) -> tuple[Triangles, ShadowQuery]:
    """The triangles of the waves, and the shadow rays of a picture of them, to a light that is low above them."""
    light = QuadLight((-14.0, 3.0, -3.0), (0.0, 2.0, 0.0), (0.0, 0.0, 2.0))
    triangles = antumbra.Scene.from_arrays(vertices).triangles()._replace(vertices=vertices, origin=np.zeros(3))
    return triangles, query_of(triangles, camera_of(size), light, spp, threads)


# --- Rows -------------------------------------------------------------------------------------------------------------


def parts(bvh: Bvh) -> np.ndarray:
    """The words of a tree, for comparisons; 0 and -0 are equal, but links are not floats."""
    arrays = bvh.nodes[:, :LINK], bvh.links[:, LINK:], bvh.prim_ids, bvh.corners
    return np.concatenate([each.ravel().astype(np.float64) for each in arrays])


def step_rows(launches: DeviceLaunches, build: Callable[[], Any]) -> Iterator[dict[str, Any]]:
    """Each kernel that `build` launches: launches, seconds and bytes."""
    queue, launch, marks = launches.device.queue, launches.launch, []

    def marked(name: str, arguments: Any, threads: int) -> None:
        if threads <= 0:  # nothing is launched
            return
        before = queue.record()
        launch(name, arguments, threads)
        marks.append((name, MOVED[name](*arguments), before, queue.record()))

    launches.launch = marked  # type: ignore[method-assign]
    try:
        build()
    finally:
        launches.launch = launch  # type: ignore[method-assign]
    queue.synchronise()
    found: dict[str, list[float]] = defaultdict(lambda: [0, 0.0, 0])
    for name, moved, before, after in marks:
        for k, value in enumerate((1, after.seconds_since(before), moved)):
            found[name][k] += value
    for name, (count, seconds, moved) in found.items():
        yield {"kernel": name, "launches": int(count), "seconds": [seconds], "bytes": int(moved)}


def rows(tracer: DeviceTracer, n: int, options: argparse.Namespace, how: Timings) -> Iterator[dict[str, Any]]:
    """Rows of all cases, and of the steps of a build."""
    about = {"scene": "waves", "triangles": n}
    first, second, device = waves(n, 0.0), waves(n, 0.4), tracer.device
    on_cpu = how.timed(partial(lbvh.build, first, how.threads), how.rounds)
    with device.upload(first, "the triangles") as memory, device.upload(second, "the triangles") as moved:
        there = partial(LbvhTree, source_of(memory, None, tracer.launches), tracer.launches)
        built = how.timed(there, how.rounds)
        copied = how.timed(partial(tracer.build, first), how.rounds)
        cpu, truth = on_cpu._replace(answers=parts(on_cpu.answers)), parts(on_cpu.answers)
        for method, timing in ("device", built), ("device, host arrays", copied):
            yield how.row(
                about | {"case": "build"}, method, timing._replace(answers=parts(timing.answers.bvh)), n, truth
            )
        yield how.row(about | {"case": "build"}, "cpu", cpu, n, truth)

        yield from ploc_rows(tracer, memory, first, how, about)

        def refitted() -> BuiltTree:
            tree = built.answers.refitted(moved)
            tree.cost()
            return tree

        timing = how.timed(refitted, how.rounds)
        on_cpu = how.timed(partial(refit.refit, on_cpu.answers, second, how.threads), how.rounds)
        truth = parts(on_cpu.answers)
        yield how.row(about | {"case": "refit"}, "device", timing._replace(answers=parts(timing.answers.bvh)), n, truth)
        yield how.row(about | {"case": "refit"}, "cpu", on_cpu._replace(answers=truth), n, truth)
        array = DeviceArray(memory, first.shape, first.dtype, device.queue)

        def updated() -> FramedVertices:
            return ResidentVertices(tracer, array).in_frame(None, np.zeros(3), "waves")

        timing, on_cpu = how.timed(updated, how.rounds), how.timed(partial(survey, first, how.threads), how.rounds)
        truth = bounds_and(first, on_cpu.answers.bounds)
        answers = bounds_and(timing.answers.fetch(), timing.answers.bounds)
        yield how.row(about | {"case": "update"}, "device", timing._replace(answers=answers), n, truth)
        yield how.row(about | {"case": "update"}, "cpu", on_cpu._replace(answers=truth), n, truth)
        triangles, query = shadow_query_of(first, options.size, options.spp, how.threads)
        camera = camera_of(options.size)
        draw = partial(draw_surfaces, tracer, triangles, camera.rays(triangles.origin), None, how.threads)
        on_cpu = how.timed(partial(primary_visibility, triangles, camera, threads=how.threads), how.rounds)
        for method, timing in ("device", how.timed(draw, how.rounds)), ("cpu", on_cpu):
            seen = timing._replace(answers=(timing.answers.face, timing.answers.depth))
            truth = on_cpu.answers.face, on_cpu.answers.depth
            yield how.row(about | {"case": "raster"}, method, seen, camera.width * camera.height, truth)

        def culled() -> DeviceTree:
            request = CullRequest([query], 32, how.threads, lambda step: None)
            return build_relevant(tracer, memory, None, request, triangle_box(triangles))

        def culled_on_cpu() -> Bvh:
            left = cull(triangles, [query], how.threads)
            bvh = lbvh.build(left.vertices, how.threads)
            return bvh._replace(prim_ids=left.kept[bvh.prim_ids])

        timing, on_cpu = how.timed(culled, how.rounds), how.timed(culled_on_cpu, how.rounds)
        truth = parts(on_cpu.answers)
        copied_bytes = copies_of(device, culled)
        timing = timing._replace(answers=parts(timing.answers.bvh))
        yield how.row(about | {"case": "cull"}, "device", timing, n, truth) | copied_bytes
        yield how.row(about | {"case": "cull"}, "cpu", on_cpu._replace(answers=truth), n, truth)
        of_ploc = partial(PlocTree, source_of(memory, None, tracer.launches), tracer.launches)
        steps = {"build": there, "ploc": of_ploc, "refit": refitted, "update": updated, "raster": draw, "cull": culled}
        for case, work in steps.items():
            for each in step_rows(tracer.launches, work):
                yield about | {"case": f"{case} step"} | each
        yield from culled_frame_rows(tracer, culled, query, how, about)
    yield from frame_rows(tracer, second, options, how, about)


def bounds_and(vertices: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Vertices with their bounds, for comparisons."""
    return np.concatenate([vertices.ravel(), bounds.ravel()])


def ploc_rows(
    tracer: DeviceTracer, memory: DeviceMemory, vertices: np.ndarray, how: Timings, about: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Rows of the tree of `ploc`."""
    source, n = source_of(memory, None, tracer.launches), len(vertices)
    built = how.timed(partial(PlocTree, source, tracer.launches), how.rounds)
    on_cpu = how.timed(partial(ploc.build, vertices, how.threads), how.rounds)
    truth = parts(on_cpu.answers)
    for method, timing, answers in ("device", built, parts(built.answers.bvh)), ("cpu", on_cpu, truth):
        yield how.row(about | {"case": "ploc"}, method, timing._replace(answers=answers), n, truth)


def copies_of(device: Device, work: Callable[[], Any]) -> dict[str, int]:
    """The bytes that a call copies to a device and from it."""
    counts, copies = {"uploaded": 0, "downloaded": 0}, (device.upload_bytes, device.download_bytes)

    def counted(name: str, copy: Callable[..., None]) -> Callable[..., None]:
        def call(address: int, array: np.ndarray, *rest: Any) -> None:
            counts[name] += array.nbytes
            copy(address, array, *rest)

        return call

    device.upload_bytes, device.download_bytes = map(counted, counts, copies)  # type: ignore[method-assign]
    try:
        work()
    finally:
        del device.upload_bytes, device.download_bytes
    return counts


def culled_frame_rows(
    tracer: DeviceTracer, build: Callable[[], DeviceTree], query: ShadowQuery, how: Timings, about: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """The row of a frame in the tree of what culling leaves."""

    def frame() -> np.ndarray:
        bits = new_bits(query)
        tracer.trace_shadow(build(), query, bits, how.threads)
        return bits

    truth, whole = new_bits(query), tracer.build(query.corners.reshape(-1, 3, 3))
    tracer.trace_shadow(whole, query, truth, how.threads)
    timing = how.timed(frame, how.rounds)
    row = how.row(about | {"case": "culled"}, "device", timing, ray_count(query), truth)
    yield row | copies_of(tracer.device, frame)


def frame_rows(
    tracer: DeviceTracer, vertices: np.ndarray, options: argparse.Namespace, how: Timings, about: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Rows of the first frame of new triangles."""
    _, query = shadow_query_of(vertices, options.size, options.spp, how.threads)
    shafts = TRACERS["multifrusta"]

    def on_device() -> np.ndarray:
        bits = new_bits(query)
        tracer.trace_shadow(tracer.build(vertices), query, bits, how.threads)
        return bits

    def on_cpu() -> np.ndarray:
        bits = new_bits(query)
        shafts.trace(shafts.prepare(lbvh.build(vertices, how.threads), how.threads), query, bits, how.threads)
        return bits

    timings = {"device, host arrays": how.timed(on_device, how.rounds), "cpu": how.timed(on_cpu, how.rounds)}
    for method, timing in timings.items():
        yield how.row(about | {"case": "frame"}, method, timing, ray_count(query), timings["cpu"].answers)
