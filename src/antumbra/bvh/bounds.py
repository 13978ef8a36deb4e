"""Boxes for builders: one 8-wide register a box, so one instruction joins two boxes.

The register holds ``lower.x lower.y lower.z -- -upper.x -upper.y -upper.z --``. The upper corner is negated, so both
corners grow by `minimum`. A *record* is the box of one triangle with the triangle's index in the fourth lane. A
*centroid box* has the same form, and bounds twice the centroids (lower + upper) of some records.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, shares
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
from .links import line_at

INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_ID_BIT = np.int32(1 << 30)
# The bit makes any index a float between 2 and 2**33. Small integers are denormal floats. In arithmetic, each can cost
# an x86 processor a hundred cycles, even in an unused lane.

MAX_COORDINATE = np.float32(2.0**125)  # keeps the difference of two sums of two coordinates finite
MAX_TRIANGLES = 1 << 28  # a leaf's link holds 8 times the slot of its first triangle
PART = 20  # float32 of one chunk of triangles: box, centroid box, 0 or NaN


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
    """Half the surface area of a box whose sides are multiplied by `scale`; inf or NaN for an empty box."""
    scaled = box * scale
    sides = scaled + swap_halves(scaled)  # negated; products of pairs have the right sign
    x, y, z = extract(sides, 0), extract(sides, 1), extract(sides, 2)
    return x * (y + z) + y * z


@kernel
def width(box):
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
def write_boxes(nodes, node, left, right):
    """Write the boxes of both children to a node. Words 12 to 15 become 0."""
    line = shuffle(join(left, right), 0, 8, 4, 12, 1, 9, 5, 13, 2, 10, 6, 14, 3, 11, 7, 15)
    line = select(mask_from_bits16(0x0CCC), -line, line)  # the upper corners
    store(nodes, line_at(node), select(mask_from_bits16(0x0FFF), line, _ZERO))


@kernel
def corners_of(vertices, i):
    """The three corners of triangle `i`. Each fourth lane holds another coordinate of the same triangle."""
    a, b, c = load4(vertices, i * 9), load4(vertices, i * 9 + 3), load4(vertices, i * 9 + 5)
    return a, b, shuffle(c, 1, 2, 3, 0)  # a read from + 6 would overrun the last triangle


@inlined
def _box(a, b, c):
    """The box of three corners, with 0 in the lanes that are no coordinates."""
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
            here = _box(a, b, c)
            box, centroids = minimum(box, here), minimum(centroids, double_centroid(here))
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
