"""All hits of ray lists in a store: each chunk is read once, and traced with the rays that enter its box.

A ray that looks for all of its hits is never done early, so nothing is gained by a traversal order, nor by keeping
chunks between queries: only one is in memory at a time.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.compact_tree import bvh_of
from ...bvh.nodes import EMPTY, MAX_DEPTH, bvh_leaf, link_at
from ...bvh.wide_bvh import widen
from ...kernels.exact.filters import BEYOND
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, ptr, put, splat4, stack_i32
from ...query.ray_list import RayArguments, changed_error
from ...scene.triangles import AllHits
from ...store.store_file import FaceRange, Store
from ...trace.rays.all_hits import RayHits, count_all, find_all, join_rays, merge_triangles
from ...trace.rays.local_rays import LocalRays, local_ray
from ...trace.rays.ray_batches import RayTracer
from ...trace.rays.ray_traversal import box_ray, enter_boxes
from .cutout_hits import CutoutHits

_STACK = 2 * MAX_DEPTH


@kernel
def _enter_chunks(ticket, nodes, links, rays, offsets, chunks):
    """Worker: list the chunks whose boxes each ray enters, from `offsets` on; or count them, if `chunks` is empty."""
    planes, ends, stack = ptr(nodes), ptr(links), stack_i32(_STACK)
    for i in items(ticket):
        ray = local_ray(rays, i)
        box, limit = box_ray(planes, ray), splat4(np.float32(ray.tmax * BEYOND))
        put(stack, 0, 0)
        height, n = 1, 0
        while height > 0:
            height -= 1
            node = get(stack, height)
            entered = enter_boxes(planes, node, box, limit)[0]
            for side in range(2):
                link = get(ends, link_at(node, side))
                if entered >> side & 1 == 0 or link == EMPTY:
                    continue
                if link >= 0:
                    put(stack, height, link)
                    height += 1
                    continue
                if len(chunks) > 0:
                    chunks[offsets[i] + n] = bvh_leaf(link).first
                n += 1
        if len(chunks) == 0:
            offsets[i + 1] = n


class _ChunkRays(NamedTuple):
    """A chunk, and the rays of a batch that enter its box."""

    range_: FaceRange  # that of the chunk
    tracer: RayTracer
    places: NDArray[np.int64]  # (m,): index of each ray in the batch
    rays: RayArguments


class RayBatch(NamedTuple):
    """Some of the rays of a list."""

    rays: LocalRays  # without `skip`
    skip: NDArray[np.int64]  # (m,): a face of the scene that is not tested; -1: none


def all_hits(
    store: Store,
    batches: Iterable[RayBatch],
    max_hits: int | None,
    rule: int,
    threads: int,
    cutouts: CutoutHits | None = None,
) -> AllHits:
    """All hits of batches of rays, or the first `max_hits` of each ray; `rule`: TRIANGLES or SURFACES."""
    parts = list[AllHits]()
    for batch in batches:
        lists = list[RayHits]()
        for chunk in _chunks(store, batch, threads):
            hits = find_all(chunk.tracer, chunk.rays, max_hits, rule, threads)
            if hits is None:
                raise changed_error()
            hits = hits._replace(face=chunk.range_.faces(hits.face))
            lists.append(RayHits(chunk.places, hits))
        if cutouts is not None:
            every_ray = np.arange(len(batch.skip))
            lists.append(RayHits(every_ray, cutouts.all_hits(_all_arguments(batch), rule, threads)))
        parts.append(merge_triangles(lists, len(batch.skip), max_hits))
    return join_rays(parts)


def count_hits(
    store: Store, batches: Iterable[RayBatch], rule: int, threads: int, cutouts: CutoutHits | None = None
) -> NDArray[np.int64]:
    """(n,) int64: the number of hits of each ray of all batches, by a rule of `trace.rays.all_hits`."""
    parts = [np.empty(0, np.int64)]
    for batch in batches:
        counts = np.zeros(len(batch.skip), np.int64)
        for chunk in _chunks(store, batch, threads):
            more = count_all(chunk.tracer, chunk.rays, rule, threads)
            if more is None:
                raise changed_error()
            counts[chunk.places] += more
        if cutouts is not None:
            counts += cutouts.count_hits(_all_arguments(batch), rule, threads)
        parts.append(counts)
    return np.concatenate(parts)


def _chunks(store: Store, batch: RayBatch, threads: int) -> Iterator[_ChunkRays]:
    """Yield each chunk whose box a ray enters, with these rays."""
    rays, n = batch.rays, len(batch.skip)
    offsets, none = np.zeros(n + 1, np.int64), np.empty(0, np.int32)
    run(_enter_chunks, threads, new_ticket(n, 1024), *store.top, rays, offsets, none)
    offsets = np.cumsum(offsets)
    chunks = np.empty(int(offsets[-1]), np.int32)
    if len(chunks):
        run(_enter_chunks, threads, new_ticket(n, 1024), *store.top, rays, offsets, chunks)
    order, memory = np.argsort(chunks, kind="stable"), store.memory()
    ends = np.cumsum(np.bincount(chunks, minlength=len(store)))
    ray_of_pair = np.repeat(np.arange(n), np.diff(offsets))[order]
    ends_of_ranges = [range_.chunks.stop for range_ in store.ranges]
    for k in np.flatnonzero(np.diff(ends, prepend=0)).tolist():
        places = ray_of_pair[(ends[k - 1] if k else 0) : ends[k]]
        tracer = RayTracer(widen(bvh_of(store.chunk(k, memory).tree), threads))
        range_ = store.ranges[bisect_right(ends_of_ranges, k)]
        yield _ChunkRays(range_, tracer, places, _arguments(rays, places, range_.numbers(batch.skip[places])))


def _all_arguments(batch: RayBatch) -> RayArguments:
    """The rays of a batch, of a store with a single range."""
    places = np.arange(len(batch.skip))
    return _arguments(batch.rays, places, batch.skip.astype(np.int32))


def _arguments(rays: LocalRays, places: np.ndarray, skip: np.ndarray) -> RayArguments:
    """Some of the rays, which are in the scene's frame, as arguments of a tracer."""
    origins, directions, _, tmin, tmax = (array[places] for array in rays[:5])
    frame = (0.0, 0.0, 0.0)
    return RayArguments(origins, directions, tmin, tmax, skip, (len(places),), rays.cull_faces, rays.segments, frame)
