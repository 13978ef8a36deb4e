"""`primary:paper`: primary rays by multi-frusta tracing as published [Benthin and Wald 2009, Sec. 4.4, Appendix A].

A frustum is the 16 rays of 4 x 4 pixels, and a tile of 16 x 16 pixels is 16 frusta, which traverse the shallow tree at
once, nearer child first. Each ends at the farthest hit of its rays. Rays are made only in leaves, as the sum of the
frustum's *start* vector, its upper left ray, and a *delta* vector that is the same for all frusta. Triangles are culled
by the four corner rays of each frustum. Both sides of triangles are visible, so no back faces are culled.

`primary:entries` adds entry points for larger blocks, which the paper suggests (Sec. 7). The frusta of 4 x 4 tiles
traverse the top of the tree together, and each tile starts at the subtrees that its own frustum meets.
"""

from typing import NamedTuple

import numpy as np

from ....bvh.block_tree import BlockTree, block_pointers
from ....bvh.nodes import MAX_DEPTH, block_leaf, box_at, box_of_link_at, link_at, slot_at
from ....kernels.jit import F32Ptr, F32x16, I32Ptr, inlined, kernel
from ....kernels.parallel import items, new_ticket, run, thread_count
from ....kernels.simd import (
    bits,
    fma,
    get,
    load16,
    lowest_bit,
    maximum,
    minimum,
    popcount,
    ptr,
    ptr_at,
    put,
    reduce_max,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ....kernels.vec3 import Vec3, add3, broadcasts, dot, largest, rows
from ....query.gbuffer import pixel_direction
from ....scene.camera import CameraRays
from ....trace.counters import (
    BOX_TESTS,
    CANDIDATES,
    N_COUNTERS,
    NODES,
    RAYS,
    TRIANGLE_TESTS,
    TRIANGLES,
    add_counters,
    cleared,
    count,
    new_counters,
)
from ....trace.descent import (
    GROW,
    WAITING_FLOATS,
    WAITING_INTS,
    NearestStack,
    NearestTraversal,
    Shafts,
    after_visit,
    endless_slabs_of,
    entry,
    next_block,
)
from ....trace.triangle_tests import lanes_from, triangle_in
from .hit_intervals import LineTest, PixelRow, direction_bound, keep_hits, start_row, write_hits
from .published_frusta import prefers_right

# --- Frusta of a tile (Sec. 4.4) --------------------------------------------------------------------------------------
#
# A ray start + delta differs from the contract's direction by at most `off` along every axis: both are rounded, start
# and delta too, so by at most four units in the last place of the largest component of any direction. The factors of
# `off` are those of `published_frusta`.


_F = np.float32
_STARTS, _FAR, _LOWS, _HIGHS = 0, 48, 64, 64 + 256
_TILE_FLOATS = _HIGHS + 256


class FrustaCamera(NamedTuple):
    """A camera's rays, with bounds that all tiles share."""

    rays: CameraRays
    delta: np.ndarray  # (3, 16) float32: x, y, z of the delta vector
    off: np.float32  # largest error of a component of start + delta
    span: np.float32  # at least the sum of the magnitudes of a direction's components


class FrustaTile(NamedTuple):
    """A tile of 16 frusta: pointers to rows of 16 lanes."""

    starts: F32Ptr  # float32: x, y, z of the start vectors
    delta: F32Ptr  # float32: x, y, z of the delta vector
    far: F32Ptr  # float32: t beyond which no ray of a frustum has a nearer hit
    lows: F32Ptr  # float32: `PixelRow.low` of each frustum
    highs: F32Ptr
    slots: I32Ptr
    x0: int  # first pixel
    y0: int


def frusta_camera(rays: CameraRays) -> FrustaCamera:
    """The `FrustaCamera` of a camera's rays."""
    lane = np.arange(16)
    delta = (lane % 4) * rays.dx[:, None] + (lane // 4) * rays.dy[:, None]
    most = np.abs(rays.corner) + (rays.width + 64) * np.abs(rays.dx) + (rays.height + 64) * np.abs(rays.dy)
    off = _F(4.1 * 2.0**-24 * most.max() + 1e-37)
    return FrustaCamera(rays, np.ascontiguousarray(delta, _F), off, _F(1.001 * most.sum()))


@inlined
def _row_of(tile, f):
    """The `PixelRow` of frustum f."""
    at = 16 * f
    x, y = tile.x0 + 4 * (f & 3), tile.y0 + 4 * (f >> 2)
    return PixelRow(ptr_at(tile.lows, at), ptr_at(tile.highs, at), ptr_at(tile.slots, at), x, y)


@kernel
def _start_tile(rays, tile):
    """Fill a tile. Return bits of the frusta that have pixels."""
    alive = np.int64(0)
    for f in range(16):
        row = _row_of(tile, f)
        d = pixel_direction(rays, row.x0, row.y0)
        for k in range(3):
            put(tile.starts, 16 * k + f, d[k])
        alive |= np.int64(start_row(rays, row) != 0) << f
    store(tile.far, 0, splat16(_F(np.inf)))
    return alive


@inlined
def _corner_rays(tile, corner):
    """Corner ray 0 to 3 of each frustum: its rays 0, 3, 12 and 15."""
    return add3(rows(tile.starts, 0, 16), broadcasts(tile.delta, 3 * (corner & 1) + 12 * (corner >> 1), 16))


@inlined
def _slabs_of(origin, low, high):
    """`Slabs` of 16 endless frusta from one origin, whose directions lie between low and high."""
    x, y, z = splat16(origin[0]), splat16(origin[1]), splat16(origin[2])
    shafts = Shafts(x, y, z, x, y, z, low.x, low.y, low.z, high.x, high.y, high.z)
    return endless_slabs_of(shafts, np.int64(0xFFFF))


@inlined
def _widen(low, high, off):
    return Vec3(low.x - off, low.y - off, low.z - off), Vec3(high.x + off, high.y + off, high.z + off)


@inlined
def _least(a, b):
    return Vec3(minimum(a.x, b.x), minimum(a.y, b.y), minimum(a.z, b.z))


@inlined
def _greatest(a, b):
    return Vec3(maximum(a.x, b.x), maximum(a.y, b.y), maximum(a.z, b.z))


@inlined
def _tile_slabs(camera, tile):
    """The `Slabs` of a tile's frusta, bounded by their corner rays."""
    low = high = _corner_rays(tile, 0)
    for corner in range(1, 4):
        d = _corner_rays(tile, corner)
        low, high = _least(low, d), _greatest(high, d)
    low, high = _widen(low, high, camera.off * _F(2.0))
    return _slabs_of(camera.rays.origin, low, high)


# --- Leaf tests (Sec. 4.2) --------------------------------------------------------------------------------------------


class _Setup(NamedTuple):
    """A triangle seen from the common origin of all rays; f32x16."""

    cp: Vec3
    qc: Vec3
    n: Vec3
    t: F32x16
    e: F32x16  # error bounds as in `LineTest`, which include `off`
    te: F32x16
    de: F32x16


@inlined
def _setup(tree, slot, camera):
    o = camera.rays.origin
    origins, triangle = Vec3(splat16(o[0]), splat16(o[1]), splat16(o[2])), triangle_in(tree.corners, slot)
    lanes, v = lanes_from(origins, splat16(camera.span), triangle), triangle.v
    a = Vec3(v.x - origins.x, v.y - origins.y, v.z - origins.z)
    off, size = splat16(camera.off), triangle.size
    e = fma(off * maximum(largest(a), splat16(size)), splat16(size * _F(18.1)), lanes.e)
    de = fma(off, splat16(size * size * _F(6.1)), direction_bound(splat16(size), splat16(camera.span)))
    return _Setup(lanes.cp, lanes.qc, lanes.n, lanes.t, e, lanes.te, de)


@inlined
def _missed(tile, s):
    """Bits of the frusta whose corner rays show that none of their rays hits a triangle."""
    far = splat16(_F(np.inf))
    low0, low1, low2, low, high0, high1, high2, high = far, far, far, far, -far, -far, -far, -far
    for corner in range(4):
        d = _corner_rays(tile, corner)
        e2, e1, dn = dot(d, s.cp), dot(d, s.qc), dot(d, s.n)
        e0 = dn - e1 - e2
        low0, low1, low2, low = minimum(low0, e0), minimum(low1, e1), minimum(low2, e2), minimum(low, dn)
        high0, high1, high2, high = maximum(high0, e0), maximum(high1, e1), maximum(high2, e2), maximum(high, dn)
    some_up = maximum(maximum(low0, low1), low2) > s.e
    some_down = minimum(minimum(high0, high1), high2) < -s.e
    above, below = s.t > s.te, s.t < -s.te
    return bits((above & (some_down | (high < -s.de))) | (below & (some_up | (low > s.de))) | (some_up & some_down))


@inlined
def _test_frustum(tree, slot, camera, tile, f, s, counters):
    """Test the rays of frustum f against a triangle. Return whether a hit may have changed."""
    count(counters, TRIANGLE_TESTS, 1)
    row = _row_of(tile, f)
    d = add3(broadcasts(tile.starts, f, 16), rows(tile.delta, 0, 16))
    test = LineTest(dot(d, s.qc), dot(d, s.cp), dot(d, s.n), s.t, s.e, s.te, s.de)
    return keep_hits(tree, slot, camera.rays, row, test, 0xFFFF, counters)


@inlined
def _shorten(tile, updated):
    """Update the farthest hits of the frusta in `updated` (bits)."""
    while updated != 0:
        f = lowest_bit(updated)
        updated &= updated - 1
        put(tile.far, f, reduce_max(load16(tile.highs, 16 * f)) * GROW)


@kernel
def _trace_leaf(tree, link, mask, camera, tile, counters):
    """Test the triangles of a leaf against the frusta in `mask`."""
    leaf, updated = block_leaf(link), np.int64(0)
    for i in range(leaf.count):
        slot = get(tree.slots, slot_at(leaf.block, i))
        s = _setup(tree, slot, camera)
        active = mask & ~_missed(tile, s)
        count(counters, TRIANGLES, 1)
        if active == 0:
            continue
        count(counters, CANDIDATES, 1)
        while active != 0:
            f = lowest_bit(active)
            active &= active - 1
            updated |= np.int64(_test_frustum(tree, slot, camera, tile, f, s, counters)) << f
    _shorten(tile, updated)


@kernel
def _walk(tree, slabs, at, camera, tile, waiting, counters):
    """Trace the frusta of a traversal's state through its subtree."""
    at = next_block(tree, slabs, at, waiting, load16(tile.far, 0), counters)
    while at.mask != 0:
        _trace_leaf(tree, at.link, at.mask, camera, tile, counters)
        at = next_block(tree, slabs, after_visit(at), waiting, load16(tile.far, 0), counters)


# --- Entry points of 4 x 4 tiles (Sec. 7) -----------------------------------------------------------------------------
#
# Lanes are tiles. A subtree that few tiles meet, or a leaf, is an entry point; others are opened. Entry points are in
# the order of the traversal, nearer child first.


_TILES = 4  # tiles per side of a block
_FEW = 4  # subtrees that fewer tiles meet are entry points
_MOST = 256  # entry points of a block
_ENTRY_INTS = 2 * _MOST + 2 * MAX_DEPTH


class EntryPoints(NamedTuple):
    """Pointers to the entry points of a block."""

    places: I32Ptr  # int32: where each subtree's link is stored, then bits of the tiles that meet it, alternating
    stack: I32Ptr  # int32: subtrees to visit, in the same form


@kernel
def _tile_frusta(rays, off, x0, y0):
    """`Slabs` of the 4 x 4 tiles of the block at pixel (x0, y0), each bounded by one frustum."""
    memory = stack_f32(96)
    for f in range(16):
        x, y = x0 + 16 * (f & 3), y0 + 16 * (f >> 2)
        for corner in range(4):
            d = pixel_direction(rays, x + 15 * (corner & 1), y + 15 * (corner >> 1))
            for k in range(3):
                low, high = get(memory, 16 * k + f), get(memory, 48 + 16 * k + f)
                put(memory, 16 * k + f, d[k] if corner == 0 or d[k] < low else low)
                put(memory, 48 + 16 * k + f, d[k] if corner == 0 or d[k] > high else high)
    low, high = _widen(rows(memory, 0, 16), rows(memory, 48, 16), off)
    return _slabs_of(rays.origin, low, high)


@kernel
def _find_entries(tree, slabs, entries, counters):
    """Write the entry points of a block. Return their number."""
    link, place, mask, height, n = np.int64(0), np.int64(-1), np.int64(0xFFFF), 0, 0
    far = splat16(_F(np.inf))
    while True:
        opens = link >= 0 and (popcount(mask) >= _FEW or place < 0) and n + height // 2 + 2 <= _MOST
        if not opens:
            put(entries.places, 2 * n, place)
            put(entries.places, 2 * n + 1, mask)
            n += 1
            mask = np.int64(0)
        else:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, 2)
            left, near_left = entry(tree.nodes, box_at(link, 0), slabs, far)
            right, near_right = entry(tree.nodes, box_at(link, 1), slabs, far)
            left, right = left & mask, right & mask
            turn = left == 0 or (right != 0 and prefers_right(near_left, near_right, left & right) > 0)
            if left != 0 and right != 0:
                put(entries.stack, height, link_at(link, 0 if turn else 1))
                put(entries.stack, height + 1, left if turn else right)
                height += 2
            place, mask = link_at(link, 1 if turn else 0), right if turn else left
        if mask == 0:
            if height == 0:
                return n
            height -= 2
            place, mask = np.int64(get(entries.stack, height)), np.int64(get(entries.stack, height + 1))
        link = np.int64(get(tree.links, place))


# --- Tracing ----------------------------------------------------------------------------------------------------------


@kernel
def _trace_tile(tree, camera, tile, number, entries, waiting, counters):
    """Trace a tile from the root, or, if there are `entries`, from those that tile `number` of its block meets."""
    n, points = entries
    alive = _start_tile(camera.rays, tile)
    if alive == 0:
        return
    slabs = _tile_slabs(camera, tile)
    if n < 0:
        _walk(tree, slabs, NearestTraversal(np.int64(0), alive, np.int64(0)), camera, tile, waiting, counters)
    for i in range(n):
        if get(points.places, 2 * i + 1) >> number & 1 != 0:
            place = get(points.places, 2 * i)
            count(counters, BOX_TESTS, 1)
            met = entry(tree.nodes, box_of_link_at(place), slabs, load16(tile.far, 0))[0] & alive
            if met != 0:
                at = NearestTraversal(np.int64(get(tree.links, place)), met, np.int64(0))
                _walk(tree, slabs, at, camera, tile, waiting, counters)


@kernel
def _write_tile(tree, rays, tile, face, t, counters):
    for f in range(16):
        row = _row_of(tile, f)
        alive = bits(load16(row.high, 0) > _F(-np.inf))
        count(counters, RAYS, popcount(alive))
        write_hits(tree, rays, row, alive, face, t)


@kernel
def _trace_blocks(ticket, arrays, camera, with_entries, face, t, counters):
    """Worker: trace blocks of 4 x 4 tiles."""
    tree, totals, rays = block_pointers(arrays), cleared(stack_i64(N_COUNTERS)), camera.rays
    side = 16 * _TILES
    across = (rays.width + side - 1) // side
    floats, slots, ints = stack_f32(_TILE_FLOATS), stack_i32(256), stack_i32(_ENTRY_INTS)
    waiting = NearestStack(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    points = EntryPoints(ints, ptr_at(ints, 2 * _MOST))
    for k in items(ticket):
        x0, y0, n = k % across * side, k // across * side, np.int64(-1)
        if with_entries:
            n = np.int64(_find_entries(tree, _tile_frusta(rays, camera.off, x0, y0), points, totals))
        for number in range(_TILES * _TILES):
            x, y = x0 + 16 * (number & 3), y0 + 16 * (number >> 2)
            if x < rays.width and y < rays.height:
                far, lows, highs = ptr_at(floats, _FAR), ptr_at(floats, _LOWS), ptr_at(floats, _HIGHS)
                tile = FrustaTile(floats, ptr(camera.delta), far, lows, highs, slots, x, y)
                _trace_tile(tree, camera, tile, number, (n, points), waiting, totals)
                _write_tile(tree, rays, tile, ptr(face), ptr(t), totals)
    add_counters(counters, totals)


def trace_frusta(
    tree: BlockTree,
    rays: CameraRays,
    threads: int | None = None,
    counters: np.ndarray | None = None,
    entries: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest hits (face, t) of the pixel-centre rays, as from `trace_primary`.

    entries : whether tiles start at entry points of blocks of 64 x 64 pixels
    """
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    side = 16 * _TILES
    ticket = new_ticket(-(-rays.width // side) * -(-rays.height // side), 1)
    counters = new_counters() if counters is None else counters
    run(_trace_blocks, thread_count(threads), ticket, tree, frusta_camera(rays), entries, face, t, counters)
    return face, t
