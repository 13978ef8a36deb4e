"""Samples that lie anywhere, as interleaved point lights and a hemisphere: packets of rays through a tree of blocks.

Where the samples of a stratum are as far apart as those of the whole light, or all around, its shaft culls nothing, and
neither does a beam. Then multi-frusta tracing falls back to rays. The 16 lanes are a receiver's rays to the points of a
list, or those of 16 receivers in one direction of the hemisphere; at a block each ray in turn is tested against the
triangles, side by side.

They also trace what is far: shafts multiply three lengths, which float32 does not hold from some coordinates on.
"""

import numpy as np

from ...bvh.nodes import boxes_of
from ...kernels.jit import kernel
from ...kernels.simd import get, lowest_bit
from ...kernels.vec import broadcasts, minus
from ...scene.lights import AMBIENT, FIXED, LIST
from ..blocktest import Block, blocks_ray
from ..counters import TRIANGLES, count
from ..lighttable import STRATA
from .raytile import rows_are_receivers

_WIDE = 0.1  # of a chunk's extents, those of a stratum from which on it is not worth a shaft
_HUGE = 0.5  # of the scene's extents, those of a chunk from which on packets are faster ...
_LARGE = 0.1  # ... and from which on they are with less samples than ...
_FEW = 8  # ... these, with which tiles do not share a walk
_FAR = 2.0**40  # coordinates up to this cannot overflow in a product of three of their differences, nor in sums of such


def _extents(query):
    """Means of the sums of the extents of a patch's samples: (of a stratum, of a chunk)."""
    points = query.samples @ np.stack([query.light.u, query.light.v, query.light.w])
    low, high = points.min(0), points.max(0)  # (n, 3) of each stratum
    chunks = np.arange(0, len(low), STRATA)
    whole = np.maximum.reduceat(high, chunks) - np.minimum.reduceat(low, chunks)
    return (high - low).sum(1).mean(), whole.sum(1).mean()


def is_incoherent(query) -> bool:
    """Are a stratum's samples far apart: a wide cone of the hemisphere, or points of a list that are?"""
    if query.light.kind != LIST:
        return query.light.kind == AMBIENT
    stratum, whole = _extents(query)
    return bool(stratum > _WIDE * whole)


def extents_of(tree) -> np.ndarray:
    """(3,) float32: the extents of a `BlockTree`."""
    low, high = boxes_of(tree.nodes[:1])[0]
    return high - low


def is_huge(query, extents) -> bool:
    """Do a lamp's samples, those of a chunk, span a good part of a tree's `extents`, so that frusta hold much of it?

    Of few samples a shaft has so few rays that less of the tree is too much.
    """
    if query.light.kind != FIXED:
        return False
    limit = _LARGE if query.samples.shape[1] < _FEW else _HUGE
    return bool(_extents(query)[1] > limit * extents.sum())


def is_far(query, box) -> bool:
    """May a coordinate of the query, or of the (2, 3) box of the triangles, be too large for float32's shafts?"""
    light = query.light
    far = np.abs(box).max() + np.abs(light.base).max() + 3.0 * light.radius
    far += max(1.0, np.abs(query.samples).max()) * np.abs([light.u, light.v, light.w]).sum()
    if query.sides.shape[0] == 1:  # receivers that are not pixels may be anywhere; those that are lie on triangles
        far += np.abs(query.origins).max(initial=0.0)
    return not far <= _FAR


@kernel
def trace_block(tree, rays, r, code, mask, facing, deferred, counters):
    """Test the rays of row r that are in `mask` against a block; bits of those that it blocks."""
    b = Block(tree, code >> 5, (np.int64(1) << (code & 31)) - 1, np.int64(0), facing, None, deferred)
    hits = np.int64(0)
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        count(counters, TRIANGLES, code & 31)
        o, place = broadcasts(rays.origins, r * rays.stride + lane, 16), r * rays.row_place + lane * rays.lane_place
        d = minus(broadcasts(rays.points, r * 48 + lane, 16), o)
        if blocks_ray(b, o, d, get(rays.tile.faces, r if rows_are_receivers(rays) else lane), place, counters):
            hits |= np.int64(1) << lane
    return hits
