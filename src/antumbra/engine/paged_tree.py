"""The tree of a store as one `Bvh`, as far as the segments of some queries reach: for `antumbra explain`."""

from collections.abc import Sequence

import numpy as np

from ..bvh.links import CHILDREN, bvh_leaf, bvh_link
from ..bvh.nodes import EMPTY, MAX_DEPTH, Bvh, aligned_empty
from ..errors import InputError
from ..query.shadow_query import ShadowQuery, new_bits
from ..store.store_format import Chunk
from ..store.system_resources import resident
from ..techniques.chcrt.occlusion_queries import Pairs, ask
from ..techniques.chcrt.picture_ray_sets import SegmentRaySets, segments_of
from ..trace.rays.single_rays import leaf_depths
from .paged import Paged

_BYTES = 140  # memory of a triangle while the tree is made


def tree_for(paged: Paged, queries: Sequence[ShadowQuery]) -> tuple[Bvh, np.ndarray]:
    """The tree over the chunks that segments may enter: (Bvh, indices in the whole scene of its prim_ids).

    Other chunks are missing children, so each ray takes the same steps as through the whole tree.

    Raises
    ------
    InputError
        If memory does not hold the tree.
    """
    store = paged.store
    wanted = _reached(paged, queries)
    need = int(store.chunks.triangles[wanted].sum()) * _BYTES + resident() - paged.residency.held
    if need > paged.max_memory:
        raise InputError(
            f"{paged.scene.name}: the trees that these rays may enter take {need >> 20}M of memory; give at least as "
            "much, or a smaller view"
        )
    chunks = [store.chunk(int(k)) for k in wanted]
    ids = np.unique(np.concatenate([chunk.bvh.prim_ids for chunk in chunks])) if chunks else np.empty(0, np.int32)
    bvh = _joined(store.top.nodes, len(store), wanted, chunks, ids)
    if leaf_depths(bvh).max(initial=0) > MAX_DEPTH:
        raise InputError(f"{paged.scene.name}: its tree has more than {MAX_DEPTH} levels, so no steps can be counted")
    return bvh, ids


def _reached(paged: Paged, queries: Sequence[ShadowQuery]) -> np.ndarray:
    """The chunks whose boxes segments meet, whether or not something blocks them before."""
    scheduled, k = paged.accelerated.prepared, len(paged.store)
    met = np.zeros(k, np.bool_)
    for query in queries:
        bits = new_bits(query)
        for step in segments_of(scheduled.parts, query):
            how = {"threads": paged.threads, "counters": None, "progress": None}
            rays = SegmentRaySets(scheduled.parts, scheduled.options, query, bits, *step, **how)
            for s in range(rays.sets):
                screen = np.full(k, len(rays.tiles.spans) - 1, np.int32)  # the tile that is the whole screen
                pairs = Pairs(screen, np.full(k, s, np.int32), np.arange(k, dtype=np.int32))
                met |= ask(rays.rays, scheduled.parts.heads, pairs, 0, True, paged.threads).counts > 0
    return np.flatnonzero(met)


def _joined(top: np.ndarray, k: int, wanted: np.ndarray, chunks: list[Chunk], ids: np.ndarray) -> Bvh:
    """One tree of a top tree and some of k chunks; `top`: see `store.store_file.TopTree`."""
    m = len(top) if k > 1 else 0  # the top tree of one chunk is not needed
    sizes = np.array([0, *(len(chunk.bvh.nodes) for chunk in chunks)])
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
        root_of[wanted] = firsts[:-1]
        nodes[:m] = top
        leaf = (links[:m] < 0) & (links[:m] != EMPTY)
        links[:m][leaf] = root_of[bvh_leaf(links[:m][leaf]).first]
    for first, end, chunk in zip(firsts[:-1], firsts[1:], chunks):
        nodes[first:end] = chunk.bvh.nodes
        own = links[first:end]
        is_full, leaf = (own < 0) & (own != EMPTY), bvh_leaf(own)
        moved = bvh_link(leaf.first + slots, leaf.count)
        own[...] = np.where(is_full, moved, np.where(own >= 0, own + int(first), own))
        slots += len(chunk.bvh.prim_ids)
    prim_ids = np.searchsorted(ids, np.concatenate([chunk.bvh.prim_ids for chunk in chunks])).astype(np.int32)
    corners = np.concatenate([chunk.bvh.corners for chunk in chunks])
    return Bvh(nodes, nodes.view(np.int32), prim_ids, corners)
