"""The discontinuity filter of interleaved sampling [Benthin and Wald 2009, Sec. 4.5].

Each pixel of a 4 x 4 block uses its own sample set. Where these pixels see the same surface and about the same
penumbra, their mean is therefore an estimate from 16 spp samples. docs/design/filter.md has the equations and
measurements.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, formula, inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import absolute, as_i32, get, load8, ptr, ptr_at, put, select, splat8, store, to_f32
from ..query.surface_links import N_LINKS, REACH, PictureSurfaces, deinterleave, interleave, link_offset

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

NOISE = 2.5
"""Twice the accepted difference of a neighbour's estimate, in units of spp**(1/4) samples (Eq. 4 of
docs/design/filter.md). The error of spp stratified samples of an edge falls as spp**(-3/4) [Mitchell 1996]."""

# --- Windows of eight pixels ------------------------------------------------------------------------------------------

_ROWS = 8  # of a share
_LANES = 8


class _Strip(NamedTuple):
    """The rows of a share and those of their windows, as planes of the flat picture."""

    first: int  # pixel at element 0 of a plane; before the first row of the picture, elements are undefined
    read: int  # first pixel of the rows
    end: int  # last pixel of the rows + 1
    step: int  # elements of a plane


@formula
def _plane_size(w):
    """Elements of a plane, for pictures of w columns."""
    return (_ROWS + 2 * REACH) * w + 2 * _LANES


@inlined
def _strip(links, first, last):
    """The `_Strip` of the rows from `first` up to `last`."""
    read, end = max(first - REACH, 0) * links.w, min(last + REACH, links.h) * links.w
    return _Strip((first - REACH) * links.w - REACH, read, end, _plane_size(links.w))


@inlined
def _weight(k):
    """The weight of a linked pixel: that of Eq. 1 in docs/design/filter.md, times 4."""
    down, right = link_offset(k)
    return (1 if down == REACH else 2) * (1 if abs(right) == REACH else 2)


@inlined
def _are_linked(bits, i, offset, k):
    """Two masks of eight pixels from i on: whether they are linked to the pixels `offset` after and before them."""
    return (load8(bits, i) & (1 << k)) != 0, (load8(bits, i - offset) & (1 << k)) != 0


# --- Visible fractions ------------------------------------------------------------------------------------------------


class _Sums(NamedTuple):
    """Where to write the filtered values of a strip: two planes in place of its first row."""

    fractions: F32Ptr
    shares: F32Ptr


@inlined
def _accepted(counts, at, offset, limit, linked):
    """The pixels after and before eight pixels that are accepted: two masks. `linked`: from `_are_linked`.

    Opposite pixels are accepted together, by their mean, which a penumbra of constant slope leaves unchanged. If only
    one of the two sees the surface of the centre, it is tested alone.
    """
    centre, (after, before) = load8(counts, at), linked
    a = select(after, load8(counts, at + offset), centre)
    b = select(before, load8(counts, at - offset), centre)
    difference = absolute(a + b - (centre + centre))
    similar = select(after & before, difference, difference + difference) <= limit
    return after & similar, before & similar


@inlined
def _filter_eight(bits, i, planes, at, inputs, out):
    """Write the filtered fractions and shares of eight pixels from pixel i on, element `at` of the planes."""
    (counts, shares), (w, limit, spp) = planes, inputs
    total, share, weight = load8(counts, at) * 4, load8(shares, at) * np.float32(4.0), splat8(4)
    for k in range(N_LINKS):
        down, right = link_offset(k)
        offset, factor = down * w + right, _weight(k)
        after, before = _accepted(counts, at, offset, limit, _are_linked(bits, i, offset, k))
        count = select(after, load8(counts, at + offset), 0) + select(before, load8(counts, at - offset), 0)
        other = select(after, load8(shares, at + offset), np.float32(0.0))
        other = other + select(before, load8(shares, at - offset), np.float32(0.0))
        total, share = total + count * factor, share + other * np.float32(factor)
        weight = weight + select(after, splat8(factor), 0) + select(before, splat8(factor), 0)
    samples = weight * spp
    store(out.fractions, 0, to_f32(samples - total) / to_f32(samples))
    store(out.shares, 0, share / to_f32(weight))


@kernel
def _filter_rows(ticket, links, counts, shares_of, limits, out, out_shares, scratch):
    """Worker: filter rows. `scratch`: the thread's memory for two planes and two vectors."""
    w, bits = links.w, ptr_at(links.bits, links.pad)
    fractions, smooth, hidden, weighted = ptr(out), ptr(out_shares), ptr(counts), ptr(shares_of)
    for first, last in shares(ticket):
        strip = _strip(links, first, last)
        planes = as_i32(ptr(scratch)), ptr_at(scratch, strip.step)
        sums = _Sums(ptr_at(scratch, 2 * strip.step), ptr_at(scratch, 2 * strip.step + _LANES))
        for i in range(strip.read, strip.end):
            put(planes[0], i - strip.first, get(hidden, i))
            put(planes[1], i - strip.first, get(weighted, i))
        for i in range(first * w, last * w, _LANES):
            _filter_eight(bits, i, planes, i - strip.first, (w, limits[0], limits[1]), sums)
            for lane in range(min(_LANES, last * w - i)):
                put(fractions, i + lane, get(sums.fractions, lane))
                put(smooth, i + lane, get(sums.shares, lane))


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
    return filter_shares(surfaces, counts, np.zeros(counts.shape, np.float32), spp, threads)[0]


def filter_shares(
    surfaces: PictureSurfaces,
    counts: NDArray[np.integer],
    shares: NDArray[np.float32],
    spp: int,
    threads: int | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """`filter_fractions`, and the mean of `shares`, (H, W) float32 from `light_visibility`, over the same pixels."""
    threads, links = thread_count(threads), surfaces.links(threads)
    counts, shares = np.ascontiguousarray(counts, np.int32), np.ascontiguousarray(shares)
    out, smooth = np.empty(counts.shape, np.float32), np.empty(counts.shape, np.float32)
    limits = int(NOISE * math.sqrt(math.sqrt(spp))), int(spp)
    scratch = lambda: (np.empty(2 * _plane_size(links.w) + 2 * _LANES, np.float32),)
    run(_filter_rows, threads, new_ticket(links.h, _ROWS), links, counts, shares, limits, out, smooth, own=scratch)
    return out, smooth


# --- Irradiance -------------------------------------------------------------------------------------------------------


@inlined
def _smooth_eight(bits, i, planes, at, step, w):
    """The smoothed red, green and blue of eight pixels from pixel i on, element `at` of three planes."""
    four, zero = np.float32(4.0), np.float32(0.0)
    red, green, blue = load8(planes, at) * four, load8(planes, at + step) * four, load8(planes, at + 2 * step) * four
    weight = splat8(four)
    for k in range(N_LINKS):
        down, right = link_offset(k)
        offset, factor = down * w + right, np.float32(_weight(k))
        after, before = _are_linked(bits, i, offset, k)
        a, b = select(after, splat8(factor), zero), select(before, splat8(factor), zero)
        weight = weight + (a + b)
        u, v = at + offset, at - offset
        red = red + (select(after, load8(planes, u), zero) + select(before, load8(planes, v), zero)) * factor
        u, v = u + step, v + step
        green = green + (select(after, load8(planes, u), zero) + select(before, load8(planes, v), zero)) * factor
        u, v = u + step, v + step
        blue = blue + (select(after, load8(planes, u), zero) + select(before, load8(planes, v), zero)) * factor
    return red / weight, green / weight, blue / weight


@kernel
def _smooth_rows(ticket, links, irradiance, out, scratch):
    """Worker: smooth rows. `scratch`: the thread's memory for six planes."""
    w, bits, source, target = links.w, ptr_at(links.bits, links.pad), ptr(irradiance), ptr(out)
    for first, last in shares(ticket):
        strip, i0, n = _strip(links, first, last), first * w, (last - first) * w
        planes, smooth = ptr(scratch), ptr_at(scratch, 3 * strip.step)
        deinterleave(source, 3 * strip.read, strip.end - strip.read, planes, strip.read - strip.first, strip.step)
        for i in range(i0, i0 + n, _LANES):
            red, green, blue = _smooth_eight(bits, i, planes, i - strip.first, strip.step, w)
            store(smooth, i - i0, red)
            store(smooth, i - i0 + strip.step, green)
            store(smooth, i - i0 + 2 * strip.step, blue)
        interleave(smooth, 0, strip.step, n, target, 3 * i0)


def smooth_irradiance(
    surfaces: PictureSurfaces, irradiance: NDArray[np.float32], threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance from interleaved lists of lights, averaged over the window of `filter_fractions`.

    The average includes every pixel of the window that sees the same surface. Unlike `filter_fractions`, it rejects no
    pixel for its value: neighbours sample different lights, so their irradiance differs far more than it varies over
    the surface, and the difference says nothing about shadows.
    """
    threads, links, out = thread_count(threads), surfaces.links(threads), np.empty_like(irradiance)
    scratch = lambda: (np.empty(6 * _plane_size(links.w), np.float32),)
    run(_smooth_rows, threads, new_ticket(links.h, _ROWS), links, irradiance, out, own=scratch)
    return out
