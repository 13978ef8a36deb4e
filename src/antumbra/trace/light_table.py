"""The light table: a query's light samples, arranged in strata for tiles of 16 receivers.

A *chunk* is 16 samples. *Stratum* s of a chunk holds sample s of all 16 sample sets. These samples are near each other
on the light, because each set is in Z order of its cells. Aligned runs of 2, 4, 8 and 16 strata are *groups*. The
groups form a heap: stratum s is group 16 + s, and group g holds groups 2g and 2g + 1. Group 1 is the whole chunk.
"""

from typing import NamedTuple

import numpy as np

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
from ..kernels.vec3 import Vec3, keep, middles_and_halves, rows
from ..query.light_samples import patch_at, sample_point
from ..scene.lights import FIXED, LIST

STRATA = 16
POINTS = STRATA * 48  # float32 of a chunk: for each stratum x, y, z of 16 lanes
ALL_GROUPS = 32  # group 0 is a copy of group 1
GROUPS = 6 * ALL_GROUPS  # float32: rows of the groups' lower x, y, z, then of the upper ones
TARGETS = 6 * 16  # float32: rows of the middles x, y, z of each lane's samples, then of their half extents


class LightTable(NamedTuple):
    """All samples of a light, as a tile's lanes take them.

    If the light moves with the receiver, of the first four fields only the shapes are meaningful, else of the last two.
    """

    points: np.ndarray  # (chunks, 16, 3, 16) float32: stratum, axis, lane
    groups: np.ndarray  # (chunks, 6, 32) float32: boxes of the groups
    targets: np.ndarray  # (chunks, 6, 16) float32: boxes of each lane's samples
    by_lane: np.ndarray  # (chunks, 16, 3, 16) float32: `points` transposed: lane, axis, stratum
    samples: np.ndarray  # (chunks, 16, 3, 16) float64: stratum, (a, b, c), lane
    turned: np.ndarray  # (chunks, 16, 3, 16) float64: `samples` transposed: lane, (a, b, c), stratum


@inlined
def stays(light):
    """Are a LightPatch's samples the same for all receivers? Then one table serves them all."""
    return light.kind == FIXED or light.kind == LIST


@inlined
def group_of(strata):
    """The smallest group that holds all of the `strata` (bits, at least one)."""
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
    """Fill the groups of one chunk from its points lane by lane (pointers): minima of lanes need no reductions."""
    low = high = rows(by_lane, 0, 16)
    for lane in range(1, 16):
        p = rows(by_lane, lane * 48, 16)
        low = Vec3(minimum(low.x, p.x), minimum(low.y, p.y), minimum(low.z, p.z))
        high = Vec3(maximum(high.x, p.x), maximum(high.y, p.y), maximum(high.z, p.z))
    keep(groups, STRATA, ALL_GROUPS, low)
    keep(groups, 3 * ALL_GROUPS + STRATA, ALL_GROUPS, high)
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
    keep(targets, 0, 16, middle)
    keep(targets, 48, 16, half)


@kernel
def turn_points(points, by_lane, count):
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
        turn_points(ptr_at(ptr(table.points), chunk * POINTS), ptr_at(ptr(table.by_lane), chunk * POINTS), count)


def light_table(query, sets) -> LightTable:
    """The table of a query; lane i of its tiles uses sample set ``sets[i]``."""
    chunks = -(-query.samples.shape[1] // STRATA)
    f32 = [
        np.zeros((chunks, *shape), np.float32) for shape in ((STRATA, 3, 16), (6, ALL_GROUPS), (6, 16), (16, 3, STRATA))
    ]
    if query.light.kind in (FIXED, LIST):  # `stays`
        unused = np.zeros((chunks, 1, 1, 1))
        table = LightTable(*f32, unused, unused)
        _fixed_table(query.light, query.samples, sets, table)
        return table
    known = np.minimum(
        np.arange(chunks * STRATA), query.samples.shape[1] - 1
    )  # strata without a sample repeat the last
    samples = query.samples[sets][:, known].reshape(16, chunks, STRATA, 3)
    both = (np.ascontiguousarray(samples.transpose(order)) for order in ((1, 2, 3, 0), (1, 0, 3, 2)))
    return LightTable(*f32, *both)
