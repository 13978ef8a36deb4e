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

from ..kernels.jit import inlined, kernel
from ..kernels.simd import (
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
    ptr_at,
    put,
    reduce_min,
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
from .rayset import GROW, HIT, RAY, ray_at
from .splits import Split, no_split

CONSTANT, DISTANCE = 1, 2  # sets of kernels to choose from: left or right first; front to back or back to front

LANES = 16
_BOX = 6 * BINS  # words of one side's boxes on one axis: lower x, y, z, upper x, y, z, a plane to a lane
_BOXES = 6 * _BOX
_COUNTS = 6 * BINS
_ROW = BINS + 2
_PLACES = 12 * _ROW
_VISITS = 12 * BINS
_SUMS = 4 * BINS
_ONE = np.float32(1.0)


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


class Counts(NamedTuple):
    """What is counted of rays."""

    places: object  # pointer to int32, 4 rows of _ROW an axis: histograms
    visits: object  # pointer to float32, 4 rows of BINS an axis: rays at each plane


# rows of `Counts.places`: planes from which on, or up to which, rays enter a side's box, or come to it
_ENTERS_LEFT, _COMES_LEFT, _ENTERS_RIGHT, _COMES_RIGHT = range(4)
# rows of `Counts.visits`: rays that visit a side if the closer child comes first, or the farther one
_LEFT_NEAR, _RIGHT_NEAR, _LEFT_FAR, _RIGHT_FAR = range(4)


class RaySplit(NamedTuple):
    """A split, the order of its children, and whether the right one comes first in a constant order."""

    split: Split
    order: object  # int64
    swapped: object  # bool
    cost: object  # float32: the heuristic, with the prior


@kernel
def no_ray_split():
    """The split of a range that rays have no say in."""
    return RaySplit(no_split(), np.int64(UNORDERED), False, INF)


@inlined
def _put_side(sides, number, k, box, count, one):
    """Write one side of plane k; `one`: memory for 8 float32."""
    store(one, 0, box)
    at = number * _BOX + k
    for axis in range(3):
        put(sides.boxes, at + axis * BINS, get(one, axis))
        put(sides.boxes, at + (3 + axis) * BINS, -get(one, 4 + axis))
    put(sides.counts, number * BINS + k, np.float32(count))


@kernel
def bound_sides(bins, n_bins, sides):
    """Fill `Sides` from the bins of a range, up to a whole number of LANES; what is beyond the bins is empty."""
    one, end = stack_f32(8), (n_bins + LANES - 1) // LANES * LANES
    for axis in range(3):
        base, box, count = axis * n_bins, splat8(INF), np.int64(0)
        for k in range(n_bins):
            _put_side(sides, 2 * axis, k, box, count, one)
            box = minimum(box, load8(bins.boxes, (base + k) * 8))
            count += get(bins.counts, base + k)
        box, count = splat8(INF), np.int64(0)
        for k in range(n_bins - 1, -1, -1):
            box = minimum(box, load8(bins.boxes, (base + k) * 8))
            count += get(bins.counts, base + k)
            _put_side(sides, 2 * axis + 1, k, box, count, one)
        for k in range(n_bins, end):
            _put_side(sides, 2 * axis, k, splat8(INF), np.int64(0), one)
            _put_side(sides, 2 * axis + 1, k, splat8(INF), np.int64(0), one)


@inlined
def _entered16(boxes, at, ray, near, far):
    """Bits of 16 planes whose boxes, at word `at`, the ray enters; near, far: rows of the planes it meets so, x 3."""
    x0, x1 = load16(boxes, at + near[0]) - ray.ox, load16(boxes, at + far[0]) - ray.ox
    y0, y1 = load16(boxes, at + near[1]) - ray.oy, load16(boxes, at + far[1]) - ray.oy
    z0, z1 = load16(boxes, at + near[2]) - ray.oz, load16(boxes, at + far[2]) - ray.oz
    entry = maximum(maximum(x0 * ray.ix, y0 * ray.iy), maximum(z0 * ray.iz, splat16(np.float32(0.0))))
    leave = minimum(minimum(x1 * ray.ix, y1 * ray.iy), minimum(z1 * ray.iz, splat16(np.float32(1.0))))
    return bits(entry <= leave * GROW)


@inlined
def _entered(boxes, number, ray, near, far, n_bins):
    """Bits of the planes on whose side `number` the ray enters the box."""
    found = _entered16(boxes, number * _BOX, ray, near, far)
    if n_bins > LANES:
        found |= _entered16(boxes, number * _BOX + LANES, ray, near, far) << LANES
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
    for half in range(0, BINS, LANES):
        more = select(mask_from_bits16((lanes >> half) & 0xFFFF), splat16(_ONE), splat16(np.float32(0.0)))
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
def _count_visits(visits, axis, first, last, lowest, highest, closer):
    """Note at which planes a ray visits each side if the closer, or the farther, child comes first."""
    at, all_ = axis * 4 * BINS, (np.int64(1) << BINS) - 1
    enters_left, enters_right = (all_ << first) & all_, all_ >> (BINS - 1 - last)
    clear_left, clear_right = all_ >> (BINS - 1 - min(lowest, BINS - 1)), (all_ << (highest + 1)) & all_
    _add_lanes(visits, at + _LEFT_NEAR * BINS, enters_left & (closer | clear_right))
    _add_lanes(visits, at + _RIGHT_NEAR * BINS, enters_right & (~closer | clear_left))
    _add_lanes(visits, at + _LEFT_FAR * BINS, enters_left & (~closer | clear_right))
    _add_lanes(visits, at + _RIGHT_FAR * BINS, enters_right & (closer | clear_left))


@kernel
def count_rays(rays, n, mapping, sides, kernels, counts):
    """Count n rays at all planes; the number of their hits."""
    lowest, highest, n_hits, n_bins = stack_i32(4), stack_i32(4), np.int64(0), mapping.n_bins
    for k in range(_PLACES):
        put(counts.places, k, 0)
    if kernels & DISTANCE:
        for k in range(0, _VISITS, LANES):
            store(counts.visits, k, splat16(np.float32(0.0)))
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
                closer = _closer16(sides.boxes, a, b, ray) | _closer16(sides.boxes, a + LANES, b + LANES, ray) << LANES
                _count_visits(counts.visits, axis, first, last, low, high, closer)
    return n_hits


@inlined
def _side_area(boxes, number, half, scale):
    """Half the area of one side's boxes of 16 planes, scaled; 0 where they are empty."""
    at, none = number * _BOX + half, splat16(np.float32(0.0))
    x = (load16(boxes, at + 3 * BINS) - load16(boxes, at)) * scale
    y = (load16(boxes, at + 4 * BINS) - load16(boxes, at + BINS)) * scale
    z = (load16(boxes, at + 5 * BINS) - load16(boxes, at + 2 * BINS)) * scale
    return select(x >= none, x * (y + z) + y * z, none)


@kernel
def _subtree_costs(sides, end, linear, costs):
    """Write what each side's subtree is taken to cost a ray that enters it, from its number of triangles."""
    for number in range(6):
        for k in range(end):
            n = get(sides.counts, number * BINS + k)
            put(costs, number * BINS + k, n if linear else np.sqrt(n) * np.sqrt(np.sqrt(n)))


@inlined
def _sum_places(places, axis, end, visits):
    """Histograms of places on one axis -> rays that enter, and come to, each side at each plane, in 4 rows of BINS."""
    row = axis * 4 * _ROW
    enters, comes = np.int32(0), np.int32(0)
    for k in range(end):
        enters += get(places, row + _ENTERS_LEFT * _ROW + k)
        comes += get(places, row + _COMES_LEFT * _ROW + k)
        put(visits, _ENTERS_LEFT * BINS + k, np.float32(enters))
        put(visits, _COMES_LEFT * BINS + k, np.float32(comes))
    enters, comes = np.int32(0), np.int32(0)
    for k in range(BINS, -1, -1):
        enters += get(places, row + _ENTERS_RIGHT * _ROW + k)
        comes += get(places, row + _COMES_RIGHT * _ROW + k)
        if k < end:
            put(visits, _ENTERS_RIGHT * BINS + k, np.float32(enters))
            put(visits, _COMES_RIGHT * BINS + k, np.float32(comes))


@inlined
def _cheaper(best, cost, axis, half, order, swapped):
    """The better one of the best split so far and the cheapest of 16 planes with an order; the first one of equals."""
    least = reduce_min(cost)
    if least < best.cost:
        k = half + lowest_bit(bits(cost == splat16(least)))
        return RaySplit(Split(axis, k, np.float32(0.0)), np.int64(order), swapped, least)
    return best


@inlined
def _costs(visits, left, right, half, c1, c2, even):
    """The heuristic of 16 planes at which so many rays visit the left and the right side (rows of `visits`)."""
    return load16(visits, left * BINS + half) * c1 + load16(visits, right * BINS + half) * c2 + even


@kernel
def cheapest_ray_split(sides, counts, n_bins, n_hits, box, settings):
    """The split, and the order of its children, of the least heuristic.

    n_hits : of all rays; without any, all orders cost the same
    box : of the range
    """
    best, kernels, end = no_ray_split(), settings.kernels, (n_bins + LANES - 1) // LANES * LANES
    constant = LEFT_FIRST if n_hits > 0 else UNORDERED
    costs, visits = stack_f32(_COUNTS), stack_f32(_SUMS)
    _subtree_costs(sides, end, settings.linear, costs)
    area, prior, zero = half_area(box, settings.scale), np.float32(settings.prior), splat16(np.float32(0.0))
    share = prior / area  # infinite, or NaN, where the box has next to no area: then there is no prior
    share = share if share < INF else np.float32(0.0)
    for axis in range(3):
        _sum_places(counts.places, axis, end, visits)
        by_distance = ptr_at(counts.visits, axis * 4 * BINS)
        for half in range(0, end, LANES):
            c1, c2 = load16(costs, 2 * axis * BINS + half), load16(costs, (2 * axis + 1) * BINS + half)
            a1 = _side_area(sides.boxes, 2 * axis, half, settings.scale)
            a2 = _side_area(sides.boxes, 2 * axis + 1, half, settings.scale)
            even = (a1 * c1 + a2 * c2) * share
            even = select((c1 > zero) & (c2 > zero), even, splat16(INF))  # both sides hold something
            if kernels & CONSTANT or n_hits == 0:
                cost = _costs(visits, _ENTERS_LEFT, _COMES_RIGHT, half, c1, c2, even)
                best = _cheaper(best, cost, axis, half, constant, False)
                cost = _costs(visits, _COMES_LEFT, _ENTERS_RIGHT, half, c1, c2, even)
                best = _cheaper(best, cost, axis, half, constant, True)
            if kernels & DISTANCE and n_hits > 0:
                cost = _costs(by_distance, _LEFT_NEAR, _RIGHT_NEAR, half, c1, c2, even)
                best = _cheaper(best, cost, axis, half, FRONT_TO_BACK, False)
                cost = _costs(by_distance, _LEFT_FAR, _RIGHT_FAR, half, c1, c2, even)
                best = _cheaper(best, cost, axis, half, BACK_TO_FRONT, False)
    return best


@kernel
def ray_split(bins, rays, n, mapping, box, settings):
    """The cheapest `RaySplit` of a range whose bins are filled, for n rays.

    settings : of the fields of `HeuristicSettings`
    """
    sides = Sides(stack_f32(_BOXES), stack_f32(_COUNTS))
    counts = Counts(stack_i32(_PLACES), stack_f32(_VISITS))
    bound_sides(bins, mapping.n_bins, sides)
    n_hits = count_rays(rays, n, mapping, sides, settings.kernels, counts)
    return cheapest_ray_split(sides, counts, mapping.n_bins, n_hits, box, settings)
