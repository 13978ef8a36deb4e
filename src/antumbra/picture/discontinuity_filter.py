"""The discontinuity filter of interleaved sampling [Benthin and Wald 2009, Sec. 4.5].

Each pixel of a 4 x 4 block uses its own sample set. Where these pixels see the same surface and about the same
penumbra, their mean is therefore an estimate from 16 spp samples. docs/design/filter.md has the equations and
measurements.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, I64Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import ptr
from ..query.gbuffer import PictureSurfaces, at, points_of, same_surface
from ..query.receivers import NOTHING

NOISE = 2.5
"""Twice the accepted difference of a neighbour's estimate, in units of spp**(1/4) samples (Eq. 4 of
docs/design/filter.md). The error of spp stratified samples of an edge falls as spp**(-3/4) [Mitchell 1996]."""

_ZERO = np.float32(0.0)


class _FilterInputs(NamedTuple):
    """The images to average, as pointers, and the threshold for accepting neighbours."""

    counts: I64Ptr  # (H, W) int64: occluded samples
    shares: F32Ptr  # (H, W) float32: averaged over the same pixels if `shared`
    shared: bool
    limit: int  # twice the accepted difference of the mean of two counts


@inlined
def _is_constant(points, inputs, y, x):
    """Whether all values in the window are equal, so that filtering would change nothing on any surface."""
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
    """Whether the pixels (y + dy, x + dx) and (y - dy, x - dx) are accepted: two booleans."""
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
    """(weighted sum of counts, weighted sum of shares, sum of weights) of accepted pixels in the window around (y, x).

    Opposite pixels are accepted together, by their mean, which a penumbra of constant slope leaves unchanged. If only
    one of the two sees the surface of the centre, it is tested alone. The weights are those of Eq. 1 in
    docs/design/filter.md, times 4.
    """
    total, weight = 4 * at(points, inputs.counts, y, x), 4
    shares = 4.0 * at(points, inputs.shares, y, x) if inputs.shared else 0.0
    for k in range(13, 25):  # the second half of the 5 x 5 window, after (y, x)
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
            total, weight = at(points, inputs.counts, y, x), 1
            share = np.float64(at(points, inputs.shares, y, x)) if inputs.shared else 0.0
            if at(points, points.side, y, x) != NOTHING and not _is_constant(points, inputs, y, x):
                total, share, weight = _window_sums(points, inputs, y, x)
            out[y, x] = np.float32(1.0 - np.float64(total) / np.float64(weight * spp))
            if inputs.shared:
                out_shares[y, x] = np.float32(share / np.float64(weight))


def filter_fractions(
    surfaces: PictureSurfaces, counts: NDArray[np.integer], spp: int, threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W) float32: the unoccluded fraction of samples, filtered over 4 x 4 pixels.

    Parameters
    ----------
    surfaces : PictureSurfaces
    counts : (H, W) int
        Occluded samples among the `spp` samples of each pixel. Pixel (x, y) uses sample set (x mod 4) + 4 (y mod 4).
    spp : int
    threads : int, optional
        None: all cores. The result does not depend on it.

    Notes
    -----
    The window covers 4 x 4 pixels around the *centre* of each pixel. It overlaps 5 x 5 pixels, whose border counts
    half, so that each sample set counts once. If all pixels are accepted, the result is exactly the fraction of
    16 spp samples.
    """
    return _filter(surfaces, counts, np.empty((0, 0), np.float32), spp, threads)[0]


def filter_shares(
    surfaces: PictureSurfaces,
    counts: NDArray[np.integer],
    shares: NDArray[np.float32],
    spp: int,
    threads: int | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`filter_fractions`, and the mean of `shares`, (H, W) float32 from `light_visibility`, over the same pixels."""
    return _filter(surfaces, counts, np.ascontiguousarray(shares), spp, threads)


def _filter(
    surfaces: PictureSurfaces,
    counts: NDArray[np.integer],
    shares: NDArray[np.float32],
    spp: int,
    threads: int | None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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


def smooth_irradiance(
    surfaces: PictureSurfaces, irradiance: NDArray[np.float32], threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance from interleaved lists of lights, averaged over the window of `filter_fractions`.

    The average includes every pixel of the window that sees the same surface. Unlike `filter_fractions`, it rejects no
    pixel for its value: neighbours sample different lights, so their irradiance differs far more than it varies over
    the surface, and the difference says nothing about shadows.
    """
    out = np.empty_like(irradiance)
    run(_smooth_rows, thread_count(threads), new_ticket(len(out), 8), surfaces, irradiance, out)
    return out
