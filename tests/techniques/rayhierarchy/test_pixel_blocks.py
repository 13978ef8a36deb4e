"""Blocks of pixels as leaves: pixels beside each other, on one face of the cube, without wide gaps."""

import numpy as np
import pytest

from antumbra.query.receivers import FREE
from antumbra.techniques.rayhierarchy.box_nodes import Boxes
from antumbra.techniques.rayhierarchy.light_beams import PERSPECTIVE, beams_of
from antumbra.techniques.rayhierarchy.pixel_blocks import rays_by_blocks
from antumbra.techniques.rayhierarchy.ray_leaves import BLOCK_BOX
from antumbra.techniques.rayhierarchy.ray_tree import tree_of
from beam_scenes import on_surfaces
from hierarchies import receivers_in

CASES = [(light, False) for light in ("point", "quad", "sun", "ambient")] + [("point", True)]
"""Lights, and whether their rays are projected."""


@pytest.mark.parametrize("light, projected", CASES)
def test_blocks_make_leaves_of_pixels_beside_each_other_on_one_face(light, projected):
    _, query = on_surfaces(7, light, (41, 38), spp=1)
    (beam,) = beams_of(query)
    rays = rays_by_blocks(query, beam, np.zeros((41, 38, 1), np.uint64), 2, projected=projected)
    assert rays.placed
    several = 0
    for part, face in enumerate(rays.faces):
        leaves = receivers_in(rays)[rays.starts[part] : rays.starts[part + 1]]
        assert (leaves >= 0).any(1).all()
        for leaf in leaves:
            ids = leaf[leaf >= 0]
            y, x = np.divmod(ids, 38)
            assert np.ptp(y // 4) == 0 == np.ptp(x // 4)
            several += len(ids) > 1
            if beam.kind == PERSPECTIVE:
                d = query.origins.reshape(-1, 3)[ids].astype(np.float64) - beam.apex
                assert (np.abs(d).argmax(1) == face // 2).all()
    assert several > 50


@pytest.mark.parametrize("projected", [False, True])
def test_wide_gaps_part_the_pixels_of_a_block(projected):
    """Two walls, one behind the other: a block on their edge has a leaf for each wall."""
    _, query = on_surfaces(7, "point", (4, 4), spp=1)
    (beam,) = beams_of(query)
    x, y = np.meshgrid(np.arange(4), np.arange(4))
    near = np.stack([0.5 + x / 100, y / 100, np.full((4, 4), 2.0)], -1)
    for far, expected in ((0.0, [16]), (0.1, [8, 8]), (-1.3, [8, 8]), (0.005, [16])):
        points = near + np.where(x < 2, 0, far)[..., None] * [1, 0, 0]
        here = query._replace(
            origins=(points + beam.apex).astype(np.float32),
            faces=np.full((4, 4), -1, np.int32),
            sides=np.full((4, 4), FREE, np.int8),
        )
        rays = rays_by_blocks(here, beam, np.zeros((4, 4, 1), np.uint64), 1, projected=projected)
        assert sorted(np.bitwise_count(rays.lanes)) == expected and set(rays.blocks) == {0}
        assert np.bitwise_or.reduce(rays.lanes) == 0xFFFF


@pytest.mark.parametrize("shape", [(4, 4), (5, 8), (9, 7)])
def test_projected_coordinates_are_those_of_the_receivers_on_their_face(shape):
    _, query = on_surfaces(11, "point", shape, spp=1)
    (beam,) = beams_of(query)
    rays = rays_by_blocks(query, beam, np.zeros((*shape, 1), np.uint64), 1, projected=True)
    u, v, q = rays.points[: 48 * (rays.blocks.max() + 1)].reshape(-1, 3, 16).swapaxes(0, 1)[:, rays.blocks]
    ids, seen = receivers_in(rays), 0
    for part, face in enumerate(rays.faces.tolist()):
        for leaf in range(rays.starts[part], rays.starts[part + 1]):
            lanes = ids[leaf] >= 0
            d = (query.origins.reshape(-1, 3)[ids[leaf][lanes]].astype(np.float64) - beam.apex) * beam.unit
            axis = face // 2
            across = [(axis + 1) % 3, (axis + 2) % 3] if axis < 2 else [0, 1]
            depth = np.abs(d[:, axis])
            np.testing.assert_allclose(q[leaf][lanes] * depth, 1.0, rtol=1e-5)
            for x, k in zip((u, v), across):
                np.testing.assert_allclose(x[leaf][lanes], d[:, k] / depth, atol=1e-5)
            seen += lanes.sum()
    assert seen == (ids >= 0).sum() > 0


@pytest.mark.parametrize("shape", [(64, 64), (41, 38)])
def test_boxes_written_with_blocks_are_those_of_their_rays(shape):
    """Blocks that are a single leaf have a box, and nodes are the same without it."""
    _, query = on_surfaces(7, "point", shape, spp=1)
    (beam,) = beams_of(query)
    rays = rays_by_blocks(query, beam, np.zeros((*shape, 1), np.uint64), 2, projected=True)
    has_box = rays.boxes[BLOCK_BOX * rays.blocks] < np.inf
    alone = np.bincount(rays.blocks)[rays.blocks] == 1
    np.testing.assert_array_equal(has_box, alone)
    assert 0 < alone.sum() < len(alone)
    trees = [tree_of(Boxes, beam, each, 2) for each in (rays, rays._replace(boxes=np.full_like(rays.boxes, np.inf)))]
    np.testing.assert_array_equal(trees[0].numbers, trees[1].numbers)
    np.testing.assert_array_equal(trees[0].alive, trees[1].alive)
