"""Compact trees hold block trees: expanded again they have the same leaves, and as binary trees they are valid."""

import numpy as np
import pytest

from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.compact_tree import bvh_of, compact, compacted, expand, expanded_bytes, leaf_fault
from antumbra.bvh.nodes import MAX_LEAF, aligned_empty
from antumbra.bvh.tree_quality import validate
from antumbra.engine.method_registry import BUILDERS
from block_trees import slots_in_blocks
from bvh_scenes import HAZARDS, scattered, terrain

SCENES = {f"{n} triangles": scattered(n) for n in (0, 1, 2, 9, 16, 17)} | {"terrain": terrain(900)}
SCENES |= {name: soup for name, soup in HAZARDS.items() if len(soup) < 1000}


def _expanded(tree):
    """The block tree in memory that has been used before."""
    memory = aligned_empty((expanded_bytes(len(tree.nodes)),), "u1")
    memory[:] = 255
    nodes = aligned_empty(tree.nodes.shape, "f4")
    nodes[...] = tree.nodes
    return expand(tree._replace(nodes=nodes, links=nodes.view(np.int32)), memory)


def _leaves(tree):
    """(node, side) -> the triangles of the leaf, of a `BlockTree`."""
    slots = {at: ~int(tree.links[at[0], 12 + at[1]]) >> 5 for at in zip(*np.nonzero(tree.links[:, 12:14] < 0))}
    return {at: tree.prim_ids[tree.slots[block][tree.slots[block] >= 0]].tolist() for at, block in slots.items()}


@pytest.mark.parametrize("builder", BUILDERS)
@pytest.mark.parametrize("scene", SCENES)
def test_a_tree_and_its_compact_form_have_the_same_leaves(scene, builder):
    vertices = np.asarray(SCENES[scene], np.float32)
    blocks = block_tree(BUILDERS[builder].build(vertices), 1)
    tree = compact(blocks)
    assert leaf_fault(tree) == "" and sorted(tree.prim_ids) == list(range(len(vertices)))
    np.testing.assert_array_equal(tree.corners, vertices.reshape(-1, 9)[tree.prim_ids])
    again = _expanded(tree)
    assert sorted(slots_in_blocks(vertices, again)) == list(range(len(vertices)))
    assert _leaves(again) == _leaves(blocks)
    np.testing.assert_array_equal(again.nodes[:, :12], blocks.nodes[:, :12])
    validate(bvh_of(tree), vertices)
    for back, array in zip(compacted(again), tree):
        np.testing.assert_array_equal(back.view(np.int32), array.view(np.int32))


def test_a_leaf_of_more_triangles_than_a_binary_tree_has_becomes_two():
    tree = compact(block_tree(BUILDERS["bsah"].build(scattered(400)), 1))
    counts = ~tree.links[:, 12:14][tree.links[:, 12:14] < 0] & 31
    assert (counts > MAX_LEAF).any() and (counts <= MAX_LEAF).any()
    assert len(bvh_of(tree).nodes) == len(tree.nodes) + (counts > MAX_LEAF).sum()


@pytest.mark.parametrize(
    "link, words",
    [
        (0, "leaves below"),
        (~(0 * 32 + 17), "or more than 16"),
        (~(390 * 32 + 16), "beyond the last"),
        (-(2**31), "more"),
    ],
)
def test_leaves_that_lead_outside_of_the_arrays_are_found(link, words):
    tree = compact(block_tree(BUILDERS["bsah"].build(scattered(400)), 1))
    node, side = np.argwhere(tree.links[:, 12:14] < 0)[3]
    tree.links[node, 12 + side] = link
    assert words in leaf_fault(tree)


def test_the_box_of_a_missing_child_is_its_siblings():
    tree = compact(block_tree(BUILDERS["bsah"].build(scattered(1)), 1))
    assert leaf_fault(tree) == ""
    tree.nodes[0, 1] = 7.0
    assert "missing child" in leaf_fault(tree)
