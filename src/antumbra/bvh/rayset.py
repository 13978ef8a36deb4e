"""Sets of shadow rays with all their hits, as the builder `srdh` passes them down the tree.

Each child of a node gets a filtered ray set [Feltman et al. 2012, Sec. 3.4]. It has the rays that come to the child in
the order of visits and enter its box. Of each ray, it has the triangles that the ray meets in the child. Hits are
sparse, so each ray has a list of them. A hit is only a centroid, since that decides the triangle's side of a split.
"""

from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.simd import as_i32, extract, get, load4, load8, ptr, ptr_at, put, store
from ..trace.rays.ray_hits import Intersections
from .nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED

RAY = 8  # words: origin, reciprocal direction, first hit, number of hits
HIT = 4  # words: twice the centroid, as in `bounds.double_centroid`, and one unused
_TINY = np.float32(1e-20)  # a direction's component below this share of the largest one counts as this share
GROW = np.float32(1.0 + 2.0**-20)  # margin of the slab test: a ray that meets a triangle enters its box


class ShownRays(NamedTuple):
    """Rays and their hits."""

    rays: np.ndarray  # (m, RAY) float32; its last two words are int32
    hits: np.ndarray  # (h, HIT) float32


class ShownRaysPointers(NamedTuple):
    """Pointers to the arrays of a `ShownRays`, from some ray and some hit on."""

    rays: F32Ptr  # float32 *
    words: I32Ptr  # int32 *, the same memory
    hits: F32Ptr  # float32 *


class Side(NamedTuple):
    """A number of rays and a number of hits: the size of one side's set, or a position in a `ShownRays`."""

    rays: int
    hits: int


class ShownRay(NamedTuple):
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


def shown_rays(found: Intersections, flat: np.ndarray) -> ShownRays:
    """The ray set of these intersections with the triangles `flat`, (n, 9) float32."""
    hits = np.zeros((len(found.prims), HIT), np.float32)
    corners = flat[found.prims].reshape(-1, 3, 3)
    hits[:, :3] = corners.min(axis=1) + corners.max(axis=1)
    return ShownRays(bounded_rays(found), hits)


@inlined
def rays_of(set_, start):
    """Pointers to the arrays of a `ShownRays`, which must outlive them, from the position `start` (a `Side`) on."""
    rays = ptr_at(ptr(set_.rays), start.rays * RAY)
    return ShownRaysPointers(rays, as_i32(rays), ptr_at(ptr(set_.hits), start.hits * HIT))


@inlined
def ray_at(rays, i):
    """Ray number i as a `ShownRay`."""
    k = i * RAY
    return ShownRay(
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
    return Side(side.rays + 1, hit + n)


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
    to_left, to_right = Side(np.int64(0), np.int64(0)), Side(np.int64(0), np.int64(0))
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
