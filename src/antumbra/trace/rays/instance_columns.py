"""Columns of rays in copies: 64 rays of a batch, each in the scene's frame and in that of the copy it is in.

Each ray has two columns of a `RayBlock`: the rows of all rays in the scene's frame come first, and those in copies
follow. Both have the rows that box tests and packets read.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.exact.filters import BEYOND
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, inlined
from ...kernels.simd import get, lowest_bit, ptr_at, put
from .instance_traversal import (
    LATER,
    InstanceHit,
    InstanceQuery,
    copy_limit,
    filter_bounds,
    map_ray,
    slab,
    slab_margins,
    test_triangle,
)
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    DX,
    FAR,
    FLOOR,
    INVERSE,
    LANES,
    LIMIT,
    LOWER,
    NEAR,
    OX,
    TMIN,
    UNIT,
    block_of,
    ray_of,
)

RAYS = BLOCKS * LANES
WORLD = BLOCKS * BLOCK_WORDS  # words of all rays in the scene's frame; those in copies follow
COLUMN_WORDS, CORNER_WORDS, ID_WORDS = 2 * WORLD, 9 * (RAYS + 1), 3 * RAYS  # sizes of memory
SLACK = LOWER  # row of rays in copies, see `lines_may_pass`


class CopyFrames(NamedTuple):
    """The frames of the copies that 64 rays are in: pointers to scratch memory."""

    starts: F64Ptr  # float64 *: t of each ray where it enters its copy
    scales: F64Ptr  # float64 *: t in the copy's frame, per t; 0: hits do not limit the search


class BatchHits(NamedTuple):
    """The hits of 64 rays, as a tree for `hit_reports`: the triangle of ray i is in slot i."""

    prim_ids: I32Ptr  # int32 *: scene index of each ray's face
    slots: I32Ptr  # not used
    corners: F32Ptr  # float32 *, 9 per ray, then 9 of the triangle that is tested
    t: F64Ptr  # float64 *: see `InstanceHit`
    ids: I64Ptr  # int64 *, 3 per ray: see `InstanceHit`


@inlined
def column_of(i):
    """The word of ray i in the rows of its frame."""
    return i // LANES * BLOCK_WORDS + i % LANES


@inlined
def fill_column(scene, blocks, i, copy, start, hits, frames):
    """Write the column of ray i in a copy, from t = `start` on, or from its tmin."""
    ray = ray_of(block_of(blocks, i // LANES), i % LANES)
    r, rows = map_ray(scene, copy, ray, max(ray.tmin, start)), ptr_at(blocks.rows, WORLD + column_of(i))
    fits, along, pad = slab_margins(r.o, r.d, r.reach, r.shift)
    for k in range(3):
        inverse, near, far = slab(r.o[k], r.d[k], along, pad, fits)
        put(rows, INVERSE + LANES * k, inverse)
        put(rows, NEAR + LANES * k, near)
        put(rows, FAR + LANES * k, far)
        put(rows, OX + LANES * k, r.o[k])
        put(rows, DX + LANES * k, r.d[k])
    unit, floor, slack = filter_bounds(r)
    put(rows, UNIT, unit)
    put(rows, FLOOR, floor)
    put(rows, SLACK, slack)
    put(rows, TMIN, np.float32(0.0))
    put(rows, LIMIT, copy_limit(r, get(hits.t, i)))
    put(frames.starts, i, r.start)
    put(frames.scales, i, r.scale if r.tame else np.float64(0.0))


@inlined
def settle_lanes(scene, blocks, i, copy, first, lanes, query, hits, frames):
    """Test ray i against triangles of a copy, exactly. Return whether this ends the ray's any-hit query.

    lanes : bits of the triangles of the mesh's tree from lane `first` on
    """
    block = block_of(blocks, i // LANES)
    hit = InstanceHit(hits.corners, np.int64(RAYS), np.int64(i), ptr_at(hits.t, i), ptr_at(hits.ids, 3 * i))
    question = InstanceQuery(np.int64(get(block.skip, i % LANES)), query.cull_faces, query.any_hit)
    ray = ray_of(block, i % LANES)
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        if test_triangle(scene, copy, first + lane, ray, question, hit, None):
            if query.any_hit:
                return True
            _shorten(blocks.rows, i, get(hits.t, i), frames)
    return False


@inlined
def _shorten(rows, i, t, frames):
    """Limit the search of ray i to triangles that may be nearer than t."""
    put(rows, column_of(i) + LIMIT, np.float32(t * BEYOND))
    scale = get(frames.scales, i)
    if scale != 0.0:
        local = (t * BEYOND - get(frames.starts, i)) * scale
        put(rows, WORLD + column_of(i) + LIMIT, np.float32(local * LATER))
