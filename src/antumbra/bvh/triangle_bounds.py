"""Boxes and records of triangles: input checks, bounds and records, the first steps of every builder.

A box is one 8-wide register, ``lower.x lower.y lower.z -- -upper.x -upper.y -upper.z --``. The upper corner is negated,
so one `minimum` joins two boxes. A *record* is the box of one triangle with the triangle's index in the fourth lane. A
*centroid box* has the same form, and bounds twice the centroids (lower + upper) of a set of records.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, new_ticket, run_short, shares
from ..kernels.simd import (
    as_i32,
    extract,
    get,
    join,
    load4,
    load8,
    mask_from_bits4,
    mask_from_bits16,
    maximum,
    minimum,
    ptr,
    put,
    select,
    shuffle,
    splat4,
    splat8,
    store,
    swap_halves,
)
from .nodes import CHILDREN, EMPTY, LINK, MAX_LEAF, Bvh, aligned_empty, bvh_link, line_at

# --- Boxes and records in registers -----------------------------------------------------------------------------------


INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_ID_BIT = np.int32(1 << 30)
# The bit makes every index a float between 2 and 2**33. Small integers would be denormal floats, and arithmetic with
# one can cost an x86 processor a hundred cycles, even in an unused lane.

MAX_COORDINATE = np.float32(2.0**125)  # keeps the difference of two sums of two coordinates finite
MAX_TRIANGLES = 1 << 28  # a leaf's link holds 8 times the slot of its first triangle
PART = 20  # float32 per chunk of triangles: box, centroid box, 0 or NaN


@kernel
def record_id(records, i):
    """Index of the triangle of record `i`."""
    return get(as_i32(records), i * 8 + 3) ^ _ID_BIT


@kernel
def double_centroid(box):
    """lower + upper of a box, as a centroid box."""
    return box - swap_halves(box)


@kernel
def half_area(box, scale):
    """Half the surface area of a box scaled by `scale`; inf or NaN for an empty box."""
    scaled = box * scale
    sides = scaled + swap_halves(scaled)  # negated, but products of pairs have the right sign
    x, y, z = extract(sides, 0), extract(sides, 1), extract(sides, 2)
    return x * (y + z) + y * z


@kernel
def longest_side(box):
    """The longest side of a box."""
    sides = -(box + swap_halves(box))
    return max(extract(sides, 0), extract(sides, 1), extract(sides, 2))


@kernel
def range_bounds(records, first, last):
    """(box, centroid box) of the records from `first` to `last` - 1."""
    box, centroids = splat8(INF), splat8(INF)
    for i in range(first, last):
        record = load8(records, i * 8)
        box = minimum(box, record)
        centroids = minimum(centroids, double_centroid(record))
    return box, centroids


@inlined
def write_boxes(nodes, node, left_box, right_box):
    """Write the boxes of both children to a node. Words 12 to 15 become 0."""
    line = shuffle(join(left_box, right_box), 0, 8, 4, 12, 1, 9, 5, 13, 2, 10, 6, 14, 3, 11, 7, 15)
    line = select(mask_from_bits16(0x0CCC), -line, line)  # the upper corners
    store(nodes, line_at(node), select(mask_from_bits16(0x0FFF), line, _ZERO))


@kernel
def corners_of(vertices, i):
    """The three corners of triangle `i`. Their fourth lanes hold other coordinates of the same triangle."""
    a, b, c = load4(vertices, i * 9), load4(vertices, i * 9 + 3), load4(vertices, i * 9 + 5)
    return a, b, shuffle(c, 1, 2, 3, 0)  # reading from + 6 would overrun the last triangle


@inlined
def _box(a, b, c):
    """The box of three corners, with 0 in the unused lanes."""
    coordinates = mask_from_bits4(7)
    lower = select(coordinates, minimum(minimum(a, b), c), _ZERO)
    return join(lower, select(coordinates, -maximum(maximum(a, b), c), _ZERO))


@inlined
def triangle_box(vertices, i):
    """The box of triangle `i`."""
    a, b, c = corners_of(vertices, i)
    return _box(a, b, c)


@inlined
def double_centroid_of(vertices, i):
    """lower + upper of triangle `i`."""
    a, b, c = corners_of(vertices, i)
    return minimum(minimum(a, b), c) + maximum(maximum(a, b), c)


@kernel
def bound_triangles(ticket, vertices, parts):
    """Worker: write a row of `parts` for each chunk of triangles."""
    v, rows = ptr(vertices), ptr(parts)
    for first, last in shares(ticket):
        faults, box, centroids = splat4(_ZERO), splat8(INF), splat8(INF)
        for i in range(first, last):
            a, b, c = corners_of(v, i)
            faults += a * _ZERO + b * _ZERO + c * _ZERO  # stays NaN once a coordinate is NaN or infinite
            triangle = _box(a, b, c)
            box, centroids = minimum(box, triangle), minimum(centroids, double_centroid(triangle))
        row = first // ticket[CHUNK] * PART
        store(rows, row, box)
        store(rows, row + 8, centroids)
        store(rows, row + 16, faults)


@kernel
def write_records(ticket, vertices, records, parts):
    """Worker: write the records of all triangles, and a row of `parts` for each chunk."""
    v, out, out_ids, rows = ptr(vertices), ptr(records), as_i32(records), ptr(parts)
    coordinates = mask_from_bits4(7)
    for first, last in shares(ticket):
        faults = splat4(_ZERO)
        for i in range(first, last):
            a, b, c = corners_of(v, i)
            faults += a * _ZERO + b * _ZERO + c * _ZERO  # stays NaN once a coordinate is NaN or infinite
            store(out, i * 8, minimum(minimum(a, b), c))
            put(out_ids, i * 8 + 3, np.int32(i) | _ID_BIT)
            store(out, i * 8 + 4, select(coordinates, -maximum(maximum(a, b), c), _ZERO))
        box, centroids = range_bounds(out, first, last)
        row = first // ticket[CHUNK] * PART
        store(rows, row, box)
        store(rows, row + 8, centroids)
        store(rows, row + 16, faults)


# --- Input checks, scene bounds, scenes of fewer than two triangles ---------------------------------------------------


TRIANGLES_PER_SHARE = 4096  # triangles that a thread bounds at a time
PAIR = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0], [2, 2, 2, 3, 2, 2, 2, 3, 2]], np.float32)
"""Two triangles, the fewest that can be split. Builders compile their kernels for large scenes on them."""

_CORNERS = [0, 1, 2, 4, 5, 6]  # the coordinate words of a box


def checked_vertices(vertices: object, max_leaf: int) -> NDArray[np.float32]:
    """The vertices, checked, as (n, 9) float32."""
    vertices = np.asarray(vertices)
    if vertices.ndim != 3 or vertices.shape[1:] != (3, 3) or vertices.dtype != np.float32:
        raise InputError(f"vertices is {vertices.dtype} {vertices.shape}; it must be float32 (n, 3, 3)")
    if len(vertices) > MAX_TRIANGLES:
        raise InputError(f"vertices has {len(vertices)} triangles; a BVH holds at most {MAX_TRIANGLES}")
    if max_leaf not in range(1, MAX_LEAF + 1):
        raise InputError(f"max_leaf is {max_leaf!r}; it must be a whole number from 1 to {MAX_LEAF}")
    return np.ascontiguousarray(vertices).reshape(-1, 9)


def _bounds(
    worker: kernel, flat: NDArray[np.float32], threads: int, *args: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(box, centroid box) of all triangles, bounded in chunks by `worker`."""
    parts = np.empty((-(-len(flat) // TRIANGLES_PER_SHARE), PART), np.float32)
    run_short(worker, threads, new_ticket(len(flat), TRIANGLES_PER_SHARE), flat, *args, parts)
    bounds = parts[:, :16].min(axis=0, initial=np.inf)
    if not ((parts[:, 16:] == 0).all() and (bounds[_CORNERS] > -MAX_COORDINATE).all()):
        row = int(np.argmin((np.abs(flat) < MAX_COORDINATE).all(axis=1)))
        raise InputError(f"triangle {row} has a coordinate that is not finite, or not below {MAX_COORDINATE:.1e}")
    return bounds[:8], bounds[8:]


def scene_bounds(flat: NDArray[np.float32], threads: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(box, centroid box) of all triangles `flat`, (n, 9) float32."""
    return _bounds(bound_triangles, flat, threads)


def make_records(
    flat: NDArray[np.float32], records: NDArray[np.float32], threads: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Fill `records`, (n, 8) float32, and return (box, centroid box) of all triangles."""
    return _bounds(write_records, flat, threads, records)


def area_scale_for(box: NDArray[np.float32]) -> np.float32:
    """A power of two that scales the largest coordinate to about 1."""
    largest = float(np.abs(box[_CORNERS]).max())
    return np.float32(2.0 ** min(126, -math.frexp(largest)[1]))


def area_scale_of(bvh: Bvh) -> np.float32:
    """`area_scale_for` the box of a finished BVH."""
    largest = np.abs(bvh.nodes[0, :12].reshape(3, 4)).max(axis=1)
    return area_scale_for(np.resize(np.append(largest, 0), 8))


def trivial_bvh(flat: NDArray[np.float32]) -> Bvh:
    """The BVH of at most one triangle, (n, 9) float32. Coordinates are checked as in larger scenes."""
    scene_bounds(flat, 1)
    n = len(flat)
    nodes = aligned_empty((1, 16), "f4")
    nodes[0, :12] = [np.inf, np.inf, -np.inf, -np.inf] * 3
    nodes[0, 12:] = 0
    links = nodes.view(np.int32)
    links[0, CHILDREN] = EMPTY
    if n:
        corners = flat.reshape(3, 3)
        nodes[0, [0, 4, 8]], nodes[0, [2, 6, 10]] = corners.min(axis=0), corners.max(axis=0)
        links[0, LINK] = bvh_link(0, 1)
    return Bvh(nodes, links, np.zeros(n, np.int32), flat.copy())
