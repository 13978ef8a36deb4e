"""Sums over the suns that sensors see: hours, energy, and stretches without a break."""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count


class Calendar(NamedTuple):
    """Suns in the order of time, each with `samples` bits; arrays for kernels."""

    places: np.ndarray  # (k, samples) int32: bit of each sample in a sensor's row
    hours: np.ndarray  # (k,) float64, length of the interval
    bins: np.ndarray  # (k, b) int32: columns of `Tally.binned` to which the hours are added
    starts: np.ndarray  # (k,) bool: the sun before belongs to another day, or there is a gap
    energy: np.ndarray  # (k,) float64, Wh/m2 on a surface at right angles to the rays
    directions: np.ndarray  # (k, 3) float64, unit vectors towards the suns


class Tally(NamedTuple):
    """What sensors see, n rows."""

    hours: np.ndarray  # (n,) float64
    binned: np.ndarray  # (n, columns) float64: hours in each bin
    energy: np.ndarray  # (n,) float64, Wh/m2: sum of energy x cosine
    longest: np.ndarray  # (n,) float64: hours of the longest stretch without a break
    first: np.ndarray  # (n,) int32: the first sun seen, -1: none
    last: np.ndarray  # (n,) int32: the last sun seen, -1: none


@inlined
def _seen(row, places, k):
    """The share of the samples of sun k that a sensor sees."""
    samples, seen = places.shape[1], np.int64(0)
    for s in range(samples):
        at = places[k, s]
        seen += 1 - np.int64(row[at >> 6] >> np.uint64(at & 63) & np.uint64(1))
    return np.float64(seen) / samples


@inlined
def _cosine(normals, i, directions, k):
    """The cosine between a sensor's normal and a sun; 1 without normals, 0 for suns behind."""
    if len(normals) == 0:
        return np.float64(1.0)
    c = normals[i, 0] * directions[k, 0] + normals[i, 1] * directions[k, 1] + normals[i, 2] * directions[k, 2]
    return c if c > 0.0 else np.float64(0.0)


@kernel
def _tally_rows(ticket, bits, normals, calendar, tally):
    n_suns, n_bins = calendar.bins.shape
    for i in items(ticket):
        total = energy = run_hours = longest = 0.0
        first = last = -1
        for k in range(n_suns):
            share = _seen(bits[i], calendar.places, k)
            if calendar.starts[k] or share < 0.5:
                run_hours = 0.0
            if share == 0.0:
                continue
            hours = share * calendar.hours[k]
            total += hours
            for b in range(n_bins):
                tally.binned[i, calendar.bins[k, b]] += hours
            energy += share * calendar.energy[k] * _cosine(normals, i, calendar.directions, k)
            if share >= 0.5:
                run_hours += calendar.hours[k]
                longest = max(longest, run_hours)
                first, last = k if first < 0 else first, k
        tally.hours[i], tally.energy[i], tally.longest[i] = total, energy, longest
        tally.first[i], tally.last[i] = first, last


def tally_of(bits: np.ndarray, normals: np.ndarray | None, calendar: Calendar, columns: int, threads=None) -> Tally:
    """The sums of n sensors.

    bits : (n, w) uint64: bit set = sample occluded
    normals : (n, 3) float64 unit vectors, or None: energy falls at right angles
    columns : number of bins
    """
    n = len(bits)
    hours, binned, energy, longest = np.zeros(n), np.zeros((n, columns)), np.zeros(n), np.zeros(n)
    tally = Tally(hours, binned, energy, longest, np.zeros(n, np.int32), np.zeros(n, np.int32))
    normals = np.empty((0, 3)) if normals is None else np.ascontiguousarray(normals, np.float64)
    run(_tally_rows, thread_count(threads), new_ticket(n, 64), bits, normals, calendar, tally)
    return tally
