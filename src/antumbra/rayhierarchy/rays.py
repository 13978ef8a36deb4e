"""The rays of a beam: the leaves of its hierarchy, side by side in memory as they are tested side by side."""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..parallel import CHUNK, N, new_ticket, run, take
from ..simd import as_i32, gather, get, load16, maximum, ptr, ptr_at, put
from ..simd import bits as bits_of
from ..trace.vec import Vec
from .asking import asking_of, end_of, patch_for
from .beams import Beam
from .order import PAD, Order, leaf_starts_of
from .rows import LANES


class Rays(NamedTuple):
    """Receivers in leaves of `ways`, with the ends of their segments.

    A leaf's dead segments are those that nothing has to be asked about: its receiver or sample does not exist, or is
    blocked. Lanes from `ways` on are not in `dead`.
    """

    ways: int  # rays to a leaf, nodes to a node: 4 or 16
    origins: np.ndarray  # (h, w, 3) float32: all receivers
    faces: np.ndarray  # (h, w) int32: each one's own triangle, -1: none
    ids: np.ndarray  # (leaves ways,) int32: which receivers; -1: none; and PAD more where 16 are read for four
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
def everyone(leaves):
    """Bits of all lanes of a leaf."""
    return (np.int64(1) << leaves.ways) - 1


@inlined
def receivers_of(leaves, leaf):
    """(i32x16: the receivers of a leaf, receiver 0 where there is none; bits of the lanes that have one)."""
    ids = load16(leaves.ids, leaf * leaves.ways)
    return maximum(ids, np.int32(0)), bits_of(ids >= np.int32(0)) & everyone(leaves)


@inlined
def origins_of(leaves, there):
    """`Vec` of f32x16: where receivers are."""
    at = there * 3
    return Vec(gather(leaves.origins, at), gather(leaves.origins, at + 1), gather(leaves.origins, at + 2))


@inlined
def _fill_ends(asking, i, leaves, ends, lane):
    """Write the ends of one receiver's segments to its lane."""
    patch = patch_for(asking, i)
    for s in range(leaves.count):
        l = end_of(asking, patch, i, leaves.first + s)
        for k in range(3):
            put(ends, (3 * s + k) * leaves.ways + lane, l[k])


@inlined
def _dead(asking, there, s):
    """Bits of the lanes whose receivers, `there`, have sample s below their horizon."""
    word = gather(as_i32(asking.bits), there * np.int32(2 * asking.words) + np.int32(s >> 5))
    return bits_of((word >> np.int32(s & 31)) & 1 != np.int32(0))


@inlined
def _fill_leaf(asking, leaves, leaf):
    """What is not asked of a leaf's receivers, and the ends of their segments."""
    there, lanes = receivers_of(leaves, leaf)
    for s in range(leaves.count):
        dead = ~lanes
        if leaves.count > 1:  # else those below the horizon are not here
            dead |= _dead(asking, there, leaves.first + s)
        put(leaves.dead, leaf * leaves.count + s, dead & everyone(leaves))
    if leaves.end_step != 0:
        ends = ptr_at(leaves.ends, leaf * leaves.end_step)
        for lane in range(leaves.ways):
            _fill_ends(asking, max(np.int64(get(leaves.ids, leaf * leaves.ways + lane)), 0), leaves, ends, lane)


@kernel
def _fill(ticket, query, bits, rays):
    """Worker: fill leaves."""
    asking, leaves = asking_of(query, bits), leaves_of(rays)
    first = take(ticket)
    while first >= 0:
        for leaf in range(first, min(first + ticket[CHUNK], ticket[N])):
            _fill_leaf(asking, leaves, leaf)
        first = take(ticket)


@kernel
def _spread(order, leaf_starts, ways, ids):
    """Write the receivers of leaves, none of which has those of two faces."""
    for part in range(len(order.faces)):
        to = leaf_starts[part] * ways - order.starts[part]
        for i in range(order.starts[part], order.starts[part + 1]):
            ids[i + to] = order.ids[i]


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
    ends = np.empty((n * step if step else 3 * count * ways) + PAD, np.float32)
    ends[-PAD:] = 0.0
    ids = order.ids
    if ways < LANES or not order.placed:
        ids = np.full(n * ways + PAD, -1, np.int32)
        _spread(order, starts, ways, ids)
    dead = np.empty((n, count), np.int32)
    rays = Rays(ways, query.origins, query.faces, ids, ends, step, dead, beam.first, count)
    run(_fill, threads, new_ticket(n, 256), query, bits, rays)
    if not step and len(order.ids):
        _fill_common(query, np.int64(max(order.ids.max(), 0)), bits, rays)
    return rays


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
