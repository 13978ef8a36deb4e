"""Leaves of a ray hierarchy: the rays of a beam in SIMD lanes, and their tests against a triangle.

Blocks. Receivers are stored in *blocks*, each with as many lanes as a leaf. A leaf owns some lanes of a block; the
other lanes belong to other leaves or are empty. The segment ends are either shared by all receivers, or stored in the
same layout. Blocks of *projected* rays (`projected_rays`) hold coordinates on a face, and find receivers in the query.

Tests. A triangle is tested against the 16 rays of a leaf at once, in float32, or exactly where the error bounds of
float32 leave the result undecided.

Scratch memory is reused between calls. The operating system clears each new page of a process, which takes longer than
most kernels spend on the page; memory released between frames would be cleared again in every frame.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.forks import hold_during_fork
from ...kernels.exact.predicate import segment
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run_short
from ...kernels.simd import (
    as_i32,
    atomic_or,
    bits,
    gather,
    get,
    iota16,
    load16,
    lowest_bit,
    maximum,
    minimum,
    prefetch,
    ptr,
    ptr_at,
    put,
)
from ...kernels.simd import bits as bits_of
from ...kernels.vec3 import rows, subtract3
from ...query.shadow_query import ShadowQuery, patch_of, sample_of
from ...trace.counters import TRIANGLE_TESTS, count
from ...trace.rays.ray_traversal import settle
from ...trace.triangle_tests import decide, lanes_from, length1
from .light_beams import Beam, query_bits_of

# --- Scratch memory ---------------------------------------------------------------------------------------------------

KEPT = 64 << 20
"""Maximum number of bytes retained for later calls."""

spare_buffers: list[NDArray[np.uint8]] = []
"""Buffers retained for later calls, most recently used first."""

_lock = threading.Lock()
hold_during_fork(_lock)

Empty = Callable[[int, Any], np.ndarray]
"""Function of a number of elements and their dtype, such as ``numpy.empty``."""


def _spare_buffer(size: int) -> NDArray[np.uint8]:
    """A buffer of at least this many bytes: the smallest spare one that fits and is at most twice as large, or new."""
    with _lock:
        fit = [i for i, spare in enumerate(spare_buffers) if size <= len(spare) <= 2 * size]
        if fit:
            return spare_buffers.pop(min(fit, key=lambda i: len(spare_buffers[i])))
    return np.empty(size, np.uint8)


def _return_buffers(buffers: list[NDArray[np.uint8]]) -> None:
    with _lock:
        total = 0
        for i, buffer in enumerate(all_ := buffers + spare_buffers):
            total += len(buffer)
            if total > KEPT:
                del all_[i:]
                break
        spare_buffers[:] = all_


@contextmanager
def borrowed() -> Iterator[Empty]:
    """Yield a function like ``numpy.empty``; its arrays must not be used after the ``with`` block."""
    buffers: list[NDArray[np.uint8]] = []

    def empty(n: int, dtype: Any) -> np.ndarray:
        size = n * np.dtype(dtype).itemsize
        buffer = _spare_buffer(size)
        buffers.append(buffer)
        return buffer[:size].view(dtype)

    try:
        yield empty
    finally:
        _return_buffers(buffers)


# --- Leaves -----------------------------------------------------------------------------------------------------------

HUGE = np.float32(1e30)  # of 1 / depth: receivers closer to the apex are not projected
BLOCK_BOX = 8  # numbers from the box of a block to the next one
PAD = 16  # padding at the end of an array, because kernels always read 16 numbers


class LeafRays(NamedTuple):
    """Receivers in leaves of `ways`, with the ends of their segments.

    A dead segment needs no test: it is blocked, or its receiver or sample does not exist. Lanes from `ways` on have no
    bits in `dead`.
    """

    ways: int  # rays per leaf and children per node: 4 or 16
    origins: np.ndarray  # (3 blocks ways + PAD,) float32: block, axis, lane; projected: of all receivers, (3 h w,)
    ids: np.ndarray  # (blocks ways + PAD,) int32: index of the receiver; -1: none; projected: (PAD,)
    own: np.ndarray  # (blocks ways + PAD,) int32: the triangle that the receiver lies on; -1: none
    ends: np.ndarray  # (3 n_samples ways [blocks] + PAD,) float32: [block,] sample, axis, lane
    end_step: int  # float32 numbers from one block's ends to the next; 0: all blocks share their ends
    blocks: np.ndarray  # (leaves,) int32: the block of each leaf
    lanes: np.ndarray  # (leaves,) int32: bits of the block's lanes that the leaf owns
    dead: np.ndarray  # (leaves, n_samples) int32: bits of the lanes whose segment is dead
    first: int  # the first sample
    n_samples: int  # number of samples
    starts: np.ndarray  # (k + 1,) int64: the first leaf of each face, and the end
    faces: np.ndarray  # (k,) int64: the faces
    placed: bool  # leaves keep their places even if all their segments are dead
    samples: np.ndarray  # (leaves,) int32: the first sample of each leaf, counted from `first`
    points: np.ndarray  # (PAD,) float32; projected: (48 blocks + PAD,), block, (u, v, q), lane
    width: int  # 0; projected: of the picture
    height: int  # 0; projected: of the picture
    boxes: np.ndarray  # (PAD,) float32; projected: (8 blocks,), the lowest and highest u, v and q of a block that is a
    # single leaf, as 6 of 8 numbers; the first is inf where there is none


class Blocks(NamedTuple):
    """Receivers in n blocks of `ways` lanes; the other fields are as in `LeafRays`."""

    n: int
    ways: int
    origins: np.ndarray
    ids: np.ndarray
    own: np.ndarray
    points: np.ndarray
    width: int
    height: int
    boxes: np.ndarray


class LeafCut(NamedTuple):
    """Assignment of the lanes of blocks to leaves, as in `LeafRays`."""

    blocks: np.ndarray  # (leaves,) int32
    lanes: np.ndarray  # (leaves,) int32
    starts: np.ndarray  # (k + 1,) int64
    faces: np.ndarray  # (k,) int64
    placed: bool


class Leaves(NamedTuple):
    """`LeafRays` in kernels, with pointers instead of arrays; the fields have the same meaning."""

    ways: int
    origins: F32Ptr
    ids: I32Ptr
    own: I32Ptr
    ends: F32Ptr
    end_step: int
    blocks: I32Ptr
    lanes: I32Ptr
    dead: I32Ptr
    first: int
    n_samples: int
    samples: I32Ptr
    points: F32Ptr
    width: int
    height: int
    boxes: F32Ptr


@inlined
def leaves_of(rays):
    """The `Leaves` of `LeafRays`."""
    return Leaves(
        rays.ways, ptr(rays.origins), ptr(rays.ids), ptr(rays.own), ptr(rays.ends), rays.end_step, ptr(rays.blocks),
        ptr(rays.lanes), ptr(rays.dead), rays.first, rays.n_samples, ptr(rays.samples), ptr(rays.points), rays.width,
        rays.height, ptr(rays.boxes),
    )  # fmt: skip


@inlined
def block_of(leaves, leaf):
    """The block of a leaf."""
    return get(leaves.blocks, leaf)


@inlined
def ends_in(leaves, leaf, block):
    """Pointer to the ends of a leaf's segments; block: the leaf's block."""
    return ptr_at(leaves.ends, block * leaves.end_step + 3 * leaves.ways * get(leaves.samples, leaf))


@inlined
def origins_in(leaves, block):
    """The positions of a block's receivers, a `Vec`."""
    return rows(leaves.origins, 3 * block * leaves.ways, leaves.ways)


@inlined
def pixels_of_block(y, x, h, w):
    """(i32x16 indices of the pixels of the block of 4 x 4 at (y, x), bits of those within the picture).

    The others repeat one of the last row or column.
    """
    row, column = (iota16() >> np.int32(2)) + np.int32(y), (iota16() & np.int32(3)) + np.int32(x)
    there = bits((row < np.int32(h)) & (column < np.int32(w)))
    return minimum(row, np.int32(h - 1)) * np.int32(w) + minimum(column, np.int32(w - 1)), there


@inlined
def receiver_at(leaves, block, lane):
    """Index of the receiver in a lane of a block, which must have one."""
    if leaves.width == 0:
        return np.int64(get(leaves.ids, block * leaves.ways + lane))
    columns = (leaves.width + 3) >> 2
    y, x = block // columns * 4 + (lane >> 2), block % columns * 4 + (lane & 3)
    return np.int64(y * leaves.width + x)


@inlined
def fetch_leaf(leaves, leaf):
    """Prefetch a leaf's receivers into the cache."""
    block = block_of(leaves, leaf)
    if leaves.width > 0:
        for k in range(0, 48, 16):
            prefetch(leaves.points, 48 * block + k)
        prefetch(leaves.own, 16 * block)
        return
    for k in range(3):
        prefetch(leaves.origins, (3 * block + k) * leaves.ways)
    prefetch(leaves.own, block * leaves.ways)


@kernel
def _fill_ends(ticket, query, bits, rays):
    """Worker: write the segment ends of each block's receivers. Empty lanes repeat the ends of another lane."""
    query_bits, leaves, ways = query_bits_of(query, bits), leaves_of(rays), np.int64(rays.ways)
    for block in items(ticket):
        some_id = -1
        for lane in range(ways):
            some_id = max(some_id, get(leaves.ids, block * ways + lane))
        for lane in range(ways if some_id >= 0 else 0):
            i = get(leaves.ids, block * ways + lane)
            _fill_lane(query_bits, i if i >= 0 else some_id, leaves, block, lane)


@inlined
def _fill_lane(query_bits, i, leaves, block, lane):
    """Write the ends of the segments of receiver i to a lane."""
    patch, ends = patch_of(query_bits.query, i), ptr_at(leaves.ends, block * leaves.end_step)
    for s in range(leaves.n_samples):
        l = sample_of(query_bits.query, patch, i, leaves.first + s)
        for k in range(3):
            put(ends, (3 * s + k) * leaves.ways + lane, l[k])


@kernel
def _fill_common(query, leaf, bits, rays):
    """Write the ends that all receivers share, computed for one receiver of a leaf."""
    query_bits, leaves = query_bits_of(query, bits), leaves_of(rays)
    lane = lowest_bit(get(leaves.lanes, leaf) | 1 << 15) & leaves.ways - 1
    i = max(get(leaves.ids, block_of(leaves, leaf) * leaves.ways + lane), 0)
    for lane in range(rays.ways):
        _fill_lane(query_bits, i, leaves, 0, lane)


@inlined
def _fill_leaf(query_bits, leaves, leaf):
    """Mark the segments of a leaf that are dead before the traversal."""
    lanes = get(leaves.lanes, leaf)
    others = ~lanes & (1 << leaves.ways) - 1
    ids = maximum(load16(leaves.ids, block_of(leaves, leaf) * leaves.ways), np.int32(0))
    there = ids * np.int32(2 * query_bits.query.words)
    for n in range(leaves.n_samples):
        s = leaves.first + n
        word = gather(as_i32(query_bits.bits), there + np.int32(s >> 5))
        known = bits_of((word >> np.int32(s & 31)) & 1 != np.int32(0)) & lanes
        put(leaves.dead, leaf * leaves.n_samples + n, known | others)


@kernel
def _fill_dead(ticket, query, bits, rays):
    """Worker: mark the segments that are dead before the traversal."""
    query_bits, leaves = query_bits_of(query, bits), leaves_of(rays)
    for leaf in items(ticket):
        _fill_leaf(query_bits, leaves, leaf)


def new_blocks(n: int, ways: int, empty: Empty) -> Blocks:
    """Allocate n blocks."""
    origins, ids, own = (empty(k * n * ways + PAD, kind) for k, kind in ((3, np.float32), (1, np.int32), (1, np.int32)))
    for padded in origins, ids, own:
        padded[-PAD:] = 0
    none = np.zeros(PAD, np.float32)
    return Blocks(n, ways, origins, ids, own, none, 0, 0, none)


@inlined
def block_pointers(blocks):
    """The same `Blocks` with pointers."""
    return Blocks(
        blocks.n, blocks.ways, ptr(blocks.origins), ptr(blocks.ids), ptr(blocks.own), ptr(blocks.points), blocks.width,
        blocks.height, ptr(blocks.boxes),
    )  # fmt: skip


def rays_in(
    query: ShadowQuery, beam: Beam, blocks: Blocks, cut: LeafCut, bits: NDArray[np.uint64], threads: int, empty: Empty
) -> LeafRays:
    """Make the `LeafRays` of the receivers in blocks; `cut` assigns their lanes to leaves."""
    n, count = blocks.n, beam.n_samples
    step = 0 if beam.common else 3 * count * blocks.ways
    ends = empty((n * step if step else 3 * count * blocks.ways) + PAD, np.float32)
    ends[-PAD:] = 0
    dead = empty(len(cut.blocks) * count, np.int32).reshape(-1, count)
    rays = LeafRays(
        blocks.ways, blocks.origins, blocks.ids, blocks.own, ends, step, cut.blocks, cut.lanes, dead,
        beam.first, count, cut.starts, cut.faces, cut.placed, np.zeros(len(cut.blocks), np.int32), *blocks[5:],
    )  # fmt: skip
    if count == 1:  # all receivers of a leaf are active, so their only sample is live
        np.bitwise_xor(cut.lanes, (1 << blocks.ways) - 1, out=dead[:, 0])
    else:
        run_short(_fill_dead, threads, new_ticket(len(dead), 1024), query, bits, rays)
    if blocks.width:
        ends[:-PAD] = np.repeat(beam.apex.astype(np.float32), 16)  # the only end, exactly
    elif step:
        run_short(_fill_ends, threads, new_ticket(n, 64), query, bits, rays)
    elif len(dead):
        _fill_common(query, int(np.argmax(cut.lanes != 0)), bits, rays)
    return rays


def finished_share(rays: LeafRays) -> float:
    """The share of dead segments."""
    segments = int(np.bitwise_count(rays.lanes).sum()) * rays.n_samples
    return int(np.bitwise_count(rays.dead & rays.lanes[:, None]).sum()) / max(segments, 1)


@kernel
def _write_bits(ticket, rays, bits):
    """Worker: set the bits of the blocked segments."""
    leaves, out, words = leaves_of(rays), ptr(bits), bits.shape[2]
    for leaf in items(ticket):
        for s in range(leaves.n_samples):
            blocked = get(leaves.dead, leaf * leaves.n_samples + s) & get(leaves.lanes, leaf)
            block, n = block_of(leaves, leaf), leaves.first + s
            while blocked != 0:
                i = receiver_at(leaves, block, lowest_bit(blocked))
                blocked &= blocked - 1
                at = i * words + (n >> 6)
                put(out, at, get(out, at) | np.uint64(1) << np.uint64(n & 63))


def write_bits(rays: LeafRays, bits: NDArray[np.uint64], threads: int) -> None:
    """Set the bits of blocked segments in (h, w, words) uint64."""
    run_short(_write_bits, threads, new_ticket(len(rays.dead), 256), rays, bits)


# --- Tests of a triangle against the rays of a leaf -------------------------------------------------------------------


@kernel
def _exactly_blocked(leaves, block, ends, corners, slot, facing, unsure, counters):
    """Bits of the `unsure` lanes that the triangle blocks: an exact test where float32 was undecided."""
    blocked, o = 0, ptr_at(leaves.origins, 3 * block * leaves.ways)
    while unsure != 0:
        lane = lowest_bit(unsure)
        unsure &= unsure - 1
        ray = segment(
            get(o, lane), get(o, leaves.ways + lane), get(o, 2 * leaves.ways + lane),
            get(ends, lane), get(ends, leaves.ways + lane), get(ends, 2 * leaves.ways + lane),
        )  # fmt: skip
        side = settle(ray, corners, slot, counters)
        if side != 0 and side != facing:
            blocked |= 1 << lane
    return blocked


@inlined
def _span(leaves, ends, origins):
    """Upper bound of the 1-norm of each lane's segments."""
    span = length1(subtract3(rows(ends, 0, leaves.ways), origins))
    for s in range(1, leaves.n_samples):
        span = maximum(span, length1(subtract3(rows(ends, 3 * s * leaves.ways, leaves.ways), origins)))
    return span


@kernel
def block_rays(leaves, leaf, corners, slot, triangle, prim, facing, counters):
    """Mark the segments of a leaf that the triangle in `slot` blocks as dead; True if all of them are dead now.

    triangle : the result of `triangle_in`
    prim : the triangle's id; it does not block receivers that lie on it
    """
    ways, block, all_lanes = leaves.ways, block_of(leaves, leaf), (1 << leaves.ways) - 1
    marks, first = ptr_at(leaves.dead, leaf * leaves.n_samples), 0
    while first < leaves.n_samples and get(marks, first) == all_lanes:
        first += 1
    if first == leaves.n_samples:
        return True
    origins, ends = origins_in(leaves, block), ends_in(leaves, leaf, block)
    lanes, finished = lanes_from(origins, _span(leaves, ends, origins), triangle), True
    for s in range(first, leaves.n_samples):
        live = all_lanes & ~get(marks, s)
        if live == 0:
            continue
        count(counters, TRIANGLE_TESTS, 1)
        points = ptr_at(ends, 3 * s * ways)
        hit, unsure = decide(subtract3(rows(points, 0, ways), origins), lanes, facing)
        if (hit | unsure) & live != 0:
            others = ~bits(load16(leaves.own, block * ways) == np.int32(prim))
            hit, unsure = hit & live & others, unsure & live & others
            if unsure != 0:
                hit |= _exactly_blocked(leaves, block, points, corners, slot, facing, unsure, counters)
            if hit != 0:
                atomic_or(leaves.dead, leaf * leaves.n_samples + s, hit)
                live &= ~hit
        finished = finished and live == 0
    return finished
