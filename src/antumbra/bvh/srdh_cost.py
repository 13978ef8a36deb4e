"""The Shadow Ray Distribution Heuristic of all candidate splits of a range at once [Feltman et al. 2012, Sec. 3.3].

A plane between two bins parts a range P in P1 and P2. The cost of a split for the rays R that come to it is

    sum over r of  (1 - k'(r) H(P2, r)) I(P1, r) |P1| + (1 - k(r) H(P1, r)) I(P2, r) |P2|

where I says that the ray enters the box, H that it meets something in there, and k is 1 where the left child is visited
first, k' = 1 - k. From plane to plane boxes only grow on one side and shrink on the other. So along an axis a ray
enters left boxes from some plane on and right ones up to some plane, and the same goes for what it meets. For constant
k, then, four counts of rays at each plane, which histograms of these places give, are the whole sum. Planes lie side by
side in the lanes of a register when a ray is tested against their boxes. Orders by distance, which need not be so well
behaved, are counted plane by plane.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..simd import (
    bits,
    get,
    highest_bit,
    load4,
    load8,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    put,
    select,
    splat4,
    splat8,
    splat16,
    stack_f32,
    stack_i32,
    store,
    to_i32,
)
from .bins import BINS
from .bounds import INF, half_area
from .nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED
from .rayset import HIT, RAY, ray_at
from .splits import Split, no_split

CONSTANT, DISTANCE = 1, 2  # sets of kernels to choose from: left or right first; front to back or back to front

_BOX = 6 * BINS  # words of one side's boxes on one axis: lower x, y, z, upper x, y, z, a plane to a lane
_BOXES = 6 * _BOX
_NUMBERS = 6 * BINS
_ROW = BINS + 2
_PLACES = 12 * _ROW
_LANES = 12 * BINS
_GROW = np.float32(1.0 + 2.0**-20)


class HeuristicSettings(NamedTuple):
    """What the heuristic of all ranges is computed with."""

    scale: object  # float32, a power of two: makes the largest coordinate about 1, so that no area overflows
    kernels: object  # int64: sets of kernels to choose from
    prior: object  # float64: how many rays that are spread evenly, as the SAH assumes, are added to those counted
    linear: object  # bool: a subtree of n triangles is taken to cost n, as published; else n to the power of 3/4


class Sides(NamedTuple):
    """Both sides of all planes; side s (0: left) on axis a is number 2 a + s. Left of plane k are the bins below k."""

    boxes: object  # pointer, _BOX words a side; empty ones lower = +inf, upper = -inf
    counts: object  # pointer to float32, BINS a side: triangles
    areas: object  # pointer to float32, BINS a side


class Counts(NamedTuple):
    """What is counted of rays."""

    places: object  # pointer to int32, 4 rows of _ROW an axis: histograms
    lanes: object  # pointer to int32, 4 rows of BINS an axis: rays at each plane


# rows of `Counts.places`: planes from which on, or up to which, rays enter a side's box, or come to it
_ENTERS_LEFT, _COMES_LEFT, _ENTERS_RIGHT, _COMES_RIGHT = range(4)
# rows of `Counts.lanes`: rays that visit a side if the closer child comes first, or the farther one
_LEFT_NEAR, _RIGHT_NEAR, _LEFT_FAR, _RIGHT_FAR = range(4)


class RaySplit(NamedTuple):
    """A split, the order of its children, and whether the right one comes first in a constant order."""

    split: Split
    order: object  # int64
    swapped: object  # bool
    cost: object  # float64: the heuristic, with the prior


@kernel
def no_ray_split():
    """The split of a range that rays have no say in."""
    return RaySplit(no_split(), np.int64(UNORDERED), False, np.float64(np.inf))


@inlined
def _put_box(sides, number, k, box, count, scale, one):
    """Write one side of plane k; `one`: memory for 8 float32."""
    store(one, 0, box)
    at = number * _BOX + k
    for axis in range(3):
        put(sides.boxes, at + axis * BINS, get(one, axis))
        put(sides.boxes, at + (3 + axis) * BINS, -get(one, 4 + axis))
    put(sides.counts, number * BINS + k, np.float32(count))
    put(sides.areas, number * BINS + k, half_area(box, scale) if count > 0 else np.float32(0.0))


@kernel
def bound_sides(bins, n_bins, scale, sides):
    """Fill `Sides` from the bins of a range."""
    one = stack_f32(8)
    for axis in range(3):
        base, box, count = axis * n_bins, splat8(INF), np.int64(0)
        for k in range(BINS):
            _put_box(sides, 2 * axis, k, box if k < n_bins else splat8(INF), count, scale, one)
            if k < n_bins:
                box = minimum(box, load8(bins.boxes, (base + k) * 8))
                count += get(bins.counts, base + k)
        box, count = splat8(INF), np.int64(0)
        for k in range(BINS - 1, -1, -1):
            if k < n_bins:
                box = minimum(box, load8(bins.boxes, (base + k) * 8))
                count += get(bins.counts, base + k)
            _put_box(sides, 2 * axis + 1, k, box, count, scale, one)


@inlined
def _entered16(boxes, at, ray, near, far):
    """Bits of 16 planes whose boxes, at word `at`, the ray enters; near, far: rows of the planes it meets so, x 3."""
    x0, x1 = load16(boxes, at + near[0]) - ray.ox, load16(boxes, at + far[0]) - ray.ox
    y0, y1 = load16(boxes, at + near[1]) - ray.oy, load16(boxes, at + far[1]) - ray.oy
    z0, z1 = load16(boxes, at + near[2]) - ray.oz, load16(boxes, at + far[2]) - ray.oz
    entry = maximum(maximum(x0 * ray.ix, y0 * ray.iy), maximum(z0 * ray.iz, splat16(np.float32(0.0))))
    leave = minimum(minimum(x1 * ray.ix, y1 * ray.iy), minimum(z1 * ray.iz, splat16(np.float32(1.0))))
    return bits(entry <= leave * _GROW)


@inlined
def _entered(boxes, number, ray, near, far, n_bins):
    """Bits of the planes on whose side `number` the ray enters the box."""
    found = _entered16(boxes, number * _BOX, ray, near, far)
    if n_bins > 16:
        found |= _entered16(boxes, number * _BOX + 16, ray, near, far) << 16
    return found


@inlined
def _closer16(boxes, left, right, ray):
    """Bits of 16 planes whose left box has the centre that is closer to the ray's origin."""
    two, near, far = np.float32(2.0), splat16(np.float32(0.0)), splat16(np.float32(0.0))
    origin = ray.ox, ray.oy, ray.oz
    for axis in range(3):
        row = axis * BINS
        a = load16(boxes, left + row) + load16(boxes, left + row + 3 * BINS) - two * origin[axis]
        b = load16(boxes, right + row) + load16(boxes, right + row + 3 * BINS) - two * origin[axis]
        near, far = near + a * a, far + b * b
    return bits(near <= far)


@inlined
def _put_bins_met(rays, i, mapping, n_bins, lowest, highest):
    """Write the lowest and highest bin, on each axis, of the triangles that ray i meets; BINS and -1 without any."""
    top = np.int32(n_bins - 1)
    low, high = splat4(np.int32(BINS)), splat4(np.int32(-1))
    first = np.int64(get(rays.words, i * RAY + 6))
    for k in range(first, first + get(rays.words, i * RAY + 7)):
        centroid = load4(rays.hits, k * HIT)
        place = minimum(maximum(to_i32((centroid - mapping.origin) * mapping.factor), np.int32(0)), top)
        low, high = minimum(low, place), maximum(high, place)
    store(lowest, 0, low)
    store(highest, 0, high)


@inlined
def _add(memory, at):
    put(memory, at, get(memory, at) + 1)


@inlined
def _add_lanes(memory, at, lanes):
    """Add one to each of the BINS counts whose bit is set."""
    for half in range(0, BINS, 16):
        chosen = mask_from_bits16((lanes >> half) & 0xFFFF)
        more = select(chosen, splat16(np.int32(1)), splat16(np.int32(0)))
        store(memory, at + half, load16(memory, at + half) + more)


@inlined
def _count_places(places, axis, first, last, lowest, highest):
    """Note from and up to which planes a ray enters boxes, and comes to them, of constant orders.

    first : the first plane whose left box it enters; last : the last one whose right box
    lowest, highest : bins of what it meets; on the left from plane lowest + 1 on, on the right up to plane highest
    """
    at = axis * 4 * _ROW
    _add(places, at + _ENTERS_LEFT * _ROW + first)
    _add(places, at + _COMES_LEFT * _ROW + max(first, highest + 1))
    _add(places, at + _ENTERS_RIGHT * _ROW + last)
    _add(places, at + _COMES_RIGHT * _ROW + min(last, lowest))


@inlined
def _count_lanes(lanes, axis, first, last, lowest, highest, closer):
    """Note at which planes a ray visits each side if the closer, or the farther, child comes first."""
    at, all_ = axis * 4 * BINS, (np.int64(1) << BINS) - 1
    enters_left, enters_right = (all_ << first) & all_, all_ >> (BINS - 1 - last)
    clear_left, clear_right = all_ >> (BINS - 1 - min(lowest, BINS - 1)), (all_ << (highest + 1)) & all_
    _add_lanes(lanes, at + _LEFT_NEAR * BINS, enters_left & (closer | clear_right))
    _add_lanes(lanes, at + _RIGHT_NEAR * BINS, enters_right & (~closer | clear_left))
    _add_lanes(lanes, at + _LEFT_FAR * BINS, enters_left & (~closer | clear_right))
    _add_lanes(lanes, at + _RIGHT_FAR * BINS, enters_right & (closer | clear_left))


@kernel
def count_rays(rays, n, mapping, sides, kernels, counts):
    """Count n rays at all planes; the number of their hits."""
    lowest, highest, n_hits, n_bins = stack_i32(4), stack_i32(4), np.int64(0), mapping.n_bins
    for k in range(_PLACES):
        put(counts.places, k, 0)
    if kernels & DISTANCE:
        for k in range(_LANES):
            put(counts.lanes, k, 0)
    for i in range(n):
        ray = ray_at(rays.rays, i)
        up = ray.ix >= 0.0, ray.iy >= 0.0, ray.iz >= 0.0
        near = 0 if up[0] else 3 * BINS, BINS if up[1] else 4 * BINS, 2 * BINS if up[2] else 5 * BINS
        far = 3 * BINS if up[0] else 0, 4 * BINS if up[1] else BINS, 5 * BINS if up[2] else 2 * BINS
        _put_bins_met(rays, i, mapping, n_bins, lowest, highest)
        n_hits += get(rays.words, i * RAY + 7)
        for axis in range(3):
            low, high = np.int64(get(lowest, axis)), np.int64(get(highest, axis))
            left = _entered(sides.boxes, 2 * axis, ray, near, far, n_bins)
            right = _entered(sides.boxes, 2 * axis + 1, ray, near, far, n_bins)
            first = min(lowest_bit(left | np.int64(1) << BINS), low + 1)
            last = max(highest_bit(right | 1), high)
            _count_places(counts.places, axis, first, last, low, high)
            if kernels & DISTANCE:
                a, b = 2 * axis * _BOX, (2 * axis + 1) * _BOX
                closer = _closer16(sides.boxes, a, b, ray) | _closer16(sides.boxes, a + 16, b + 16, ray) << 16
                _count_lanes(counts.lanes, axis, first, last, low, high, closer)
    return n_hits


@inlined
def _subtree_cost(n, linear):
    """What a subtree of n triangles is taken to cost a ray that enters it."""
    return n if linear else np.sqrt(n) * np.sqrt(np.sqrt(n))


@inlined
def _cheaper(best, axis, k, order, swapped, cost):
    """The better one of the best split so far and another one."""
    if cost < best.cost:
        return RaySplit(Split(axis, k, np.float32(0.0)), order, swapped, cost)
    return best


@kernel
def cheapest_ray_split(sides, counts, n_bins, n_hits, area, settings):
    """The split, and the order of its children, of the least heuristic.

    n_hits : of all rays; without any, all orders cost the same
    area : half the area of the range's box, scaled as in `sides`
    """
    best = no_ray_split()
    constant = np.int64(LEFT_FIRST if n_hits > 0 else UNORDERED)
    places, lanes, kernels, prior = counts.places, counts.lanes, settings.kernels, settings.prior
    for axis in range(3):
        row, side, lane = axis * 4 * _ROW, 2 * axis * BINS, axis * 4 * BINS
        enters_right, comes_right = np.int64(0), np.int64(0)
        for k in range(BINS + 1):
            enters_right += get(places, row + _ENTERS_RIGHT * _ROW + k)
            comes_right += get(places, row + _COMES_RIGHT * _ROW + k)
        enters_left, comes_left = np.int64(0), np.int64(0)
        for k in range(n_bins):
            enters_left += get(places, row + _ENTERS_LEFT * _ROW + k)
            comes_left += get(places, row + _COMES_LEFT * _ROW + k)
            n1, n2 = np.float64(get(sides.counts, side + k)), np.float64(get(sides.counts, side + BINS + k))
            if n1 > 0.0 and n2 > 0.0:
                c1, c2 = _subtree_cost(n1, settings.linear), _subtree_cost(n2, settings.linear)
                a1, a2 = np.float64(get(sides.areas, side + k)), np.float64(get(sides.areas, side + BINS + k))
                even = prior * ((a1 * c1 + a2 * c2) / area if area > 0.0 else c1 + c2)
                if kernels & CONSTANT or n_hits == 0:
                    cost = enters_left * c1 + comes_right * c2 + even
                    best = _cheaper(best, np.int64(axis), np.int64(k), constant, False, cost)
                    cost = comes_left * c1 + enters_right * c2 + even
                    best = _cheaper(best, np.int64(axis), np.int64(k), constant, True, cost)
                if kernels & DISTANCE and n_hits > 0:
                    at = lane + k
                    cost = get(lanes, at) * c1 + get(lanes, at + BINS) * c2 + even
                    best = _cheaper(best, np.int64(axis), np.int64(k), np.int64(FRONT_TO_BACK), False, cost)
                    cost = get(lanes, at + 2 * BINS) * c1 + get(lanes, at + 3 * BINS) * c2 + even
                    best = _cheaper(best, np.int64(axis), np.int64(k), np.int64(BACK_TO_FRONT), False, cost)
            enters_right -= get(places, row + _ENTERS_RIGHT * _ROW + k)
            comes_right -= get(places, row + _COMES_RIGHT * _ROW + k)
    return best


@kernel
def ray_split(bins, rays, n, mapping, box, settings):
    """The cheapest `RaySplit` of a range whose bins are filled, for n rays.

    settings : of the fields of `HeuristicSettings`
    """
    sides = Sides(stack_f32(_BOXES), stack_f32(_NUMBERS), stack_f32(_NUMBERS))
    counts = Counts(stack_i32(_PLACES), stack_i32(_LANES))
    bound_sides(bins, mapping.n_bins, settings.scale, sides)
    n_hits = count_rays(rays, n, mapping, sides, settings.kernels, counts)
    area = np.float64(half_area(box, settings.scale))
    return cheapest_ray_split(sides, counts, mapping.n_bins, n_hits, area, settings)
