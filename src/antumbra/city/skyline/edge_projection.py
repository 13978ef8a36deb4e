"""The kernel of skylines: the edges of triangles, projected to the directions of a compass around each eye.

In a vertical half-plane through the eye, the slope z / r of a planar face is monotonic in r, so its supremum lies on an
edge. In the direction d, the slope of an edge from a to b is a mediant of those of its ends::

    (|d b| z_a + |a d| z_b) / |a b|        |u v|: the 2D cross product, positive where v is clockwise of u

Over azimuths, this is a sinusoid, whose peak and values at the limits of a bin give the supremum of the bin in closed
form. Nodes of the tree are visited steepest first, and skipped once no part of their box can rise above the skyline.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.nodes import EMPTY, MAX_DEPTH, Bvh, box_at, box_of_link_at, bvh_leaf, is_leaf, link_at, tree_of
from ...kernels.elementary import atan2, cos, sin
from ...kernels.jit import F64Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, ptr, put, stack_f64, stack_i32

_HEAP = 1024  # boxes in order of their slopes
_QUEUE_SIZE = _HEAP + MAX_DEPTH + 2
_AZIMUTH_ERROR = 4e-8  # radians: greatest error of `_place`
_ROUNDING = 1e-12  # relative tolerance of a bound of slopes
_VOLUME_ERROR = 1e-14  # relative error of a triple product, with a margin

# --- Arguments --------------------------------------------------------------------------------------------------------


class Compass(NamedTuple):
    """Equally spaced azimuths, clockwise from true north, and the scene's axes among them.

    A half step is half the distance of two azimuths. Azimuth k lies at half step 2 k; its bin, which is centred on it,
    ends at the half steps 2 k - 1 and 2 k + 1.
    """

    east: NDArray[np.float64]  # (2 m,): easting of the unit vector to each half step, along the scene's own axes
    north: NDArray[np.float64]  # (2 m,): its northing
    turn: float  # half steps per radian
    start: float  # half step of the scene's own north
    around: float  # half steps: greatest error of `_place`
    up_axis: int
    north_axis: int
    sign: float  # of the north axis: -1 if north is -Z


class Slopes(NamedTuple):
    """The skylines of n points: tangents of elevations, -inf where there is nothing."""

    at: NDArray[np.float64]  # (n, m): along each azimuth
    highest: NDArray[np.float64]  # (n, m): the supremum in its bin


class _SlopeRow(NamedTuple):
    """The slopes of one point."""

    at: F64Ptr
    highest: F64Ptr
    first: int  # index of its first number
    m: int


class _Corner(NamedTuple):
    """A corner of a triangle, seen from an eye; float64."""

    x: Any  # easting
    y: Any  # northing
    z: Any  # height
    slope: Any  # z / r
    place: Any  # azimuth in half steps, 0 <= place < 2 m


class _Box(NamedTuple):
    """A box, seen from an eye; float64."""

    x0: Any
    x1: Any
    y0: Any
    y1: Any
    z1: Any  # its upper end


class _Queue(NamedTuple):
    """Boxes to visit: a heap of up to `_HEAP` boxes, steepest first, and a stack of those that found it full."""

    words: I32Ptr  # of their links
    bounds: F64Ptr  # of their slopes


# --- Azimuths ---------------------------------------------------------------------------------------------------------


@inlined
def _wrapped(k, m):
    """k modulo m, for -m <= k < 2 m."""
    if k < 0:
        return k + m
    return k - m if k >= m else k


@inlined
def _azimuth(x, y):
    """``arctan2(x, y)`` with an error below 4e-8, Eq. (4.4.49) of Abramowitz and Stegun; 0 for the zero vector."""
    a, b = abs(x), abs(y)
    q = min(a, b) / max(a, b) if max(a, b) > 0.0 else np.float64(0.0)
    s = q * q
    p = -0.0559098861 + s * (0.0218612288 + s * -0.0040540580)
    p = 0.1994653599 + s * (-0.1390853351 + s * (0.0964200441 + s * p))
    angle = q * (0.9999993329 + s * (-0.3332985605 + s * p))
    angle = np.pi / 2.0 - angle if a > b else angle
    angle = np.pi - angle if y < 0.0 else angle
    return -angle if x < 0.0 else angle


@inlined
def _wrap(place, compass):
    """A place modulo 2 m, for -2 m <= place < 4 m."""
    full = len(compass.east)
    place = place + full if place < 0.0 else place
    return place - full if place >= full else place


@inlined
def _place(x, y, compass):
    """The azimuth of a direction in half steps, 0 <= place < 2 m, up to ``compass.around``."""
    return _wrap(_azimuth(x, y) * compass.turn + compass.start, compass)


@inlined
def _bin_of(place):
    """The azimuth in whose bin a place lies; m means 0."""
    return np.int64(np.floor(0.5 * (place + 1.0)))


@inlined
def _exact_bin(x, y, place, compass):
    """The azimuth in whose bin a direction lies."""
    if _bin_of(place - compass.around) != _bin_of(place + compass.around):
        place = _wrap(atan2(x, y) * compass.turn + compass.start, compass)
    return _wrapped(_bin_of(place), len(compass.east) >> 1)


@inlined
def _raise(values, index, slope):
    if slope > get(values, index):
        put(values, index, slope)


# --- Boxes ----------------------------------------------------------------------------------------------------------


@inlined
def _greatest_slope(box):
    """An upper bound of the slopes in a box."""
    if box.z1 > 0.0:
        x, y = max(max(box.x0, -box.x1), 0.0), max(max(box.y0, -box.y1), 0.0)
    else:
        x, y = max(box.x1, -box.x0), max(box.y1, -box.y0)
    slope = box.z1 / np.sqrt(x * x + y * y) if box.z1 != 0.0 else np.float64(0.0)
    return slope + _ROUNDING * abs(slope)


@inlined
def _ends(box):
    """The corners of a box's outline that come first and last clockwise: x, y, x, y. The eye is beside the box."""
    if box.x0 > 0.0:
        return box.x0 if box.y1 > 0.0 else box.x1, box.y1, box.x1 if box.y0 > 0.0 else box.x0, box.y0
    if box.x1 < 0.0:
        return box.x0 if box.y0 > 0.0 else box.x1, box.y0, box.x1 if box.y1 > 0.0 else box.x0, box.y1
    if box.y0 > 0.0:
        return box.x0, box.y0, box.x1, box.y0
    return box.x1, box.y1, box.x0, box.y1


@inlined
def _rises(box, slope, row, compass):
    """Whether a box may rise above the skyline, at one of its azimuths or in one of its bins."""
    if max(box.x0, -box.x1) <= 0.0 and max(box.y0, -box.y1) <= 0.0:
        begin, end = np.float64(0.0), np.float64(2 * row.m - 1)
    else:
        x0, y0, x1, y1 = _ends(box)
        begin, end = _place(x0, y0, compass), _place(x1, y1, compass)
        if end < begin:
            end += 2 * row.m
        begin, end = begin - compass.around, end + compass.around
    first, last = _bin_of(begin), _bin_of(end)
    for k in range(first, min(last, first + row.m) + 1):
        at = row.first + _wrapped(k, row.m)
        # A box beside the azimuth itself can only raise the bin.
        if slope > (get(row.at, at) if begin <= 2 * k <= end else get(row.highest, at)):
            return True
    return False


# --- Triangles --------------------------------------------------------------------------------------------------------


@inlined
def _corner(corners, at, eye, compass):
    """The `_Corner` of three float32 at a word."""
    x = np.float64(get(corners, at)) - eye[0]
    y = compass.sign * (np.float64(get(corners, at + compass.north_axis)) - eye[1])
    z = np.float64(get(corners, at + compass.up_axis)) - eye[2]
    r = np.sqrt(x * x + y * y)
    # A corner on the vertical through the eye is part of no azimuth.
    return _Corner(x, y, z, z / r if r > 0.0 else np.float64(-np.inf), _place(x, y, compass))


@inlined
def _raise_corner(a, row, compass):
    """Raise the bin of a corner."""
    if a.slope > get(row.at, row.first + _wrapped(_bin_of(a.place), row.m)):  # `highest` is not lower than `at`
        _raise(row.highest, row.first + _exact_bin(a.x, a.y, a.place, compass), a.slope)


@inlined
def _peak(a, b, width, row, compass):
    """The greatest slope of an edge between its ends, in whose bin it is raised; -inf if an end is higher."""
    x, y = b.z * a.y - a.z * b.y, a.z * b.x - b.z * a.x
    if not (x * a.y - a.x * y > 0.0 and b.x * y - x * b.y > 0.0):
        return np.float64(-np.inf)
    slope = np.sqrt(x * x + y * y) / width
    _raise(row.highest, row.first + _exact_bin(x, y, _place(x, y, compass), compass), slope)
    return slope


@inlined
def _raise_edge(a, b, row, compass):
    """Raise the slopes along the edge from a to b, which lies clockwise of a."""
    width = b.x * a.y - a.x * b.y
    if not width > 0.0:
        return  # seen from its end: its corners have been counted
    full = 2 * row.m
    span = b.place - a.place
    if span < -0.25 * full:
        span += full
    elif span > 0.75 * full:
        span -= full
    most = max(max(a.slope, b.slope), _peak(a, b, width, row, compass))
    most += _ROUNDING * abs(most)
    first = np.int64(np.ceil(a.place - compass.around))
    last = np.int64(np.floor(a.place + span + compass.around))
    for j in range(first, last + 1):
        j = _wrapped(j, full)
        k = j >> 1
        if most <= get(row.at, row.first + k) and (
            j & 1 == 0 or most <= get(row.at, row.first + _wrapped(k + 1, row.m))
        ):
            continue
        east, north = compass.east[j], compass.north[j]
        before, after = east * a.y - a.x * north, b.x * north - east * b.y
        # The signs depend on one corner each, so no direction passes between two edges that share it.
        if before >= 0.0 and after >= 0.0:
            slope = (after * a.z + before * b.z) / width
            _raise(row.highest, row.first + k, slope)
            if j & 1:
                _raise(row.highest, row.first + _wrapped(k + 1, row.m), slope)
            else:
                _raise(row.at, row.first + k, slope)


@inlined
def _raise_triangle(corners, slot, eye, row, compass):
    """Raise the slopes along the upper edges of a triangle."""
    a = _corner(corners, 9 * slot, eye, compass)
    b = _corner(corners, 9 * slot + 3, eye, compass)
    c = _corner(corners, 9 * slot + 6, eye, compass)
    for corner in (a, b, c):
        _raise_corner(corner, row, compass)
    # An edge is upper if the third corner is not above the plane through the eye and the edge.
    volume = a.x * (b.y * c.z - b.z * c.y) + a.y * (b.z * c.x - b.x * c.z) + a.z * (b.x * c.y - b.y * c.x)
    error = _VOLUME_ERROR * _size(a) * _size(b) * _size(c)
    for p, q in ((a, b), (b, c), (c, a)):
        if p.y * q.x > p.x * q.y:
            if volume >= -error:
                _raise_edge(p, q, row, compass)
        elif volume <= error:
            _raise_edge(q, p, row, compass)


@inlined
def _size(a):
    return abs(a.x) + abs(a.y) + abs(a.z)


# --- The tree ---------------------------------------------------------------------------------------------------------


@inlined
def _box(nodes, at, eye, compass):
    """The `_Box` of a child."""
    y = at + 4 * compass.north_axis
    south = compass.sign * (np.float64(get(nodes, y)) - eye[1])
    north = compass.sign * (np.float64(get(nodes, y + 2)) - eye[1])
    return _Box(
        np.float64(get(nodes, at)) - eye[0],
        np.float64(get(nodes, at + 2)) - eye[0],
        min(south, north),
        max(south, north),
        np.float64(get(nodes, at + 4 * compass.up_axis + 2)) - eye[2],
    )


@inlined
def _push(queue, n, word, bound):
    """Add a box to a queue of n boxes."""
    if n < _HEAP:
        while n > 0 and get(queue.bounds, (n - 1) >> 1) < bound:
            up = (n - 1) >> 1
            put(queue.words, n, np.int32(get(queue.words, up)))
            put(queue.bounds, n, get(queue.bounds, up))
            n = up
    put(queue.words, n, np.int32(word))
    put(queue.bounds, n, bound)


@inlined
def _pop(queue, n):
    """Remove the steepest box of a queue of n boxes, or the last one that found the heap full: (word, bound)."""
    last, least = get(queue.words, n - 1), get(queue.bounds, n - 1)
    if n > _HEAP:
        return last, least
    word, bound = get(queue.words, 0), get(queue.bounds, 0)
    n -= 1
    at, below = 0, 1
    while below < n:
        if below + 1 < n and get(queue.bounds, below + 1) > get(queue.bounds, below):
            below += 1
        if get(queue.bounds, below) <= least:
            break
        put(queue.words, at, np.int32(get(queue.words, below)))
        put(queue.bounds, at, get(queue.bounds, below))
        at, below = below, 2 * below + 1
    put(queue.words, at, np.int32(last))
    put(queue.bounds, at, least)
    return word, bound


@kernel
def _find_skyline(tree, eye, row, compass):
    """Raise the slopes of one point to those of all triangles."""
    queue = _Queue(stack_i32(_QUEUE_SIZE), stack_f64(_QUEUE_SIZE))
    n, node = 0, np.int64(0)
    while True:
        for side in (0, 1):
            link = get(tree.links, link_at(node, side))
            if link != EMPTY:
                box = _box(tree.nodes, box_at(node, side), eye, compass)
                _push(queue, n, link_at(node, side), _greatest_slope(box))
                n += 1
        node = np.int64(-1)
        while node < 0:
            if n == 0:
                return
            word, bound = _pop(queue, n)
            n -= 1
            if not _rises(_box(tree.nodes, box_of_link_at(word), eye, compass), bound, row, compass):
                continue
            link = get(tree.links, word)
            if not is_leaf(link):
                node = np.int64(link)
                continue
            leaf = bvh_leaf(link)
            for slot in range(leaf.first, leaf.first + leaf.count):
                _raise_triangle(tree.corners, slot, eye, row, compass)


@kernel
def _find_skylines(ticket, bvh, eyes, compass, slopes):
    m = slopes.at.shape[1]
    for i in items(ticket):
        north, up = eyes[i, compass.north_axis], eyes[i, compass.up_axis]
        eye = np.float64(eyes[i, 0]), np.float64(north), np.float64(up)
        row = _SlopeRow(ptr(slopes.at), ptr(slopes.highest), i * m, m)
        if slopes.at[i, 0] < np.inf:  # otherwise a surface above the eye closes the skyline
            _find_skyline(tree_of(bvh), eye, row, compass)


# --- Skylines of points -----------------------------------------------------------------------------------------------


def compass_of(m: int, up: str, north: float) -> Compass:
    """The compass of m azimuths in a scene.

    up : "y" or "z"
    north : degrees, direction of true north, clockwise from the scene's own north axis
    """
    bearing = np.radians(np.arange(2 * m) * (180.0 / m) + north)
    start = -north % 360.0 * m / 180.0
    axes = (2, 1, 1.0) if up == "z" else (1, 2, -1.0)
    turn = m / np.pi
    around = _AZIMUTH_ERROR * turn + _ROUNDING * m
    return Compass(sin(bearing), cos(bearing), turn, start, around, *axes)


def raise_slopes(
    bvh: Bvh,
    eyes: NDArray[np.float32],
    compass: Compass,
    slopes: Slopes,
    threads: int,
    progress: ProgressCallback | None = None,
) -> None:
    """Raise the slopes of eyes, (n, 3) float32 in the frame of the tree, to those of its triangles.

    Points with infinite slopes are skipped. Repeat the call for further trees.
    """
    run(_find_skylines, threads, new_ticket(len(eyes), 4), bvh, eyes, compass, slopes, progress=progress)
