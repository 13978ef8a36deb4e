"""The light table: a query's light samples, arranged in strata for tiles of 16 receivers.

A *chunk* is 16 samples. *Stratum* s of a chunk holds sample s of all 16 sample sets, which are near each other on the
light, because the cells of each set are in Z order. Aligned runs of 2, 4, 8 and 16 strata are *groups*. Groups form a
heap: stratum s is group 16 + s, and group g contains groups 2g and 2g + 1. Group 1 is the whole chunk.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.simd import (
    get,
    highest_bit,
    load16,
    lowest_bit,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
)
from ..kernels.vec3 import Vec3, middles_and_halves, rows, store3
from ..query.light_samples import patch_at, sample_point
from ..query.shadow_query import ShadowQuery
from ..scene.lights import FIXED, LIST

STRATA = 16
POINTS = STRATA * 48  # float32 per chunk: for each stratum x, y, z of 16 lanes
ALL_GROUPS = 32  # group 0 is a copy of group 1
GROUPS = 6 * ALL_GROUPS  # float32: rows of the groups' lower x, y, z, then of the upper ones
TARGETS = 6 * 16  # float32: rows of the middles x, y, z of each lane's samples, then of their half extents


class LightTable(NamedTuple):
    """All samples of a light, arranged for the lanes of tiles.

    For a light that moves with the receiver, only the shapes of the first four fields are meaningful; for other lights,
    only the shapes of the last two.
    """

    points: np.ndarray  # (chunks, 16, 3, 16) float32: stratum, axis, lane
    groups: np.ndarray  # (chunks, 6, 32) float32: boxes of the groups
    targets: np.ndarray  # (chunks, 6, 16) float32: boxes of each lane's samples
    by_lane: np.ndarray  # (chunks, 16, 3, 16) float32: `points` transposed: lane, axis, stratum
    samples: np.ndarray  # (chunks, 16, 3, 16) float64: stratum, (a, b, c), lane
    samples_by_lane: np.ndarray  # (chunks, 16, 3, 16) float64: `samples` transposed: lane, (a, b, c), stratum


@inlined
def is_fixed(light):
    """True if a LightPatch has the same samples for all receivers, which then share one table."""
    return light.kind == FIXED or light.kind == LIST


@inlined
def group_of(strata):
    """The smallest group that contains all `strata` (bits, at least one)."""
    low, high = 16 + lowest_bit(strata), 16 + highest_bit(strata)
    return low >> (highest_bit(low ^ high) + 1)


@inlined
def _join_groups(lower, upper):
    """Bound the groups along one axis from their strata."""
    for g in range(15, 0, -1):
        a, b = get(lower, 2 * g), get(lower, 2 * g + 1)
        put(lower, g, a if a < b else b)
        a, b = get(upper, 2 * g), get(upper, 2 * g + 1)
        put(upper, g, a if a > b else b)
    put(lower, 0, get(lower, 1))
    put(upper, 0, get(upper, 1))


@kernel
def bound_groups(points, groups, count):
    """Fill the groups of one chunk from its points (pointers); strata from `count` on repeat the last one."""
    for k in range(3):
        lower, upper = ptr_at(groups, k * ALL_GROUPS), ptr_at(groups, (3 + k) * ALL_GROUPS)
        for s in range(STRATA):
            p = load16(points, (s if s < count else count - 1) * 48 + 16 * k)
            put(lower, 16 + s, reduce_min(p))
            put(upper, 16 + s, reduce_max(p))
        _join_groups(lower, upper)


@kernel
def bound_strata(by_lane, groups):
    """Fill the groups of one chunk from its points by lane (pointers), which takes minima of vectors, no reductions."""
    low = high = rows(by_lane, 0, 16)
    for lane in range(1, 16):
        p = rows(by_lane, lane * 48, 16)
        low = Vec3(minimum(low.x, p.x), minimum(low.y, p.y), minimum(low.z, p.z))
        high = Vec3(maximum(high.x, p.x), maximum(high.y, p.y), maximum(high.z, p.z))
    store3(groups, STRATA, ALL_GROUPS, low)
    store3(groups, 3 * ALL_GROUPS + STRATA, ALL_GROUPS, high)
    for k in range(3):
        _join_groups(ptr_at(groups, k * ALL_GROUPS), ptr_at(groups, (3 + k) * ALL_GROUPS))


@kernel
def bound_targets(points, targets, count):
    """Fill the targets of one chunk from its points (pointers)."""
    low = high = rows(points, 0, 16)
    for s in range(1, count):
        p = rows(points, s * 48, 16)
        low = Vec3(minimum(low.x, p.x), minimum(low.y, p.y), minimum(low.z, p.z))
        high = Vec3(maximum(high.x, p.x), maximum(high.y, p.y), maximum(high.z, p.z))
    middle, half = middles_and_halves(low, high)
    store3(targets, 0, 16, middle)
    store3(targets, 48, 16, half)


@kernel
def transpose_points(points, by_lane, count):
    """Write the points of a chunk lane by lane; strata from `count` on repeat the last one."""
    for lane in range(16):
        for k in range(3):
            for s in range(16):
                put(by_lane, lane * 48 + 16 * k + s, get(points, (s if s < count else count - 1) * 48 + 16 * k + lane))


@kernel
def _fixed_table(light, samples, sets, table):
    o, n = np.float32(0.0), np.float64(0.0)
    patch = patch_at(light, o, o, o, n, n, n)
    spp = samples.shape[1]
    for chunk in range(len(table.points)):
        count = min(STRATA, spp - chunk * STRATA)
        points = table.points[chunk]
        for s in range(count):
            for lane in range(16):
                a, b, c = samples[sets[lane], chunk * STRATA + s]
                points[s, 0, lane], points[s, 1, lane], points[s, 2, lane] = sample_point(patch, a, b, c)
        bound_groups(
            ptr_at(ptr(table.points), chunk * POINTS),
            ptr_at(ptr(table.groups), chunk * GROUPS),
            count,
        )
        bound_targets(ptr_at(ptr(table.points), chunk * POINTS), ptr_at(ptr(table.targets), chunk * TARGETS), count)
        transpose_points(ptr_at(ptr(table.points), chunk * POINTS), ptr_at(ptr(table.by_lane), chunk * POINTS), count)


def light_table(query: ShadowQuery, sets: NDArray[np.int64]) -> LightTable:
    """The light table of a query; lane i of its tiles uses sample set ``sets[i]``."""
    chunks = -(-query.samples.shape[1] // STRATA)
    f32 = [
        np.zeros((chunks, *shape), np.float32) for shape in ((STRATA, 3, 16), (6, ALL_GROUPS), (6, 16), (16, 3, STRATA))
    ]
    if query.light.kind in (FIXED, LIST):  # `is_fixed`
        unused = np.zeros((chunks, 1, 1, 1))
        table = LightTable._make((*f32, unused, unused))
        _fixed_table(query.light, query.samples, sets, table)
        return table
    # strata without a sample repeat the last one
    known = np.minimum(np.arange(chunks * STRATA), query.samples.shape[1] - 1)
    samples = query.samples[sets][:, known].reshape(16, chunks, STRATA, 3)
    both = (np.ascontiguousarray(samples.transpose(order)) for order in ((1, 2, 3, 0), (1, 0, 3, 2)))
    return LightTable._make((*f32, *both))
