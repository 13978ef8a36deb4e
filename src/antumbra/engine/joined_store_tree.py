"""The tree of a store as a single `Bvh`, or the part of it that segments can reach, for `antumbra explain`."""

from collections.abc import Sequence

import numpy as np

from ..base.errors import InputError
from ..bvh.compact_tree import bvh_of
from ..bvh.nodes import CHILDREN, EMPTY, MAX_DEPTH, Bvh, aligned_empty, bvh_leaf, bvh_link
from ..query.shadow_query import ShadowQuery, new_bits
from ..store.store_file import Store
from ..store.system_resources import resident_memory
from ..techniques.chcrt.occlusion_queries import Pairs, answer_queries
from ..techniques.chcrt.picture_ray_sets import SegmentRaySets, segments_of
from ..trace.rays.single_rays import leaf_depths
from .sources.paged_source import Paged

_TRIANGLE_BYTES = 140  # memory of a triangle while the tree is joined


def explained_tree(paged: Paged, queries: Sequence[ShadowQuery]) -> tuple[Bvh, np.ndarray]:
    """The tree over the chunks that segments may enter: (Bvh, index in the whole scene of each of its triangles).

    Other chunks become empty children, so each ray takes the same steps as through the whole tree.

    Raises
    ------
    InputError
        If the tree does not fit in memory.
    """
    store = paged.store
    if not store.ranges[0].is_all:
        raise InputError(f"{paged.scene.name}: has too many faces for this; explain one of its tiles")
    reached = _reached_chunks(paged, queries)
    need = int(store.chunks.triangles[reached].sum()) * _TRIANGLE_BYTES + resident_memory() - paged.residency.held
    if need > paged.max_memory:
        raise InputError(
            f"{paged.scene.name}: the trees that these rays may enter take {need >> 20}M of memory; give at least as "
            "much, or a smaller view"
        )
    return joined_tree(store, reached)


def joined_tree(store: Store, numbers: np.ndarray) -> tuple[Bvh, np.ndarray]:
    """The tree over some chunks of a store: (Bvh, index in the whole scene of each of its triangles).

    Raises
    ------
    InputError
        If the tree is deeper than a stack of the tracers.
    """
    chunks = [bvh_of(store.chunk(int(k)).tree) for k in numbers]
    top = Bvh(*store.top, np.arange(len(store), dtype=np.int32), np.empty((0, 9), np.float32))
    above = leaf_depths(top) * (len(store) > 1)  # a single chunk needs no top tree
    if any(above[k] + leaf_depths(chunk).max() > MAX_DEPTH for k, chunk in zip(numbers, chunks)):
        raise InputError(f"{store.meta.name}: its tree has more than {MAX_DEPTH} levels; steps cannot be counted")
    ids = np.unique(np.concatenate([chunk.prim_ids for chunk in chunks])) if chunks else np.empty(0, np.int32)
    return _join_trees(store.top.nodes, len(store), numbers, chunks, ids), ids


def _reached_chunks(paged: Paged, queries: Sequence[ShadowQuery]) -> np.ndarray:
    """The chunks whose boxes segments enter, whether or not they are blocked before."""
    scheduled, k = paged.accelerated.prepared, len(paged.store)
    reached = np.zeros(k, np.bool_)
    for query in queries:
        bits = new_bits(query)
        for step in segments_of(scheduled.parts, query):
            rays = SegmentRaySets(scheduled.parts, scheduled.options, step, bits, paged.threads)
            for s in range(rays.sets):
                screen = np.full(k, len(rays.tiles.spans) - 1, np.int32)  # the tile that covers the whole screen
                pairs = Pairs(screen, np.full(k, s, np.int32), np.arange(k, dtype=np.int32))
                reached |= answer_queries(rays.rays, scheduled.parts.heads, pairs, 0, paged.threads).counts > 0
    return np.flatnonzero(reached)


def _join_trees(top: np.ndarray, k: int, reached: np.ndarray, chunks: list[Bvh], ids: np.ndarray) -> Bvh:
    """Join the top tree of k chunks and the trees of those reached; `top`: see `store.store_file.TopTree`."""
    m = len(top) if k > 1 else 0  # a single chunk needs no top tree
    sizes = np.array([0, *(len(chunk.nodes) for chunk in chunks)])
    firsts = m + np.cumsum(sizes)
    nodes = aligned_empty((max(int(firsts[-1]), 1), 16), "f4")
    links, slots = nodes.view(np.int32)[:, CHILDREN], 0
    if not chunks:
        nodes[0], links[0] = 0.0, EMPTY
        nodes[0, 0:12:4] = nodes[0, 1:12:4] = np.inf
        nodes[0, 2:12:4] = nodes[0, 3:12:4] = -np.inf
        return Bvh(nodes[:1], nodes[:1].view(np.int32), np.empty(0, np.int32), np.empty((0, 9), np.float32))
    if m:
        root_of = np.full(k, EMPTY, np.int64)
        root_of[reached] = firsts[:-1]
        nodes[:m] = top
        leaf = (links[:m] < 0) & (links[:m] != EMPTY)
        links[:m][leaf] = root_of[bvh_leaf(links[:m][leaf]).first]
    for first, end, chunk in zip(firsts[:-1], firsts[1:], chunks):
        nodes[first:end] = chunk.nodes
        chunk_links = links[first:end]
        is_full, leaf = (chunk_links < 0) & (chunk_links != EMPTY), bvh_leaf(chunk_links)
        moved = bvh_link(leaf.first + slots, leaf.count)
        chunk_links[...] = np.where(is_full, moved, np.where(chunk_links >= 0, chunk_links + int(first), chunk_links))
        slots += len(chunk.prim_ids)
    prim_ids = np.searchsorted(ids, np.concatenate([chunk.prim_ids for chunk in chunks])).astype(np.int32)
    corners = np.concatenate([chunk.corners for chunk in chunks])
    return Bvh(nodes, nodes.view(np.int32), prim_ids, corners)
