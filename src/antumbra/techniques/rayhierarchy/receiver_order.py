"""The order of a beam's active receivers in the leaves of its hierarchy.

Sorted order [Olsson and Assarsson 2011, Sec. 3.5]. Receivers that the light cannot reach are dropped. The others are
sorted by face of the cube around the apex, then along a discrete Hilbert curve over the face, whose indices have two
bits per level of subdivision. Float32 is precise enough: a ray that rounding moves across the edge of a face sorts
equally well there.

Screen order. The order of a mip-map, with four pixels per node and four nodes per parent.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.morton_sort import radix_sort
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import CHUNK, N, items, new_ticket, run_short, shares
from ...kernels.simd import (
    absolute,
    fma,
    gather,
    get,
    iota16,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr,
    put,
    select,
    splat16,
    stack_i64,
    store,
    to_i32,
)
from ...kernels.simd import bits as bits_of
from ...query.shadow_query import ShadowQuery
from ...trace.counters import N_COUNTERS, add_counters, cleared
from .light_beams import (
    FACES,
    PERSPECTIVE,
    Beam,
    ConeSamples,
    SixteenReceivers,
    active_receivers,
    new_light_sides,
    origins_of,
    query_bits_of,
    relative16,
    sides_of,
    view_of,
)
from .ray_leaves import PAD

# --- Sorting keys: face of the cube and Hilbert index on it, for 16 receivers at once ---------------------------------

BITS = 14  # per coordinate; two coordinates and three bits for the face fill a non-negative int32
KEY_BITS = 2 * BITS + 3
_SIDE = np.float32(1 << BITS)
_LAST = np.int32((1 << BITS) - 1)
_F = np.float32


@inlined
def hilbert(x, y):
    """i32x16: Hilbert indices of the cells (x, y), i32x16 of BITS bits each."""
    key = splat16(np.int32(0))
    for i in range(BITS - 1, -1, -1):
        a, b = (x >> i) & 1, (y >> i) & 1
        key = (key << 2) | ((a + a + a) ^ b)
        flip = -(a & (b ^ 1))  # all bits set where the quadrant is flipped
        x, y = x ^ flip, y ^ flip
        swap = (x ^ y) & (b - 1)  # the quadrant's axes swap
        x, y = x ^ swap, y ^ swap
    return key


@inlined
def _cells(u):
    """i32x16: cells of u in [0, 1)."""
    return minimum(maximum(to_i32(minimum(maximum(u, _F(0.0)), _F(1.0)) * _SIDE), np.int32(0)), _LAST)


@inlined
def split_by_face(d):
    """(face, a, b, depth) of directions from an apex, a `Vec`: i32x16, and three f32x16.

    a and b are the coordinates across the face, and the depth is along its axis.
    """
    x, y, z = absolute(d.x), absolute(d.y), absolute(d.z)
    by_x = (x >= y) & (x >= z)
    by_y = ~by_x & (y >= z)
    depth = select(by_x, d.x, select(by_y, d.y, d.z))
    a, b = select(by_x, d.y, select(by_y, d.z, d.x)), select(by_x, d.z, select(by_y, d.x, d.y))
    face = select(by_x, np.int32(0), select(by_y, splat16(np.int32(2)), splat16(np.int32(4))))
    face = face + select(depth < _F(0.0), splat16(np.int32(1)), splat16(np.int32(0)))
    return face, a, b, absolute(depth)


@inlined
def on_cube(d):
    """(face, u, v) of directions from an apex, a `Vec` without zeros: i32x16, and twice f32x16 from 0 to 1."""
    face, a, b, depth = split_by_face(d)
    half = _F(0.5)
    s = half / depth
    return face, fma(a, s, half), fma(b, s, half)


@inlined
def cells_of(face, u, v):
    """i32x16: face and cell of (u, v), packed into one number; u and v are from 0 to 1."""
    return (((face << BITS) | _cells(u)) << BITS) | _cells(v)


@inlined
def keys_of(cells):
    """The sorting keys of packed cells, with a Hilbert index in place of the cell's coordinates."""
    return (cells >> (2 * BITS) << (2 * BITS)) | hilbert((cells >> BITS) & _LAST, cells & _LAST)


@inlined
def on_plane(d, scale):
    """(face, u, v) of points for a beam that is not PERSPECTIVE: the face is 0, and scale maps u and v to [0, 1]."""
    return splat16(np.int32(0)), (d.x - scale.u) * scale.factor, (d.y - scale.v) * scale.factor


# --- Order of the active receivers ------------------------------------------------------------------------------------

_PART = 8192  # receivers per work item, a multiple of 16
_TILE = 64  # side of a tile in pixels, a power of two; pixels of a tile are in Z order


class Order(NamedTuple):
    """The receivers of a beam, leaf after leaf."""

    ids: np.ndarray  # (n,) int32: y w + x of each receiver; -1: empty
    starts: np.ndarray  # (k + 1,) int64: the first receiver of each face, and the end; k is 1 for all faces together
    faces: np.ndarray  # (k,) int64: the faces
    placed: bool  # receivers have fixed indices, and some entries are empty


class ScreenScale(NamedTuple):
    """Map from (u, v) to [0, 1]: subtract, then multiply by `factor`."""

    u: float
    v: float
    factor: float


@inlined
def at_apex(view, d):
    """Bits of the lanes whose receivers lie exactly at the apex; their segments are points that nothing can block."""
    zero = np.float32(0.0)
    exact = view.kind == PERSPECTIVE and view.radius == 0.0
    return bits_of((d.x == zero) & (d.y == zero) & (d.z == zero)) if exact else 0


@inlined
def places_on(view, scale, d):
    """(face, u, v) of 16 receivers, with u and v from 0 to 1."""
    if view.kind == PERSPECTIVE:
        return on_cube(d)
    return on_plane(d, scale)


@kernel
def _write_cells(ticket, query, beam, scale, bits, keys, counts, light_sides, counters):
    """Worker: write each receiver's cell, or -1 if it is inactive; count the active receivers of each part."""
    query_bits, view = query_bits_of(query, bits), view_of(beam)
    samples = ConeSamples(beam.first, beam.n_samples, beam.set)
    out, known, thread_counters = ptr(keys), ptr(light_sides), cleared(stack_i64(N_COUNTERS))
    for first, end in shares(ticket):
        n = 0
        for i in range(first, end, 16):
            ids, lanes = minimum(np.int32(i) + iota16(), np.int32(ticket[N] - 1)), (1 << min(16, ticket[N] - i)) - 1
            d, sides = relative16(view, origins_of(query_bits, ids)), sides_of(query_bits, samples, ids, lanes)
            receivers = SixteenReceivers(ids, sides, gather(query_bits.query.faces, ids))
            active = active_receivers(query_bits, view, samples, receivers, known, thread_counters) & ~at_apex(view, d)
            face, u, v = places_on(view, scale, d)
            store(out, i, select(mask_from_bits16(active), cells_of(face, u, v), np.int32(-1)))
            n += popcount(active)
        counts[first // ticket[CHUNK]] = n
    add_counters(counters, thread_counters)


@kernel
def _pack(ticket, keys, starts, to_keys, to_ids):
    """Worker: write the keys and ids of the active receivers without gaps; starts: output position of each part."""
    k, out_keys, out_ids = ptr(keys), ptr(to_keys), ptr(to_ids)
    for first, last in shares(ticket):
        at = starts[first // ticket[CHUNK]]
        for i in range(first, last):
            if get(k, i) >= 0:
                put(out_keys, at, get(k, i))
                put(out_ids, at, i)
                at += 1


@kernel
def _on_screen(ticket, keys, w, h, ids):
    """Worker: write the receivers tile by tile, in Z order within a tile."""
    columns = (w + _TILE - 1) // _TILE
    for tile in items(ticket):
        y0, x0 = tile // columns * _TILE, tile % columns * _TILE
        for i in range(_TILE * _TILE):
            x, y, k = x0, y0, 0
            while i >> 2 * k:
                x += (i >> 2 * k & 1) << k
                y += (i >> 2 * k + 1 & 1) << k
                k += 1
            known = x < w and y < h and keys[y * w + x] >= 0
            ids[tile * _TILE * _TILE + i] = y * w + x if known else -1


@kernel
def _to_keys(ticket, cells):
    """Worker: replace cells by keys, in place, 16 at a time; `cells` is padded by PAD."""
    p = ptr(cells)
    for i in items(ticket):
        store(p, 16 * i, keys_of(load16(p, 16 * i)))


def sort_by_keys(keys: NDArray[np.int32], ids: NDArray[np.int32], threads: int, drop: int = 0) -> Order:
    """Sort ids by their keys into an `Order`; both are overwritten. drop: levels of the curve that keys leave out."""
    ordered, ids = radix_sort(keys, ids, KEY_BITS - 2 * drop, threads)
    starts = np.searchsorted(ordered, np.arange(FACES + 1, dtype=np.int32) << 2 * (BITS - drop)).astype(np.int64)
    faces = np.flatnonzero(np.diff(starts))
    return Order(ids, np.append(starts[faces], len(ids)), faces, False)


def order_of(
    query: ShadowQuery,
    beam: Beam,
    bits: NDArray[np.uint64],
    sort: bool,
    threads: int,
    tally: NDArray[np.int64] | None = None,
) -> Order:
    """The `Order` of a beam's active receivers.

    bits : answer bits; the bits of samples below the receiver's own surface are set
    sort : True: sorted order; False: screen order
    tally : counters, or None
    """
    h, w = query.sides.shape
    parts = -(-h * w // _PART)
    keys, counts = np.empty(h * w + 16, np.int32), np.zeros(parts + 1, np.int64)
    ticket = new_ticket(h * w, _PART)
    args = query, beam, scale_of(beam), bits, keys, counts[1:], new_light_sides(query), tally
    run_short(_write_cells, threads, ticket, *args)
    if not sort and h > 1:
        tiles = -(-w // _TILE) * -(-h // _TILE)
        ids = np.empty(tiles * _TILE * _TILE, np.int32)
        run_short(_on_screen, threads, new_ticket(tiles, 1), keys, w, h, ids)
        return _without_faces(ids, True)
    starts = np.cumsum(counts)
    packed, ids = np.zeros(int(starts[-1]) + PAD, np.int32), np.empty(int(starts[-1]), np.int32)
    run_short(_pack, threads, new_ticket(h * w, _PART), keys, starts, packed, ids)
    if not sort or not len(ids):
        return _without_faces(ids, False)
    run_short(_to_keys, threads, new_ticket(-(-len(ids) // 16), 512), packed)
    return sort_by_keys(packed[: len(ids)], ids, threads)


def _without_faces(ids: NDArray[np.int32], placed: bool) -> Order:
    return Order(ids, np.array([0, len(ids)], np.int64), np.zeros(1, np.int64), placed)


def scale_of(beam: Beam) -> ScreenScale:
    """The `ScreenScale` that maps the receivers' (u, v) to [0, 1]; unused by PERSPECTIVE beams."""
    extent = float((beam.upper - beam.lower)[:2].max())
    return ScreenScale(beam.lower[0], beam.lower[1], 1.0 / extent if extent > 0.0 else 0.0)
