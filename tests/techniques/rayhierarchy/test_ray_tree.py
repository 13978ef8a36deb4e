"""The implicit hierarchy: ranges of children, and nodes that bound their rays."""

import numpy as np
import pytest

from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import Cones
from antumbra.techniques.rayhierarchy.box_nodes import Boxes
from antumbra.techniques.rayhierarchy.light_beams import PERSPECTIVE, beams_of
from antumbra.techniques.rayhierarchy.ray_tree import tree_of
from beam_scenes import LIGHTS, RECEIVERS, lit, on_surfaces
from hierarchies import hierarchy, nodes_in, receivers_in

SLACK = 1e-6


def _numbers(made, node):
    """A node's numbers, in float64."""
    ways, rows = made.rays.ways, made.tree.nodes.rows
    group = made.tree.groups[node.part, node.level] + node.index // ways
    numbers = made.tree.numbers[group * rows * ways :][: rows * ways]
    return numbers.reshape(rows, ways)[:, node.index % ways].astype(np.float64)


def _seen(made, receivers):
    """(k, 3) float64: positions of receivers in the beam's frame."""
    beam = made.beam
    points = made.query.origins.reshape(-1, 3)[receivers].astype(np.float64)
    return (points - beam.apex) * beam.unit if beam.kind == PERSPECTIVE else points @ beam.axes.T * beam.unit


@pytest.mark.parametrize("ways", [4, 16])
@pytest.mark.parametrize("m", [1, 4, 5, 16, 17, 64, 65, 300, 1100])
def test_levels_are_full_from_the_left_and_parents_alive_where_their_children_are(m, ways):
    _, query = lit(m, "point", "all around", 1.0, m)
    (beam,) = beams_of(query)
    for sort in (True, False):
        made = hierarchy(Cones, query, beam, ways, sort)
        tree, leaves = made.tree, np.diff(made.rays.starts)
        assert tree.ways == ways == 1 << tree.shift and sum(leaves) == len(made.rays.dead)
        taken = 0
        for part, n in enumerate(leaves):
            for level in range(tree.heights[part]):
                assert tree.sizes[part, level] == -(-n // ways**level) and tree.groups[part, level] == taken
                taken += -(-tree.sizes[part, level] // ways)
            assert -(-n // ways ** tree.heights[part]) == 1
        assert len(tree.numbers) >= taken * tree.nodes.rows * ways and len(tree.alive) >= taken
        for node in nodes_in(made):
            group = tree.groups[node.part, node.level] + node.index // ways
            assert tree.alive[group] >> node.index % ways & 1 == (len(node.receivers) > 0)


def test_empty_places_on_the_screen_are_not_alive():
    _, query = on_surfaces(1, "point", (70, 70))
    query.sides[:30, 5:60] = 0
    (beam,) = beams_of(query)
    made = hierarchy(Cones, query, beam, 4, False)
    lives = {True: 0, False: 0}
    for node in nodes_in(made):
        group = made.tree.groups[node.part, node.level] + node.index // 4
        alive = bool(made.tree.alive[group] >> node.index % 4 & 1)
        assert alive == (len(node.receivers) > 0)
        lives[alive] += 1
    assert min(lives.values()) > 100


@pytest.mark.parametrize("receivers", RECEIVERS)
@pytest.mark.parametrize("light", ["point", "quad", "sphere"])
def test_cones_hold_their_rays(light, receivers):
    """This holds on all levels, also for angles far below the resolution of a float32 cosine."""
    for seed in range(8):
        _, query = lit(seed, light, receivers, 1.0, 300)
        (beam,) = beams_of(query)
        made = hierarchy(Cones, query, beam, 4, seed % 2 == 0)
        for node in nodes_in(made):
            *axis, cos, sin, shortest, longest = _numbers(made, node)
            d = _seen(made, node.receivers)
            length = np.linalg.norm(d, axis=1)
            assert shortest <= length.min() and length.max() <= longest
            d, axis, length = d[length > 0], np.array(axis), length[length > 0]
            assert np.linalg.norm(axis) == pytest.approx(1.0, abs=SLACK)
            across = np.linalg.norm(np.cross(d / length[:, None], axis), axis=1)
            angles = np.arctan2(across, d / length[:, None] @ axis)
            half = np.arcsin(sin) if cos > sin else np.arccos(max(cos, -1.0))  # from the smaller of the two
            slack = 1e-7 if cos > -0.7 else 1e-3
            assert (angles <= half + slack).all()


@pytest.mark.parametrize("receivers", RECEIVERS)
@pytest.mark.parametrize("light", LIGHTS)
def test_boxes_hold_their_rays(light, receivers):
    checked = 0
    for seed in range(4):
        _, query = lit(seed, light, receivers, 1.0, 200)
        for beam in beams_of(query)[:2]:
            made = hierarchy(Boxes, query, beam, 16 if seed % 2 else 4, True)
            for node in nodes_in(made) if made else ():
                p, numbers = _seen(made, node.receivers), _numbers(made, node)
                if beam.kind == PERSPECTIVE:
                    face = made.tree.faces[node.part]
                    depth = p[:, face // 2] * (-1 if face % 2 else 1)
                    u, v, depth = (p[depth > 0, (face // 2 + k) % 3] for k in (1, 2, 0))
                    p = np.stack([u, v, 1 + 0 * u], 1) / np.abs(depth)[:, None]
                low, high = numbers[::2], numbers[1::2]
                slack = SLACK * (1 + np.abs(p))
                assert (low - slack <= p).all() and (p <= high + slack).all()
                checked += len(p)
    assert checked > 300


def test_threads_make_the_same_tree():
    _, query = on_surfaces(2, "quad", (90, 90))
    (beam,) = beams_of(query)
    for kind in (Boxes, Cones):
        one = hierarchy(kind, query, beam, 4, True)
        three = tree_of(kind, beam, one.rays, 3)
        np.testing.assert_array_equal(one.tree.numbers, three.numbers)
        np.testing.assert_array_equal(one.tree.alive, three.alive)
        other = hierarchy(kind, query, beam, 4, True, 3)
        np.testing.assert_array_equal(receivers_in(one.rays), receivers_in(other.rays))
        np.testing.assert_array_equal(one.bits, other.bits)
