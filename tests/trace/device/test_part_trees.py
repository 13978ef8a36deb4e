"""Trees of parts on devices: one block of memory each, and the same tree when it comes back."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.trace.device.device_tree import reach_of_root, tree_bytes
from antumbra.trace.device.part_trees import part_bvh, part_tree
from antumbra.trace.device.tree_list_kernels import TREE_WORDS
from bvh_scenes import HAZARDS
from devices import DEVICES, opened


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("name", HAZARDS)
def test_a_tree_comes_back_as_it_was(device, name):
    there, bvh = opened(device), binned_sah.build(np.ascontiguousarray(HAZARDS[name], np.float32), 1)
    bvh = bvh._replace(prim_ids=bvh.prim_ids + 7)
    before = there.used
    tree = part_tree(bvh, there)
    assert tree.bytes == tree_bytes(bvh) == there.used - before and tree.bvh_bytes == bvh.nodes.nbytes
    assert tree.row.shape == (TREE_WORDS,) and tuple(tree.row.view("f4")[4:7]) == reach_of_root(bvh.nodes[0])
    back = part_bvh(tree.row, there)
    for array, expected in zip(back, bvh):
        np.testing.assert_array_equal(array.view(np.int32), expected.view(np.int32))
    tree.memory.free()
    assert there.used == before


def test_a_tree_that_does_not_fit_takes_no_memory():
    there, bvh = opened("host", 1000), binned_sah.build(np.random.default_rng(1).random((99, 3, 3), np.float32), 1)
    with pytest.raises(OutOfDeviceMemory, match="a part of the scene needs"):
        part_tree(bvh, there)
    assert there.used == 0
