"""Tiles of ray lists that hold a picture or a grid row by row: batches of eight by eight neighbours.

Sixty-four consecutive rays of a picture are a thin line, which meets more boxes than a square of as many rays. Nothing
states how long a list's rows are, and rows differ in length where pixels without a surface have been left out. So the
rows are found: the width is the distance at which rays are closest to some first ones. It is searched again, nearby,
for every eight rows. Where squares of rays are not much smaller than lines, lines remain. This determines which rays
are traced together, and no result.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import inlined, kernel
from ...kernels.marshalling import Packed
from ...kernels.simd import f32_at, f64_at, get

RUN = 8  # consecutive rays; a batch has as many runs
BATCH = RUN * RUN
FEWEST = 1 << 15
"""Rays of a list that is searched for rows; with fewer, tracing takes about as long as the search."""

_NARROWEST, _WIDEST = BATCH, 1 << 13  # rows
_NEAR = 16  # the width changes by less than this fraction of it, 1/16, from eight rows to the next
_HALF = BATCH // 2 - 1  # rays between the ends of half a line
_PROBES = 4  # rays from which the width is measured
_SPACING = 97  # rays between them, where the width is unknown
_SAMPLES = 256  # rays that determine the list's extent
_PAUSE = 4096  # rays until all widths are tried again where no rows are found, twice as many each time
_COHERENT = 0.25  # largest distance between the ends of a run, as a fraction of the list's extents
_SMALLER = 1.5  # largest size of a square relative to half a line; edges of surfaces raise both


class Runs(NamedTuple):
    """A batch: ray ``first + k * step + i`` of the list is ray ``8 k + i`` of the batch, for i below `columns`."""

    first: int
    step: int  # 8: all rays are consecutive
    columns: int


class _Scale(NamedTuple):
    """Reciprocals of a list's extents, or 0."""

    origins: np.float64
    directions: np.float64


@inlined
def line_of(first):
    """The `Runs` of 64 consecutive rays."""
    return Runs(np.int64(first), np.int64(RUN), np.int64(RUN))


@inlined
def place_of(runs, i):
    """The index in the list of ray i of a batch."""
    return runs.first + (runs.step - RUN) * (i // RUN) + i


@inlined
def number_at(operand, place):
    """The number of an operand at an address, in float64."""
    return get(f64_at(place), 0) if operand.double else np.float64(get(f32_at(place), 0))


@inlined
def _coordinate(operand, i, k):
    return number_at(operand, operand.address + i * operand.row + k * operand.column)


@inlined
def _distance(operand, i, j):
    """The distance between points i and j of an operand, as the sum of its components."""
    x = abs(_coordinate(operand, i, 0) - _coordinate(operand, j, 0))
    y = abs(_coordinate(operand, i, 1) - _coordinate(operand, j, 1))
    return x + y + abs(_coordinate(operand, i, 2) - _coordinate(operand, j, 2))


@inlined
def _apart(rays, i, j, scale):
    """The distance between two rays of a list, in its extents."""
    apart = np.float64(0.0)
    if scale.origins > 0.0:  # not for the rays of a camera
        apart = _distance(rays.origins, i, j) * scale.origins
    if scale.directions > 0.0:
        apart += _distance(rays.directions, i, j) * scale.directions
    return apart


@inlined
def _reciprocal_extent(operand, n):
    """1 / the largest extent of some points of an operand along an axis; 0 if there is none, or it is not finite."""
    largest = np.float64(0.0)
    for k in range(3):
        low, high = np.float64(np.inf), np.float64(-np.inf)
        for i in range(0, n, n // _SAMPLES):
            x = _coordinate(operand, i, k)
            low, high = min(low, x), max(high, x)
        largest = max(largest, high - low)
    return 1.0 / largest if 0.0 < largest < np.inf else 0.0


@inlined
def _width(rays, first, low, high, spacing, scale):
    """The width, at least `low` and less than `high`, at which rays are closest to those from the `first` on.

    The search begins in the middle, the width so far, so that one probe rejects most others.
    """
    low, high = max(low, _NARROWEST), min(high, rays.n - first - (_PROBES - 1) * spacing)
    best, width = np.float64(np.inf), np.int64(0)
    for k in range(high - low):
        w = (low + high) // 2 + (k // 2 if k % 2 == 0 else -(k // 2) - 1)
        total, probe = _apart(rays, first, first + w, scale), first + spacing
        while total < best and probe < first + _PROBES * spacing:
            total += _apart(rays, probe, probe + w, scale)
            probe += spacing
        if total < best:
            best, width = total, w
    return width


@inlined
def _has_squares(rays, first, width, scale):
    """Whether squares of eight rows of this width, from ray `first` on, are not much larger than half a line."""
    if width == 0 or first + RUN * width > rays.n:
        return False
    squares, lines, last = np.float64(0.0), np.float64(0.0), (RUN - 1) * width
    for at in range(first, first + width - RUN + 1, max(width // RUN, 1)):
        below, end = at + last, at + last + RUN - 1  # in the last row
        squares += _apart(rays, at, end, scale) + _apart(rays, at + RUN - 1, below, scale)
        lines += _apart(rays, at, at + _HALF, scale) + _apart(rays, end - _HALF, end, scale)
    return squares < _SMALLER * lines


@kernel
def _find(rays, runs):
    """Fill the batches of a list of rays, and return their number. `runs`: output, (b, 3) int64 `Runs`."""
    # In: rays, a `RayList` of at least `FEWEST`
    n, first, width, count = rays.n, np.int64(0), np.int64(0), 0
    search, pause = np.int64(0), np.int64(_PAUSE)
    scale = _Scale(_reciprocal_extent(rays.origins, n), _reciprocal_extent(rays.directions, n))
    while first < n:
        found = np.int64(0)
        if width > 0:
            near, spacing = width // _NEAR + 1, 2 * width + width // _PROBES
            found = _width(rays, first, width - near, width + near, spacing, scale)
        squares = _has_squares(rays, first, found, scale)
        if not squares and first >= search:
            search, pause = first + pause, 2 * pause
            if first + RUN <= n and _apart(rays, first, first + RUN - 1, scale) < _COHERENT:
                found = _width(rays, first, _NARROWEST, min((n - first) // RUN, _WIDEST), _SPACING, scale)
                squares = _has_squares(rays, first, found, scale)
        if squares:
            width = found
            for at in range(first, first + width, RUN):
                runs[count, 0], runs[count, 1], runs[count, 2] = at, width, min(RUN, first + width - at)
                count += 1
            first += RUN * width
        else:
            beyond = min(first + (BATCH * (width // RUN) if width > 0 else _PAUSE), n)
            for at in range(first, beyond, BATCH):
                runs[count, 0], runs[count, 1], runs[count, 2] = at, RUN, RUN
                count += 1
            first = beyond
    return count


NO_RUNS = np.empty((0, 3), np.int64)
"""In place of `runs_of`: all batches are lines."""


def runs_of(rays: Packed, n: int) -> NDArray[np.int64]:
    """(b, 3) int64: the batches, each a `Runs`, of a packed `RayList` of n rays. Every ray is in one of them."""
    if n < FEWEST:
        return NO_RUNS
    runs = np.empty((n // BATCH + n // (RUN * _NARROWEST) + BATCH, 3), np.int64)
    return runs[: _find(rays, runs)]
