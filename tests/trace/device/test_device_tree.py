"""Trees on devices: their layout there, and refits that give the boxes of refits on the CPU."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.bvh.nodes import LINK
from antumbra.bvh.refit import refit
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.device_traversal import PRIM, TRIANGLE
from antumbra.trace.device.device_tree import device_triangles, levels_from_below, reach_of_root, tree_bytes
from bvh_scenes import HAZARDS, terrain
from devices import DEVICES, opened


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


def test_triangles_are_read_by_three_loads_of_16_bytes():
    bvh = binned_sah.build(terrain(100), 1)
    words = device_triangles(bvh)
    assert words.shape == (len(bvh.prim_ids), TRIANGLE) and TRIANGLE % 4 == 0
    np.testing.assert_array_equal(words.view(np.int32)[:, PRIM], bvh.prim_ids)
    np.testing.assert_array_equal(words.reshape(-1, 3, 4)[..., :3].reshape(-1, 9), bvh.corners)


@pytest.mark.parametrize("name", HAZARDS)
def test_levels_list_each_node_once_and_children_first(name):
    bvh = binned_sah.build(np.ascontiguousarray(HAZARDS[name], np.float32), 1)
    order, begins = levels_from_below(bvh)
    assert begins[0] == 0 and begins[-1] == len(order) and (np.diff(begins) > 0).all()
    np.testing.assert_array_equal(np.sort(order), np.arange(len(bvh.nodes)))
    level = np.empty(len(bvh.nodes), int)
    level[order] = np.searchsorted(begins, np.arange(len(order)), "right")
    children = bvh.links[:, LINK : LINK + 2]
    parents, sides = np.nonzero(children >= 0)
    assert (level[children[parents, sides]] < level[parents]).all()


def test_the_reach_is_the_largest_coordinate_of_an_axis():
    bvh = binned_sah.build(terrain(50), 1)
    np.testing.assert_array_equal(reach_of_root(bvh.nodes[0]), np.abs(bvh.corners.reshape(-1, 3)).max(0))
    assert reach_of_root(binned_sah.build(np.empty((0, 3, 3), np.float32), 1).nodes[0]) == (0, 0, 0)


def test_a_refit_on_the_device_gives_the_boxes_of_one_on_the_cpu(tracer):
    vertices = terrain(400)
    bvh = binned_sah.build(vertices, 2)
    tree, rng = tracer.tree(bvh), np.random.default_rng(5)
    for _ in range(2):
        vertices = (vertices + rng.normal(0, 0.5, vertices.shape)).astype(np.float32)
        moved = refit(bvh, vertices)
        tracer.move(tree, moved, vertices)
        nodes = tree.nodes.read(np.empty_like(moved.nodes))
        np.testing.assert_array_equal(nodes, moved.nodes)
        words = tree.triangles.read(np.empty((len(vertices), TRIANGLE), np.float32))
        np.testing.assert_array_equal(words, device_triangles(moved))
    assert tree.bvh is moved and tree.reach == reach_of_root(moved.nodes[0])


def test_a_tree_that_does_not_fit_says_what_it_needs():
    bvh = binned_sah.build(terrain(400), 1)
    tracer = DeviceTracer(opened("host", tree_bytes(bvh) - 1))
    with pytest.raises(OutOfDeviceMemory, match=r"the tree of the scene needs .* max_memory"):
        tracer.tree(bvh)
    assert DeviceTracer(opened("host", tree_bytes(bvh))).tree(bvh).bvh is bvh
