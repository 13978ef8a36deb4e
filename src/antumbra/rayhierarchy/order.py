"""Which receivers ask a beam, and in which order they become the leaves of its hierarchy.

*Sorted* [Olsson and Assarsson 2011, Sec. 3.5]: receivers that the light cannot reach are left out, the others sorted by
the face of the cube around the apex in which they are seen, and their place on a Hilbert curve over it. *On the
screen*: in the order of a mip-map, four pixels to a node and four nodes to the next.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.radix_sort import radix_sort
from ..jit import inlined, kernel
from ..parallel import CHUNK, N, new_ticket, run, take
from ..predicate.filters import widest
from ..query.receivers import NOTHING
from ..query.shadow import is_above
from ..simd import get, mask_from_bits16, popcount, ptr, put, select, splat16, stack_f32, store
from ..trace.counters import BELOW_HORIZON, RAYS, add_counters, count, private_counters
from ..trace.vec import rows
from .asking import asking_of, end_of, horizon_at, patch_for, sets_at, three_at
from .beams import PERSPECTIVE, Beam
from .keys import BITS, KEY_BITS, cube_keys, flat_keys
from .view import FACES, relative, view_of

_PART = 8192  # receivers, a multiple of 16
_TILE = 64  # pixels a side: within, Z order; a power of two


class Order(NamedTuple):
    """The receivers of a beam, leaf after leaf."""

    ids: np.ndarray  # (n,) int32: y w + x of each receiver; -1: none
    starts: np.ndarray  # (k + 1,) int64: where each face's begin; two if all are taken together
    faces: np.ndarray  # (k,) int64: which these are
    on_screen: bool


class Samples(NamedTuple):
    """Those of a beam; see there."""

    first: int
    count: int
    set: int


class Scale(NamedTuple):
    """From (u, v) to [0, 1]."""

    u: float
    v: float
    factor: float


@inlined
def _asks(asking, beam, i, bits, words, counters):
    """Does a sample of the beam lie above the receiver's own surface? Sets the bits of those that do not."""
    patch, horizon, asks = patch_for(asking, i), horizon_at(asking, i), False
    for s in range(beam.first, beam.first + beam.count):
        l = end_of(asking, patch, i, s)
        if is_above(horizon, l[0], l[1], l[2], asking.corners):
            asks = True
        else:
            count(counters, BELOW_HORIZON, 1)
            at = i * words + (s >> 6)
            put(bits, at, get(bits, at) | np.uint64(1) << np.uint64(s & 63))
    return asks


@kernel
def _block(asking, view, samples, first, n, bits, words, places, counters):
    """16 receivers from the first on, of which n exist: bits of those that ask, and where they are, float32 rows."""
    asks, exact = np.int64(0), view.kind == PERSPECTIVE and view.radius == 0.0
    for lane in range(n):
        i, d = first + lane, (np.float64(1.0), np.float64(0.0), np.float64(0.0))
        if get(asking.sides, i) != NOTHING and (samples.set < 0 or sets_at(asking, i) == samples.set):
            d = relative(view, three_at(asking.origins, i))
            count(counters, RAYS, samples.count)
            asked = _asks(asking, samples, i, bits, words, counters)
            if asked and not (exact and widest(d) == 0.0):  # nothing is between a receiver and itself
                asks |= np.int64(1) << lane
        for k in range(3):
            put(places, 16 * k + lane, d[k])
    return asks


@kernel
def _write_keys(ticket, query, beam, scale, bits, keys, counts, tally):
    """Worker: each receiver's key, -1 if it asks nothing; how many of a part ask."""
    asking, view, samples = asking_of(query), view_of(beam), Samples(beam.first, beam.count, beam.set)
    words, out_bits, out, places = bits.shape[2], ptr(bits), ptr(keys), stack_f32(48)
    mine = private_counters(tally)
    for k in range(3):
        store(places, 16 * k, splat16(np.float32(1.0)))
    first = take(ticket)
    while first >= 0:
        n = 0
        for i in range(first, min(first + ticket[CHUNK], ticket[N]), 16):
            asks = _block(asking, view, samples, i, min(16, ticket[N] - i), out_bits, words, places, mine)
            d = rows(places, 0, 16)
            key = cube_keys(d) if view.kind == PERSPECTIVE else flat_keys(d.x, d.y, scale)
            store(out, i, select(mask_from_bits16(asks), key, np.int32(-1)))
            n += popcount(asks)
        counts[first // ticket[CHUNK]] = n
        first = take(ticket)
    add_counters(tally, mine)


@kernel
def _pack(ticket, keys, starts, to_keys, to_ids):
    """Worker: the keys of receivers that ask, and these, without gaps."""
    k, out_keys, out_ids = ptr(keys), ptr(to_keys), ptr(to_ids)
    first = take(ticket)
    while first >= 0:
        at = starts[first // ticket[CHUNK]]
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            if get(k, i) >= 0:
                put(out_keys, at, get(k, i))
                put(out_ids, at, i)
                at += 1
        first = take(ticket)


@kernel
def _on_screen(ticket, keys, w, h, ids):
    """Worker: the receivers in tiles, one a piece of work; within a tile in Z order."""
    columns = (w + _TILE - 1) // _TILE
    tile = take(ticket)
    while tile >= 0:
        y0, x0 = tile // columns * _TILE, tile % columns * _TILE
        for i in range(_TILE * _TILE):
            x, y, k = x0, y0, 0
            while i >> 2 * k:
                x += (i >> 2 * k & 1) << k
                y += (i >> 2 * k + 1 & 1) << k
                k += 1
            known = x < w and y < h and keys[y * w + x] >= 0
            ids[tile * _TILE * _TILE + i] = y * w + x if known else -1
        tile = take(ticket)


def order_of(query, beam: Beam, bits: np.ndarray, sort: bool, threads: int, tally=None) -> Order:
    """The `Order` of the receivers that ask a beam.

    bits : as tracers get them; those of samples that are not above the receiver's own surface are set
    sort : whether receivers are sorted, or in the order of the screen
    tally : counters, or None
    """
    h, w = query.sides.shape
    parts = -(-h * w // _PART)
    keys, counts = np.empty(h * w + 16, np.int32), np.zeros(parts + 1, np.int64)
    ticket = new_ticket(h * w, _PART)
    run(_write_keys, threads, ticket, query, beam, _scale(beam), bits, keys, counts[1:], tally)
    if not sort and h > 1:
        tiles = -(-w // _TILE) * -(-h // _TILE)
        ids = np.empty(tiles * _TILE * _TILE, np.int32)
        run(_on_screen, threads, new_ticket(tiles, 1), keys, w, h, ids)
        return _together(ids, True)
    starts = np.cumsum(counts)
    n = int(starts[-1])
    packed, ids = np.empty(n, np.int32), np.empty(n, np.int32)
    run(_pack, threads, new_ticket(h * w, _PART), keys, starts, packed, ids)
    if not (sort and n):
        return _together(ids, False)
    packed, ids = radix_sort(packed, ids, KEY_BITS, threads)
    starts = np.searchsorted(packed, np.arange(FACES + 1) << 2 * BITS).astype(np.int64)
    faces = np.flatnonzero(np.diff(starts))
    return Order(ids, np.append(starts[faces], n), faces, False)


def left_of(order: Order, rays) -> Order:
    """The receivers of which something is still asked after a traversal (Sec. 3.4); `rays`: the `Rays` in this order.

    On the screen they keep their places, and the others' are empty.
    """
    lanes = np.arange(rays.ways)
    dead = np.bitwise_and.reduce(rays.dead, 1)[:, None] >> lanes & 1
    ids = rays.ids[: dead.size].reshape(dead.shape)
    left = (dead == 0) & (ids >= 0)
    if order.on_screen:
        return order._replace(ids=np.where(left, ids, -1).reshape(-1))
    first = leaf_starts_of(order, rays.ways)
    counts = np.add.reduceat(left.sum(1), first[:-1]) if len(left) else np.zeros(0, np.int64)
    starts = np.append(0, np.cumsum(counts)).astype(np.int64)
    some = np.flatnonzero(counts)
    return order._replace(ids=ids[left], starts=np.append(starts[some], starts[-1]), faces=order.faces[some])


def leaf_starts_of(order: Order, ways: int) -> np.ndarray:
    """(k + 1,) int64: where the leaves of each face begin; no leaf has receivers of two."""
    return np.append(0, np.cumsum(-(-np.diff(order.starts) // ways)))


def _together(ids: np.ndarray, on_screen: bool) -> Order:
    return Order(ids, np.array([0, len(ids)], np.int64), np.zeros(1, np.int64), on_screen)


def _scale(beam: Beam) -> Scale:
    """What maps the receivers' (u, v) to [0, 1], where the beam is not PERSPECTIVE."""
    extent = float((beam.upper - beam.lower)[:2].max())
    return Scale(beam.lower[0], beam.lower[1], 1.0 / extent if extent > 0.0 else 0.0)
