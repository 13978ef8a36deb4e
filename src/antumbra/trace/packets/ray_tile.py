"""Ray tiles: the rays of a tile as 16 rows of 16, for all tracers whose lanes are rays.

Rows. In packets over pixels, a row is a stratum, and its lanes are the receivers. In packets and frusta with a common
origin, a row is a receiver, and its lanes are the receiver's samples.

Incoherent samples. If the samples of a stratum are as far apart as the whole light, or in all directions, neither
shafts nor beams cull anything, and multi-frusta tracing falls back to packets through the tree of blocks. The 16 lanes
are the rays of one receiver to the points of a list, or the rays of 16 receivers in one direction of the hemisphere. At
a block, each ray in turn is tested against all triangles side by side.

Packets also trace scenes with large coordinates, for which shafts overflow float32, because they multiply three
lengths.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.block_tree import BlockTree
from ...bvh.nodes import MAX_DEPTH, block_leaf, boxes_of
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import new_ticket, run, thread_count
from ...kernels.simd import broadcast16, get, lowest_bit, ptr_at, put, store
from ...kernels.vec3 import broadcasts, rows, subtract3
from ...query.shadow_query import ShadowQuery
from ...scene.lights import AMBIENT, FIXED, is_list
from ..counters import TRIANGLES, count, new_counters
from ..horizon import apply_horizon
from ..light_table import POINTS, STRATA, LightTable, light_table
from ..tile import (
    TILE_FLOATS,
    Tile,
    TileShape,
    fill_lanes,
    first_pixel,
    load_receivers,
    move_light,
    query_chunk_of,
    read_bits,
    sets_of,
    tile_at,
    tile_shape,
    transpose_bits,
    write_bits,
)
from ..tree_list import TREE
from ..triangle_tests import Block, blocks_ray, deferred_ints, resolve_deferred

# --- The rays of a tile -----------------------------------------------------------------------------------------------


STACK = 4 * MAX_DEPTH
_AT = TREE + 1
SCRATCH_FLOATS = TILE_FLOATS + POINTS
_STACK_AT = 32 + (_AT + 15) // 16 * 16  # offset of the stack, after `dead` and `pixel`, 16 int32 each, and `at`
SCRATCH_INTS = _STACK_AT + STACK + deferred_ints(1)


class SampleRows(NamedTuple):
    """The light samples of a query, arranged for tiles."""

    table: LightTable
    parameters: np.ndarray  # (chunks, 16 receivers, 2, 16 samples) float32: (a, b) on the light's patch


class RayTileJob(NamedTuple):
    """The data shared by all tiles of a run."""

    shape: TileShape
    chunk: int  # number of the chunk
    n_samples: int  # in the chunk
    by_sample: bool  # whether the lanes of a row are one receiver's samples; otherwise 16 receivers
    fresh: bool  # True: no ray has been tested yet; False: the bits mark the rays known to be blocked


class RayTileScratch(NamedTuple):
    """A thread's memory."""

    tile: F32Ptr  # float32, one `Tile`
    pixel: I32Ptr  # int32, its first pixel: see `tile.first_pixel`
    origins: F32Ptr  # float32, each receiver's origin in all 16 lanes
    stack: I32Ptr  # int32
    at: I32Ptr  # int32, see `descent.save`; then the number of the tree
    dead: I32Ptr  # int32, one per receiver: bits of its blocked samples
    deferred: I32Ptr  # int32, see `triangle_tests.deferred_ints`


class TileRays(NamedTuple):
    """The rays of a tile: pointers."""

    tile: Tile
    pixel: I32Ptr  # int32: y and x of its first pixel
    origins: F32Ptr  # float32 x, y, z of 16 lanes; row r at r * stride
    stride: int  # float32 between the origins of two rows
    points: F32Ptr  # float32 x, y, z of 16 lanes; row r at r * 48
    dead: I32Ptr  # int32, one per row: bits of the blocked rays
    rows: int  # bits of the rows that hold rays
    lanes: int  # bits of the lanes that hold rays
    row_place: int  # step of `triangle_tests.defer`'s place from row to row
    lane_place: int  # step of the place from lane to lane


@inlined
def scratch_in(floats, ints):
    """`RayTileScratch` in SCRATCH_FLOATS float32 and SCRATCH_INTS int32 on the stack of a kernel."""
    return RayTileScratch(
        floats,
        ptr_at(ints, 16),
        ptr_at(floats, TILE_FLOATS),
        ptr_at(ints, _STACK_AT),
        ptr_at(ints, 32),
        ints,
        ptr_at(ints, _STACK_AT + STACK),
    )


@inlined
def query_chunk_in(query, samples, job):
    """The `QueryChunk` of a job."""
    return query_chunk_of(query, samples.table, job.shape, job.chunk, job.n_samples)


@kernel
def by_receiver(tile, scratch):
    """Fill the receivers' origins. Return the points of the receivers' samples."""
    for r in range(16):
        for k in range(3):
            store(scratch.origins, r * 48 + 16 * k, broadcast16(tile.origins, 16 * k + r))
    transpose_bits(tile.dead, scratch.dead)
    return tile.by_lane


@inlined
def rays_by_stratum(chunk, scratch, valid):
    """The `TileRays` of the tile in scratch memory where rows are strata; valid: bits of the lanes with a receiver."""
    tile, strata = tile_at(scratch.tile, 0, chunk), (1 << chunk.n_samples) - 1
    return TileRays(
        tile, scratch.pixel, tile.origins, 0, tile.points, tile.dead, strata if valid != 0 else 0, valid, 16, 1
    )


@kernel
def read_tile(job, chunk, n, scratch, known, counters):
    """Read tile n. Rays that the receivers' own surfaces surely block are marked as dead.

    Return bits of the lanes with a receiver. (Kernels return no pointers: where several call one, these would be in
    memory, whose pointers have another size in WebAssembly.)

    known : pointer to the bits of all receivers; ignored if the job is fresh
    """
    y0, x0 = n // job.shape.columns * job.shape.height, n % job.shape.columns * job.shape.width
    tile = tile_at(scratch.tile, 0, chunk)
    put(scratch.pixel, 0, y0)
    put(scratch.pixel, 1, x0)
    put(scratch.deferred, 0, 0)
    valid = load_receivers(chunk, y0, x0, tile)
    if valid != 0:
        fill_lanes(tile, valid)
        if not chunk.fixed:
            move_light(chunk, y0, x0, valid, tile)
        if job.fresh:
            apply_horizon(chunk, y0, x0, valid, tile, scratch.deferred, counters)
        else:
            read_bits(chunk, y0, x0, valid, tile, known)
    return valid


@inlined
def start_tile(job, chunk, n, scratch, known, counters):
    """The `TileRays` of tile n, which `read_tile` reads."""
    valid = read_tile(job, chunk, n, scratch, known, counters)
    if valid != 0 and job.by_sample:
        tile, strata = tile_at(scratch.tile, 0, chunk), (1 << chunk.n_samples) - 1
        points = by_receiver(tile, scratch)
        return TileRays(tile, scratch.pixel, scratch.origins, 48, points, scratch.dead, valid, strata, 1, 16)
    return rays_by_stratum(chunk, scratch, valid)


@inlined
def origins_of(rays, r):
    """Origins of the rays of row r."""
    return rows(rays.origins, r * rays.stride, 16)


@inlined
def directions_of(rays, r):
    """Directions of the rays of row r: from the origins to the samples, rounded once."""
    return subtract3(rows(rays.points, r * 48, 16), origins_of(rays, r))


@inlined
def open_rays(rays, r):
    """Bits of the rays of row r that are not blocked so far."""
    return rays.lanes & ~get(rays.dead, r)


@inlined
def rows_are_receivers(rays):
    """Whether the rows are receivers; otherwise strata."""
    return rays.stride != 0


@kernel
def settle(tree, chunk, rays, scratch, counters):
    """Settle the deferred tests, and update `rays.dead`."""
    if get(scratch.deferred, 0) == 0:
        return
    if rows_are_receivers(rays):
        transpose_bits(rays.dead, rays.tile.dead)
    resolve_deferred(tree.corners, chunk, scratch.tile, scratch.pixel, scratch.deferred, counters)
    if rows_are_receivers(rays):
        transpose_bits(rays.tile.dead, rays.dead)


@kernel
def finish_tile(chunk, rays, out):
    """Set the bits of the tile's blocked rays; `out`: pointer to all bits."""
    if rows_are_receivers(rays):
        transpose_bits(rays.dead, rays.tile.dead)
    valid = rays.rows if rows_are_receivers(rays) else rays.lanes
    if rays.rows != 0:
        y0, x0 = first_pixel(rays.pixel, 0)
        write_bits(chunk, y0, x0, valid, rays.tile, out)


def _samples(query: ShadowQuery, sets: NDArray[np.int64]) -> SampleRows:
    table = light_table(query, sets)
    chunks, spp = len(table.points), query.samples.shape[1]
    known = np.minimum(np.arange(chunks * STRATA), spp - 1)
    parameters = query.samples[sets][:, known, :2].astype(np.float32).reshape(16, chunks, STRATA, 2)
    return SampleRows(table, np.ascontiguousarray(parameters.transpose(1, 0, 3, 2)))


_BUNDLE = 4  # tiles that a worker may trace together
_SHARES, _MOST = 256, 64  # shares of a query's tiles that threads take, and tiles in each


class TileRun(NamedTuple):
    """A worker, and how it runs over the tiles of a query."""

    worker: Callable[..., None]
    by_sample: bool  # whether rows are receivers; otherwise strata
    threads: int | None
    counters: NDArray[np.int64] | None
    progress: ProgressCallback | None
    fresh: bool = True  # True: no ray has been tested yet; False: the bits mark the rays known to be blocked
    chunks: range | None = None  # range of the chunks of samples; None: all


def trace_tiles(tiles: TileRun, tree: object, query: ShadowQuery, bits: NDArray[np.uint64], *options: object) -> None:
    """Run ``worker(ticket, tree, query, samples, job, bits, counters, *options)`` over all tiles, chunk by chunk."""
    counters = new_counters() if tiles.counters is None else tiles.counters
    shape, spp = tile_shape(query), query.samples.shape[1]
    samples = _samples(query, sets_of(shape))
    for chunk in range(-(-spp // STRATA)) if tiles.chunks is None else tiles.chunks:
        count = min(STRATA, spp - chunk * STRATA)
        job = RayTileJob(shape, chunk, count, tiles.by_sample, tiles.fresh)
        n = shape.columns * shape.rows
        ticket = new_ticket(n, min(max(n // _SHARES // _BUNDLE * _BUNDLE, _BUNDLE), _MOST))
        arrays = tree, query, samples, job, bits, counters
        run(tiles.worker, thread_count(tiles.threads), ticket, *arrays, *options, progress=tiles.progress)


# --- Incoherent samples -----------------------------------------------------------------------------------------------


_WIDE = 0.1  # beyond this fraction of a chunk's extents, a stratum is too wide for a shaft
_HUGE = 0.5  # beyond this fraction of the scene's extents, a chunk is too wide for shafts, and packets are faster
_LARGE = 0.1  # the same limit for queries of fewer than _FEW samples
_FEW = 8  # with fewer samples, tiles do not share a traversal
_FAR = 2.0**40  # up to this coordinate, products of three differences and their sums do not overflow


def sample_extents(query: ShadowQuery) -> tuple[np.float64, np.float64]:
    """Mean extents of a patch's samples, summed over the axes: (of a stratum, of a chunk)."""
    points = query.samples @ np.stack([query.light.u, query.light.v, query.light.w])
    low, high = points.min(0), points.max(0)  # (n, 3) of each stratum
    chunks = np.arange(0, len(low), STRATA)
    extents = np.maximum.reduceat(high, chunks) - np.minimum.reduceat(low, chunks)
    return (high - low).sum(1).mean(), extents.sum(1).mean()


def is_incoherent(query: ShadowQuery) -> bool:
    """True if the samples of a stratum are far apart: hemisphere directions, or scattered points of a list."""
    if not is_list(query.light):
        return bool(query.light.kind == AMBIENT)
    stratum, chunk = sample_extents(query)
    return bool(stratum > _WIDE * chunk)


def extents_of(tree: BlockTree) -> NDArray[np.float32]:
    """(3,) float32: the extents of a `BlockTree`."""
    low, high = boxes_of(tree.nodes[:1])[0]
    extents: NDArray[np.float32] = high - low
    return extents


def is_huge(query: ShadowQuery, extents: NDArray[np.float32]) -> bool:
    """True if a chunk of a lamp's samples spans a large fraction of a tree's `extents`.

    Frusta then contain much of the tree. The limit is lower for few samples, because a shaft then has few rays.
    """
    if query.light.kind != FIXED:
        return False
    limit = _LARGE if query.samples.shape[1] < _FEW else _HUGE
    return bool(sample_extents(query)[1] > limit * extents.sum())


def is_far(query: ShadowQuery, box: NDArray[np.float32]) -> bool:
    """True if a coordinate of the query, or of the triangles' (2, 3) box, may be too large for shafts in float32."""
    light = query.light
    far = np.abs(box).max() + np.abs(light.base).max() + 3.0 * light.radius
    far += max(1.0, np.abs(query.samples).max()) * np.abs([light.u, light.v, light.w]).sum()
    if query.sides.shape[0] == 1:  # receivers in a row may be anywhere; pixels' receivers lie on triangles
        far += np.abs(query.origins).max(initial=0.0)
    return not far <= _FAR


@kernel
def trace_block(tree, row, link, mask, deferred, counters):
    """Test the rays of a `packet16.Row` in `mask` (bits) against a block. Return bits of the blocked rays."""
    # In: tree, row, link, mask. Out: deferred, counters.
    (rays, r, facing), (block, triangles) = row, block_leaf(link)
    b = Block(tree, block, (1 << triangles) - 1, 0, facing, None, deferred)
    hits = 0
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        count(counters, TRIANGLES, triangles)
        o, place = broadcasts(rays.origins, r * rays.stride + lane, 16), r * rays.row_place + lane * rays.lane_place
        d = subtract3(broadcasts(rays.points, r * 48 + lane, 16), o)
        if blocks_ray(b, o, d, get(rays.tile.faces, r if rows_are_receivers(rays) else lane), place, counters):
            hits |= 1 << lane
    return hits
