"""How much light passes through the cut-outs between receivers and light samples.

The bits of a query tell which samples are dark. A lit sample may still lose light to panes and leaves: its
transmittance is the product of those of all surfaces that its segment crosses, in any order. The tree is that of
`alpha_cutouts`, and so are the sums of depths, so the answer does not depend on the plan.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import tree_of
from ..kernels.elementary import exp2
from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, ptr, put, stack_i32
from ..query.equal_samples import any_bit, with_distinct_samples
from ..query.shadow_query import ShadowQuery, count_occluded, fraction_lit, new_bits, patch_of, query_pointers
from ..scene.alpha_masks import DARK, HALVING
from .alpha_cutouts import CutoutTree, DepthSum, ray_to_sample, sum_depths, texel_pointers
from .frusta.multi_frusta import trace_shadow

_STEP = 256
_SHIFTS = 24, 16, 8, 0
POWERS = exp2(-np.outer(2.0 ** np.array(_SHIFTS), np.arange(_STEP)) / HALVING)
"""(4, 256) float64: 2 to the power of minus each digit of a depth, from the highest to the lowest."""


class Transmission(NamedTuple):
    """The light of each sample that arrives at the receivers to which some of it comes through cut-outs."""

    rows: NDArray[np.int32]  # (h, w) int32: row of a receiver in `values`; -1: no light comes through cut-outs
    values: NDArray[np.float32]  # (k, spp, channels) float32 in [0, 1]: transmittance of each sample; 0: occluded

    def mean_of(self, fraction: NDArray[np.float32]) -> NDArray[np.float32]:
        """The visible fractions of the receivers, (h, w) float32, with the light that arrives instead."""
        out, there = fraction.copy(), self.rows >= 0
        out[there] = self.values[self.rows[there]].mean((1, 2), dtype=np.float64)
        return out

    def colour_of(self, fraction: NDArray[np.float32]) -> NDArray[np.float32]:
        """(h, w, 3) float32: `mean_of`, for red, green and blue."""
        out, there = np.repeat(fraction[..., None], 3, axis=-1), self.rows >= 0
        out[there] = self.values[self.rows[there]].mean(1, dtype=np.float64)
        return out


class TracedQuery(NamedTuple):
    """A query and its answer."""

    query: ShadowQuery
    bits: NDArray[np.uint64]  # (h, w, ceil(spp / 64)) uint64: bit s = sample s is occluded
    light: Transmission | None = None  # what comes through cut-outs; None: samples that are not occluded arrive whole

    @property
    def spp(self) -> int:
        """Number of samples of each receiver."""
        return int(self.query.samples.shape[1])

    @property
    def through(self) -> Transmission:
        """`light`, for kernels: `NONE` instead of None."""
        return NONE if self.light is None else self.light


NONE = Transmission(np.empty((0, 0), np.int32), np.empty((0, 0, 1), np.float32))
"""No light comes through cut-outs."""


def lit_fraction(traced: TracedQuery, threads: int | None = None) -> NDArray[np.float32]:
    """(h, w) float32: the mean of the light that arrives from the samples of each receiver, over all channels."""
    fraction = fraction_lit(traced.bits, traced.spp, threads)
    return fraction if traced.light is None else traced.light.mean_of(fraction)


def occluded_count(traced: TracedQuery, threads: int | None = None) -> NDArray[np.int32]:
    """(h, w) int32: the number of occluded samples of each receiver; where light comes through cut-outs, rounded."""
    counts = count_occluded(traced.bits, threads)
    if traced.light is not None:
        there = traced.light.rows >= 0
        counts[there] = np.rint(traced.spp * (1.0 - lit_fraction(traced, threads)[there]))
    return counts


class TransmissionPointers(NamedTuple):
    """Pointers to the arrays of a `Transmission`, which must outlive them."""

    rows: I32Ptr  # int32 *
    values: F32Ptr  # float32 *
    spp: int
    channels: int
    n: int  # number of rows


@inlined
def transmission_pointers(light):
    """`TransmissionPointers` of `TracedQuery.through`."""
    return TransmissionPointers(ptr(light.rows), ptr(light.values), *light.values.shape[1:], len(light.values))


@inlined
def row_of(light, i):
    """The row of receiver i, or -1."""
    return np.int64(get(light.rows, i)) if light.n > 0 else np.int64(-1)


@inlined
def arriving(light, row, s, c):
    """The share of channel c that arrives from sample s, which is not occluded; `row`: from `row_of`."""
    if row < 0:
        return np.float64(1.0)
    return np.float64(get(light.values, (row * light.spp + s) * light.channels + min(c, light.channels - 1)))


@inlined
def power_of(powers, depth):
    """2 to the power of -depth / HALVING. A product of table entries, so it is the same on all systems."""
    value = get(powers, depth >> 24) * get(powers, 256 + (depth >> 16 & 255))
    return np.float32(value * get(powers, 512 + (depth >> 8 & 255)) * get(powers, 768 + (depth & 255)))


@inlined
def _is_set(words, query, i, s):
    return get(words, i * query.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) != np.uint64(0)


@kernel
def _transmit(ticket, bvh, texels, query, met, bits, receivers, powers, values):
    """Worker: write the transmittances of all samples of receivers."""
    tree, depth, pointers = tree_of(bvh), DepthSum(texel_pointers(texels), stack_i32(3)), query_pointers(query)
    candidates, occluded, table, out = ptr(met), ptr(bits), ptr(powers), ptr(values)
    channels = values.shape[2]
    for k in items(ticket):
        i = receivers[k]
        patch, skip = patch_of(pointers, i), get(pointers.ids, i)
        for s in range(pointers.spp):
            at = (k * pointers.spp + s) * channels
            if _is_set(occluded, pointers, i, s) or not _is_set(candidates, pointers, i, s):
                whole = np.float32(not _is_set(occluded, pointers, i, s))
                for c in range(channels):
                    put(out, at + c, whole)
                continue
            sum_depths(tree, depth, ray_to_sample(pointers, patch, i, s), skip, pointers.facing)
            for c in range(channels):
                total = get(depth.sums, c)
                put(out, at + c, power_of(table, np.int64(total)) if total <= DARK else np.float32(0.0))


Shares = tuple[NDArray[np.intp], NDArray[np.float32]]
"""Receivers to which light comes through cut-outs, (k,) ascending, and `Transmission.values`."""


def shares_of(tree: CutoutTree, query: ShadowQuery, bits: NDArray[np.uint64], threads: int) -> Shares:
    """The receivers at which a lit sample meets a cut-out, and the transmittances of all their samples."""
    met = new_bits(query)
    trace_shadow(tree.blocks, query, met, threads)
    receivers = np.flatnonzero(((met & ~bits) != 0).any(-1))
    values = np.empty((len(receivers), query.samples.shape[1], tree.channels), np.float32)
    ticket = new_ticket(len(receivers), 64)
    run(_transmit, threads, ticket, tree.bvh, tree.texels, query, met, bits, receivers, POWERS, values)
    return receivers, values


def transmission(
    tree: CutoutTree | None,
    query: ShadowQuery,
    bits: NDArray[np.uint64],
    threads: int | None = None,
    shares: Callable[[CutoutTree, ShadowQuery, NDArray[np.uint64], int], Shares] = shares_of,
) -> Transmission | None:
    """The light that comes through cut-outs; None if they only have holes, or if no sample is met.

    bits : (h, w, ceil(spp / 64)) uint64, the answer to the query, in which cut-outs are included
    shares : `shares_of`, or the same on a device
    """
    if tree is None or not tree.channels:
        return None
    samples = query.samples.shape[1]
    few = with_distinct_samples(query)
    if few is not query:
        query, bits = few, any_bit(bits)
    receivers, values = shares(tree, query, bits, thread_count(threads))
    if not len(receivers):
        return None
    rows = np.full(query.sides.shape, -1, np.int32)
    rows.reshape(-1)[receivers] = np.arange(len(receivers), dtype=np.int32)
    if few.samples.shape[1] < samples:
        values = np.repeat(values, samples, 1)
    return Transmission(rows, values)
