"""The discontinuity filter of interleaved sampling [Benthin and Wald 2009, Sec. 4.5].

Sixteen neighbouring pixels use sixteen different sample sets. So their mean is an estimate from 16 spp samples, if they
see the same surface and about the same penumbra. For measurements see docs/design/filter.md.
"""

import math
from typing import NamedTuple

import numpy as np

from ..kernels.jit import F32Ptr, I64Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import ptr
from ..query.gbuffer import PictureSurfaces, at, points_of, same_surface
from ..query.receivers import NOTHING

NOISE = 2.5
"""Twice the accepted difference of a neighbour's estimate, in units of spp**(1/4) samples (equation 4 of
docs/design/filter.md). The error of spp stratified samples of an edge falls as spp**(-3/4) [Mitchell 1996]."""


_ZERO = np.float32(0.0)


class _FilterInputs(NamedTuple):
    """What the filter averages, as pointers, and how it judges neighbours."""

    counts: I64Ptr  # (H, W) int64: occluded samples
    shares: F32Ptr  # (H, W) float32: averaged with the counts, if `shared`
    shared: bool
    limit: int  # accepted difference of the mean of two counts, times two


@inlined
def _is_constant(points, inputs, y, x):
    """Whether all values in the window are the same. Then there is nothing to filter, on any surface."""
    centre, share = at(points, inputs.counts, y, x), at(points, inputs.shares, y, x) if inputs.shared else _ZERO
    for v in range(max(y - 2, 0), min(y + 3, points.h)):
        for u in range(max(x - 2, 0), min(x + 3, points.w)):
            if at(points, inputs.counts, v, u) != centre:
                return False
            if inputs.shared and at(points, inputs.shares, v, u) != share:
                return False
    return True


@inlined
def _accepted_pair(points, inputs, y, x, dy, dx):
    """Which of the pixels (y + dy, x + dx) and (y - dy, x - dx) are accepted, two booleans."""
    centre = at(points, inputs.counts, y, x)
    after, before = same_surface(points, y, x, y + dy, x + dx), same_surface(points, y, x, y - dy, x - dx)
    a = at(points, inputs.counts, y + dy, x + dx) if after else centre
    b = at(points, inputs.counts, y - dy, x - dx) if before else centre
    if after and before:
        similar = abs(a + b - 2 * centre) <= inputs.limit
    else:
        similar = 2 * abs(a + b - 2 * centre) <= inputs.limit
    return after and similar, before and similar


@inlined
def _window_sums(points, inputs, y, x):
    """(weighted sum of counts, of shares, sum of weights) over the accepted pixels of the window around (y, x).

    Pixels are accepted in opposite pairs, by the pair's mean, because a steady slope of the penumbra does not change
    this mean. A pixel is judged alone if the other pixel of its pair sees another surface. The weights are those of
    equation 1 of docs/design/filter.md, times 4.
    """
    total, weight = 4 * at(points, inputs.counts, y, x), 4
    shares = 4.0 * at(points, inputs.shares, y, x) if inputs.shared else 0.0
    for k in range(13, 25):  # the pixels of the 5 x 5 window that come after (y, x)
        dy, dx = k // 5 - 2, k % 5 - 2
        w = (1 if dy == 2 else 2) * (1 if abs(dx) == 2 else 2)
        after, before = _accepted_pair(points, inputs, y, x, dy, dx)
        for sign, accepted in ((1, after), (-1, before)):
            if accepted:
                v, u = y + sign * dy, x + sign * dx
                total, weight = total + w * at(points, inputs.counts, v, u), weight + w
                if inputs.shared:
                    shares += np.float64(w) * at(points, inputs.shares, v, u)
    return total, shares, weight


@kernel
def _filter_rows(ticket, surfaces, counts, shares, limit, spp, out, out_shares):
    points, inputs = points_of(surfaces), _FilterInputs(ptr(counts), ptr(shares), len(shares) > 0, limit)
    for y in items(ticket):
        for x in range(points.w):
            total, weight = at(points, inputs.counts, y, x), np.int64(1)
            share = np.float64(at(points, inputs.shares, y, x)) if inputs.shared else 0.0
            if at(points, points.side, y, x) != NOTHING and not _is_constant(points, inputs, y, x):
                total, share, weight = _window_sums(points, inputs, y, x)
            out[y, x] = np.float32(1.0 - np.float64(total) / np.float64(weight * spp))
            if inputs.shared:
                out_shares[y, x] = np.float32(share / np.float64(weight))


def filter_fractions(surfaces: PictureSurfaces, counts: np.ndarray, spp: int, threads=None) -> np.ndarray:
    """(H, W) float32: the fraction of samples that are not occluded, filtered over 4 x 4 pixels.

    Parameters
    ----------
    seen : Seen
    counts : (H, W) int
        Number of a pixel's `spp` samples that are occluded. Pixel (x, y) used sample set (x mod 4) + 4 (y mod 4).
    spp : int
    threads : int, optional
        None: all cores. The result does not depend on it.

    Notes
    -----
    The window is 4 x 4 pixels around the *centre* of each pixel. It overlaps 5 x 5 pixels, and those on its border
    count half. So each sample set counts once. If all pixels are accepted, the result is exactly the fraction of
    16 spp samples.
    """
    return _filter(surfaces, counts, np.empty((0, 0), np.float32), spp, threads)[0]


def filter_shares(
    surfaces: PictureSurfaces, counts: np.ndarray, shares: np.ndarray, spp: int, threads=None
) -> tuple[np.ndarray, np.ndarray]:
    """`filtered`, and the mean of `shares` ((H, W) float32, of `picture.light_visibility`) over the same pixels."""
    return _filter(surfaces, counts, np.ascontiguousarray(shares), spp, threads)


def _filter(surfaces, counts, shares, spp, threads) -> tuple[np.ndarray, np.ndarray]:
    counts, out, smooth = np.ascontiguousarray(counts, np.int64), np.empty(counts.shape, "f4"), np.empty_like(shares)
    limit = int(NOISE * math.sqrt(math.sqrt(spp)))
    args = surfaces, counts, shares, limit, int(spp), out, smooth
    run(_filter_rows, thread_count(threads), new_ticket(len(out), 8), *args)
    return out, smooth


@kernel
def _smooth_rows(ticket, surfaces, irradiance, out):
    points = points_of(surfaces)
    for y in items(ticket):
        for x in range(points.w):
            red = green = blue = weight = 0.0
            for v in range(y - 2, y + 3):
                for u in range(x - 2, x + 3):
                    if (v == y and u == x) or same_surface(points, y, x, v, u):
                        w = (1.0 if abs(v - y) == 2 else 2.0) * (1.0 if abs(u - x) == 2 else 2.0)
                        red += w * irradiance[v, u, 0]
                        green += w * irradiance[v, u, 1]
                        blue += w * irradiance[v, u, 2]
                        weight += w
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = red / weight, green / weight, blue / weight


def smooth_irradiance(surfaces: PictureSurfaces, irradiance: np.ndarray, threads=None) -> np.ndarray:
    """(H, W, 3) float32: irradiance from interleaved lists of lights, averaged over the window of `filtered`.

    The average includes every pixel of the window that sees the same surface. Neighbours ask different lights. So their
    irradiance differs far more than it changes from place to place, and the difference says nothing about shadows.
    """
    out = np.empty_like(irradiance)
    run(_smooth_rows, thread_count(threads), new_ticket(len(out), 8), surfaces, irradiance, out)
    return out
