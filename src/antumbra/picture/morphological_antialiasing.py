"""Morphological anti-aliasing [Reshetov 2009]: smooth edges from the pixels' surfaces alone, without tracing rays.

The boundary between two surfaces is a staircase of straight runs of pixel sides. Where it steps to one side at the end
of a run, the true edge is taken to cross the middle of the step and to meet the run at the run's middle. It then cuts
off a known share of each pixel beside the run, and this share gets the colour of the pixel across. The paper finds
boundaries by differences in colour; here the surfaces are known. A run ends where an outline against the background
becomes a boundary between two surfaces. Outlines also count as steps at the ends of creases, as in fine meshes at
silhouettes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, I8Ptr, U8Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, shares, thread_count
from ..kernels.simd import get, ptr, put
from ..query.pixel_refinement import NO_BOUNDARY, boundaries
from ..query.surface_links import PictureSurfaces

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

# --- Runs of pixel sides ----------------------------------------------------------------------------------------------
#
# The comments describe runs between rows, with pixels above and below. Runs between columns are those of the transposed
# picture: only the strides differ.

_UP, _DOWN, _NOWHERE = 1, -1, 0


class _Sides(NamedTuple):
    """The boundaries of a picture or its transpose, as pointers; pixel (y, x) is element y `down` + x `right`."""

    below: I8Ptr  # between each pixel and that below it
    beside: I8Ptr  # between each pixel and that to its right
    rows: int
    columns: int
    down: int
    right: int
    less: int  # a step is at most the length of its run minus this high; of equal runs in both directions, one counts


class _Cuts(NamedTuple):
    """The shares of neighbours in pixels, as pointers."""

    cut: F32Ptr  # four per pixel: of the pixels below, above, to the right and to the left
    mixed: U8Ptr  # whether a share is not 0


@inlined
def _at(sides, y, x):
    return y * sides.down + x * sides.right


@inlined
def _step(sides, y, x, highest):
    """Direction in which a run between rows y and y + 1 steps at its end, the sides to the right of column x.

    Steps higher than `highest` do not count. A step higher than the run is long is not part of a staircase along the
    run, but ends an object or belongs to a steeper edge.
    """
    up, down = get(sides.beside, _at(sides, y, x)), get(sides.beside, _at(sides, y + 1, x))
    if up == down:
        return _NOWHERE
    turn, v, height = (-1, y, 0) if up > down else (1, y + 1, 0)
    while height <= highest and 0 <= v < sides.rows and get(sides.beside, _at(sides, v, x)) == max(up, down):
        v, height = v + turn, height + 1
    if height > highest:
        return _NOWHERE
    return _UP if up > down else _DOWN


@inlined
def _cut(k, length):
    """The share cut off pixel k from the end of a run, by a line from half a pixel at the end to the middle."""
    middle = np.float32(0.5) * np.float32(length)
    a, b = np.float32(k), min(np.float32(k + 1), middle)
    return np.float32(0.5) * (b - a) * (np.float32(1.0) - (a + b) / (np.float32(2.0) * middle))


@inlined
def _add(cuts, pixel, neighbour, share):
    """Add to the share of a neighbour in a pixel."""
    at = 4 * pixel + neighbour
    put(cuts.cut, at, get(cuts.cut, at) + share)
    put(cuts.mixed, pixel, True)


@kernel
def _cut_run(sides, cuts, first, y, start, stop):
    """Write the shares of the pixels on both sides of the run from column `start` to `stop`, between rows y and y + 1.

    A run that steps to the same side at both ends is not smoothed, since smoothing would erode small details.

    first : 0 for runs between rows, 2 between columns: the share of the pixel across, for the pixels above the run
    """
    length = stop - start
    before = _step(sides, y, start - 1, length - sides.less) if start > 0 else _NOWHERE
    after = _step(sides, y, stop - 1, length - sides.less)  # the last column has no side to its right
    if before == after:
        return
    for k in range((length + 1) // 2):
        cut = _cut(k, length)
        for step, x in ((before, start + k), (after, stop - 1 - k)):
            if step == _UP:
                _add(cuts, _at(sides, y, x), first, cut)
            elif step == _DOWN:
                _add(cuts, _at(sides, y + 1, x), first + 1, cut)


@kernel
def _cut_rows(ticket, below, beside, cut, mixed):
    """Worker: find the runs between rows."""
    h, w = below.shape
    sides, cuts = _Sides(ptr(below), ptr(beside), h, w, w, 1, 0), _Cuts(ptr(cut), ptr(mixed))
    for y in items(ticket):
        x = 0
        while x < w:
            start, kind = x, get(sides.below, y * w + x)
            while x < w and get(sides.below, y * w + x) == kind:
                x += 1
            if kind != NO_BOUNDARY:
                _cut_run(sides, cuts, 0, y, start, x)


@kernel
def _cut_columns(ticket, below, beside, cut, mixed, starts):
    """Worker: find the runs between columns, row by row. `starts`: where the current run of each column has begun."""
    h, w = below.shape
    sides, cuts = _Sides(ptr(beside), ptr(below), w, h, 1, w, 1), _Cuts(ptr(cut), ptr(mixed))
    for first, last in shares(ticket):
        for x in range(first, last):
            put(ptr(starts), x, 0)
        for y in range(1, h + 1):
            for x in range(first, last):
                kind = get(sides.below, (y - 1) * w + x)
                if y == h or get(sides.below, y * w + x) != kind:
                    if kind != NO_BOUNDARY:
                        _cut_run(sides, cuts, 2, x, get(ptr(starts), x), y)
                    put(ptr(starts), x, y)


# --- Mixtures ---------------------------------------------------------------------------------------------------------


@inlined
def _change(values, own, at, share):
    """The change of the value `own` by a share of a neighbour's; the neighbour of a share of 0 may not exist."""
    return share * (get(values, at) - own) if share > np.float32(0.0) else np.float32(0.0)


@kernel
def _mix_pixels(ticket, pixels, cut, w, picture, out):
    """Worker: write the mixed values of pixels of a picture of w columns, (h w, channels)."""
    shares_of, values, mixed, channels = ptr(cut), ptr(picture), ptr(out), picture.shape[1]
    one, row = np.float32(1.0), w * channels
    for e in items(ticket):
        pixel = pixels[e]
        below, above = get(shares_of, 4 * pixel), get(shares_of, 4 * pixel + 1)
        right, left = get(shares_of, 4 * pixel + 2), get(shares_of, 4 * pixel + 3)
        total = below + above + right + left
        scale = one / total if total > one else one
        for c in range(channels):
            at = pixel * channels + c
            own = get(values, at)
            change = _change(values, own, at + row, below) + _change(values, own, at - row, above)
            change += _change(values, own, at + channels, right) + _change(values, own, at - channels, left)
            put(mixed, e * channels + c, own + scale * change)


class Mixture(NamedTuple):
    """The pixels at edges, and the shares of their neighbours."""

    pixels: NDArray[np.int64]  # (E,) int64: indices in the flat picture
    cut: NDArray[np.float32]  # (H, W, 4): of the pixels below, above, right and left; their sum may exceed 1
    threads: int

    def of(self, picture: np.ndarray) -> NDArray[np.float32]:
        """(E, ...) float32: the mixed values of a picture (H, W, ...)."""
        h, w, *channels = picture.shape
        flat = np.ascontiguousarray(picture, np.float32).reshape(h * w, -1)
        out = np.empty((len(self.pixels), flat.shape[1]), np.float32)
        run(_mix_pixels, self.threads, new_ticket(len(out), 1024), self.pixels, self.cut, w, flat, out)
        return out.reshape(len(out), *channels)

    def mix(self, picture: np.ndarray) -> None:
        """Write the mixed values to a C-contiguous picture (H, W, ...)."""
        picture.reshape(-1, *picture.shape[2:])[self.pixels] = self.of(picture)


def mixture(surfaces: PictureSurfaces, colour: np.ndarray, threads: int | None = None) -> Mixture:
    """Find the pixels at edges, and the shares with which to mix them with their neighbours.

    colour : (n, 3) float32, linear colours of the faces that `surfaces` indexes
    """
    threads = thread_count(threads)
    below, right = boundaries(surfaces, colour, threads)
    h, w = below.shape
    cut, mixed = np.zeros((h, w, 4), np.float32), np.zeros((h, w), np.bool_)
    run(_cut_rows, threads, new_ticket(h - 1, 8), below, right, cut, mixed)
    run(_cut_columns, threads, new_ticket(w - 1, 64), below, right, cut, mixed, np.empty(w, np.int64))
    return Mixture(np.flatnonzero(mixed), cut, threads)
