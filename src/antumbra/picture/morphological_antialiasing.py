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

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..query.pixel_refinement import NO_BOUNDARY, boundaries
from ..query.surface_links import PictureSurfaces

_UP, _DOWN, _NOWHERE = 1, -1, 0


@inlined
def _step(right, y, x, highest):
    """Direction in which a run between rows y and y + 1 steps at its end, the sides to the right of column x.

    Steps higher than `highest` do not count. A step higher than the run is long is not part of a staircase along the
    run, but ends an object or belongs to a steeper edge.
    """
    up, down = right[y, x], right[y + 1, x]
    if up == down:
        return _NOWHERE
    turn, v, height = (-1, y, 0) if up > down else (1, y + 1, 0)
    while height <= highest and 0 <= v < len(right) and right[v, x] == max(up, down):
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
def _cut_run(right, y, start, stop, less, above, under):
    """Write the shares of the pixels on both sides of the run from column `start` to `stop`, between rows y and y + 1.

    Steps are at most `length - less` high. A run that steps to the same side at both ends is not smoothed, since
    smoothing would erode small details.
    """
    length = stop - start
    before = _step(right, y, start - 1, length - less) if start > 0 else _NOWHERE
    after = _step(right, y, stop - 1, length - less)  # the last column has no side to its right
    if before == after:
        return
    for k in range((length + 1) // 2):
        cut = _cut(k, length)
        for step, x in ((before, start + k), (after, stop - 1 - k)):
            if step == _UP:
                above[y, x] += cut
            elif step == _DOWN:
                under[y + 1, x] += cut


@kernel
def _cut_rows(ticket, below, right, less, above, under):
    """Worker: write the share that each pixel takes of the pixel below (`above`) and of the one above it (`under`)."""
    w = below.shape[1]
    for y in items(ticket):
        x = 0
        while x < w:
            start, kind = x, below[y, x]
            while x < w and below[y, x] == kind:
                x += 1
            if kind != NO_BOUNDARY:
                _cut_run(right, y, start, x, less, above, under)


class Mixture(NamedTuple):
    """The pixels at edges, and the weights of their neighbours."""

    pixels: NDArray[np.int64]  # (E,) int64: indices in the flat picture
    others: NDArray[np.int64]  # (4, E) int64: the pixels below, above, to the right and to the left
    shares: NDArray[np.float32]  # (4, E): weights of these neighbours; the pixel itself has the remaining weight

    def of(self, picture: np.ndarray) -> NDArray[np.float32]:
        """(E, ...) float32: the mixed values of a picture (H, W, ...)."""
        flat = picture.reshape(-1, *picture.shape[2:])
        shape = self.pixels.shape + (1,) * (flat.ndim - 1)
        mixed: NDArray[np.float32] = (np.float32(1.0) - self.shares.sum(0)).reshape(shape) * flat[self.pixels]
        for other, share in zip(self.others, self.shares):
            mixed += share.reshape(shape) * flat[other]
        return mixed

    def mix(self, picture: np.ndarray) -> None:
        """Write the mixed values to a C-contiguous picture (H, W, ...)."""
        picture.reshape(-1, *picture.shape[2:])[self.pixels] = self.of(picture)


def mixture(surfaces: PictureSurfaces, colour: np.ndarray, threads: int | None = None) -> Mixture:
    """Find the pixels at edges, and the weights with which to mix them with their neighbours.

    colour : (n, 3) float32, linear colours of the faces that `surfaces` indexes
    """
    below, right = boundaries(surfaces, colour, threads)
    h, w = below.shape
    flat = _cuts(below, right, 0, threads)
    upright = _cuts(right.T, below.T, 1, threads)  # of equal runs in both directions, only one counts
    cut = np.stack([*flat, *(shares.T for shares in upright)]).reshape(4, -1)
    pixels = np.flatnonzero(cut.any(0))
    shares = cut[:, pixels]
    shares /= np.maximum(shares.sum(0), np.float32(1.0))
    others = pixels + np.array([w, -w, 1, -1])[:, None]
    return Mixture(pixels, np.clip(others, 0, h * w - 1), shares)


def _cuts(
    below: np.ndarray, right: np.ndarray, less: int, threads: int | None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Two (H, W) float32: the shares that pixels take of the pixels below and above them; `less`: see `_cut_run`."""
    above, under = (np.zeros(below.shape, np.float32) for _ in range(2))
    below, right = np.ascontiguousarray(below), np.ascontiguousarray(right)
    run(_cut_rows, thread_count(threads), new_ticket(len(below) - 1, 8), below, right, less, above, under)
    return above, under
