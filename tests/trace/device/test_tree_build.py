"""Trees that devices build: those of the CPU's `lbvh`, node by node, and their refits."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.bvh import lbvh
from antumbra.bvh.nodes import LINK, Bvh
from antumbra.bvh.refit import refit
from antumbra.bvh.tree_quality import sah_cost
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.device_tree import reach_of_root
from antumbra.trace.device.tree_build import BuiltTree, LbvhTree, source_of
from bvh_scenes import HAZARDS, terrain
from devices import DEVICES, opened


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


def assert_equal_trees(ours, theirs):
    np.testing.assert_array_equal(ours.nodes[:, :LINK], theirs.nodes[:, :LINK])
    np.testing.assert_array_equal(ours.links[:, LINK:], theirs.links[:, LINK:])
    np.testing.assert_array_equal(ours.prim_ids, theirs.prim_ids)
    np.testing.assert_array_equal(ours.corners, theirs.corners)


@pytest.mark.parametrize("name", HAZARDS)
def test_a_device_builds_the_tree_of_the_cpu(tracer, name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    tree, expected = tracer.build(vertices), lbvh.build(vertices, 2)
    assert_equal_trees(tree.bvh, expected)
    assert tree.reach == reach_of_root(expected.nodes[0])
    assert isinstance(tree, BuiltTree) == (len(vertices) > 1)


@pytest.mark.parametrize("n", [2, 3, 31, 32, 33, 127, 1023, 1024, 1025])
@pytest.mark.parametrize("max_leaf", [1, 4, 8])
def test_trees_of_any_size_and_leaf_are_those_of_the_cpu(tracer, n, max_leaf):
    vertices = terrain(2 * n, seed=n)[:n].copy()
    tree = LbvhTree(source_of(vertices, None, tracer.launches), tracer.launches, max_leaf)
    assert_equal_trees(tree.bvh, lbvh.build(vertices, 1, max_leaf))


def test_a_scene_of_many_parts_is_sorted_like_on_the_cpu(tracer):
    vertices = terrain(70_000)
    assert_equal_trees(tracer.build(vertices).bvh, lbvh.build(vertices, 2))


@pytest.mark.parametrize("count", [1, 2, 900])
def test_a_tree_of_some_faces_names_them(tracer, count):
    vertices = terrain(1000)
    faces = np.sort(np.random.default_rng(1).permutation(len(vertices))[:count]).astype(np.int32)
    expected = lbvh.build(vertices[faces].copy(), 1)
    assert_equal_trees(tracer.build(vertices, faces).bvh, expected._replace(prim_ids=faces[expected.prim_ids]))


def test_vertices_on_the_device_are_built_from_there(tracer):
    vertices = terrain(500)
    with tracer.device.upload(vertices) as memory:
        tree = LbvhTree(source_of(memory, None, tracer.launches), tracer.launches)
        assert_equal_trees(tree.bvh, lbvh.build(vertices, 1))
        moved = (vertices * np.float32(1.5)).astype(np.float32)
        memory.write(moved)
        tree = tree.refitted(memory)
    assert_equal_trees(tree.bvh, refit(lbvh.build(vertices, 1), moved))


@pytest.mark.parametrize("faces", [None, np.arange(7, 399, 2, dtype=np.int32)], ids=["all", "some"])
def test_a_refit_of_a_built_tree_gives_the_boxes_of_one_on_the_cpu(tracer, faces):
    vertices, rng = terrain(400), np.random.default_rng(5)
    first = tree = tracer.build(vertices, faces)
    before = tree.bvh
    for _ in range(2):
        vertices = (vertices + rng.normal(0, 0.5, vertices.shape)).astype(np.float32)
        tree = tree.refitted(vertices)
        chosen = vertices if faces is None else vertices[faces]
        own = before if faces is None else before._replace(prim_ids=np.searchsorted(faces, before.prim_ids))
        expected = refit(Bvh(*own), np.ascontiguousarray(chosen))
        assert_equal_trees(tree.bvh, expected._replace(prim_ids=before.prim_ids))
        assert tree.reach == reach_of_root(expected.nodes[0])
        assert tree.cost() == sah_cost(expected) and tree.built_cost == sah_cost(before)
    assert not np.array_equal(tree.bvh.corners, before.corners)
    first._bvh = None
    assert_equal_trees(first.bvh, before)  # for those who still use it


@pytest.mark.parametrize("name", [name for name, vertices in HAZARDS.items() if len(vertices) > 1])
def test_the_cost_of_a_tree_is_that_of_the_cpu_to_the_bit(tracer, name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    assert tracer.build(vertices).cost() == sah_cost(lbvh.build(vertices, 1))


@pytest.mark.parametrize("n", [63, 64, 65, 4095, 4096, 4097, 9000])
def test_areas_are_added_in_the_order_of_the_cpu(tracer, n):
    vertices = terrain(4 * n, seed=n)[: n + 1].copy()
    tree = LbvhTree(source_of(vertices, None, tracer.launches), tracer.launches, 1)
    assert len(tree.bvh.nodes) == n
    assert tree.cost() == sah_cost(tree.bvh) == sah_cost(tree.bvh, threads=2)


def test_a_tree_is_refitted_until_its_cost_has_grown_beyond_the_limit(tracer):
    vertices, rng = terrain(600), np.random.default_rng(7)
    tree = tracer.build(vertices)
    built, costs = tree.cost(), []
    for amount in (0.02, 0.02, 0.02, 5.0):
        vertices = (vertices + rng.normal(0, amount, vertices.shape)).astype(np.float32)
        moved = tracer.refit(tree, vertices, 1.5)
        expected = sah_cost(refit(tree.bvh, vertices))
        costs.append(expected)
        assert (moved is None) == (expected > 1.5 * built)
        if moved is not None:
            tree = moved
            assert tree.cost() == expected and tree.built_cost == built
    assert moved is None and built != costs[0] < 1.5 * built


def test_a_tree_that_was_uploaded_is_not_refitted_as_one_that_was_built(tracer):
    vertices = terrain(2)[:1].copy()
    assert tracer.refit(tracer.build(vertices), vertices, 2.0) is None


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2.0**125])
def test_a_coordinate_that_no_tree_takes_is_refused_as_by_the_cpu(tracer, value):
    vertices = terrain(300)
    vertices[123, 1, 2] = value
    message = "triangle 123 has a coordinate that is not finite, or not below"
    with pytest.raises(InputError, match=message):
        tracer.build(vertices)
    with pytest.raises(InputError, match=message):
        lbvh.build(vertices, 1)
    vertices[123] = 0.0
    assert_equal_trees(tracer.build(vertices).bvh, lbvh.build(vertices, 1))


def test_a_tree_that_does_not_fit_says_what_it_needs():
    tracer = DeviceTracer(opened("host", 1 << 16))
    with pytest.raises(OutOfDeviceMemory, match=r"the tree of the scene needs .* max_memory"):
        tracer.build(terrain(5000))
    assert tracer.device.used == 0
