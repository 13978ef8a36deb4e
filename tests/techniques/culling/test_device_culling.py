"""Culling on devices: it keeps the triangles that the CPU keeps, and the tree of those has the same bits."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import lbvh
from antumbra.engine.method_registry import CULLERS
from antumbra.engine.plan import parse_plan
from antumbra.techniques.culling import culling_grid, pre_bvh_culling
from antumbra.techniques.culling.culling_grid import Targets, grid_over
from antumbra.techniques.culling.device_culling import (
    CULL_KERNELS,
    build_relevant,
    compared_tags,
    mark_cells,
    read_cells,
)
from antumbra.techniques.culling.pre_bvh_culling import BoundedSegments, bound_segments, mark_segments, select_relevant
from antumbra.trace.device.device_kernels import KERNELS
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.tree_build import BuiltTree
from asking import query_of
from devices import DEVICES, opened

LIGHT = at.QuadLight((-1.0, 4.0, -1.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


LIGHTS = {
    "quad": LIGHT,
    "tilted": at.QuadLight((-3.0, 4.0, -1.0), (2.0, 1.5, 0.3), (0.4, -1.0, 2.0)),
    "point": at.PointLight((0.3, 3.0, 0.1)),
    "sphere": at.SphereLight((0.5, 3.0, -1.0), 0.8),
    "sun": at.DirectionalLight((0.3, -1.0, 0.2), 40.0),
    "ambient": at.AmbientOcclusion(),
    "nearby": at.AmbientOcclusion(1.5),
}


def assert_same_cells(ours, theirs):
    np.testing.assert_array_equal(ours.cells, theirs.cells)
    np.testing.assert_array_equal(ours.sums, theirs.sums)


@pytest.mark.parametrize("n", [16, 32, 64])
@pytest.mark.parametrize("light", LIGHTS)
def test_a_device_marks_the_cells_of_the_cpu(tracer, scene, light, n):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), LIGHTS[light], 4)
    found = read_cells(mark_cells(bound_segments(triangles, [query], 2, n=n), tracer.launches), tracer.launches)
    assert_same_cells(found, mark_segments(triangles, [query], 2, n=n).cells)
    assert found.cells.any()


def test_lights_and_receivers_of_several_queries_are_marked_together(tracer, scene):
    triangles, first = query_of(scene, scene.cameras[0].resized(24, 16), LIGHTS["point"], 4)
    others = [query_of(scene, scene.cameras[0].resized(9, 7), LIGHTS[name], 4)[1] for name in ("tilted", "sun")]
    queries = [first, *others]
    found = read_cells(mark_cells(bound_segments(triangles, queries, 2), tracer.launches), tracer.launches)
    assert_same_cells(found, mark_segments(triangles, queries, 2).cells)
    assert found.cells.sum() > mark_segments(triangles, [first], 2).cells.cells.sum()


@pytest.mark.parametrize("scale", [2.0**-60, 1.0, 2.0**50])
@pytest.mark.parametrize("extent", [(1, 1, 1), (1, 0, 1), (0, 0, 0)], ids=str)
def test_flat_tiny_and_huge_boxes_mark_the_cells_of_the_cpu(tracer, scale, extent):
    rng, flat = np.random.default_rng(6), np.array(extent) * scale
    boxes = np.sort(rng.integers(-4, 5, (60, 2, 3)), 1) * flat
    grid = grid_over(-4.0 * flat, 4.0 * flat, 16)
    pairs = [(boxes[:40], Targets(boxes[56:], False)), (boxes[40:56], Targets(boxes[:2], True))]
    cells = np.zeros((16, 16, 16), np.uint8)
    for pair in pairs:
        culling_grid.mark_between(*pair, grid, cells, 1)
    found = read_cells(mark_cells(BoundedSegments(grid, pairs), tracer.launches), tracer.launches)
    assert_same_cells(found, pre_bvh_culling.marked_cells_of(cells, 1))


@pytest.mark.parametrize("n", [16, 32])
@pytest.mark.parametrize("some", [False, True], ids=["all faces", "some faces"])
def test_a_device_builds_the_tree_of_what_the_cpu_keeps(tracer, scene, n, some):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), LIGHT, 4)
    marking = mark_segments(triangles, [query], 2, n=n)
    faces = np.arange(1, len(triangles.vertices), 3, dtype=np.int32) if some else None
    kept = select_relevant(triangles, marking, 2).kept
    if faces is not None:
        kept = np.intersect1d(kept, faces)
    tree = build_relevant(tracer, triangles.vertices, faces, bound_segments(triangles, [query], 2, n=n))
    expected = lbvh.build(np.ascontiguousarray(triangles.vertices[kept]), 2)
    np.testing.assert_array_equal(tree.bvh.prim_ids, kept[expected.prim_ids])
    np.testing.assert_array_equal(tree.bvh.corners, expected.corners)
    assert 2 < len(kept) < len(triangles.vertices if faces is None else faces)


@pytest.mark.parametrize("left", [0, 1])
def test_a_tree_of_what_little_culling_leaves_is_uploaded(tracer, scene, left):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), LIGHT, 4)
    marking = mark_segments(triangles, [query], 2)
    kept, n = select_relevant(triangles, marking, 2).kept, len(triangles.vertices)
    faces = np.sort(np.concatenate([np.setdiff1d(np.arange(n), kept)[:50], kept[:left]])).astype(np.int32)
    tree = build_relevant(tracer, triangles.vertices, faces, bound_segments(triangles, [query], 2))
    np.testing.assert_array_equal(tree.bvh.prim_ids, kept[:left])
    assert not isinstance(tree, BuiltTree)


@pytest.mark.parametrize("device", [pytest.param(name, marks=pytest.mark.device(name)) for name in ("host", "opencl")])
def test_pictures_culled_on_a_device_have_the_bits_of_the_cpu(device, scene, monkeypatch):
    camera = scene.cameras[0].resized(24, 16)
    expected = at.render(scene, camera, LIGHT, spp=4, plan="bsah+single").bits[0]
    plan = parse_plan(f"grid32+lbvh+device:{device}:0")
    culler = CULLERS["grid32"]
    monkeypatch.setitem(CULLERS, "grid32", culler._replace(cull=None))  # the CPU drops no triangle
    np.testing.assert_array_equal(at.render(scene, camera, LIGHT, spp=4, plan=plan).bits[0], expected)


def test_a_light_that_no_triangle_can_block_leaves_an_empty_tree():
    scene = at.Scene.from_arrays([[[-1.0, 0, -1], [1, 0, -1], [0, 0, 1]], [[50.0, 0, 0], [51, 0, 0], [50, 0, 1]]])
    camera, light = at.Camera((0.0, 2.0, 0.1), (0.0, 0.0, 0.0), width=8, height=8), at.PointLight((0.0, 5.0, 0.0))
    frames = [at.render(scene, camera, light, plan=plan) for plan in ("grid32+lbvh+device:host:0", "bsah+single")]
    np.testing.assert_array_equal(frames[0].bits[0], frames[1].bits[0])


def test_the_self_test_compares_triangles_that_are_kept_and_dropped(tracer):
    *cells, (found, expected) = compared_tags(tracer.device)
    np.testing.assert_array_equal(found, expected)
    assert 100 < len(expected) < 1900
    for marked, by_cpu in cells:
        np.testing.assert_array_equal(marked, by_cpu)
    assert 100 < cells[0][1].sum() < 3500


def test_devices_know_the_kernels_of_culling():
    assert set(CULL_KERNELS) <= set(KERNELS)
