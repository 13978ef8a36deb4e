"""All hits of rays: every triangle that a ray meets in its interval, sorted; or only their number.

Batches of 64 rays are read as in `ray_batches` and walk the wide BVH interleaved (`interleaved_rays`), none of them to
an early end. A test that float32 leaves undecided is settled at once, so no hit is found twice or missed.

Memory. How many hits there are is known only afterwards. A thread lists the hits of a batch in its scratch memory,
reserves room for them in the output arrays, and writes them there, sorted. A batch for which either memory is too small
only counts its hits; it is traced again with memory for this number. Batches end in any order, so the hits are finally
copied to the order of the rays.

Order. Hits are sorted as `kernels.exact.filters.precedes` states, so the first one is the nearest hit. Their t are from
`signed_t` until all hits of a ray have been sorted.

Rules. TRIANGLES counts every triangle that a ray meets, so a ray through a common edge counts two. SURFACES displaces
rays infinitesimally (`kernels.exact.surface_crossing`), so it counts one. A hit that float32 decides lies inside its
triangle, so only undecided tests need the second rule. INSIDE is SURFACES for a ray from a point, and also marks points
that are on a triangle. POINTS counts all triangles that a ray meets at one t once. It stores bounds of the t of a ray's
hits, and computes t only where they overlap. APART instead marks rays with such hits, some of which may count.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import WIDTH, wide_tree_of
from ...kernels.exact.filters import precedes, rounded_t
from ...kernels.exact.predicate import exact_touches
from ...kernels.exact.surface_crossing import crosses_surface
from ...kernels.jit import F32Ptr, I32Ptr, I64Ptr, inlined, kernel, overload
from ...kernels.marshalling import ArgumentForm, Packed, address_of
from ...kernels.parallel import STOP, items, new_ticket, run, thread_count
from ...kernels.simd import (
    atomic_add,
    bits,
    get,
    load16,
    lowest_bit,
    popcount,
    ptr,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    store,
)
from ...query.ray_list import HitArrays, RayArguments, hit_arrays
from ...scene.triangles import AllHits
from .hit_reports import CORNER_WORDS, REPORT_WORDS, Report, compute_numbers, pad, write_hit
from .interleaved_rays import bounds_of, keep_hits, leaf_of, walk_interleaved
from .ray_batches import RayTracer, read_batch, run_batches, share_ends
from .ray_traversal import settle
from .row_tiles import line_of
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    LANES,
    PRECISE_WORDS,
    Query,
    RayBlock,
    block_of,
    ray_of,
    without_skipped,
)

TRIANGLES, SURFACES, INSIDE, POINTS, APART = range(5)
"""Rules of counting, see above."""

ON_SURFACE = 1 << 30
"""Added to a count by INSIDE for each triangle that the ray's origin is on."""

UNCLEAR = 1 << 30
"""In a count by POINTS or APART: the ray has more than 32 hits, or by APART, two whose t may be equal."""

_RAYS = BLOCKS * LANES
_MOST = 2 * LANES  # hits of a ray whose bounds are stored
_SPAN_WORDS = 2 * _MOST  # `near` and `far`
_SPANS = _RAYS * _SPAN_WORDS
_SLOTS = _RAYS * _MOST
_BELOW, _ABOVE, _TINY = 1.0 - 2.0**-20, 1.0 + 2.0**-20, 2.0**-148  # which give float32 bounds of a t
_ROWS, _PRECISE = BLOCKS * BLOCK_WORDS, BLOCKS * PRECISE_WORDS

# --- Hits of a batch --------------------------------------------------------------------------------------------------


class HitSink(NamedTuple):
    """Receives all hits of the rays of a batch: pointers."""

    counts: I32Ptr  # int32 *, 64: number of hits of each ray
    total: I32Ptr  # int32 *: number of hits of all rays
    rays: I32Ptr  # int32 *: the ray of each hit that is listed
    slots: I64Ptr  # int64 *: the slot of its triangle; for the rule POINTS, int32 *, 32 for each ray
    room: int  # most hits that are listed
    rule: int
    spans: F32Ptr  # float32 *, for the rule POINTS: bounds of the t of each ray's hits


@inlined
def _overlaps(sink, i, near, far):
    """The hits (bits) of ray i whose bounds overlap others."""
    spans, n = ptr_at(sink.spans, i * _SPAN_WORDS), np.int64(get(sink.counts, i))
    found = bits((load16(spans, 0) <= far) & (load16(spans, _MOST) >= near))
    if n > LANES:
        found |= bits((load16(spans, LANES) <= far) & (load16(spans, _MOST + LANES) >= near)) << LANES
    return found & ((1 << min(n, _MOST)) - 1)


@inlined
def _add_span(sink, i, slot, near, far):
    """Count a hit of ray i, which has fewer than 32, by the rule POINTS."""
    n, spans = np.int64(get(sink.counts, i)), ptr_at(sink.spans, i * _SPAN_WORDS)
    put(spans, n, near)
    put(spans, _MOST + n, far)
    put(sink.slots, i * _MOST + n, slot)
    put(sink.counts, i, np.int32(n + 1))


@kernel
def _add_point(sink, tree, block, i, slot, bounds):
    """Count a hit of ray i, in `block`, by the rule POINTS, unless another one has the same t. Not inlined: it is rare.

    sink, tree, slot : of the walk, and the slot of the triangle
    bounds : (near, far) float32, of its t
    """
    equal, n = _overlaps(sink, i, bounds[0], bounds[1]), np.int64(get(sink.counts, i))
    if n >= _MOST or (equal != 0 and sink.rule == APART):
        put(sink.counts, i, np.int32(UNCLEAR))
        return
    if equal:
        ray = ray_of(block, i % LANES)
        t = rounded_t(ray, tree.corners, slot)
        while equal:
            if rounded_t(ray, tree.corners, np.int64(get(sink.slots, i * _MOST + lowest_bit(equal)))) == t:
                return
            equal &= equal - 1
    _add_span(sink, i, slot, bounds[0], bounds[1])


@inlined
def _add_points(sink, tree, block, i, first, hits, bounds):
    """Count hits (bits) of ray i by the rule POINTS.

    first : first lane of the ray's leaf
    bounds : of all tests there
    """
    while hits:
        k = lowest_bit(hits)
        hits &= hits - 1
        near, far, slot = get(bounds, k), get(bounds, WIDTH + k), np.int64(get(tree.slots, first + k))
        if np.int64(get(sink.counts, i)) >= _MOST or _overlaps(sink, i, near, far) != 0:
            _add_point(sink, tree, block, i, slot, (near, far))
        else:
            _add_span(sink, i, slot, near, far)


@inlined
def _add(sink, i, slot):
    """Add a hit of ray i."""
    total = get(sink.total, 0)
    put(sink.counts, i, get(sink.counts, i) + 1)
    put(sink.total, 0, total + 1)
    if total < sink.room:
        put(sink.rays, total, i)
        put(sink.slots, total, slot)


@kernel
def _add_undecided(sink, tree, block, i, slot, query):
    """Decide the test of ray i of the batch, in `block`, against the triangle in a slot. Not inlined: it is rare."""
    if np.int64(get(tree.prim_ids, slot)) == get(block.skip, i % LANES):
        return
    ray = ray_of(block, i % LANES)
    side = settle(ray, tree.corners, slot, None)
    if side != 0 and side != query.cull_faces:
        if sink.rule >= POINTS:
            t = rounded_t(ray, tree.corners, slot)
            _add_point(sink, tree, block, i, slot, (np.float32(t * _BELOW - _TINY), np.float32(t * _ABOVE + _TINY)))
        elif sink.rule == TRIANGLES or crosses_surface(ray, tree.corners, slot):
            _add(sink, i, slot)
    elif sink.rule == INSIDE and exact_touches(ray.ox, ray.oy, ray.oz, tree.corners, slot):
        put(sink.counts, i, get(sink.counts, i) | ON_SURFACE)


@inlined
def _keep_all(sink, tree, blocks, i, rays, query):
    """Add the hits of ray i in its leaf."""
    (first, lanes), block = leaf_of(rays, i), block_of(blocks, i // LANES)
    decided, undecided, skip = lanes & ((1 << WIDTH) - 1), lanes >> WIDTH, np.int64(get(block.skip, i % LANES))
    if decided and skip >= 0:
        decided = without_skipped(tree, first, decided, skip)
    if sink.rule >= POINTS:
        _add_points(sink, tree, block, i, first, decided, bounds_of(rays, i))
        decided = np.int64(0)
    elif sink.room == 0:
        put(sink.counts, i, get(sink.counts, i) + np.int32(popcount(decided)))
        decided = np.int64(0)
    while decided:
        k = lowest_bit(decided)
        decided &= decided - 1
        _add(sink, i, np.int64(get(tree.slots, first + k)))
    while undecided:
        k = lowest_bit(undecided)
        undecided &= undecided - 1
        _add_undecided(sink, tree, block, i, np.int64(get(tree.slots, first + k)), query)
    return False


@overload(keep_hits)
def _keep_hits(hits, tree, blocks, i, rays, query, counters):
    if getattr(hits, "instance_class", None) is HitSink:
        return lambda hits, tree, blocks, i, rays, query, counters: _keep_all(hits, tree, blocks, i, rays, query)
    return None


@inlined
def walk_batch(tree, batch, alive, cull_faces, sink):
    """Add all hits of the rays in `alive` (bits) of a batch to an empty sink."""
    for k in range(0, _RAYS, LANES):
        store(sink.counts, k, splat16(np.int32(0)))
    put(sink.total, 0, 0)
    walk_interleaved(tree, batch, alive, Query(cull_faces, True), sink, None)


# --- Numbers of hits --------------------------------------------------------------------------------------------------


@kernel
def _count(ticket, wide, rays, rule, out, faults):
    """Worker: write the number of hits of each ray."""
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), rays.segments)
    nothing, tree = stack_i32(1), wide_tree_of(wide)
    sink = HitSink(stack_i32(_RAYS), stack_i32(1), nothing, stack_i32(_SLOTS), np.int64(0), rule, stack_f32(_SPANS))
    sound = share_ends(rays, batch)
    for b in items(ticket):
        n, alive, good = read_batch(tree, rays, line_of(b * _RAYS), batch)
        if not (sound and good):
            faults[0], ticket[STOP] = True, 1
            break
        walk_batch(tree, batch, alive, rays.cull_faces, sink)
        for i in range(n):
            out[b * _RAYS + i] = get(sink.counts, i)


def count_all(
    tracer: RayTracer, rays: RayArguments, rule: int = TRIANGLES, threads: int | None = None
) -> NDArray[np.int64] | None:
    """(n,) int64: the number of hits of each ray, by a rule; None if a ray is invalid."""
    counts = np.empty(rays.n, np.int64)
    return counts if tracer.run(_count, threads, rays, rule, counts) else None


# --- Lists of hits ----------------------------------------------------------------------------------------------------


class _Batches(NamedTuple):
    """Batches of a ray list, and what becomes of them."""

    numbers: np.ndarray  # (m,) int64: batch b holds the rays from 64 b on
    begin: int  # number of the batch to which element 0 of `counts` belongs
    counts: np.ndarray  # (n,) int64: number of hits of each ray
    places: np.ndarray  # (m,) int64: element of the arrays at which a batch's hits begin; -1: memory is too small
    totals: np.ndarray  # (m,) int64: number of its hits
    next_free: np.ndarray  # (1,) int64: first free element of the arrays
    faults: np.ndarray  # (1,) bool: whether a ray is invalid

    def packed(self) -> Packed:
        """The batches as a kernel argument, which they must outlive."""
        numbers, begin, counts, places, totals, next_free, faults = self
        m = len(numbers)
        return _BATCHES.pack(
            address_of(numbers), m, 8, begin, address_of(counts), len(counts), 8, address_of(places), m, 8,
            address_of(totals), m, 8, address_of(next_free), 1, 8, address_of(faults), 1, 1,
        )  # fmt: skip


_NONE = np.empty(0, np.int64)
_BATCHES = ArgumentForm(_Batches(_NONE, 0, _NONE, _NONE, _NONE, _NONE, np.empty(0, np.bool_)))


class _Scratch(NamedTuple):
    """A thread's list of hits. Its arrays hold LANES more than their room."""

    rays: np.ndarray  # (room + LANES,) int32
    slots: np.ndarray  # (room + LANES,) int64


@inlined
def _set(out, to, source, at):
    """Set an element of the arrays to element `at` of others."""
    out.face[to], out.t[to], out.u[to], out.v[to] = source.face[at], source.t[at], source.u[at], source.v[at]


@kernel
def _sort(out, first, n):
    """Sort n hits: Shell's sort, which is an insertion sort for a few of them."""
    gap = 1
    while gap < n // 9:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(first + gap, first + n):
            face, t, u, v, at = out.face[i], out.t[i], out.u[i], out.v[i], i
            while at - gap >= first and precedes(t, face, out.t[at - gap], out.face[at - gap]):
                _set(out, at, out, at - gap)
                at -= gap
            out.face[at], out.t[at], out.u[at], out.v[at] = face, t, u, v
        gap //= 3


@inlined
def _write_hits(tree, batch, sink, report, out, place):
    """Write the listed hits of a batch from element `place` on, ray by ray, and each ray's in order."""
    total, ends, end = np.int64(get(sink.total, 0)), stack_i32(_RAYS), 0
    for i in range(_RAYS):
        put(ends, i, end)
        end += get(sink.counts, i)
    pad(report, total)
    for begin in range(0, total, LANES):
        compute_numbers(tree, batch, report, begin, total, -1)
        for k in range(begin, min(begin + LANES, total)):
            i = np.int64(get(sink.rays, k))
            write_hit(tree, batch, k, report, True, out, place + get(ends, i))
            put(ends, i, get(ends, i) + 1)
    for i in range(_RAYS):
        n = np.int64(get(sink.counts, i))
        if n > 1:
            _sort(out, place + get(ends, i) - n, n)


@kernel
def _collect(ticket, wide, rays, rule, batches, out, scratch):
    """Worker: write the hits of batches, or only count those for which memory is too small."""
    batch = RayBlock(stack_f32(_ROWS), stack_f64(_PRECISE), stack_i32(_RAYS), rays.segments)
    room, tree = np.int64(len(scratch.rays) - LANES), wide_tree_of(wide)
    sink = HitSink(stack_i32(_RAYS), stack_i32(1), ptr(scratch.rays), ptr(scratch.slots), room, rule, stack_f32(1))
    report = Report(stack_f32(CORNER_WORDS), stack_f32(BLOCK_WORDS), stack_f64(REPORT_WORDS), sink.rays, sink.slots)
    sound = share_ends(rays, batch)
    for k in items(ticket):
        first = batches.numbers[k] * _RAYS
        n, alive, good = read_batch(tree, rays, line_of(first), batch)
        if not (sound and good):
            batches.faults[0], ticket[STOP] = True, 1
            break
        walk_batch(tree, batch, alive, rays.cull_faces, sink)
        total, place = np.int64(get(sink.total, 0)), np.int64(-1)
        if total <= room:
            place = atomic_add(batches.next_free, 0, total)
        if place + total > len(out.t):
            place = np.int64(-1)
        if place >= 0 and total > 0:
            _write_hits(tree, batch, sink, report, out, place)
        batches.places[k], batches.totals[k] = place, total
        for i in range(n):
            batches.counts[first - batches.begin * _RAYS + i] = get(sink.counts, i)


@kernel
def _copy(ticket, batches, offsets, source, out):
    """Worker: copy the hits of each ray, as many as there is room for between its offsets."""
    for k in items(ticket):
        at, first = batches.places[k], (batches.numbers[k] - batches.begin) * _RAYS
        for i in range(first, min(first + _RAYS, len(batches.counts))):
            for hit in range(offsets[i + 1] - offsets[i]):
                to, of = offsets[i] + hit, at + hit
                out.face[to], out.t[to], out.u[to], out.v[to] = (
                    source.face[of],
                    source.t[of],
                    source.u[of],
                    source.v[of],
                )
            at += batches.counts[i]


_CHUNK = 16  # batches that a thread takes at a time
_HITS_PER_RAY = 3  # of all rays, for which memory is first allocated


class HitMemory(NamedTuple):
    """The memory of `find_all`, which changes no hit."""

    together: int = 1 << 14  # batches whose hits are in memory twice at a time
    room: int = 1 << 12  # hits of a batch for which memory is first allocated


USUAL_MEMORY = HitMemory()


def find_all(
    tracer: RayTracer,
    rays: RayArguments,
    max_hits: int | None = None,
    rule: int = TRIANGLES,
    threads: int | None = None,
    memory: HitMemory = USUAL_MEMORY,
) -> AllHits | None:
    """All hits of rays, with signed t, or the first `max_hits` of each; None if a ray is invalid.

    rule : TRIANGLES or SURFACES
    """
    n_threads, listed, n = thread_count(threads), rays.packed(), rays.n
    n_batches = -(-n // _RAYS)

    def trace(batches: _Batches, out: HitArrays, room: int) -> None:
        def scratch() -> tuple[_Scratch]:
            return (_Scratch(np.empty(room + LANES, np.int32), np.empty(room + LANES, np.int64)),)

        ticket = new_ticket(len(batches.numbers), _CHUNK)
        run_batches(_collect, threads, ticket, tracer.tree, listed, rule, batches.packed(), out.packed(), own=scratch)

    parts = list[AllHits]()
    for begin in range(0, n_batches, memory.together):
        numbers = np.arange(begin, min(begin + memory.together, n_batches))
        counts = np.empty(min(n - begin * _RAYS, len(numbers) * _RAYS), np.int64)
        rounds = _rounds(numbers, counts, memory.room, trace)
        if rounds is None:
            return None
        parts.append(_in_order(rounds, max_hits, n_threads))
    return join_rays(parts)


_Round: TypeAlias = tuple[_Batches, HitArrays]
"""Batches, and the arrays that hold the hits of those whose place is not negative."""


def _rounds(
    numbers: np.ndarray, counts: np.ndarray, room: int, trace: Callable[[_Batches, HitArrays, int], None]
) -> list[_Round] | None:
    """Trace batches, then once more those for which memory was too small. None if a ray is invalid.

    room : hits of a batch for which memory is first allocated
    """
    rounds, begin, size = list[_Round](), int(numbers[0]), max(_HITS_PER_RAY * _RAYS * len(numbers), 2 * room)
    while len(numbers):
        places, totals = np.empty(len(numbers), np.int64), np.empty(len(numbers), np.int64)
        batches = _Batches(numbers, begin, counts, places, totals, np.zeros(1, np.int64), np.zeros(1, np.bool_))
        out = hit_arrays(size, False)
        trace(batches, out, room)
        if batches.faults[0]:
            return None
        rounds.append((batches, out))
        missing = places < 0
        if not missing.any():
            break
        numbers, room, size = numbers[missing], int(totals[missing].max()), int(totals[missing].sum())
    return rounds


def _in_order(rounds: list[_Round], max_hits: int | None, threads: int) -> AllHits:
    """The hits of all batches of some rounds, in the order of rays."""
    (batches, out), counts = rounds[0], rounds[0][0].counts
    offsets = _offsets(counts if max_hits is None else np.minimum(counts, max_hits))
    n_hits, places = int(offsets[-1]), batches.places
    if max_hits is None and len(rounds) == 1 and (len(places) == 1 or bool((places[1:] >= places[:-1]).all())):
        return AllHits(offsets, out.t[:n_hits], out.face[:n_hits], out.u[:n_hits], out.v[:n_hits])
    hits = hit_arrays(n_hits, False)
    for batches, out in rounds:
        stored = batches.places >= 0
        some = batches._replace(numbers=batches.numbers[stored], places=batches.places[stored])
        run(_copy, threads, new_ticket(len(some.numbers), _CHUNK), some, offsets, out, hits)
    return AllHits(offsets, hits.t, hits.face, hits.u, hits.v)


def _offsets(counts: np.ndarray) -> NDArray[np.int64]:
    offsets = np.zeros(len(counts) + 1, np.int64)
    counts.cumsum(out=offsets[1:])
    return offsets


# --- Several lists ----------------------------------------------------------------------------------------------------


def join_rays(parts: Sequence[AllHits]) -> AllHits:
    """The hits of consecutive parts of a ray list as those of the whole list."""
    if len(parts) == 1:
        return parts[0]
    counts = [np.diff(part.ray_offsets) for part in parts]
    arrays = [np.concatenate([part[k] for part in parts]) for k in range(1, 5)] if parts else _nothing()
    return AllHits(_offsets(np.concatenate(counts) if parts else np.empty(0, np.int64)), *arrays)


def _nothing() -> list[np.ndarray]:
    return list(hit_arrays(0, False)._asdict()[name] for name in AllHits._fields[1:])


class RayHits(NamedTuple):
    """The hits of some rays of a list."""

    rays: NDArray[np.int64]  # (m,): index of each ray in the list
    hits: AllHits  # of m rays


def unsigned(hits: AllHits) -> AllHits:
    """Sorted hits with signed t as those that callers get. The array of t is changed."""
    np.abs(hits.t, out=hits.t)
    return hits


def merge_triangles(lists: Sequence[RayHits], n: int, max_hits: int | None = None) -> AllHits:
    """The hits of n rays from those on several sets of triangles, with signed t, or the first `max_hits` of each."""
    if len(lists) == 1 and len(lists[0].rays) == n and max_hits is None:
        return unsigned(lists[0].hits)
    rays = np.concatenate([np.empty(0, np.int64), *(each.rays[each.hits.ray] for each in lists)])
    columns = [
        np.concatenate([empty, *(each.hits[k] for each in lists)]) for k, empty in enumerate(_nothing(), start=1)
    ]
    return sorted_hits(rays, columns, n, max_hits)


def sorted_hits(rays: NDArray[np.int64], columns: Sequence[np.ndarray], n: int, max_hits: int | None = None) -> AllHits:
    """Hits in any order as those of n rays, or the first `max_hits` of each ray.

    rays : (k,) int64, the ray of each hit
    columns : (k,) each: signed t, face, u and v
    """
    t, face, u, v = columns
    order, offsets = np.lexsort((face, t < 0.0, np.abs(t), rays)), _offsets(np.bincount(rays, minlength=n))
    if max_hits is not None:
        order = order[np.arange(len(order)) - np.repeat(offsets[:-1], np.diff(offsets)) < max_hits]
        offsets = _offsets(np.minimum(np.diff(offsets), max_hits))
    return unsigned(AllHits(offsets, t[order], face[order], u[order], v[order]))
