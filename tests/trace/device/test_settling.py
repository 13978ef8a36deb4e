"""Records of tests and rays that a device leaves, decided on the CPU."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.trace.device.device_kernels import RECORD
from antumbra.trace.device.settling import BEST, RAY, SLOT, blocked_rays, heads_of, nearest_slots, renumber, traced_rays

WALLS = np.array([[[-1.0, -1, k], [3, -1, k], [-1, 3, k]] for k in range(4)], np.float32)
"""Parallel walls; a ray along z through (-1, 0) runs through their edges."""


def records_of(tests, x=-1.0):
    """Records of (ray, slot, best slot), of rays from z = -1 along z through the edges of all walls."""
    records = np.zeros((len(tests), RECORD))
    heads_of(records)[:, [RAY, SLOT, BEST]] = tests
    records[:, 2:] = [x, 0, -1, 0, 0, 1, 0, 0, 0, 0, np.inf, 0]
    return records


def test_a_ray_through_an_edge_is_blocked_and_one_beside_it_is_not():
    bvh = binned_sah.build(WALLS, 1)
    tests = [(5, 0, -1), (7, 3, -1), (5, 1, -1)]
    np.testing.assert_array_equal(blocked_rays(records_of(tests), bvh, 0, None, 0, 1), [5, 7])
    assert not len(blocked_rays(records_of(tests, np.nextafter(-1.0, -2)), bvh, 0, None, 0, 1))
    facing = [len(blocked_rays(records_of(tests), bvh, cull_faces, None, 0, 1)) for cull_faces in (-1, 1)]
    assert sorted(facing) == [0, 2]


def test_the_nearest_of_several_undecided_tests_and_of_the_best_hit_wins():
    bvh = binned_sah.build(WALLS, 1)
    slot = np.argsort(bvh.prim_ids)
    tests = [(2, slot[3], slot[1]), (9, slot[2], -1), (9, slot[0], -1), (9, slot[1], -1), (2, slot[2], slot[1])]
    rays, slots = nearest_slots(records_of(tests), bvh, 0)
    np.testing.assert_array_equal(rays, [2, 9])
    np.testing.assert_array_equal(bvh.prim_ids[slots], [1, 0])


def test_recorded_rays_are_traced_through_the_whole_tree():
    bvh = binned_sah.build(WALLS, 1)
    records = records_of([(0, -1, 0), (1, 0, 0)])  # the second one ignores the first wall
    np.testing.assert_array_equal(bvh.prim_ids[traced_rays(records, bvh, 0, False, 1)], [0, 1])
    assert (traced_rays(records, bvh, 0, True, 1) >= 0).all()


@pytest.mark.parametrize("slots", [[[9, -1], [-1, -1], [4, 9], [7, 4]], [[9, 4], [7, 9]], [[-1, -1]]])
def test_records_are_renumbered_by_the_slots_that_they_name(slots):
    records = records_of([(k, *row) for k, row in enumerate(slots)])
    heads = heads_of(records)
    found = renumber(records)
    assert found.tolist() == sorted({slot for row in slots for slot in row} - {-1})
    np.testing.assert_array_equal(np.append(found, -1)[heads[:, [SLOT, BEST]]], slots)
    assert heads[:, RAY].tolist() == list(range(len(slots)))
