"""Sums over the suns that sensors see: hours, energy, and the longest unbroken stretch.

A kernel adds up the suns of 16 sensors side by side, in chronological order, so each sum has the same bits as alone.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import F64Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import get, ptr, ptr_at, put, stack_f64

# --- Suns and sums ----------------------------------------------------------------------------------------------------


WHOLE = np.empty((1, 0), np.float32)
"""`SunLight.passing` if the light of a direction arrives whole or not at all."""


class Calendar(NamedTuple):
    """Suns in chronological order, each with `samples` bits; arrays for kernels."""

    places: np.ndarray  # (k, samples) int32: bit of each sample in a sensor's row
    hours: np.ndarray  # (k,) float64, length of the interval
    bins: np.ndarray  # (k, b) int32: columns of `Tally.binned` to which the hours are added
    starts: np.ndarray  # (k,) bool: the previous sun belongs to another day, or there is a gap
    energy: np.ndarray  # (k,) float64, Wh/m2 on a surface perpendicular to the rays
    directions: np.ndarray  # (k, 3) float64, unit vectors towards the suns


class Tally(NamedTuple):
    """The sums of n sensors."""

    hours: np.ndarray  # (n,) float64
    binned: np.ndarray  # (n, columns) float64: hours in each bin
    energy: np.ndarray  # (n,) float64, Wh/m2: sum of energy x cosine
    longest: np.ndarray  # (n,) float64: hours of the longest unbroken stretch
    first: np.ndarray  # (n,) int32: the first visible sun, -1: none
    last: np.ndarray  # (n,) int32: the last visible sun, -1: none


class SunLight(NamedTuple):
    """The light of all directions at n sensors, in bundle order."""

    bits: NDArray[np.uint64]  # (n, w) uint64: a set bit marks an occluded direction
    passing: NDArray[np.float32]  # (n, 64 w) float32: share of the light that arrives; (1, 0): all of it or none


# --- Sixteen sensors side by side -------------------------------------------------------------------------------------


_LANES = 16  # sensors whose sums are computed side by side
_SUMS = 10 * _LANES  # float64


class SumLanes(NamedTuple):
    """The sums of `_LANES` sensors so far, as in `Tally`: pointers to a float64 of each."""

    shares: F64Ptr  # of the light of the current sun
    hours: F64Ptr
    energy: F64Ptr
    run: F64Ptr  # hours of the current unbroken stretch
    longest: F64Ptr
    first: F64Ptr
    last: F64Ptr
    normals: F64Ptr  # x, y, z; rows of _LANES


@inlined
def _sum_lanes(memory):
    """The `SumLanes` in _SUMS float64."""
    return SumLanes(
        memory, ptr_at(memory, _LANES), ptr_at(memory, 2 * _LANES), ptr_at(memory, 3 * _LANES),
        ptr_at(memory, 4 * _LANES), ptr_at(memory, 5 * _LANES), ptr_at(memory, 6 * _LANES), ptr_at(memory, 7 * _LANES),
    )  # fmt: skip


@inlined
def _row_of(first, lane, n):
    """The sensor in a lane; lanes beyond the last sensor repeat it."""
    return min(first + lane, n - 1)


@inlined
def _clear_sums(sums, normals, first, n):
    """Begin the sums of the sensors from `first` on. Without normals, light arrives perpendicularly."""
    for lane in range(_LANES):
        put(sums.hours, lane, 0.0)
        put(sums.energy, lane, 0.0)
        put(sums.run, lane, 0.0)
        put(sums.longest, lane, 0.0)
        put(sums.first, lane, -1.0)
        put(sums.last, lane, -1.0)
        for axis in range(3):
            normal = normals[_row_of(first, lane, n), axis] if len(normals) > 0 else 0.0
            put(sums.normals, axis * _LANES + lane, normal)


@inlined
def _fill_shares(sums, light, places, k, first):
    """Write the shares of the light of sun k that the sensors from `first` on get. Return whether any is positive."""
    n, words = light.bits.shape
    samples, bits, is_lit = places.shape[1], ptr(light.bits), np.int64(0)
    for s in range(samples):
        at = np.int64(places[k, s])
        word, shift = at >> 6, np.uint64(at & 63)
        for lane in range(_LANES):
            row = _row_of(first, lane, n)
            if light.passing.shape[1] > 0:
                share = np.float64(light.passing[row, at])
            else:
                share = np.float64(1 - np.int64(get(bits, row * words + word) >> shift & np.uint64(1)))
            is_lit |= np.int64(share > 0.0)
            put(sums.shares, lane, get(sums.shares, lane) + share if s > 0 else share)
    if samples > 1:
        for lane in range(_LANES):
            put(sums.shares, lane, get(sums.shares, lane) / samples)
    return is_lit != 0


@inlined
def _add_sun(sums, calendar, k, sided):
    """Add sun k to the sums, without branches, so that lanes become vectors.

    sided : 1.0 if the sensors have normals, else 0.0
    """
    hours, energy, towards = calendar.hours[k], calendar.energy[k], calendar.directions
    x, y, z = towards[k, 0], towards[k, 1], towards[k, 2]
    goes_on, place = np.float64(0.0 if calendar.starts[k] else 1.0), np.float64(k)
    nx, ny, nz = sums.normals, ptr_at(sums.normals, _LANES), ptr_at(sums.normals, 2 * _LANES)
    for lane in range(_LANES):
        share, c = get(sums.shares, lane), get(nx, lane) * x + get(ny, lane) * y + get(nz, lane) * z
        cosine = c * np.float64(c > 0.0) * sided + (1.0 - sided)
        put(sums.hours, lane, get(sums.hours, lane) + share * hours)
        put(sums.energy, lane, get(sums.energy, lane) + share * energy * cosine)
        lit, first, last = np.float64(share >= 0.5), get(sums.first, lane), get(sums.last, lane)
        run = (get(sums.run, lane) * goes_on + hours) * lit
        longest = get(sums.longest, lane)
        put(sums.run, lane, run)
        put(sums.longest, lane, run if run > longest else longest)
        put(sums.first, lane, first + (place - first) * lit * np.float64(first < 0.0))
        put(sums.last, lane, last + (place - last) * lit)


@inlined
def _write_sums(sums, first, end, tally):
    for i in range(first, end):
        lane = i - first
        tally.hours[i], tally.energy[i] = get(sums.hours, lane), get(sums.energy, lane)
        tally.longest[i] = get(sums.longest, lane)
        tally.first[i], tally.last[i] = get(sums.first, lane), get(sums.last, lane)


@kernel
def _tally_rows(ticket, light, normals, calendar, tally):
    """Worker: the sums of all sensors, 16 at a time."""
    sums, n = _sum_lanes(stack_f64(_SUMS)), len(light.bits)
    for block in items(ticket):
        first, end = block * _LANES, min((block + 1) * _LANES, n)
        _clear_sums(sums, normals, first, n)
        for k in range(len(calendar.hours)):
            if _fill_shares(sums, light, calendar.places, k, first):
                _add_sun(sums, calendar, k, np.float64(len(normals) > 0))
                for b in range(calendar.bins.shape[1]):
                    for i in range(first, end):
                        tally.binned[i, calendar.bins[k, b]] += get(sums.shares, i - first) * calendar.hours[k]
            else:
                for lane in range(_LANES):
                    put(sums.run, lane, 0.0)
        _write_sums(sums, first, end, tally)


def tally_of(
    light: SunLight, normals: NDArray[np.float64] | None, calendar: Calendar, columns: int, threads: int | None = None
) -> Tally:
    """The sums of n sensors.

    normals : (n, 3) float64 unit vectors, or None: light arrives perpendicularly
    columns : number of bins
    """
    n = len(light.bits)
    hours, binned, energy, longest = np.zeros(n), np.zeros((n, columns)), np.zeros(n), np.zeros(n)
    tally = Tally(hours, binned, energy, longest, np.zeros(n, np.int32), np.zeros(n, np.int32))
    normals = np.empty((0, 3)) if normals is None else np.ascontiguousarray(normals, np.float64)
    run(_tally_rows, thread_count(threads), new_ticket(-(-n // _LANES), 4), light, normals, calendar, tally)
    return tally


def _example() -> None:
    bits, ones, days = np.zeros((2, 1), np.uint64), np.zeros(1), np.zeros((1, 1), np.int32)
    tally_of(SunLight(bits, WHOLE), None, Calendar(days, ones, days, np.ones(1, bool), ones, np.zeros((1, 3))), 1, 1)


EXAMPLES = {"sun hours": _example}
"""The example calls of this study."""
