"""Incoherent samples, as of interleaved point lights and the hemisphere: packets of rays through a tree of blocks.

If the samples of a stratum are as far apart as the whole light, or all around, neither shafts nor beams cull anything.
Then multi-frusta tracing falls back to rays. The 16 lanes are the rays of a receiver to the points of a list, or the
rays of 16 receivers in one direction of the hemisphere. At a block, each ray in turn is tested against the triangles
side by side.

Packets also trace far scenes. Shafts multiply three lengths, and float32 overflows for large coordinates.
"""

import numpy as np

from ...bvh.links import block_leaf
from ...bvh.nodes import boxes_of
from ...kernels.jit import kernel
from ...kernels.simd import get, lowest_bit
from ...kernels.vec import broadcasts, minus
from ...scene.lights import AMBIENT, FIXED, is_list
from ..blocktest import Block, blocks_ray
from ..counters import TRIANGLES, count
from ..lighttable import STRATA
from .raytile import rows_are_receivers

_WIDE = 0.1  # beyond this share of a chunk's extents, a stratum is too wide for a shaft
_HUGE = 0.5  # beyond this share of the scene's extents, a chunk is too wide for shafts: packets are faster
_LARGE = 0.1  # the same limit for queries of fewer than _FEW samples
_FEW = 8  # with fewer samples, tiles do not share a walk
_FAR = 2.0**40  # up to this coordinate, no product of three differences overflows, and no sum of such products


def sample_extents(query):
    """Mean extents of a patch's samples, summed over the axes: (of a stratum, of a chunk)."""
    points = query.samples @ np.stack([query.light.u, query.light.v, query.light.w])
    low, high = points.min(0), points.max(0)  # (n, 3) of each stratum
    chunks = np.arange(0, len(low), STRATA)
    whole = np.maximum.reduceat(high, chunks) - np.minimum.reduceat(low, chunks)
    return (high - low).sum(1).mean(), whole.sum(1).mean()


def is_incoherent(query) -> bool:
    """Are a stratum's samples far apart: directions of the hemisphere, or scattered points of a list?"""
    if not is_list(query.light):
        return query.light.kind == AMBIENT
    stratum, whole = sample_extents(query)
    return bool(stratum > _WIDE * whole)


def extents_of(tree) -> np.ndarray:
    """(3,) float32: the extents of a `BlockTree`."""
    low, high = boxes_of(tree.nodes[:1])[0]
    return high - low


def is_huge(query, extents) -> bool:
    """Do the samples of a lamp's chunk span a large part of a tree's `extents`? Then frusta contain much of the tree.

    With few samples a shaft has few rays, so the limit is lower.
    """
    if query.light.kind != FIXED:
        return False
    limit = _LARGE if query.samples.shape[1] < _FEW else _HUGE
    return bool(sample_extents(query)[1] > limit * extents.sum())


def is_far(query, box) -> bool:
    """May a coordinate of the query, or of the triangles' (2, 3) box, be too large for shafts in float32?"""
    light = query.light
    far = np.abs(box).max() + np.abs(light.base).max() + 3.0 * light.radius
    far += max(1.0, np.abs(query.samples).max()) * np.abs([light.u, light.v, light.w]).sum()
    if query.sides.shape[0] == 1:  # receivers in a row may be anywhere; pixels' receivers lie on triangles
        far += np.abs(query.origins).max(initial=0.0)
    return not far <= _FAR


@kernel
def trace_block(tree, rays, r, link, mask, facing, deferred, counters):
    """Test the rays of row r in `mask` (bits) against a block. Return bits of the rays that it blocks."""
    # In: tree, rays, r, link, mask, facing. Out: deferred, counters.
    block, triangles = block_leaf(link)
    b = Block(tree, block, (np.int64(1) << triangles) - 1, np.int64(0), facing, None, deferred)
    hits = np.int64(0)
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        count(counters, TRIANGLES, triangles)
        o, place = broadcasts(rays.origins, r * rays.stride + lane, 16), r * rays.row_place + lane * rays.lane_place
        d = minus(broadcasts(rays.points, r * 48 + lane, 16), o)
        if blocks_ray(b, o, d, get(rays.tile.faces, r if rows_are_receivers(rays) else lane), place, counters):
            hits |= np.int64(1) << lane
    return hits
