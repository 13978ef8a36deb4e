"""The rays of a beam: the leaves of its hierarchy, side by side in memory as they are tested side by side."""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..parallel import CHUNK, N, new_ticket, run, take
from ..simd import (
    as_i32,
    gather,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    ptr,
    ptr_at,
    put,
    select,
    stack_f32,
    stack_i32,
    store,
)
from ..simd import bits as bits_of
from .asking import asking_of, end_of, patch_for
from .beams import Beam
from .order import PAD, Order, leaf_starts_of


class Rays(NamedTuple):
    """Receivers in leaves of `ways`, with the ends of their segments.

    A leaf's dead segments are those that nothing has to be asked about: its receiver or sample does not exist, or is
    blocked. Lanes from `ways` on are not in `dead`.
    """

    ways: int  # rays to a leaf, nodes to a node: 4 or 16
    origins: np.ndarray  # (3 leaves ways + PAD,) float32: leaf, axis, lane
    faces: np.ndarray  # (leaves ways + PAD,) int32: each receiver's own triangle, -1: none
    ids: np.ndarray  # (leaves ways + PAD,) int32: which receiver; -1: none
    ends: np.ndarray  # (3 count ways [leaves] + PAD,) float32: [leaf,] sample, axis, lane
    end_step: int  # float32 from a leaf's ends to the next one's; 0: all have the same
    dead: np.ndarray  # (leaves, count) int32: bits of lanes
    first: int  # sample
    count: int  # samples


class Leaves(NamedTuple):
    """`Rays` in kernels: pointers instead of arrays."""

    ways: int
    origins: object
    faces: object
    ids: object
    ends: object
    end_step: int
    dead: object
    first: int
    count: int


@inlined
def leaves_of(rays):
    """The `Leaves` of `Rays`."""
    return Leaves(
        rays.ways, ptr(rays.origins), ptr(rays.faces), ptr(rays.ids), ptr(rays.ends), rays.end_step, ptr(rays.dead),
        rays.first, rays.count,
    )  # fmt: skip


@inlined
def _fill_ends(asking, i, leaves, ends, lane):
    """Write the ends of one receiver's segments to its lane."""
    patch = patch_for(asking, i)
    for s in range(leaves.count):
        l = end_of(asking, patch, i, leaves.first + s)
        for k in range(3):
            put(ends, (3 * s + k) * leaves.ways + lane, l[k])


@inlined
def _dead(asking, there, lanes, ids, s):
    """Bits of the lanes whose sample s nothing is asked about; there: the lanes' receivers, of which `lanes` exist."""
    word = gather(as_i32(asking.bits), there * np.int32(2 * asking.words) + np.int32(s >> 5))
    return bits_of((word >> np.int32(s & 31)) & 1 != np.int32(0)) | ~lanes


@inlined
def _put_lanes(p, at, ways, v, scratch):
    """Write as many lanes as a leaf has."""
    if ways == 16:
        store(p, at, v)
        return
    store(scratch, 0, v)
    for lane in range(ways):
        put(p, at + lane, get(scratch, lane))


@kernel
def _fill_leaf(asking, ids, lanes, leaves, leaf):
    """A leaf's receivers, of which some `lanes` (bits) exist; the other lanes repeat one of them, and are dead."""
    ways, at, everyone = leaves.ways, leaf * leaves.ways, (np.int64(1) << leaves.ways) - 1
    whole, floats = stack_i32(16), stack_f32(16)
    mask, anyone = mask_from_bits16(lanes), np.int64(get(ids, lowest_bit(lanes))) if lanes != 0 else np.int64(0)
    there = select(mask, load16(ids, 0), np.int32(anyone))
    _put_lanes(leaves.ids, at, ways, select(mask, there, np.int32(-1)), whole)
    _put_lanes(leaves.faces, at, ways, select(mask, gather(asking.faces, there), np.int32(-1)), whole)
    for k in range(3):
        _put_lanes(leaves.origins, (3 * leaf + k) * ways, ways, gather(asking.origins, there * 3 + np.int32(k)), floats)
    for s in range(leaves.count):
        put(leaves.dead, leaf * leaves.count + s, _dead(asking, there, lanes, ids, leaves.first + s) & everyone)
    if leaves.end_step != 0:
        ends = ptr_at(leaves.ends, leaf * leaves.end_step)
        for lane in range(ways):
            i = np.int64(get(leaves.ids, at + lane))
            _fill_ends(asking, i if i >= 0 else anyone, leaves, ends, lane)


@kernel
def _fill(ticket, query, order, leaf_starts, bits, rays):
    """Worker: leaves with the receivers that their places in the order say."""
    asking, leaves, part, places = asking_of(query, bits), leaves_of(rays), np.int64(0), stack_i32(16)
    first = take(ticket)
    while first >= 0:
        for leaf in range(first, min(first + ticket[CHUNK], ticket[N])):
            part = part if leaf_starts[part] <= leaf else np.int64(0)
            while leaf_starts[part + 1] <= leaf:
                part += 1
            at = order.starts[part] + (leaf - leaf_starts[part]) * leaves.ways
            n, ids = min(leaves.ways, order.starts[part + 1] - at), ptr_at(order.ids, at)
            if at + 16 > len(order.ids):  # no more is read than there is
                for lane in range(n):
                    put(places, lane, get(ids, lane))
                ids = places
            lanes = bits_of(load16(ids, 0) >= np.int32(0)) & (np.int64(1) << n) - 1
            _fill_leaf(asking, ids, lanes, leaves, leaf)
        first = take(ticket)


@kernel
def _fill_common(query, i, bits, rays):
    """The ends that all receivers have, taken from receiver i."""
    asking, leaves = asking_of(query, bits), leaves_of(rays)
    for lane in range(rays.ways):
        _fill_ends(asking, i, leaves, leaves.ends, lane)


def rays_of(query, beam: Beam, order: Order, ways: int, bits: np.ndarray, threads: int) -> Rays:
    """The `Rays` of the receivers in an order."""
    starts = leaf_starts_of(order, ways)
    n, count = int(starts[-1]), beam.count
    step = 0 if beam.common else 3 * count * ways
    rays = Rays(
        ways,
        np.empty(3 * n * ways + PAD, np.float32),
        np.empty(n * ways + PAD, np.int32),
        np.empty(n * ways + PAD, np.int32),
        np.empty((n * step if step else 3 * count * ways) + PAD, np.float32),
        step,
        np.empty((n, count), np.int32),
        beam.first,
        count,
    )
    for padded in rays.origins, rays.faces, rays.ids, rays.ends:
        padded[-PAD:] = 0
    run(_fill, threads, new_ticket(n, 256), query, order, starts, bits, rays)
    if not step and len(order.ids):
        _fill_common(query, np.int64(max(order.ids.max(), 0)), bits, rays)
    return rays


def finished(rays: Rays) -> float:
    """The share of the segments of which nothing is asked any more."""
    asked = int(np.count_nonzero(rays.ids[: len(rays.dead) * rays.ways] >= 0)) * rays.count
    empty = rays.dead.size * rays.ways - asked
    dead = sum(int(np.count_nonzero(rays.dead >> lane & 1)) for lane in range(rays.ways))
    return (dead - empty) / max(asked, 1)


@kernel
def _write_bits(ticket, rays, bits):
    """Worker: set the bits of the segments that have been found blocked."""
    leaves, out, words = leaves_of(rays), ptr(bits), bits.shape[2]
    first = take(ticket)
    while first >= 0:
        for leaf in range(first, min(first + ticket[CHUNK], ticket[N])):
            for s in range(leaves.count):
                dead, n = np.int64(get(leaves.dead, leaf * leaves.count + s)), leaves.first + s
                for lane in range(leaves.ways):
                    i = np.int64(get(leaves.ids, leaf * leaves.ways + lane))
                    if i >= 0 and dead >> lane & 1:
                        at = i * words + (n >> 6)
                        put(out, at, get(out, at) | np.uint64(1) << np.uint64(n & 63))
        first = take(ticket)


def write_bits(rays: Rays, bits: np.ndarray, threads: int) -> None:
    """Set the bits of blocked segments in (h, w, words) uint64."""
    run(_write_bits, threads, new_ticket(len(rays.dead), 256), rays, bits)
