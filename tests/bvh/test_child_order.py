"""Children are stored in the order of traversal."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.child_order import order_children
from antumbra.bvh.nodes import LEFT_FIRST, LINKS, NO_CHILD, WIDTH
from antumbra.bvh.tree_quality import validate
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.techniques.srdh import srdh_builder
from bvh_scenes import HAZARDS, scattered, terrain
from shadow_rays import met_in, nested


def _half_surface(low, high):
    x, y, z = high.astype(float) - low
    return x * y + y * z + z * x


def _visit(wide, areas, node, found):
    """(blocked share of the rays through a wide node, steps of such a ray).

    Appends to `found`, for each node, its children's blocked shares per step.
    """
    links = [k for k in wide.links[node, LINKS : LINKS + WIDTH].tolist() if k != NO_CHILD]
    planes = wide.nodes[node, :LINKS].reshape(3, 2, WIDTH)[:, :, : len(links)]
    whole = _half_surface(planes[:, 0].min(1), planes[:, 1].max(1))
    children = []
    for lane, link in enumerate(links):
        surface = _half_surface(planes[:, 0, lane], planes[:, 1, lane])
        leaf = link < 0
        share = (1 - np.exp(-areas[~link >> 4] / surface), 1.0) if leaf else _visit(wide, areas, link, found)
        children.append((surface / whole, *share))
    found.append([blocked / cost for _, blocked, cost in children])
    passing, steps = 1.0, 1.0
    for enter, blocked, cost in children[::-1]:
        steps += passing * enter * cost
        passing *= 1 - enter * blocked
    return 1 - passing, steps


@pytest.mark.parametrize("name", ["large, terrain", "large, scattered"])
def test_wide_nodes_end_with_the_child_that_blocks_a_ray_soonest(name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    wide = widen(BUILDERS["bsah"].build(vertices, 2), 2)
    faces = wide.bvh.prim_ids[wide.slots]
    corners = vertices[faces].astype(float)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]), axis=2
    )
    found = []
    _visit(wide, np.where(wide.slots >= 0, areas, 0).sum(1), 0, found)
    assert len(found) == len(wide.nodes)
    for shares in found:
        assert (np.diff(shares) >= -1e-9 * np.array(shares[1:])).all()


def _areas(vertices):
    corners = vertices.astype(float)
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)


def _rtsah(vertices, areas, tree, found):
    """(low, high, blocked share of the rays through the box, tests of one such ray) of a `nested` tree."""
    if isinstance(tree, list):
        low, high = vertices[tree].min((0, 1)), vertices[tree].max((0, 1))
        surface = _half_surface(low, high)
        return low, high, 1 - np.exp(-areas[tree].sum() / surface) if surface > 0 else 0.0, 1.0 + len(tree)
    sides = [_rtsah(vertices, areas, side, found) for side in tree[:2]]
    low, high = np.minimum(sides[0][0], sides[1][0]), np.maximum(sides[0][1], sides[1][1])
    whole = _half_surface(low, high)
    enter = [_half_surface(*side[:2]) / whole for side in sides]
    (_, _, b1, c1), (_, _, b2, c2) = sides
    found.append((b1 / c1, b2 / c2))
    cost = 1 + enter[0] * c1 + (1 - enter[0] * b1) * enter[1] * c2
    return low, high, 1 - (1 - enter[0] * b1) * (1 - enter[1] * b2), cost


@pytest.mark.parametrize("vertices", [terrain(1500), scattered(900)], ids=["terrain", "scattered"])
def test_rtsah_puts_the_child_first_that_blocks_more_rays_for_its_cost(vertices):
    bvh, found = binned_sah.build(vertices, 1), []
    before = bvh.nodes.tobytes()
    ordered = order_children(bvh)
    validate(ordered, vertices)
    assert bvh.nodes.tobytes() == before and not np.shares_memory(ordered.nodes, bvh.nodes)
    _rtsah(vertices, _areas(vertices), nested(ordered), found)
    first, second = np.array(found).T
    assert len(found) == len(bvh.nodes) and (first >= second * (1 - 1e-6)).all() and (first > second).any()
    assert (ordered.links[:, 12] != bvh.links[:, 12]).mean() > 0.2


@pytest.mark.parametrize("mirror", [1, -1])
def test_rtsah_puts_the_denser_child_first(mirror):
    """Two cubes of the same size: one with many triangles, one with few, all of the same size."""
    rng = np.random.default_rng(0)
    cube = lambda n: rng.uniform(-1, 1, (n, 1, 3)) + rng.uniform(-0.2, 0.2, (n, 3, 3))
    vertices = np.concatenate([cube(200) + [10 * mirror, 0, 0], cube(20) - [10 * mirror, 0, 0]]).astype(np.float32)
    root = order_children(binned_sah.build(vertices, 1)).nodes[0]
    assert (root[[0, 2]] * mirror > 0).all() and (root[[1, 3]] * mirror < 0).all()


@pytest.mark.parametrize("n", [0, 1, 2])
def test_rtsah_of_few_triangles(n):
    validate(order_children(binned_sah.build(scattered(n), 1)), scattered(n))


def test_rtsah_of_hazards():
    for name, soup in HAZARDS.items():
        vertices = np.ascontiguousarray(soup, np.float32)
        if len(vertices) < 10_000:
            validate(order_children(binned_sah.build(vertices, 1)), vertices), name


def test_a_tree_of_blocks_keeps_the_order_that_a_builder_chose():
    vertices = terrain(6000)
    bvh = srdh_builder.build(vertices, 1, rays=met_in(vertices, 600))
    free = bvh._replace(nodes=bvh.nodes.copy())
    free = free._replace(links=free.nodes.view(np.int32))
    free.links[:, 14] = 0
    kept, sorted_ = block_tree(bvh), block_tree(free)
    chosen = kept.links[:, 14] == LEFT_FIRST
    assert 0.1 < chosen.mean() < 1
    boxes = {n.tobytes() for n in bvh.nodes[:, :12]}
    assert all(n.tobytes() in boxes for n in kept.nodes[chosen, :12])
    assert not all(n.tobytes() in boxes for n in sorted_.nodes[:, :12])
