"""Blocks of triangles: every triangle is in one block, and boxes bound everything below them."""

import numpy as np
import pytest
from hypothesis import given

from antumbra.bvh.block_tree import block_tree
from antumbra.engine.method_registry import BUILDERS
from block_trees import slots_in_blocks
from strategies import soups
from strength import examples


@given(soups())
@examples(30)
def test_every_triangle_is_in_one_block(soup):
    vertices = soup.astype(np.float32).reshape(-1, 3, 3)
    for builder in BUILDERS.values():
        tree = block_tree(builder.build(vertices), 2)
        assert sorted(slots_in_blocks(vertices, tree)) == list(range(len(vertices)))


@pytest.mark.parametrize("n", [0, 1, 2, 16, 17, 5000])
def test_few_and_many_triangles(n):
    rng = np.random.default_rng(n)
    vertices = (rng.normal(size=(n, 1, 3)) + 0.05 * rng.normal(size=(n, 3, 3))).astype(np.float32)
    tree = block_tree(BUILDERS["bsah"].build(vertices))
    assert sorted(slots_in_blocks(vertices, tree)) == list(range(n))
    assert len(tree.blocks) <= max(2, n) and np.isfinite(tree.nodes[:, :12]).all()


def _blocked(vertices, slots):
    """The area of a block's triangles, relative to half the surface of their box."""
    v = vertices.astype(float)[slots]
    area = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1).sum() / 2
    x, y, z = v.reshape(-1, 3).max(0) - v.reshape(-1, 3).min(0)
    return (x * y + y * z + z * x) * (1 - np.exp(-area / (x * y + y * z + z * x)))


@pytest.mark.parametrize("large", [0, 1])
def test_the_likelier_blocked_child_is_left(large):
    """Two groups of 16 triangles far apart. The triangles of one are ten times as large."""
    rng = np.random.default_rng(3)
    heaps = rng.uniform(-1, 1, (2, 16, 3, 3))
    heaps[1 - large] *= 0.1
    heaps[1, ..., 0] += 30
    vertices = heaps.reshape(-1, 3, 3).astype(np.float32)
    tree = block_tree(BUILDERS["bsah"].build(vertices))
    sides = [tree.prim_ids[tree.slots[~tree.links[0, 12 + k] >> 5, :16]] for k in (0, 1)]
    assert {*sides[0]} == {*range(16 * large, 16 * large + 16)}
    assert _blocked(vertices, sides[0]) > _blocked(vertices, sides[1])


def _price(tree, vertices, width, node, found):
    """(low, high, share of the rays that a node blocks, its cost to a bundle).

    Appends to `found`, for each node, what its children block for their cost.
    """
    surface = lambda low, high, more=0.0: sum(np.prod(np.delete(high - low + more, k)) for k in range(3))
    sides = []
    for child, link in enumerate(tree.links[node, 12:14]):
        low, high = (tree.nodes[node, [k + child, 4 + k + child, 8 + k + child]].astype(float) for k in (0, 2))
        if link >= 0:
            share, price = _price(tree, vertices, width, link, found)[2:]
        else:
            slots = tree.prim_ids[tree.slots[~link >> 5, : ~link & 31]]
            v = vertices.astype(float)[slots]
            area = np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1).sum() / 2
            share, price = 1 - np.exp(-area / surface(low, high)), 2.0
        sides.append((low, high, share, price))
    low, high = np.minimum(sides[0][0], sides[1][0]), np.maximum(sides[0][1], sides[1][1])
    whole, wide = surface(low, high), surface(low, high, width)
    first, second = (
        (share * surface(*box) / whole, price * surface(*box, width) / wide) for *box, share, price in sides
    )
    found.append((first[0] / first[1], second[0] / second[1]))
    cost = 1 + first[1] + (1 - first[0]) * second[1]
    return low, high, 1 - (1 - first[0]) * (1 - second[0]), cost


def test_every_node_has_the_child_left_that_blocks_more_rays_for_its_cost_to_a_bundle():
    rng = np.random.default_rng(4)
    scale = 10.0 ** rng.uniform(-2, 0, (600, 1, 1))
    vertices = (rng.uniform(-4, 4, (600, 1, 3)) + scale * rng.normal(size=(600, 3, 3))).astype(np.float32)
    tree, found = block_tree(BUILDERS["bsah"].build(vertices)), []
    width = 0.01 * np.linalg.norm(np.ptp(vertices.reshape(-1, 3).astype(float), axis=0))
    _price(tree, vertices, width, 0, found)
    first, second = np.array(found).T
    assert len(found) == len(tree.nodes) > 20
    assert (first >= second * (1 - 1e-6)).all() and (first > 1.1 * second).any()
