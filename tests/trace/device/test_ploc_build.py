"""Trees of `ploc` that devices build: those of the CPU, node by node, and their refits."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.bvh import ploc
from antumbra.bvh.nodes import LINK
from antumbra.bvh.refit import refit
from antumbra.bvh.top_down import largest_subtree
from antumbra.bvh.tree_quality import sah_cost
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.device_tree import reach_of_root
from antumbra.trace.device.ploc_build import PlocTree
from antumbra.trace.device.tree_build import source_of
from bvh_scenes import HAZARDS, terrain
from devices import DEVICES, opened


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


def assert_equal_trees(ours, theirs):
    np.testing.assert_array_equal(ours.prim_ids, theirs.prim_ids)
    np.testing.assert_array_equal(ours.links[:, LINK:], theirs.links[:, LINK:])
    np.testing.assert_array_equal(ours.nodes[:, :LINK], theirs.nodes[:, :LINK])
    np.testing.assert_array_equal(ours.corners, theirs.corners)


@pytest.mark.parametrize("name", HAZARDS)
def test_a_device_builds_the_tree_of_the_cpu(tracer, name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    tree, expected = tracer.build(vertices, None, "ploc"), ploc.build(vertices, 2)
    assert_equal_trees(tree.bvh, expected)
    assert tree.reach == reach_of_root(expected.nodes[0])
    assert isinstance(tree, PlocTree) == (len(vertices) > 1)
    if len(vertices) > 1:
        assert tree.cost() == sah_cost(expected)


@pytest.mark.parametrize("n", [2, 3, 4, 31, 32, 33, 1025, 4096, 4097])
@pytest.mark.parametrize("max_leaf", [1, 4, 8])
def test_trees_of_any_size_and_leaf_are_those_of_the_cpu(tracer, n, max_leaf):
    vertices = terrain(2 * n, seed=n)[:n].copy()
    tree = PlocTree(source_of(vertices, None, tracer.launches), tracer.launches, max_leaf)
    assert_equal_trees(tree.bvh, ploc.build(vertices, 1, max_leaf))


def test_leaves_within_leaves_are_not_nodes(tracer):
    """A subtree may be dearer as a leaf than as nodes, and a larger one around it cheaper as a leaf."""
    rng = np.random.default_rng(3)
    vertices = (rng.normal(0, 1, (3000, 1, 3)) + rng.normal(0, 0.3, (3000, 3, 3))).astype(np.float32)
    tree = PlocTree(source_of(vertices, None, tracer.launches), tracer.launches, 8)
    assert_equal_trees(tree.bvh, ploc.build(vertices, 1, 8))


def test_many_ranges_are_clustered_apart_and_then_together(tracer):
    vertices = terrain(70_000)
    assert len(vertices) > 8 * largest_subtree(len(vertices))
    tree, expected = tracer.build(vertices, None, "ploc"), ploc.build(vertices, 2)
    assert_equal_trees(tree.bvh, expected)
    moved = (vertices * np.float32(1.5)).astype(np.float32)
    assert_equal_trees(tree.refitted(moved).bvh, refit(expected, moved))


def test_clusters_that_merge_slowly_are_paired_before_the_tree_is_too_deep(tracer):
    """Each cluster is nearest to a smaller one, so only one pair merges in a round."""
    vertices = np.ascontiguousarray(HAZARDS["receding"], np.float32)
    tree = PlocTree(source_of(vertices, None, tracer.launches), tracer.launches, 1)
    assert len(tree._rounds) > 30
    assert_equal_trees(tree.bvh, ploc.build(vertices, 1, 1))


@pytest.mark.parametrize("count", [1, 2, 900])
def test_a_tree_of_some_faces_names_them(tracer, count):
    vertices = terrain(1000)
    faces = np.sort(np.random.default_rng(1).permutation(len(vertices))[:count]).astype(np.int32)
    expected = ploc.build(vertices[faces].copy(), 1)
    found = tracer.build(vertices, faces, "ploc").bvh
    assert_equal_trees(found, expected._replace(prim_ids=faces[expected.prim_ids]))


def test_refits_give_the_boxes_of_the_cpu_and_leave_the_first_tree(tracer):
    vertices, rng = terrain(6000), np.random.default_rng(5)
    first = tree = tracer.build(vertices, None, "ploc")
    before = tree.bvh
    for _ in range(2):
        vertices = (vertices + rng.normal(0, 0.3, vertices.shape)).astype(np.float32)
        tree, expected = tree.refitted(vertices), refit(before, vertices)
        assert_equal_trees(tree.bvh, expected)
        assert tree.cost() == sah_cost(expected) and tree.built_cost == sah_cost(before)
    first._bvh = None
    assert_equal_trees(first.bvh, before)  # for those who still use it


@pytest.mark.parametrize("value", [np.nan, np.inf, 2.0**125])
def test_a_coordinate_that_no_tree_takes_is_refused_as_by_the_cpu(tracer, value):
    vertices = terrain(300)
    vertices[123, 1, 2] = value
    message = "triangle 123 has a coordinate that is not finite, or not below"
    for build in lambda: tracer.build(vertices, None, "ploc"), lambda: ploc.build(vertices, 1):
        with pytest.raises(InputError, match=message):
            build()
    vertices[123] = 0.0
    assert_equal_trees(tracer.build(vertices, None, "ploc").bvh, ploc.build(vertices, 1))
