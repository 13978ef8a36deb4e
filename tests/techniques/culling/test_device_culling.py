"""Culling on devices: it keeps the triangles that the CPU keeps, and the tree of those has the same bits."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import lbvh
from antumbra.engine.method_registry import CULLERS
from antumbra.engine.plan import parse_plan
from antumbra.query.query_bounds import triangle_box
from antumbra.query.receivers import NOTHING
from antumbra.query.shadow_query import new_bits
from antumbra.techniques.culling import culling_grid, pre_bvh_culling
from antumbra.techniques.culling.culling_grid import Targets, grid_over
from antumbra.techniques.culling.device_culling import (
    CULL_KERNELS,
    Segments,
    build_relevant,
    compared_tags,
    mark_cells,
    mark_queries,
    read_cells,
)
from antumbra.techniques.culling.device_sources import SourceBoxes
from antumbra.techniques.culling.pre_bvh_culling import (
    CullRequest,
    cull,
    mark_segments,
    select_relevant,
    with_shared_receivers,
)
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


def marked_by(tracer, triangles, queries, n=32):
    """The cells that a device marks for queries; None: no segment can meet a triangle."""
    groups = [(tracer.receivers(group[0], 2), group) for group in with_shared_receivers(queries)]
    marked = mark_queries(groups, triangle_box(triangles), n, tracer.launches)
    return None if marked is None else read_cells(marked, tracer.launches)


def request_of(*queries, n=32):
    return CullRequest(queries, n, 2, lambda step: None)


def assert_same_cells(ours, theirs):
    np.testing.assert_array_equal(ours.cells, theirs.cells)
    np.testing.assert_array_equal(ours.sums, theirs.sums)


@pytest.mark.parametrize("n", [16, 32, 64])
@pytest.mark.parametrize("light", LIGHTS)
def test_a_device_marks_the_cells_of_the_cpu(tracer, scene, light, n):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), LIGHTS[light], 4)
    found = marked_by(tracer, triangles, [query], n)
    assert_same_cells(found, mark_segments(triangles, [query], 2, n=n).cells)
    assert found.cells.any()


def test_lights_and_receivers_of_several_queries_are_marked_together(tracer, scene):
    triangles, first = query_of(scene, scene.cameras[0].resized(24, 16), LIGHTS["point"], 4)
    others = [query_of(scene, scene.cameras[0].resized(9, 7), LIGHTS[name], 4)[1] for name in ("tilted", "sun")]
    queries = [first, *others]
    assert len(with_shared_receivers([*queries, first._replace(light=others[0].light)])) == 3
    found = marked_by(tracer, triangles, queries)
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
    there = [(tracer.device.upload(sources), targets) for sources, targets in pairs]
    segments = [Segments(SourceBoxes(block.address, block.size // 48), [targets]) for block, targets in there]
    found = read_cells(mark_cells(grid, segments, tracer.launches), tracer.launches)
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
    tree = build_relevant(tracer, triangles.vertices, faces, request_of(query, n=n), triangle_box(triangles))
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
    tree = build_relevant(tracer, triangles.vertices, faces, request_of(query), triangle_box(triangles))
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


@pytest.mark.parametrize("missing", ["receivers", "triangles near them", "pixels"])
def test_segments_that_meet_nothing_leave_an_empty_tree(tracer, scene, missing):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), LIGHT, 4)
    if missing == "receivers":
        query = query._replace(sides=np.full_like(query.sides, NOTHING))
    elif missing == "pixels":
        names = "origins", "faces", "sides", "ids"
        query = query._replace(**{name: getattr(query, name)[:0].copy() for name in names})
    else:
        triangles = triangles._replace(vertices=triangles.vertices + np.float32(1e4))
    assert marked_by(tracer, triangles, [query]) is None
    assert not len(cull(triangles, [query], 2).kept)
    tree = build_relevant(tracer, triangles.vertices, None, request_of(query), triangle_box(triangles))
    assert tree.n == 0


def test_culling_is_a_step_of_its_own(tracer, scene):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), LIGHT, 4)
    steps = []
    request = request_of(query)._replace(lap=steps.append)
    build_relevant(tracer, triangles.vertices, None, request, triangle_box(triangles))
    build_relevant(tracer, triangles.vertices + np.float32(1e4), None, request, triangle_box(triangles) + 1e4)
    assert steps == ["cull", "cull"]


def moved_bytes(device, monkeypatch):
    """A list of the sizes of all copies to a device, and one of those from it; both grow."""

    def counted(name):
        sizes, copy = [], getattr(device, name)
        monkeypatch.setattr(device, name, lambda at, array, *rest: (sizes.append(array.nbytes), copy(at, array, *rest)))
        return sizes

    return counted("upload_bytes"), counted("download_bytes")


@pytest.mark.parametrize("resident", [True, False], ids=["vertices on the device", "on the host"])
def test_from_triangles_and_receivers_to_bits_the_host_sees_only_boxes_and_counts(tracer, scene, monkeypatch, resident):
    camera, lights = scene.cameras[0].resized(160, 120), ("point", "tilted", "sun")
    triangles, first = query_of(scene, camera, LIGHTS[lights[0]], 4)
    if resident:  # points without triangles of their own, whose vertices are on the host
        none, up = np.full_like(first.faces, -1), np.tile([0.0, 1.0, 0.0], (*first.sides.shape, 1))
        first = first._replace(faces=none, ids=none, normals=up)
    others = [query_of(scene, camera, LIGHTS[name], 4)[1] for name in lights[1:]]
    shared = {name: getattr(first, name) for name in ("origins", "faces", "sides", "ids", "normals", "corners")}
    queries = [first, *(query._replace(**shared) for query in others)]
    receivers, few = 16 * first.sides.size, 4096
    with tracer.device.upload(triangles.vertices) as memory:
        whole = tracer.tree(lbvh.build(triangles.vertices))
        up, down = moved_bytes(tracer.device, monkeypatch)
        vertices = memory if resident else triangles.vertices
        tree = build_relevant(tracer, vertices, None, request_of(*queries), triangle_box(triangles))
        assert sum(up) - receivers - (first.normals.nbytes if resident else triangles.vertices.nbytes) < few
        assert up.count(receivers) == 1 and sum(down) < 256
        for query in queries:
            up.clear()
            bits, expected = new_bits(query), new_bits(query)
            tracer.trace_shadow(tree, query, bits, 2)
            assert sum(up) < few
            tracer.trace_shadow(whole, query, expected, 2)
            assert receivers in up and bits.any()
            np.testing.assert_array_equal(bits, expected)


def test_the_self_test_compares_triangles_that_are_kept_and_dropped(tracer):
    *sources, cells, sums, (found, expected) = compared_tags(tracer.device)
    np.testing.assert_array_equal(found, expected)
    assert 100 < len(expected) < 1900
    for ours, by_cpu in (*sources, cells, sums):
        np.testing.assert_array_equal(ours, by_cpu)
    assert 100 < cells[1].sum() < 3500 and min(len(boxes) for boxes, _ in sources) > 1


def test_devices_know_the_kernels_of_culling():
    assert set(CULL_KERNELS) <= set(KERNELS)
