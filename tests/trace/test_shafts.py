"""Shafts, beams and segments against boxes: no segment that meets a box is missed, and clear cases are decided."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr, splat16
from antumbra.kernels.vec3 import rows
from antumbra.trace.light_table import ALL_GROUPS
from antumbra.trace.shafts import (
    PLANE,
    PLANES,
    SHAFT_FLOATS,
    D,
    box_at,
    make_shafts,
    reach_of,
    segments_in_box,
    shafts_in_box,
    store_inverses,
)

F = np.float32
SCALES = [1.0, 1e-6, 1e6]


@kernel
def _segments_in_box(origins, ends, bounds, inverses):
    o, l = rows(ptr(origins), 0, 16), rows(ptr(ends), 0, 16)
    reach = store_inverses(ptr(inverses), 0, o, l)
    return segments_in_box(o, rows(ptr(inverses), 0, 16), splat16(reach), box_at(ptr(bounds)))


@kernel
def _shafts_in_box(origins, along, start, end, bounds):
    box = box_at(ptr(bounds))
    o, v = rows(ptr(origins), 0, 16), rows(ptr(along), 0, 16)
    start_half, end_half = rows(ptr(start), 0, 16), rows(ptr(end), 0, 16)
    reach = reach_of(o, v, start_half, end_half)
    return shafts_in_box(o, v, start_half, end_half, reach, box.middle, box.half)


@kernel
def _make_shafts(info, groups, shafts):
    make_shafts(ptr(info), ptr(groups), ptr(shafts))


def bounds_of(middle, half):
    """(8,) float32: the centre and the half extents of a box, as a block stores them."""
    return np.array([*middle, 0, *half, 0], F)


def lanes_of(mask):
    return mask >> np.arange(16) & 1 != 0


def meets(origins, ends, middle, half):
    """(n,) bool: whether segments meet a box, by slabs in float64."""
    d, o = (ends - origins).astype(float), origins.astype(float)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.stack([(middle - half - o) / d, (middle + half - o) / d])
    near, far = np.fmin(*t).max(-1), np.fmax(*t).min(-1)
    return np.fmax(near, 0.0) <= np.fmin(far, 1.0)


def some_boxes(rng, n=200):
    return zip(rng.uniform(-1, 1, (n, 3)).astype(F), rng.uniform(0.01, 0.4, (n, 3)).astype(F))


@pytest.mark.parametrize("scale", SCALES)
def test_segments_that_meet_a_box_are_found(scale):
    rng = np.random.default_rng(1)
    found = wanted = extra = 0
    for middle, half in some_boxes(rng):
        origins, ends = (scale * rng.uniform(-1, 1, (2, 16, 3))).astype(F)
        middle, half = F(scale) * middle, F(scale) * half
        told = lanes_of(_segments_in_box(origins.T.copy(), ends.T.copy(), bounds_of(middle, half), np.empty(48, F)))
        truth = meets(origins, ends, middle.astype(float), half.astype(float))
        assert told[truth].all()
        found, wanted, extra = found + told.sum(), wanted + truth.sum(), extra + (told & ~truth).sum()
    assert 0 < wanted < 16 * 200 and extra <= 0.01 * wanted, "the test is sharp, apart from rounding"


@pytest.mark.parametrize("scale", SCALES)
def test_no_segment_of_a_shaft_is_missed(scale):
    rng = np.random.default_rng(2)
    found, missed = 0, 0
    for middle, half in some_boxes(rng, 300):
        origins, along = (scale * rng.uniform(-1, 1, (2, 16, 3))).astype(F)
        start, end = (scale * rng.uniform(0, 0.05, (2, 16, 3))).astype(F)
        middle, half = F(scale) * middle, F(scale) * half
        arrays = [a.T.copy() for a in (origins, along, start, end)]
        told = lanes_of(_shafts_in_box(*arrays, bounds_of(middle, half)))
        x, y = rng.uniform(-1, 1, (2, 32, 16, 3))
        from_ = origins + x * start
        to = origins + along.astype(float) + y * end
        met = meets(from_.reshape(-1, 3), to.reshape(-1, 3), middle.astype(float), half.astype(float))
        met = met.reshape(32, 16).any(0)
        assert told[met].all()
        found, missed = found + met.sum(), missed + (~told).sum()
    assert found > 100 and missed > 100


def test_planes_of_shafts_bound_all_their_segments():
    rng = np.random.default_rng(3)
    c, half = rng.normal(size=3).astype(F), rng.uniform(0.1, 0.5, 3).astype(F)
    low = rng.uniform(3, 6, (3, ALL_GROUPS)).astype(F)
    high = low + rng.uniform(0.01, 0.8, low.shape).astype(F)
    groups = np.concatenate([low, high])
    shafts = np.zeros(SHAFT_FLOATS, F)
    _make_shafts(np.array([*c, *half], F), groups, shafts)
    table, sharp = shafts.reshape(-1, ALL_GROUPS), 0
    np.testing.assert_allclose(table[D : D + 3], (low + high) / 2 - c[:, None], rtol=1e-6)
    assert PLANES % ALL_GROUPS == 0
    for plane in range(4):
        rows_ = table[(PLANES + plane * PLANE) // ALL_GROUPS :][:5].astype(float)
        for g in range(ALL_GROUPS):
            w, b = rows_[:3, g], rows_[3, g]
            for t in rng.random(20):
                start = (1 - t) * rng.uniform(-1, 1, (50, 3)) * half
                end = t * (rng.uniform(low[:, g], high[:, g], (50, 3)) - c)
                inside = (start + end) @ w
                assert (inside <= b).all()
            corners = np.array([[(low, high)[i >> k & 1][k, g] - c[k] for k in range(3)] for i in range(8)])
            sharp += (corners @ w).max() > b - 1e-2 * abs(b)
    assert sharp > 3 * ALL_GROUPS, "planes touch the boxes"
