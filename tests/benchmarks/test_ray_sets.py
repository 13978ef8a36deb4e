"""Orders of rays: each ray asked occurs once, and packets follow their order."""

import numpy as np
import pytest

from antumbra.query.gbuffer import pixel_direction
from antumbra.scene.camera import Camera
from peers.ray_contest import LANES, ORDERS, PeerRays, blocks, packets, primary_rays, valid_ids

SHAPE = (10, 7, 20)


def some_rays():
    n = np.prod(SHAPE)
    asked = np.random.default_rng(3).random(n) < 0.6
    return PeerRays(SHAPE, np.zeros((n // 20, 3), "f4"), 20, np.zeros((n, 3), "f4"), 1.0, asked)


def test_blocks_hold_each_pixel_once_in_morton_order():
    found = blocks(10, 7)
    assert found.shape == (6, LANES)
    assert sorted(found[found >= 0]) == list(range(70))
    assert found[0].tolist() == [y * 7 + x for y in range(4) for x in range(4)]
    assert [row[0] for row in found] == [0, 4, 28, 32, 56, 60]


@pytest.mark.parametrize("lanes", [4, 8, 16])
@pytest.mark.parametrize("order", ORDERS)
def test_packets_hold_each_ray_that_is_asked_once(order, lanes):
    rays = some_rays()
    ids = packets(rays, order, lanes)
    assert ids.shape[1] == lanes
    assert sorted(valid_ids(ids)) == np.nonzero(rays.active)[0].tolist()
    assert (ids >= 0).any(1).all()
    for row in ids:
        live = row[row >= 0]
        assert len(set(live % 20 if order == "pixels" else live // 20)) == 1


def test_primary_rays_are_those_of_the_pixels():
    rays = Camera((1, 2, 3), (0, 0, 0), width=5, height=3).rays(np.zeros(3))
    found = primary_rays(rays)
    expected = [pixel_direction.py_func(rays, x, y) for y in range(3) for x in range(5)]
    np.testing.assert_array_equal(found.directions, np.array(expected))
    assert found.active.all() and found.tmax == np.inf
