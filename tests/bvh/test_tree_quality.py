"""`validate` finds every kind of fault. Costs and counts equal those of a plain computation."""

import numpy as np
import pytest

from antumbra.bvh.binned_sah import build
from antumbra.bvh.nodes import EMPTY, MAX_DEPTH, aligned_empty
from antumbra.bvh.tree_quality import sah_cost, statistics, validate
from bvh_scenes import chain, scattered, terrain

VERTICES = terrain(300)
BOUNDS = "box is not the bounds of"


def writable_bvh():
    return build(VERTICES, 1)


def with_child(bvh, wanted):
    """(node, side) of the first child whose link `wanted` accepts."""
    for node in range(len(bvh.nodes)):
        for side in (0, 1):
            if wanted(int(bvh.links[node, 12 + side])):
                return node, side
    raise AssertionError("no such child")


def inner(link):
    return link >= 0


def leaf(link):
    return link < 0


def larger_leaf(link):
    return link < 0 and ~link & 7


def move_plane(bvh, wanted, word, by):
    node, side = with_child(bvh, wanted)
    word = 4 * word[0] + 2 * word[1] + side
    bvh.nodes[node, word] = np.nextafter(bvh.nodes[node, word], np.float32(by))


def set_link(bvh, wanted, value):
    node, side = with_child(bvh, wanted)
    bvh.links[node, 12 + side] = value(bvh, node, side) if callable(value) else value


def an_inner_right_link(bvh, node, side):
    rights = bvh.links[:, 13]
    return rights[rights >= 0][-1]


def with_one_less(bvh, node, side):
    return bvh.links[node, 12 + side] + 1


def point_leaf_at(bvh, first):
    node, side = with_child(bvh, larger_leaf)
    bvh.links[node, 12 + side] = ~((first << 3) + (~bvh.links[node, 12 + side] & 7))


def set_box(bvh, wanted, value):
    node, side = with_child(bvh, wanted)
    bvh.nodes[node, side] = value


def assign(array, i, value):
    array[i] = value


CORRUPTIONS = {
    "link beyond the nodes": (lambda b: set_link(b, inner, len(b.nodes)), "leads to no node"),
    "link to the root": (lambda b: set_link(b, inner, 0), "another parent, or to the root"),
    "link to itself": (lambda b: set_link(b, inner, lambda _, node, side: node), "another parent, or to the root"),
    "two links to one node": (lambda b: set_link(b, inner, an_inner_right_link), f"another parent|{BOUNDS}"),
    "missing child": (lambda b: set_link(b, leaf, int(EMPTY)), "child is missing"),
    "leaf beyond the slots": (lambda b: point_leaf_at(b, len(b.prim_ids) - 1), "slots beyond the last"),
    "leaf of others' slots": (lambda b: point_leaf_at(b, len(b.prim_ids) // 2), f"another leaf also has|{BOUNDS}"),
    "leaf without its last slot": (lambda b: set_link(b, larger_leaf, with_one_less), f"{BOUNDS}|not in the tree"),
    "inner link made a leaf": (lambda b: set_link(b, inner, ~0), BOUNDS),
    "leaf box too small below": (lambda b: move_plane(b, leaf, (0, 0), np.inf), BOUNDS),
    "leaf box too large below": (lambda b: move_plane(b, leaf, (1, 0), -np.inf), BOUNDS),
    "leaf box too small above": (lambda b: move_plane(b, leaf, (2, 1), -np.inf), BOUNDS),
    "leaf box too large above": (lambda b: move_plane(b, leaf, (2, 1), np.inf), BOUNDS),
    "inner box too small": (lambda b: move_plane(b, inner, (1, 1), -np.inf), BOUNDS),
    "inner box too large": (lambda b: move_plane(b, inner, (0, 0), -np.inf), BOUNDS),
    "NaN in a leaf box": (lambda b: set_box(b, leaf, np.nan), BOUNDS),
    "NaN in an inner box": (lambda b: set_box(b, inner, np.nan), BOUNDS),
    "NaN in the corners": (lambda b: assign(b.corners, (5, 4), np.nan), "slot 5"),
    "other corners": (lambda b: assign(b.corners, (5, 8), b.corners[5, 8] + 1), "slot 5"),
    "a triangle twice": (lambda b: assign(b.prim_ids, 7, b.prim_ids[2]), "slot 7"),
    "a triangle that is not": (lambda b: assign(b.prim_ids, 7, len(b.prim_ids)), "slot 7"),
    "a negative triangle": (lambda b: assign(b.prim_ids, 7, -1), "slot 7"),
}


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_corruption_is_found_and_named(name):
    corrupt, message = CORRUPTIONS[name]
    bvh = writable_bvh()
    validate(bvh, VERTICES)
    corrupt(bvh)
    with pytest.raises(ValueError, match=message):
        validate(bvh, VERTICES)


@pytest.mark.parametrize("wanted, message", [(inner, "another parent"), (leaf, "another leaf also has")])
def test_sharing_is_found_where_all_boxes_are_equal(wanted, message):
    vertices = np.tile(scattered(1), (16, 1, 1))
    bvh = build(vertices)
    links = bvh.links[:, 12:14]
    last = tuple(np.argwhere(wanted(links))[-1])
    links[last] = links[wanted(links)][0]
    with pytest.raises(ValueError, match=message):
        validate(bvh, vertices)


def test_every_box_word_matters():
    """Any coordinate of any box that is NaN, or one unit in the last place off, is found."""
    bvh = writable_bvh()
    rng = np.random.default_rng(1)
    for node, word in zip(rng.integers(0, len(bvh.nodes), 100), rng.integers(0, 12, 100)):
        good = bvh.nodes[node, word]
        for bad in (np.nextafter(good, np.float32(np.inf)), np.nextafter(good, np.float32(-np.inf)), np.nan):
            bvh.nodes[node, word] = bad
            with pytest.raises(ValueError, match=r"^node \d+: the (left|right) box is not the bounds"):
                validate(bvh, VERTICES)
        bvh.nodes[node, word] = good
    validate(bvh, VERTICES)


def test_depth():
    bvh, vertices = chain(MAX_DEPTH + 1)
    validate(bvh, vertices)
    assert statistics(bvh).depth == MAX_DEPTH
    with pytest.raises(ValueError, match="more than MAX_DEPTH"):
        validate(*chain(MAX_DEPTH + 2))


def test_root_of_one_triangle_must_have_an_empty_box():
    vertices = scattered(1)
    bvh = build(vertices)
    bvh.nodes[0, 1] = 0
    with pytest.raises(ValueError, match="but its box is not"):
        validate(bvh, vertices)


def test_unreachable_nodes_are_found():
    bvh = writable_bvh()
    nodes = aligned_empty((len(bvh.nodes) + 1, 16), "f4")
    nodes[:-1], nodes[-1] = bvh.nodes, bvh.nodes[-1]
    with pytest.raises(ValueError, match="not in the tree"):
        validate(bvh._replace(nodes=nodes, links=nodes.view(np.int32)), VERTICES)


def test_arrays_of_another_form_are_found():
    bvh = writable_bvh()
    copied = bvh._replace(links=bvh.links.copy())
    shorter = bvh._replace(prim_ids=bvh.prim_ids[:-1])
    wider = bvh._replace(corners=bvh.corners.astype(np.float64))
    for bad, message in ((copied, "same memory"), (shorter, "prim_ids is"), (wider, "corners is")):
        with pytest.raises(ValueError, match=message):
            validate(bad, VERTICES)


def plain_cost(bvh, c_traverse, c_intersect):
    """The SAH cost by its definition: a sum over all nodes and leaves in a walk from the root, in plain numpy."""
    lower, upper = bvh.nodes[:, [0, 1, 4, 5, 8, 9]], bvh.nodes[:, [2, 3, 6, 7, 10, 11]]

    def area(box_lower, box_upper):
        x, y, z = box_upper.astype(np.float64) - box_lower.astype(np.float64)
        return 2 * (x * y + y * z + z * x)

    def cost(node, node_area):
        total = c_traverse * node_area
        for side in (0, 1):
            link = int(bvh.links[node, 12 + side])
            child_area = area(lower[node, side::2], upper[node, side::2])
            total += cost(link, child_area) if link >= 0 else c_intersect * child_area * ((~link & 7) + 1)
        return total

    root = area(lower[0].reshape(3, 2).min(1), upper[0].reshape(3, 2).max(1))
    return cost(0, root) / root


@pytest.mark.parametrize("costs", [(1.0, 1.0), (2.0, 1.0), (0.0, 3.0)])
def test_sah_cost_is_its_definition(costs):
    bvh = writable_bvh()
    assert sah_cost(bvh, *costs) == pytest.approx(plain_cost(bvh, *costs), rel=1e-12)


def test_sah_cost_without_area():
    assert sah_cost(build(np.zeros((0, 3, 3), np.float32))) == 0
    points = build(np.zeros((9, 3, 3), np.float32), max_leaf=3)
    assert sah_cost(points, 10.0, 1.0) == 10.0 * len(points.nodes) + 9


def test_statistics_count_what_is_there():
    bvh = writable_bvh()
    shape = statistics(bvh)
    links = bvh.links[:, 12:14]
    assert shape.nodes == len(bvh.nodes) and shape.leaves == np.count_nonzero(links < 0)
    assert shape.leaf_sizes.tolist() == np.bincount((~links[links < 0] & 7) + 1, minlength=9).tolist()
    assert shape.bytes_per_triangle == pytest.approx(40 + 64 * len(bvh.nodes) / len(VERTICES))
    empty = statistics(build(np.zeros((0, 3, 3), np.float32)))
    assert (empty.nodes, empty.leaves, empty.depth, empty.bytes_per_triangle) == (1, 0, 1, 64)
