"""What is certain for beams and a triangle: a miss, or a cover; and on which side of its plane the light is."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr, splat16
from antumbra.kernels.vec3 import rows
from antumbra.trace.frusta.shaft_culling import block_lanes, cull_beams, verdict

F = np.float32


@kernel
def _cull_beams(origin, along, half, numbers, span, facing, told):
    """Beams from one receiver, each with the triangle in its lane."""
    o = rows(ptr(origin), 0, 16)
    lanes = block_lanes(o, ptr(numbers), splat16(span))
    v = cull_beams(rows(ptr(along), 0, 16), rows(ptr(half), 0, 16), lanes, facing)
    told[0], told[1], told[2], told[3] = v.miss, v.cover, v.above, v.below


@kernel
def _verdict(numbers, facing, told):
    at = ptr(numbers)
    e, k, ends = rows(at, 0, 16), rows(at, 48, 16), rows(at, 96, 16)
    f = rows(at, 144, 16)
    v = verdict(e.x, e.y, e.z, k.x, k.y, k.z, ends.x, ends.y, f.x, f.y, facing)
    told[0], told[1], told[2], told[3] = v.miss, v.cover, v.above, v.below


def lanes_of(told):
    return told[:, None] >> np.arange(16) & 1 != 0


def blocked(o, ends, v0, p, q):
    """(n, 16) bool: whether segments from o meet triangles, in float64; NaN-free for general positions."""
    d, a = ends - o, v0 - o
    normal = np.cross(p, q)
    dn = (d * normal).sum(-1)
    t = (a * normal).sum(-1) / dn
    at = o + t[..., None] * d - v0
    pp, pq, qq = ((x * y).sum(-1) for x, y in ((p, p), (p, q), (q, q)))
    ap, aq = (at * p).sum(-1), (at * q).sum(-1)
    det = pp * qq - pq**2
    u, w = (qq * ap - pq * aq) / det, (pp * aq - pq * ap) / det
    return (t > 0) & (t < 1) & (u >= 0) & (w >= 0) & (u + w <= 1), dn


def cases(rng):
    """A receiver, 16 beams to boxes above it, and 16 triangles, some of which are large or lie beside."""
    o = rng.normal(size=3).astype(F)
    along = (rng.uniform(-1, 1, (16, 3)) + (0, 6, 0)).astype(F)
    half = rng.uniform(0.05, 0.8, (16, 3)).astype(F)
    v0 = (o + along * 0.5 + rng.normal(size=(16, 3)) * rng.choice([0.3, 2.0], (16, 1))).astype(F)
    p, q = (rng.normal(size=(2, 16, 3)) * rng.choice([0.3, 6.0], (16, 1))).astype(F)
    v0 -= (p + q) * F(1 / 3)
    return o, along, half, v0, p, q


@pytest.mark.parametrize("facing", [-1, 0, 1])
def test_what_is_certain_for_beams_is_true_of_all_their_segments(facing):
    rng, misses, covers, sides = np.random.default_rng(4), 0, 0, 0
    for _ in range(150):
        o, along, half, v0, p, q = cases(rng)
        numbers = np.stack([*v0.T, *p.T, *q.T]).astype(F)
        span, told = F(1.01 * (np.abs(along) + half).sum(1).max()), np.zeros(4, np.int64)
        _cull_beams(np.repeat(o, 16).reshape(3, 16), along.T.copy(), half.T.copy(), numbers, span, facing, told)
        miss, cover, above, below = lanes_of(told)
        ends = o.astype(float) + along + rng.uniform(-1, 1, (300, 16, 3)) * half
        hit, dn = blocked(o.astype(float), ends, *(x.astype(float) for x in (v0, p, q)))
        if facing:
            hit &= facing * dn < 0
        assert not hit[:, miss].any() and hit[:, cover].all() and not (miss & cover).any() and not (above & below).any()
        distance = ((v0 - ends) * np.cross(p.astype(float), q.astype(float))).sum(-1)
        assert (distance[:, above] > 0).all() and (distance[:, below] < 0).all()
        misses, covers, sides = misses + miss.sum(), covers + cover.sum(), sides + (above | below).sum()
    assert misses > 300 and covers > 30 and sides > 300


def test_verdicts_follow_from_signs_outside_the_slack():
    numbers, told = np.zeros((12, 16), F), np.zeros(4, np.int64)
    numbers[3:6], numbers[7], numbers[10] = 0.5, 0.5, 0.5  # slack of the edges, of t and of f
    numbers[:3], numbers[6], numbers[9] = 1.0, 1.0, -1.0  # inside, and the ends on both sides of the plane: covered
    numbers[0, 1] = -1.0  # edges of both signs: missed
    numbers[0, 2] = 0.25  # within its slack: open
    numbers[9, 3] = 1.0  # both ends on one side: missed
    numbers[9, 4] = -0.25  # an end within its slack: open
    numbers[:3, 5] = -1.0  # inside, seen from behind
    _verdict(numbers, 0, told)
    miss, cover, above, below = lanes_of(told)
    assert np.flatnonzero(miss).tolist() == [1, 3] and np.flatnonzero(~cover).tolist() == [1, 2, 3, 4]
    assert np.flatnonzero(above).tolist() == [3] and np.flatnonzero(~below).tolist() == [3, 4]
    _verdict(numbers, 1, told)
    assert np.flatnonzero(lanes_of(told)[1]).tolist() == [5], "the front is culled"
    _verdict(numbers, -1, told)
    assert 5 in np.flatnonzero(lanes_of(told)[0]), "the back is culled"
