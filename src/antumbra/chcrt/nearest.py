"""The nearest hits of one ray a pixel, through lists of parts [Mattausch et al. 2015, Sec. 5.2].

Packets of 4 x 4 neighbours go down each part together, the nearer child first. Each ray goes only as far as its nearest
hit so far. At a block, each ray is tested against all triangles side by side. If float32 cannot decide a test, float64
does. Float64 also decides which hit is nearest, as everywhere (`trace.rays.traverse.walk`). The lowest triangle index
wins ties.
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple

import numpy as np

from ..bvh.blocks import ROWS as BLOCK_ROWS
from ..kernels.fields import F32Ptr, F64Ptr, I32Ptr
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take
from ..kernels.predicate.exact import ray_along
from ..kernels.predicate.filters import hit_t, meets
from ..kernels.simd import (
    get,
    load16,
    lowest_bit,
    ptr,
    ptr_at,
    put,
    stack_f32,
    stack_f64,
    stack_i32,
)
from ..kernels.vec import broadcasts, rows
from ..trace.descent import (
    WAITING_FLOATS,
    WAITING_INTS,
    Near,
    Waiting,
    entry,
    next_block,
    rays_as_shafts,
    slabs_of,
    visited,
)
from ..trace.forest import Hits, forest_pointers, item, list_of, root_in, tree_in
from ..trace.raytest import ray_meets
from .camera import BEYOND
from .cells import (
    FAR,
    WORDS,
    Picture,
    first_receiver,
    new_cells,
    no_cell,
    nothing_yet,
    put_cell,
    region_in,
    regions_in,
    wider,
)

_F = np.float32
_SMALLEST, _EXPONENT = np.float32(2.0**-126), np.int32(0x7F800000)


class PictureRays(NamedTuple):
    """A `query.diffuse.RayPass` as a picture, (h, w) pixels."""

    origins: np.ndarray  # (h, w, 3) float32
    directions: np.ndarray  # (h, w, 3) float32; zero: there is no ray
    skip: np.ndarray  # (h, w) int32: triangles that do not count, -1 for none


class Looks(NamedTuple):
    """How far the rays of a pass look.

    A ray's *length* is a power of two. This multiple of its direction takes the ray out of the scene.
    """

    lengths: np.ndarray  # (h, w) float32
    limits: np.ndarray  # (h, w) float32, in lengths; -1 where there is no ray


class Cell(NamedTuple):
    """The 16 rays of a cell: pointers to scratch memory."""

    rays: F32Ptr  # float32: rows ox oy oz, and the whole length of the rays along x, y and z
    limits: F32Ptr  # float32
    t: F64Ptr  # float64
    face: I32Ptr  # int32
    part: I32Ptr  # int32
    slot: I32Ptr  # int32
    own: I32Ptr  # int32: the triangle that does not count, -1 for none


@kernel
def _measure(ticket, directions, reach, lengths, bits_, limits):
    """Worker: write the lengths of rays, row by row of pixels, and limits of one length.

    bits_ : the bits of `lengths`; clearing the fraction bits rounds a number down to a power of two
    """
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            for x in range(directions.shape[1]):
                d = directions[y, x]
                size = max(abs(d[0]), max(abs(d[1]), abs(d[2])))
                there = size > _F(0.0)
                lengths[y, x] = max(_F(4.0 * reach / np.float64(size if there else _F(1.0))), _SMALLEST)
                limits[y, x] = _F(1.0) if there else _F(-1.0)
            for x in range(directions.shape[1]):
                bits_[y, x] &= _EXPONENT
        y0 = take(ticket)


def looks_of(rays: PictureRays, reach: float, threads: int) -> Looks:
    """`Looks` of rays that have hit nothing yet; `reach`: no ray is longer inside the scene."""
    shape = rays.skip.shape
    lengths, limits = np.empty(shape, _F), np.empty(shape, _F)
    run(_measure, threads, new_ticket(shape[0], 8), rays.directions, reach, lengths, lengths.view(np.int32), limits)
    return Looks(lengths, limits)


@inlined
def _load(picture, rays, hits, looks, y0, x0, cell):
    """Fill a cell. Return bits of its rays."""
    valid = np.int64(0)
    for lane in range(16):
        y, x = y0 + lane // picture.shape.width, x0 + lane % picture.shape.width
        inside = y < picture.h and x < picture.w
        y, x = (y, x) if inside else (y0, x0)
        length = looks.lengths[y, x]
        for k in range(3):
            put(cell.rays, 16 * k + lane, rays.origins[y, x, k])
            put(cell.rays, 48 + 16 * k + lane, rays.directions[y, x, k] * length)
        limit = looks.limits[y, x]
        there = inside and limit >= _F(0.0)
        put(cell.limits, lane, limit if there else _F(-1.0))
        put(cell.t, lane, hits.t[y, x])
        put(cell.face, lane, hits.face[y, x])
        put(cell.part, lane, hits.part[y, x])
        put(cell.slot, lane, hits.slot[y, x])
        put(cell.own, lane, rays.skip[y, x])
        if there:
            valid |= np.int64(1) << lane
    return valid


@inlined
def _write(picture, hits, looks, y0, x0, valid, cell):
    while valid != 0:
        lane = lowest_bit(valid)
        valid &= valid - 1
        y, x = y0 + lane // picture.shape.width, x0 + lane % picture.shape.width
        looks.limits[y, x], hits.t[y, x] = get(cell.limits, lane), get(cell.t, lane)
        hits.face[y, x], hits.part[y, x], hits.slot[y, x] = (
            get(cell.face, lane), get(cell.part, lane), get(cell.slot, lane)
        )  # fmt: skip


@kernel
def _meets(cell, lane, length, corners, slot):
    """Whether a ray meets a triangle, exactly."""
    return meets(_ray(cell, lane, length), corners, slot) != 0


@inlined
def _ray(cell, lane, length):
    f = np.float64
    c, s = cell.rays, 1.0 / f(length)
    return ray_along(
        get(c, lane), get(c, 16 + lane), get(c, 32 + lane),
        f(get(c, 48 + lane)) * s, f(get(c, 64 + lane)) * s, f(get(c, 80 + lane)) * s, 0.0, np.inf,
    )  # fmt: skip


@kernel
def _keep(cell, lane, length, tree, k, slot):
    """Keep a triangle that a ray meets, if it is the nearest so far."""
    prim = get(tree.prim_ids, slot)
    if prim == get(cell.own, lane):
        return
    t, best = hit_t(_ray(cell, lane, length), tree.corners, slot), get(cell.t, lane)
    if t < best or (t == best and prim < get(cell.face, lane)):
        put(cell.t, lane, t)
        put(cell.face, lane, prim)
        put(cell.part, lane, k)
        put(cell.slot, lane, slot)
        limit = _F(t / np.float64(length) * BEYOND)
        if limit < get(cell.limits, lane):
            put(cell.limits, lane, limit)


@kernel
def _trace_block(tree, k, code, mask, cell, lengths):
    """Test the rays in `mask` against a block."""
    numbers, base, present = ptr_at(tree.blocks, (code >> 5) * (BLOCK_ROWS * 16)), (code >> 5) * 16, code & 31
    present = (np.int64(1) << present) - 1
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        o, d = broadcasts(cell.rays, lane, 16), broadcasts(cell.rays, 48 + lane, 16)
        hit, unsure = ray_meets(o, d, numbers, np.int64(0), get(cell.limits, lane))
        hit, unsure = hit & present, unsure & present
        while hit | unsure != 0:
            i = lowest_bit(hit | unsure)
            slot, length = np.int64(get(tree.slots, base + i)), get(lengths, lane)
            if hit >> i & 1 != 0 or _meets(cell, lane, length, tree.corners, slot):
                _keep(cell, lane, length, tree, k, slot)
            hit, unsure = hit & ~(np.int64(1) << i), unsure & ~(np.int64(1) << i)


@kernel
def _walk(tree, k, link, mask, slabs, cell, lengths, waiting):
    """Trace the rays in `mask` through a tree, from a link on."""
    # In: tree, k, link, mask, slabs, lengths. Out: cell. Scratch: waiting.
    at = next_block(tree, slabs, Near(link, mask, np.int64(0)), waiting, load16(cell.limits, 0))
    while at.mask != 0:
        _trace_block(tree, k, ~at.link, at.mask, cell, lengths)
        at = next_block(tree, slabs, visited(at), waiting, load16(cell.limits, 0))


@inlined
def _trace_cell(forest, begin, end, valid, cell, lengths, waiting):
    """Trace the rays of a cell through the parts of a list."""
    # In: forest, begin, end, valid, lengths. Out: cell. Scratch: waiting.
    d = rows(cell.rays, 48, 16)
    slabs = slabs_of(rays_as_shafts(rows(cell.rays, 0, 16), d), valid)
    for i in range(begin, end):
        k = item(forest, i)
        mask = entry(forest.heads, k * 16, slabs, load16(cell.limits, 0))[0] & valid
        if mask != 0:
            _walk(tree_in(forest, k), k, root_in(forest, k), mask, slabs, cell, lengths, waiting)


@inlined
def _lengths_of(picture, looks, y0, x0, lengths):
    for lane in range(16):
        y, x = y0 + lane // picture.shape.width, x0 + lane % picture.shape.width
        put(lengths, lane, looks.lengths[y, x] if y < picture.h and x < picture.w else _F(1.0))


@kernel
def _trace(ticket, arrays, spans, tiles, columns, picture, rays, hits, looks, cells):
    """Worker: trace all cells of some screen tiles, and update how far they look."""
    # In: arrays, spans, tiles, columns, picture, rays. In and out: hits, looks, cells.
    cell = Cell(stack_f32(96), stack_f32(16), stack_f64(16), stack_i32(16), stack_i32(16), stack_i32(16), stack_i32(16))
    waiting = Waiting(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    lengths, forest = stack_f32(16), forest_pointers(arrays)
    t = take(ticket)
    while t >= 0:
        span = spans[tiles[t]]
        for j in range(regions_in(span)):
            region = region_in(span, j, columns)
            out = ptr_at(ptr(cells), region * WORDS)
            for g in range(16):
                y, x = first_receiver(picture, region, g)
                if y >= picture.h or x >= picture.w:
                    continue
                valid = _load(picture, rays, hits, looks, y, x, cell)
                if valid != 0:
                    _lengths_of(picture, looks, y, x, lengths)
                    begin, end = list_of(forest, y, x, np.int64(0))
                    _trace_cell(forest, begin, end, valid, cell, lengths, waiting)
                    _write(picture, hits, looks, y, x, valid, cell)
                    far = _F(-1.0)
                    for lane in range(16):
                        far = max(far, get(cell.limits, lane))
                    put(out, FAR * 16 + g, far)
        t = take(ticket)


def trace_nearest(
    forest, spans, tiles, picture: Picture, rays: PictureRays, hits: Hits, looks: Looks, cells, threads
) -> None:
    """Trace the rays of some tiles through their lists, and update `hits`, `looks` and `cells`."""
    ticket, columns = new_ticket(len(tiles), 1), picture.layout.columns
    run(_trace, threads, ticket, forest, spans, tiles, columns, picture, rays, hits, looks, cells)


@kernel
def _bound(ticket, picture, rays, looks, cells):
    """Worker: write the cells of regions."""
    region = take(ticket)
    while region >= 0:
        out = ptr_at(ptr(cells), region * WORDS)
        for g in range(16):
            y0, x0 = first_receiver(picture, region, g)
            (low, high), (d_low, d_high), n = nothing_yet(), nothing_yet(), 0
            for y in range(y0, min(y0 + picture.shape.height, picture.h)):
                for x in range(x0, min(x0 + picture.shape.width, picture.w)):
                    if looks.limits[y, x] >= _F(0.0):
                        o, d, s = rays.origins[y, x], rays.directions[y, x], looks.lengths[y, x]
                        low, high = wider(low, high, (o[0], o[1], o[2]))
                        d_low, d_high = wider(d_low, d_high, (d[0] * s, d[1] * s, d[2] * s))
                        n += 1
            if n == 0:
                no_cell(out, g)
            else:
                put_cell(out, g, low, high, d_low, d_high, _F(1.0), _F(n))
        region = take(ticket)


def bound_rays(picture: Picture, rays: PictureRays, looks: Looks, threads: int) -> np.ndarray:
    """The cells of a pass, (1, regions, ROWS, 16)."""
    cells = new_cells(picture, 1)
    run(_bound, threads, new_ticket(cells.shape[1], 1), picture, rays, looks, cells)
    return cells
