"""Packets of some of the four blocks of a batch, and of all of them."""

from itertools import product

import numpy as np
import pytest

import oracle
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.query.ray_list import hit_arrays, rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.counters import NODES, new_counters
from antumbra.trace.rays.ray_batches import RayTracer

_TMAX = 1.25
_LANES, _BLOCKS = 16, 4


def _soup(rng):
    """(n, 3, 3) float32: triangles in the unit cube."""
    return (rng.uniform(size=(300, 1, 3)) + rng.normal(scale=0.08, size=(300, 3, 3))).astype(np.float32)


def _coherent(kind, rng, n):
    """(origins, ends) of n rays that are coherent: from one point, to one, or from one small box to another."""
    a, b = rng.uniform(-0.2, 1.2, (2, 3))
    near = rng.uniform(-0.01, 0.01, (2, n, 3))
    if kind == "from one point":
        return np.broadcast_to(a, (n, 3)), b + near[1]
    if kind == "to one point":
        return a + 8 * near[0], np.broadcast_to(b, (n, 3))
    if kind == "along an axis":  # directions of both signs, and zeros, along the other two
        ends = a + near[0] * [1, 1, 0] + [0, 0, 1.0]
        return a + near[1] * [1, 1, 0], np.where(rng.uniform(size=(n, 3)) < 0.2, a + [0, 0, 1.0], ends)
    return a + near[0], b + near[1]


def _batches(kind, rng):
    """(origins, directions), (m * 64, 3) float32: each set of a batch's blocks is coherent once, others random."""
    origins, ends = [], []
    for together in product([False, True], repeat=_BLOCKS):
        o, e = rng.uniform(size=(2, _BLOCKS * _LANES, 3))
        member = np.repeat(together, _LANES)
        o[member], e[member] = _coherent(kind, rng, int(member.sum()))
        origins.append(o)
        ends.append(e)
    o, e = (np.concatenate(a).astype(np.float32) for a in (origins, ends))
    return o, np.where(e == o, np.float32(0.25), e - o)


@pytest.mark.parametrize("kind", ["from one point", "to one point", "along an axis", "between boxes"])
def test_any_blocks_of_a_batch_may_be_a_packet(kind):
    rng = np.random.default_rng(5)
    soup = _soup(rng)
    tracer = RayTracer(widen(BUILDERS["bsah"].build(soup, 1), 1))
    origins, directions = (np.concatenate(a) for a in zip(*[_batches(kind, rng) for _ in range(3)], strict=True))
    origins, directions = origins[:-5], directions[:-5]  # the last block is not full
    rays = rays_of(origins, directions, HitFilter(0.0, _TMAX), (0.0, 0.0, 0.0), len(soup))
    blocked, nearest = hit_arrays(len(origins), True), hit_arrays(len(origins), False)
    assert tracer.trace(rays, True, blocked, 1) and tracer.trace(rays, False, nearest, 1)
    truth = oracle.occluded(soup, origins, directions, tmax=_TMAX)
    assert 0.1 < truth.mean() < 0.9
    np.testing.assert_array_equal(blocked.blocked, truth)
    t, face = oracle.closest_hit(soup, origins, directions, 0.0, _TMAX)
    np.testing.assert_array_equal(nearest.t, t)
    np.testing.assert_array_equal(nearest.face, face)


def test_four_coherent_blocks_visit_nodes_together():
    rng = np.random.default_rng(6)
    soup = _soup(rng)
    tracer = RayTracer(widen(BUILDERS["bsah"].build(soup, 1), 1))
    origins, ends = _coherent("between boxes", rng, _BLOCKS * _LANES)
    visits = []
    for n in (_LANES, _BLOCKS * _LANES):
        rays = rays_of(
            origins[:n].astype(np.float32), (ends - origins)[:n].astype(np.float32), HitFilter(), (0.0, 0.0, 0.0), 300
        )
        counters = new_counters()
        assert tracer.trace(rays, False, hit_arrays(n, False), 1, counters)
        visits.append(int(counters[NODES]))
    assert 0 < visits[1] < 2 * visits[0]
