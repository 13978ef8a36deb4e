"""The Shadow Ray Distribution Heuristic: ray sets, and the best split for them [Feltman et al. 2012, Sec. 3.3].

Ray sets. The builder passes sets of shadow rays with all their hits down the tree. Each child of a node gets a filtered
ray set [Feltman et al. 2012, Sec. 3.4]: the rays that reach the child in visiting order and enter its box, each with
the triangles that it hits in the child. Hits are sparse, so each ray has a list of them. A hit is stored as a centroid
only, because that decides the triangle's side of a split.

Cost. All candidate splits of a range are evaluated at once. A plane between two bins divides a range P into P1 and P2.
The cost of a split for the rays R that reach the range is (docs/design/srdh.md, eq. 1)

    sum over r of  (1 - k'(r) H(P2, r)) I(P1, r) |P1| + (1 - k(r) H(P1, r)) I(P2, r) |P2|

I is 1 if the ray enters the box, H is 1 if it hits a triangle in it, k is 1 if the ray visits the left child first, and
k' = 1 - k.

From one plane to the next, boxes only grow on one side and shrink on the other. Along an axis, a ray therefore enters
the left boxes from one plane on, and the right boxes up to another plane. The same holds for hits. For constant k, the
sum follows from four counts of rays at each plane, which are prefix sums of histograms of the ray's four planes. A ray
is tested against the boxes of all planes in SIMD. Distance-based orders lack this structure and are counted plane by
plane.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...bvh.binned_split import BINS, Split, no_split
from ...bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED
from ...bvh.triangle_bounds import INF, half_area
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    as_i32,
    bits,
    extract,
    get,
    highest_bit,
    load4,
    load8,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    ptr,
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
from ...trace.rays.ray_hits import Intersections

# --- ray sets ---------------------------------------------------------------------------------------------------------

RAY = 8  # words: origin, reciprocal direction, first hit, number of hits
HIT = 4  # words: twice the centroid, as in `triangle_bounds.double_centroid`, and one unused
_TINY = np.float32(1e-20)  # direction components are clamped from below to this share of the largest one
GROW = np.float32(1.0 + 2.0**-20)  # margin of the slab test: a ray that hits a triangle enters its box


class RayHitSet(NamedTuple):
    """Rays and their hits."""

    rays: NDArray[np.float32]  # (m, RAY) float32; its last two words are int32
    hits: NDArray[np.float32]  # (h, HIT) float32


class RayHitSetPointers(NamedTuple):
    """Pointers to the arrays of a `RayHitSet`, starting at some ray and some hit."""

    rays: F32Ptr  # float32 *
    words: I32Ptr  # int32 *, the same memory
    hits: F32Ptr  # float32 *


class SetSize(NamedTuple):
    """A number of rays and a number of hits: the size of one side's set, or a position in a `RayHitSet`."""

    rays: int
    hits: int


class SlabRay(NamedTuple):
    """A ray for slab tests: origin and reciprocal direction, float32 scalars."""

    ox: np.float32
    oy: np.float32
    oz: np.float32
    ix: np.float32
    iy: np.float32
    iz: np.float32


def check_intersections(intersections: Intersections, n: int) -> None:
    """Raise InputError if a segment hits a triangle whose index is out of range for n triangles."""
    if len(intersections.prims) and not (intersections.prims.min() >= 0 and intersections.prims.max() < n):
        raise InputError(
            f"rays hit triangles {intersections.prims.min()} to {intersections.prims.max()}; there are {n}"
        )


def bounded_rays(intersections: Intersections) -> NDArray[np.float32]:
    """(m, RAY) float32: the rays of a `RayHitSet` of all segments, ready for slab tests."""
    rays = np.zeros((len(intersections.origins), RAY), np.float32)
    direction = intersections.ends - intersections.origins
    limit = _TINY * np.abs(direction).max(axis=1, initial=np.float32(1e-15), keepdims=True)
    direction = np.where(np.abs(direction) < limit, limit, direction)
    rays[:, :3], rays[:, 3:6] = intersections.origins, np.float32(1.0) / direction
    words = rays.view(np.int32)
    words[:, 6], words[:, 7] = intersections.first[:-1], np.diff(intersections.first)
    return rays


def ray_hit_set(intersections: Intersections, flat: NDArray[np.float32]) -> RayHitSet:
    """The ray set of intersections with the triangles `flat`, (n, 9) float32."""
    hits = np.zeros((len(intersections.prims), HIT), np.float32)
    corners = flat[intersections.prims].reshape(-1, 3, 3)
    hits[:, :3] = corners.min(axis=1) + corners.max(axis=1)
    return RayHitSet(bounded_rays(intersections), hits)


@inlined
def rays_of(set_, start):
    """Pointers to the arrays of a `RayHitSet`, which must outlive them, from the position `start` (a `SetSize`) on."""
    rays = ptr_at(ptr(set_.rays), start.rays * RAY)
    return RayHitSetPointers(rays, as_i32(rays), ptr_at(ptr(set_.hits), start.hits * HIT))


@inlined
def ray_at(rays, i):
    """Ray i as a `SlabRay`."""
    k = i * RAY
    return SlabRay(
        get(rays, k), get(rays, k + 1), get(rays, k + 2), get(rays, k + 3), get(rays, k + 4), get(rays, k + 5)
    )


@inlined
def _enters(box, ray):
    """Whether a ray enters a nonempty box; `box` points to a box in the format of `triangle_bounds`."""
    ax, bx = (get(box, 0) - ray.ox) * ray.ix, (-get(box, 4) - ray.ox) * ray.ix
    ay, by = (get(box, 1) - ray.oy) * ray.iy, (-get(box, 5) - ray.oy) * ray.iy
    az, bz = (get(box, 2) - ray.oz) * ray.iz, (-get(box, 6) - ray.oz) * ray.iz
    t_near = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), np.float32(0.0)))
    t_far = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), np.float32(1.0)))
    return t_near <= t_far * GROW


@inlined
def _squared_distance(box, ray):
    """The squared distance between twice a box's centre and twice a ray's origin."""
    two = np.float32(2.0)
    x, y, z = get(box, 0) - get(box, 4), get(box, 1) - get(box, 5), get(box, 2) - get(box, 6)
    x, y, z = x - two * ray.ox, y - two * ray.oy, z - two * ray.oz
    return x * x + y * y + z * z


@inlined
def _left_first(order, left, right, ray):
    """Whether a ray visits the left child first. In constant orders, the left child comes first."""
    if order == FRONT_TO_BACK:
        return _squared_distance(left, ray) <= _squared_distance(right, ray)
    if order == BACK_TO_FRONT:
        return not _squared_distance(left, ray) <= _squared_distance(right, ray)
    return order == LEFT_FIRST


@inlined
def _copy_ray(source, i, target, size, axis, origin, factor, limit, is_left):
    """Append ray i, with its hits on one side of a split, to a child's set, and return the set's new `SetSize`."""
    # In: source, `RayHitSetPointers`; size, `SetSize` of the set; axis to limit, the split; is_left, side of the child
    # Out: target, the child's `RayHitSetPointers`
    at, hit, n = size.rays * RAY, size.hits, 0
    store(target.rays, at, load8(source.rays, i * RAY))
    first = get(source.words, i * RAY + 6)
    for k in range(first, first + get(source.words, i * RAY + 7)):
        if ((get(source.hits, k * HIT + axis) - origin) * factor < limit) == is_left:
            store(target.hits, (hit + n) * HIT, load4(source.hits, k * HIT))
            n += 1
    put(target.words, at + 6, hit)
    put(target.words, at + 7, n)
    return SetSize(size.rays + 1, hit + n)


@kernel
def divide_rays(source, n, mapping, choice, boxes, left, right):
    """Write each child's ray set with its hits, and return the `SetSize` of both.

    Left is the side of the lower centroids.
    """
    # In: source, `RayHitSetPointers` to n rays; mapping, as for `binned_split.partition`; choice, `RaySplit`
    # In: boxes, pointer to the boxes of the left and the right side
    # Out: left, right, `RayHitSetPointers`
    axis, limit, order = choice.split.axis, np.float32(choice.split.place), choice.order
    origin, factor = extract(mapping.origin, axis), extract(mapping.factor, axis)
    left_box, right_box = boxes, ptr_at(boxes, 8)
    left_size, right_size = SetSize(0, 0), SetSize(0, 0)
    for i in range(n):
        ray, below = ray_at(source.rays, i), 0
        first, count = get(source.words, i * RAY + 6), get(source.words, i * RAY + 7)
        for k in range(first, first + count):
            below += np.int64((get(source.hits, k * HIT + axis) - origin) * factor < limit)
        above = count - below
        left_first = _left_first(order, left_box, right_box, ray) != choice.swapped
        blocked = order != UNORDERED
        if (below > 0 or _enters(left_box, ray)) and not (blocked and not left_first and above > 0):
            left_size = _copy_ray(source, i, left, left_size, axis, origin, factor, limit, True)
        if (above > 0 or _enters(right_box, ray)) and not (blocked and left_first and below > 0):
            right_size = _copy_ray(source, i, right, right_size, axis, origin, factor, limit, False)
    return left_size, right_size


# --- costs of all candidate splits ------------------------------------------------------------------------------------

CONSTANT, DISTANCE = 1, 2  # bits of traversal kernels: left or right first; front to back or back to front

LANES = 16
_BOX = 6 * BINS  # words of one side's boxes on one axis: lower x, y, z, upper x, y, z, one plane a lane
_BOXES = 6 * _BOX
_COUNTS = 6 * BINS
_ROW = BINS + 2
_PLACES = 12 * _ROW
_VISITS = 12 * BINS
_SUMS = 4 * BINS
_ONE = np.float32(1.0)


class HeuristicSettings(NamedTuple):
    """Settings of the heuristic for all ranges."""

    scale: np.float32  # a power of two: scales the largest coordinate to about 1, so no area overflows
    kernels: np.int64  # CONSTANT, DISTANCE, or both
    prior: np.float64  # number of uniformly distributed rays, as the SAH assumes, added to the counted rays
    linear: bool  # whether a subtree of n triangles costs n, as published; else n to the power of 3/4


class RangeSides(NamedTuple):
    """Both sides of all planes. Side s (0: left) on axis a has the number 2 a + s. Bins below k are left of plane k."""

    boxes: F32Ptr  # float32 *, _BOX words per side; empty boxes have lower = +inf, upper = -inf
    counts: F32Ptr  # float32 *, BINS per side: triangles


class RayCounts(NamedTuple):
    """Counts of rays at planes."""

    places: I32Ptr  # int32 *, 4 rows of _ROW per axis: histograms
    visits: F32Ptr  # float32 *, 4 rows of BINS per axis: rays at each plane


# rows of `RayCounts.places`: first plane (left) or last plane (right) at which a ray enters a side's box or visits it
_ENTERS_LEFT, _COMES_LEFT, _ENTERS_RIGHT, _COMES_RIGHT = range(4)
# rows of `RayCounts.visits`: rays that visit a side if the closer, or the farther, child comes first
_LEFT_NEAR, _RIGHT_NEAR, _LEFT_FAR, _RIGHT_FAR = range(4)


class RaySplit(NamedTuple):
    """A split with the order of its children."""

    split: Split
    order: int  # as in `nodes`
    swapped: bool  # whether the right child comes first in a constant order
    cost: np.float32  # the heuristic, with the prior


@kernel
def no_ray_split():
    """The split of a range without rays."""
    return RaySplit(no_split(), np.int64(UNORDERED), False, INF)


@inlined
def _put_side(sides, number, k, box, count, scratch):
    """Write one side of plane k; `scratch` has room for 8 float32."""
    store(scratch, 0, box)
    at = number * _BOX + k
    for axis in range(3):
        put(sides.boxes, at + axis * BINS, get(scratch, axis))
        put(sides.boxes, at + (3 + axis) * BINS, -get(scratch, 4 + axis))
    put(sides.counts, number * BINS + k, np.float32(count))


@kernel
def bound_sides(bins, n_bins, sides):
    """Fill `RangeSides` from the bins of a range, padded with empty sides to a multiple of LANES."""
    scratch, end = stack_f32(8), (n_bins + LANES - 1) // LANES * LANES
    for axis in range(3):
        base, box, count = axis * n_bins, splat8(INF), 0
        for k in range(n_bins):
            _put_side(sides, 2 * axis, k, box, count, scratch)
            box = minimum(box, load8(bins.boxes, (base + k) * 8))
            count += get(bins.counts, base + k)
        box, count = splat8(INF), 0
        for k in range(n_bins - 1, -1, -1):
            box = minimum(box, load8(bins.boxes, (base + k) * 8))
            count += get(bins.counts, base + k)
            _put_side(sides, 2 * axis + 1, k, box, count, scratch)
        for k in range(n_bins, end):
            _put_side(sides, 2 * axis, k, splat8(INF), 0, scratch)
            _put_side(sides, 2 * axis + 1, k, splat8(INF), 0, scratch)


@inlined
def _entered16(boxes, at, ray, near_rows, far_rows):
    """Bits of the planes, of 16 from word `at` on, whose boxes a ray enters; rows: those of the near and far bounds."""
    x0, x1 = load16(boxes, at + near_rows[0]) - ray.ox, load16(boxes, at + far_rows[0]) - ray.ox
    y0, y1 = load16(boxes, at + near_rows[1]) - ray.oy, load16(boxes, at + far_rows[1]) - ray.oy
    z0, z1 = load16(boxes, at + near_rows[2]) - ray.oz, load16(boxes, at + far_rows[2]) - ray.oz
    entry = maximum(maximum(x0 * ray.ix, y0 * ray.iy), maximum(z0 * ray.iz, splat16(np.float32(0.0))))
    leave = minimum(minimum(x1 * ray.ix, y1 * ray.iy), minimum(z1 * ray.iz, splat16(np.float32(1.0))))
    return bits(entry <= leave * GROW)


@inlined
def _entered(boxes, number, ray, near_rows, far_rows, n_bins):
    """Bits of the planes at which the ray enters the box of side `number`."""
    planes = _entered16(boxes, number * _BOX, ray, near_rows, far_rows)
    if n_bins > LANES:
        planes |= _entered16(boxes, number * _BOX + LANES, ray, near_rows, far_rows) << LANES
    return planes


@inlined
def _closer16(boxes, left, right, ray):
    """Bits of the planes, of 16, at which the left box's centre is closer to the ray's origin."""
    two, left_distance, right_distance = np.float32(2.0), splat16(np.float32(0.0)), splat16(np.float32(0.0))
    origin = ray.ox, ray.oy, ray.oz
    for axis in range(3):
        row = axis * BINS
        a = load16(boxes, left + row) + load16(boxes, left + row + 3 * BINS) - two * origin[axis]
        b = load16(boxes, right + row) + load16(boxes, right + row + 3 * BINS) - two * origin[axis]
        left_distance, right_distance = left_distance + a * a, right_distance + b * b
    return bits(left_distance <= right_distance)


@inlined
def _put_hit_bins(rays, i, mapping, n_bins, lowest, highest):
    """Write the lowest and highest bin of ray i's hits on each axis; BINS and -1 without hits."""
    top = np.int32(n_bins - 1)
    low, high = splat4(np.int32(BINS)), splat4(np.int32(-1))
    first = get(rays.words, i * RAY + 6)
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
    """Increment each of the BINS counts whose bit is set."""
    for half in range(0, BINS, LANES):
        increments = select(mask_from_bits16((lanes >> half) & 0xFFFF), splat16(_ONE), splat16(np.float32(0.0)))
        store(memory, at + half, load16(memory, at + half) + increments)


@inlined
def _count_places(places, axis, first, last, lowest, highest):
    """Count the first or last planes at which a ray enters boxes, and visits them, for constant orders.

    first : the first plane whose left box the ray enters
    last : the last plane whose right box it enters
    lowest, highest : bins of its hits; the left has hits from plane lowest + 1 on, the right up to plane highest
    """
    at = axis * 4 * _ROW
    _add(places, at + _ENTERS_LEFT * _ROW + first)
    _add(places, at + _COMES_LEFT * _ROW + max(first, highest + 1))
    _add(places, at + _ENTERS_RIGHT * _ROW + last)
    _add(places, at + _COMES_RIGHT * _ROW + min(last, lowest))


@inlined
def _count_visits(visits, axis, first, last, lowest, highest, closer):
    """Count the planes at which a ray visits each side if the closer, or the farther, child comes first."""
    at, all_ = axis * 4 * BINS, (1 << BINS) - 1
    enters_left, enters_right = (all_ << first) & all_, all_ >> (BINS - 1 - last)
    clear_left, clear_right = all_ >> (BINS - 1 - min(lowest, BINS - 1)), (all_ << (highest + 1)) & all_
    _add_lanes(visits, at + _LEFT_NEAR * BINS, enters_left & (closer | clear_right))
    _add_lanes(visits, at + _RIGHT_NEAR * BINS, enters_right & (~closer | clear_left))
    _add_lanes(visits, at + _LEFT_FAR * BINS, enters_left & (~closer | clear_right))
    _add_lanes(visits, at + _RIGHT_FAR * BINS, enters_right & (closer | clear_left))


@kernel
def count_rays(rays, n, mapping, sides, kernels, counts):
    """Count n rays at all planes, and return the number of their hits."""
    lowest, highest, n_hits, n_bins = stack_i32(4), stack_i32(4), 0, mapping.n_bins
    for k in range(_PLACES):
        put(counts.places, k, 0)
    if kernels & DISTANCE:
        for k in range(0, _VISITS, LANES):
            store(counts.visits, k, splat16(np.float32(0.0)))
    for i in range(n):
        ray = ray_at(rays.rays, i)
        up = ray.ix >= 0.0, ray.iy >= 0.0, ray.iz >= 0.0
        near_rows = 0 if up[0] else 3 * BINS, BINS if up[1] else 4 * BINS, 2 * BINS if up[2] else 5 * BINS
        far_rows = 3 * BINS if up[0] else 0, 4 * BINS if up[1] else BINS, 5 * BINS if up[2] else 2 * BINS
        _put_hit_bins(rays, i, mapping, n_bins, lowest, highest)
        n_hits += get(rays.words, i * RAY + 7)
        for axis in range(3):
            low, high = get(lowest, axis), get(highest, axis)
            left_planes = _entered(sides.boxes, 2 * axis, ray, near_rows, far_rows, n_bins)
            right_planes = _entered(sides.boxes, 2 * axis + 1, ray, near_rows, far_rows, n_bins)
            first = min(lowest_bit(left_planes | 1 << BINS), low + 1)
            last = max(highest_bit(right_planes | 1), high)
            _count_places(counts.places, axis, first, last, low, high)
            if kernels & DISTANCE:
                a, b = 2 * axis * _BOX, (2 * axis + 1) * _BOX
                closer = _closer16(sides.boxes, a, b, ray) | _closer16(sides.boxes, a + LANES, b + LANES, ray) << LANES
                _count_visits(counts.visits, axis, first, last, low, high, closer)
    return n_hits


@inlined
def _side_area(boxes, number, half, scale):
    """Half the scaled area of one side's boxes at 16 planes; 0 for empty boxes."""
    at, zero = number * _BOX + half, splat16(np.float32(0.0))
    x = (load16(boxes, at + 3 * BINS) - load16(boxes, at)) * scale
    y = (load16(boxes, at + 4 * BINS) - load16(boxes, at + BINS)) * scale
    z = (load16(boxes, at + 5 * BINS) - load16(boxes, at + 2 * BINS)) * scale
    return select(x >= zero, x * (y + z) + y * z, zero)


@kernel
def _subtree_costs(sides, end, linear, costs):
    """Write the estimated cost per ray of each side's subtree, from its triangle count (docs/design/srdh.md, eq. 2)."""
    for number in range(6):
        for k in range(end):
            n = get(sides.counts, number * BINS + k)
            put(costs, number * BINS + k, n if linear else np.sqrt(n) * np.sqrt(np.sqrt(n)))


@inlined
def _sum_places(places, axis, end, visits):
    """Sum one axis' histograms to the rays that enter, and visit, each side at each plane, in 4 rows of BINS."""
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
    """The cheaper of `best` and the cheapest of 16 planes in an order. On ties, the earlier one wins."""
    least = reduce_min(cost)
    if least < best.cost:
        k = half + lowest_bit(bits(cost == splat16(least)))
        return RaySplit(Split(axis, k, np.float32(0.0)), np.int64(order), swapped, least)
    return best


@inlined
def _costs(visits, left_row, right_row, half, c1, c2, even):
    """The heuristic at 16 planes."""
    # In: visits, with rows `left_row` and `right_row`: rays that visit each side; half, first plane
    # In: c1, c2, f32x16, cost of each side's subtree; even, f32x16, cost for the uniformly distributed rays
    return load16(visits, left_row * BINS + half) * c1 + load16(visits, right_row * BINS + half) * c2 + even


@kernel
def cheapest_ray_split(sides, counts, n_bins, n_hits, box, settings):
    """The split and child order with the lowest cost.

    n_hits : hits of all rays; without hits, all orders cost the same
    box : the range's box
    """
    best, kernels, end = no_ray_split(), settings.kernels, (n_bins + LANES - 1) // LANES * LANES
    constant = LEFT_FIRST if n_hits > 0 else UNORDERED
    costs, visits = stack_f32(_COUNTS), stack_f32(_SUMS)
    _subtree_costs(sides, end, settings.linear, costs)
    area, prior, zero = half_area(box, settings.scale), np.float32(settings.prior), splat16(np.float32(0.0))
    share = prior / area  # infinite or NaN for a box of almost zero area, which gets no prior
    share = share if share < INF else np.float32(0.0)
    for axis in range(3):
        _sum_places(counts.places, axis, end, visits)
        by_distance = ptr_at(counts.visits, axis * 4 * BINS)
        for half in range(0, end, LANES):
            c1, c2 = load16(costs, 2 * axis * BINS + half), load16(costs, (2 * axis + 1) * BINS + half)
            a1 = _side_area(sides.boxes, 2 * axis, half, settings.scale)
            a2 = _side_area(sides.boxes, 2 * axis + 1, half, settings.scale)
            even = (a1 * c1 + a2 * c2) * share
            even = select((c1 > zero) & (c2 > zero), even, splat16(INF))  # both sides have triangles
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
    """The cheapest `RaySplit` of a range with filled bins, for n rays.

    settings : any tuple with the fields of `HeuristicSettings`
    """
    sides = RangeSides(stack_f32(_BOXES), stack_f32(_COUNTS))
    counts = RayCounts(stack_i32(_PLACES), stack_f32(_VISITS))
    bound_sides(bins, mapping.n_bins, sides)
    n_hits = count_rays(rays, n, mapping, sides, settings.kernels, counts)
    return cheapest_ray_split(sides, counts, mapping.n_bins, n_hits, box, settings)
