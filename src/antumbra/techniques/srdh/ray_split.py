"""The Shadow Ray Distribution Heuristic: ray sets, and the best split for them [Feltman et al. 2012, Sec. 3.3].

Ray sets. They are sets of shadow rays with all their hits, which the builder passes down the tree. Each child of a node
gets a filtered ray set [Feltman et al. 2012, Sec. 3.4]. It has the rays that come to the child in the order of visits
and enter its box. Of each ray, it has the triangles that the ray meets in the child. Hits are sparse, so each ray has a
list of them. A hit is only a centroid, since that decides the triangle's side of a split.

Cost. All candidate splits of a range are priced at once. A plane between two bins parts a range P into P1 and P2. The
cost of a split for the rays R that come to the range is (docs/design/srdh.md, eq. 1)

    sum over r of  (1 - k'(r) H(P2, r)) I(P1, r) |P1| + (1 - k(r) H(P1, r)) I(P2, r) |P2|

I is 1 if the ray enters the box, and H is 1 if it meets something in there. k is 1 if the ray visits the left child
first, and k' = 1 - k.

From plane to plane, boxes only grow on one side and shrink on the other. So along an axis, a ray enters left boxes from
one plane on, and right boxes up to another plane. The same holds for hits. For constant k, the sum follows from four
counts of rays at each plane. Histograms of the ray's four planes give the counts. A ray is tested against the boxes of
all planes in the lanes of registers. Orders by distance lack this structure, and are counted plane by plane.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.binned_split import BINS, Split, no_split
from ...bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED
from ...bvh.triangle_bounds import INF, half_area
from ...errors import InputError
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

# --- Sets of shadow rays with all their hits, as the builder `srdh` passes them down the tree -------------------------
#
# Each child of a node gets a filtered ray set [Feltman et al. 2012, Sec. 3.4]. It has the rays that come to the child
# in the order of visits and enter its box. Of each ray, it has the triangles that the ray meets in the child. Hits are
# sparse, so each ray has a list of them. A hit is only a centroid, since that decides the triangle's side of a split.


RAY = 8  # words: origin, reciprocal direction, first hit, number of hits
HIT = 4  # words: twice the centroid, as in `bounds.double_centroid`, and one unused
_TINY = np.float32(1e-20)  # a direction's component below this share of the largest one counts as this share
GROW = np.float32(1.0 + 2.0**-20)  # margin of the slab test: a ray that meets a triangle enters its box


class RayHitSet(NamedTuple):
    """Rays and their hits."""

    rays: np.ndarray  # (m, RAY) float32; its last two words are int32
    hits: np.ndarray  # (h, HIT) float32


class RayHitSetPointers(NamedTuple):
    """Pointers to the arrays of a `ShownRays`, from some ray and some hit on."""

    rays: F32Ptr  # float32 *
    words: I32Ptr  # int32 *, the same memory
    hits: F32Ptr  # float32 *


class SetSize(NamedTuple):
    """A number of rays and a number of hits: the size of one side's set, or a position in a `ShownRays`."""

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


def check_intersections(found: Intersections, n: int) -> None:
    """Raise InputError if a segment meets a triangle out of range for n triangles."""
    if len(found.prims) and not (found.prims.min() >= 0 and found.prims.max() < n):
        raise InputError(f"rays meet triangles {found.prims.min()} to {found.prims.max()}; there are {n}")


def bounded_rays(found: Intersections) -> np.ndarray:
    """(m, RAY) float32: the rays of a `ShownRays` of all segments, ready for slab tests."""
    rays = np.zeros((len(found.origins), RAY), np.float32)
    direction = found.ends - found.origins
    limit = _TINY * np.abs(direction).max(axis=1, initial=np.float32(1e-15), keepdims=True)
    direction = np.where(np.abs(direction) < limit, limit, direction)
    rays[:, :3], rays[:, 3:6] = found.origins, np.float32(1.0) / direction
    words = rays.view(np.int32)
    words[:, 6], words[:, 7] = found.first[:-1], np.diff(found.first)
    return rays


def ray_hit_set(found: Intersections, flat: np.ndarray) -> RayHitSet:
    """The ray set of these intersections with the triangles `flat`, (n, 9) float32."""
    hits = np.zeros((len(found.prims), HIT), np.float32)
    corners = flat[found.prims].reshape(-1, 3, 3)
    hits[:, :3] = corners.min(axis=1) + corners.max(axis=1)
    return RayHitSet(bounded_rays(found), hits)


@inlined
def rays_of(set_, start):
    """Pointers to the arrays of a `ShownRays`, which must outlive them, from the position `start` (a `Side`) on."""
    rays = ptr_at(ptr(set_.rays), start.rays * RAY)
    return RayHitSetPointers(rays, as_i32(rays), ptr_at(ptr(set_.hits), start.hits * HIT))


@inlined
def ray_at(rays, i):
    """Ray number i as a `ShownRay`."""
    k = i * RAY
    return SlabRay(
        get(rays, k), get(rays, k + 1), get(rays, k + 2), get(rays, k + 3), get(rays, k + 4), get(rays, k + 5)
    )


@inlined
def _pierces(box, ray):
    """Whether a ray enters a box that is not empty; `box` points to a box in the form of `bounds`."""
    ax, bx = (get(box, 0) - ray.ox) * ray.ix, (-get(box, 4) - ray.ox) * ray.ix
    ay, by = (get(box, 1) - ray.oy) * ray.iy, (-get(box, 5) - ray.oy) * ray.iy
    az, bz = (get(box, 2) - ray.oz) * ray.iz, (-get(box, 6) - ray.oz) * ray.iz
    near = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), np.float32(0.0)))
    far = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), np.float32(1.0)))
    return near <= far * GROW


@inlined
def _away(box, ray):
    """The squared distance between twice a box's centre and twice a ray's origin."""
    two = np.float32(2.0)
    x, y, z = get(box, 0) - get(box, 4), get(box, 1) - get(box, 5), get(box, 2) - get(box, 6)
    x, y, z = x - two * ray.ox, y - two * ray.oy, z - two * ray.oz
    return x * x + y * y + z * z


@inlined
def _left_first(order, left, right, ray):
    """Whether a ray visits the left child first. In constant orders, the left child is the first."""
    if order == FRONT_TO_BACK:
        return _away(left, ray) <= _away(right, ray)
    if order == BACK_TO_FRONT:
        return not _away(left, ray) <= _away(right, ray)
    return order == LEFT_FIRST


@inlined
def _copy_ray(source, i, target, side, axis, origin, factor, limit, wanted):
    """Add ray i, with its hits on one side of a split, to a child's set, and return the set's new size, a `Side`."""
    # In: source, `ShownRaysPointers`; side, size of the set; axis to limit, the split; wanted, True for left
    # Out: target, the child's `ShownRaysPointers`
    at, hit, n = side.rays * RAY, side.hits, np.int64(0)
    store(target.rays, at, load8(source.rays, i * RAY))
    first = np.int64(get(source.words, i * RAY + 6))
    for k in range(first, first + get(source.words, i * RAY + 7)):
        if ((get(source.hits, k * HIT + axis) - origin) * factor < limit) == wanted:
            store(target.hits, (hit + n) * HIT, load4(source.hits, k * HIT))
            n += 1
    put(target.words, at + 6, hit)
    put(target.words, at + 7, n)
    return SetSize(side.rays + 1, hit + n)


@kernel
def divide_rays(source, n, mapping, chosen, boxes, left, right):
    """Write each child's ray set, with its hits, and return both sizes as `Side`s.

    Left is the side of the lower centroids.
    """
    # In: source, n `ShownRaysPointers`; mapping, as for `bins.partition`; chosen, `srdh_cost.RaySplit`
    # In: boxes, pointer to the boxes of the left and the right side
    # Out: left, right, `ShownRaysPointers`
    axis, limit, order = chosen.split.axis, np.float32(chosen.split.place), chosen.order
    origin, factor = extract(mapping.origin, axis), extract(mapping.factor, axis)
    low, high = boxes, ptr_at(boxes, 8)
    to_left, to_right = SetSize(np.int64(0), np.int64(0)), SetSize(np.int64(0), np.int64(0))
    for i in range(n):
        ray, below = ray_at(source.rays, i), np.int64(0)
        first, count = np.int64(get(source.words, i * RAY + 6)), np.int64(get(source.words, i * RAY + 7))
        for k in range(first, first + count):
            below += np.int64((get(source.hits, k * HIT + axis) - origin) * factor < limit)
        above = count - below
        left_first = _left_first(order, low, high, ray) != chosen.swapped
        blocked = order != UNORDERED
        if (below > 0 or _pierces(low, ray)) and not (blocked and not left_first and above > 0):
            to_left = _copy_ray(source, i, left, to_left, axis, origin, factor, limit, True)
        if (above > 0 or _pierces(high, ray)) and not (blocked and left_first and below > 0):
            to_right = _copy_ray(source, i, right, to_right, axis, origin, factor, limit, False)
    return to_left, to_right


# ---------------------------------------------------------------------------------------------------------------------
# The Shadow Ray Distribution Heuristic of all candidate splits of a range at once [Feltman et al. 2012, Sec. 3.3].
#
# A plane between two bins parts a range P into P1 and P2. The cost of a split for the rays R that come to the range is
# (docs/design/srdh.md, eq. 1)
#
#     sum over r of  (1 - k'(r) H(P2, r)) I(P1, r) |P1| + (1 - k(r) H(P1, r)) I(P2, r) |P2|
#
# I is 1 if the ray enters the box, and H is 1 if it meets something in there. k is 1 if the ray visits the left child
# first, and k' = 1 - k.
#
# From plane to plane, boxes only grow on one side and shrink on the other. So along an axis, a ray enters left boxes
# from one plane on, and right boxes up to another plane. The same holds for hits. For constant k, the sum follows from
# four counts of rays at each plane. Histograms of the ray's four planes give the counts. A ray is tested against the
# boxes of all planes in the lanes of registers. Orders by distance lack this structure, and are counted plane by
# plane.


CONSTANT, DISTANCE = 1, 2  # sets of traversal kernels: left or right first; front to back or back to front

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
    kernels: int  # CONSTANT, DISTANCE, or both
    prior: np.float64  # evenly spread rays, as the SAH assumes, that are added to the counted rays
    linear: bool  # whether a subtree of n triangles costs n, as published; else n to the power of 3/4


class RangeSides(NamedTuple):
    """Both sides of all planes. Side s (0: left) on axis a has number 2 a + s. The bins below k are left of plane k."""

    boxes: F32Ptr  # float32 *, _BOX words a side; empty boxes have lower = +inf, upper = -inf
    counts: F32Ptr  # float32 *, BINS a side: triangles


class RayCounts(NamedTuple):
    """Counts of rays at planes."""

    places: I32Ptr  # int32 *, 4 rows of _ROW an axis: histograms
    visits: F32Ptr  # float32 *, 4 rows of BINS an axis: rays at each plane


# rows of `Counts.places`: first plane (left) or last plane (right) at which a ray enters a side's box, or comes to it
_ENTERS_LEFT, _COMES_LEFT, _ENTERS_RIGHT, _COMES_RIGHT = range(4)
# rows of `Counts.visits`: rays that visit a side if the closer child comes first, or if the farther one does
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
def _put_side(sides, number, k, box, count, one):
    """Write one side of plane k; `one` is scratch memory of 8 float32."""
    store(one, 0, box)
    at = number * _BOX + k
    for axis in range(3):
        put(sides.boxes, at + axis * BINS, get(one, axis))
        put(sides.boxes, at + (3 + axis) * BINS, -get(one, 4 + axis))
    put(sides.counts, number * BINS + k, np.float32(count))


@kernel
def bound_sides(bins, n_bins, sides):
    """Fill `Sides` from the bins of a range, padded with empty sides to a multiple of LANES."""
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
    """Bits of the planes whose boxes a ray enters, of 16 at word `at`; near, far: rows of near and far bounds."""
    x0, x1 = load16(boxes, at + near[0]) - ray.ox, load16(boxes, at + far[0]) - ray.ox
    y0, y1 = load16(boxes, at + near[1]) - ray.oy, load16(boxes, at + far[1]) - ray.oy
    z0, z1 = load16(boxes, at + near[2]) - ray.oz, load16(boxes, at + far[2]) - ray.oz
    entry = maximum(maximum(x0 * ray.ix, y0 * ray.iy), maximum(z0 * ray.iz, splat16(np.float32(0.0))))
    leave = minimum(minimum(x1 * ray.ix, y1 * ray.iy), minimum(z1 * ray.iz, splat16(np.float32(1.0))))
    return bits(entry <= leave * GROW)


@inlined
def _entered(boxes, number, ray, near, far, n_bins):
    """Bits of the planes at which the ray enters the box of side `number`."""
    found = _entered16(boxes, number * _BOX, ray, near, far)
    if n_bins > LANES:
        found |= _entered16(boxes, number * _BOX + LANES, ray, near, far) << LANES
    return found


@inlined
def _closer16(boxes, left, right, ray):
    """Bits of the planes, of 16, at which the left box's centre is closer to the ray's origin."""
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
    """Write the lowest and highest bin of ray i's hits on each axis; BINS and -1 without hits."""
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
    """Count the planes at which a ray starts or ends to enter boxes, and to come to them, for constant orders.

    first : the first plane whose left box the ray enters
    last : the last plane whose right box it enters
    lowest, highest : bins of its hits; hits are on the left from plane lowest + 1 on, on the right up to plane highest
    """
    at = axis * 4 * _ROW
    _add(places, at + _ENTERS_LEFT * _ROW + first)
    _add(places, at + _COMES_LEFT * _ROW + max(first, highest + 1))
    _add(places, at + _ENTERS_RIGHT * _ROW + last)
    _add(places, at + _COMES_RIGHT * _ROW + min(last, lowest))


@inlined
def _count_visits(visits, axis, first, last, lowest, highest, closer):
    """Count the planes at which a ray visits each side if the closer, or the farther, child comes first."""
    at, all_ = axis * 4 * BINS, (np.int64(1) << BINS) - 1
    enters_left, enters_right = (all_ << first) & all_, all_ >> (BINS - 1 - last)
    clear_left, clear_right = all_ >> (BINS - 1 - min(lowest, BINS - 1)), (all_ << (highest + 1)) & all_
    _add_lanes(visits, at + _LEFT_NEAR * BINS, enters_left & (closer | clear_right))
    _add_lanes(visits, at + _RIGHT_NEAR * BINS, enters_right & (~closer | clear_left))
    _add_lanes(visits, at + _LEFT_FAR * BINS, enters_left & (~closer | clear_right))
    _add_lanes(visits, at + _RIGHT_FAR * BINS, enters_right & (closer | clear_left))


@kernel
def count_rays(rays, n, mapping, sides, kernels, counts):
    """Count n rays at all planes, and return the number of their hits."""
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
    """Half the scaled area of one side's boxes at 16 planes; 0 for empty boxes."""
    at, none = number * _BOX + half, splat16(np.float32(0.0))
    x = (load16(boxes, at + 3 * BINS) - load16(boxes, at)) * scale
    y = (load16(boxes, at + 4 * BINS) - load16(boxes, at + BINS)) * scale
    z = (load16(boxes, at + 5 * BINS) - load16(boxes, at + 2 * BINS)) * scale
    return select(x >= none, x * (y + z) + y * z, none)


@kernel
def _subtree_costs(sides, end, linear, costs):
    """Write the estimated cost of each side's subtree for a ray, from its triangles (docs/design/srdh.md, eq. 2)."""
    for number in range(6):
        for k in range(end):
            n = get(sides.counts, number * BINS + k)
            put(costs, number * BINS + k, n if linear else np.sqrt(n) * np.sqrt(np.sqrt(n)))


@inlined
def _sum_places(places, axis, end, visits):
    """Sum one axis' histograms to the rays that enter, and come to, each side at each plane: 4 rows of BINS."""
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
    """The cheaper of `best` and the cheapest of 16 planes in an order. The earlier wins at equal costs."""
    least = reduce_min(cost)
    if least < best.cost:
        k = half + lowest_bit(bits(cost == splat16(least)))
        return RaySplit(Split(axis, k, np.float32(0.0)), np.int64(order), swapped, least)
    return best


@inlined
def _costs(visits, left, right, half, c1, c2, even):
    """The heuristic of 16 planes."""
    # In: visits, with rows `left` and `right`: rays that visit each side; half, first plane
    # In: c1, c2, f32x16, cost of each side's subtree; even, f32x16, cost for the evenly spread rays
    return load16(visits, left * BINS + half) * c1 + load16(visits, right * BINS + half) * c2 + even


@kernel
def cheapest_ray_split(sides, counts, n_bins, n_hits, box, settings):
    """The split and order of children with the least heuristic.

    n_hits : hits of all rays; without hits, all orders cost the same
    box : the range's box
    """
    best, kernels, end = no_ray_split(), settings.kernels, (n_bins + LANES - 1) // LANES * LANES
    constant = LEFT_FIRST if n_hits > 0 else UNORDERED
    costs, visits = stack_f32(_COUNTS), stack_f32(_SUMS)
    _subtree_costs(sides, end, settings.linear, costs)
    area, prior, zero = half_area(box, settings.scale), np.float32(settings.prior), splat16(np.float32(0.0))
    share = prior / area  # infinite or NaN for a box of almost no area, which gets no prior
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
    """The cheapest `RaySplit` of a range for n rays. The range's bins are filled.

    settings : has the fields of `HeuristicSettings`
    """
    sides = RangeSides(stack_f32(_BOXES), stack_f32(_COUNTS))
    counts = RayCounts(stack_i32(_PLACES), stack_f32(_VISITS))
    bound_sides(bins, mapping.n_bins, sides)
    n_hits = count_rays(rays, n, mapping, sides, settings.kernels, counts)
    return cheapest_ray_split(sides, counts, mapping.n_bins, n_hits, box, settings)
