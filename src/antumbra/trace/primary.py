"""Primary rays by multi-frusta tracing: the G-buffer by ray tracing, the same bits as the rasteriser's.

A tile of 32 x 16 pixels is 16 frusta of 8 x 4 pixels, which go through a `BlockTree` together, front to back, each up
to the farthest of what its pixels see [Benthin and Wald 2009, Sec. 4]. Blocks are culled and tested by halves of
frusta, *cells* of 4 x 4 pixels: one for each lane. For each pixel the tile keeps the triangle in front and an interval
of its depth key 1 / t; what float32 cannot decide is put aside, and settled by the contract's own predicates after each
block. The float64 t of what is seen is computed once, at the end (`finish`).
"""

import numpy as np

from ..bvh.blocks import ROWS, BlockTree, block_pointers, block_tree
from ..bvh.nodes import MAX_DEPTH
from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take, thread_count
from ..predicate.filters import meets
from ..query.pixels import pixel_ray
from ..query.raster_depth import NO_PLANE, eye_plane, plane_t
from ..query.raster_setup import direction_error, make_view
from ..simd import (
    bits,
    get,
    iota16,
    load16,
    lowest_bit,
    minimum,
    popcount,
    prefetch,
    ptr,
    put,
    reduce_min,
    select,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    store,
)
from .finish import KNOWN, KNOWN_FLOATS, MARK_WORDS, PLANE_FLOATS, Seen, finish
from .frusta import FLOATS, GROW, bound_directions, meet_mixed, meet_uniform, prepare
from .pixelblock import ASIDE, CELLS, PIXELS, Pixels, first_pixel, trace_block
from .pixelsetup import HEIGHT, WIDTH, WORK, frame_of

_F = np.float32
_DEPTH = 2 * MAX_DEPTH
_ENTRIES = 16 * _DEPTH
_NO_BLOCK = -1  # the link of a block of no triangles
_SUPER = 4  # tiles of a square that is traced in Morton order
_NEXT_BELOW, _NEXT_ABOVE, _TINY = 1.0 - 2.0**-22, 1.0 + 2.0**-22, 1e-37  # more than rounding a key to float32 loses
_LARGEST = 1e30  # more than a depth key that float32 computes


@inlined
def _start(pixels, x0, y0, rays):
    """Nothing is seen yet; bits of the frusta that have pixels."""
    alive = np.int64(0)
    for cell in range(CELLS):
        x, y = first_pixel(cell)
        inside = ((iota16() & 3) < rays.width - x0 - x) & ((iota16() >> 2) < rays.height - y0 - y)
        store(pixels.low, 16 * cell, select(inside, splat16(_F(-np.inf)), splat16(_F(np.inf))))
        store(pixels.high, 16 * cell, splat16(_F(-np.inf)))
        store(pixels.slot, 16 * cell, splat16(np.int32(-1)))
        put(pixels.least, cell, _F(-np.inf) if bits(inside) != 0 else _F(np.inf))
        if bits(inside) != 0:
            alive |= np.int64(1) << (cell & 15)
    store(pixels.far, 0, splat16(_F(np.inf)))
    put(pixels.aside, 0, 0)
    return alive


@kernel
def _settle(pixels, tree, rays, x0, y0, scale):
    """Let the contract decide the pixels that were put aside."""
    o, touched = rays.origin, np.int64(0)
    mine, other = NO_PLANE, NO_PLANE
    for k in range(np.int64(get(pixels.aside, 0))):
        slot, entry = np.int64(get(pixels.aside, 2 + 2 * k)), np.int64(get(pixels.aside, 3 + 2 * k))
        at = entry >> 1
        (x, y), lane = first_pixel(at >> 4), at & 15
        ray = pixel_ray(rays, x0 + x + (lane & 3), y0 + y + (lane >> 2))
        if entry & 1 == 0 and meets(ray, tree.corners, slot) == 0:
            continue
        if slot != mine.triangle:
            mine = eye_plane(tree.corners, slot, o)
        t, best = plane_t(mine, ray, tree.corners), np.int64(get(pixels.slot, at))
        if best >= 0:
            if best != other.triangle:
                other = eye_plane(tree.corners, best, o)
            best_t = plane_t(other, ray, tree.corners)
            if best_t < t or (best_t == t and get(tree.prim_ids, best) < get(tree.prim_ids, slot)):
                continue
        key = 1.0 / (t * scale) if scale > 0.0 else 0.0
        low = key * _NEXT_BELOW - _TINY if scale > 0.0 else -np.inf
        put(pixels.low, at, low if low < _LARGEST else _LARGEST)
        put(pixels.high, at, key * _NEXT_ABOVE + _TINY if scale > 0.0 else np.inf)
        put(pixels.slot, at, slot)
        touched |= np.int64(1) << (at >> 4)
    put(pixels.aside, 0, 0)
    while touched != 0:
        cell = lowest_bit(touched)
        touched &= touched - 1
        put(pixels.least, cell, reduce_min(load16(pixels.low, 16 * cell)))


@inlined
def _shorten(pixels, scale):
    """What some frusta see has come nearer."""
    least, far = minimum(load16(pixels.least, 0), load16(pixels.least, 16)), load16(pixels.far, 0)
    store(pixels.far, 0, select(least > _F(0.0), _F(1.0) / (least * scale) * GROW, far))


@inlined
def _fetch(tree, link):
    """Ask for the node or the block behind a link; in large scenes, waiting for memory is what takes longest."""
    if link >= 0:
        prefetch(tree.nodes, link * 16)
        return
    block = ~link >> 5
    for row in range(ROWS):
        prefetch(tree.blocks, (block * ROWS + row) * 16)
    prefetch(tree.slots, block * 16)


@kernel
def _walk(tree, rays, frame, slabs, alive, pixels, x0, y0, scale, work, stack, entries):
    """Trace the frusta in `alive` (bits). Each block waits until the next one is found, while memory fetches it."""
    nodes, links = tree.nodes, tree.links
    one_way, uniforms = prepare(slabs, frame.eye)
    link, mask, height = np.int64(0), alive, np.int64(0)
    waiting, waiting_mask = np.int64(_NO_BLOCK), np.int64(0)
    while True:
        if link >= 0:
            far, at = load16(pixels.far, 0), link * 16
            if one_way:
                near_l, left = meet_uniform(nodes, at, uniforms, far)
                near_r, right = meet_uniform(nodes, at + 1, uniforms, far)
            else:
                near_l, left = meet_mixed(nodes, at, slabs, far)
                near_r, right = meet_mixed(nodes, at + 1, slabs, far)
            left &= mask
            right &= mask
            if left | right != 0:
                first, second = np.int64(get(links, at + 12)), np.int64(get(links, at + 13))
                if left != 0:
                    _fetch(tree, first)
                if right != 0:
                    _fetch(tree, second)
                mask = left
                if right != 0:
                    both = left & right
                    if left == 0:
                        first, mask = second, right
                    else:
                        swap = 2 * popcount(bits(near_r < near_l) & both) > popcount(both)
                        put(stack, 2 * height, first if swap else second)
                        put(stack, 2 * height + 1, left if swap else right)
                        store(entries, 16 * height, near_l if swap else near_r)
                        height += 1
                        first, mask = (second, right) if swap else (first, left)
                link = first
                continue
        ready, ready_mask = np.int64(_NO_BLOCK), np.int64(0)
        if link < 0:
            ready, ready_mask, waiting, waiting_mask = waiting, waiting_mask, link, mask
        if ~ready & 31 != 0:
            seen = trace_block(frame, tree, ~ready >> 5, ~ready & 31, ready_mask, pixels, work)
            if get(pixels.aside, 0) != 0:
                _settle(pixels, tree, rays, x0, y0, scale)
                seen = True
            if seen:
                _shorten(pixels, _F(scale))
        mask = np.int64(0)
        while mask == 0:
            if height == 0:
                if waiting == _NO_BLOCK:
                    return
                link = np.int64(_NO_BLOCK)
                break
            height -= 1
            mask = np.int64(get(stack, 2 * height + 1))
            mask &= bits(load16(entries, 16 * height) <= load16(pixels.far, 0))
            link = np.int64(get(stack, 2 * height))


@inlined
def _place(k, across):
    """First pixel (x0, y0) of tile k: squares of _SUPER x _SUPER tiles, each in Morton order."""
    square, k = k // (_SUPER * _SUPER), k % (_SUPER * _SUPER)
    x, y = square % across * _SUPER, square // across * _SUPER
    return WIDTH * (x + (k & 1) + (k >> 1 & 2)), HEIGHT * (y + (k >> 1 & 1) + (k >> 2 & 2))


@kernel
def _trace_tiles(ticket, arrays, rays, view, error, scale, across, face, t):
    """Worker: whole tiles, each by one thread."""
    pixels = Pixels(
        stack_f32(PIXELS), stack_f32(PIXELS), stack_i32(PIXELS), stack_f32(CELLS), stack_f32(16), stack_i32(ASIDE)
    )
    slabs, work, stack, entries = stack_f32(FLOATS), stack_f32(WORK), stack_i32(_DEPTH), stack_f32(_ENTRIES)
    seen = Seen(
        stack_f64(PLANE_FLOATS), stack_i32(PIXELS), stack_f64(KNOWN_FLOATS), stack_i32(KNOWN), stack_i32(MARK_WORDS)
    )
    tree = block_pointers(arrays)
    k = take(ticket)
    while k >= 0:
        x0, y0 = _place(k, across)
        alive = _start(pixels, x0, y0, rays)
        if alive != 0:
            bound_directions(rays, error, x0, y0, slabs)
            frame = frame_of(view, x0, y0, scale)
            _walk(tree, rays, frame, slabs, alive, pixels, x0, y0, scale, work, stack, entries)
            finish(pixels, tree, rays, x0, y0, seen, ptr(face), ptr(t))
        k = take(ticket)


def _scale(tree, view) -> float:
    """A power of two that brings pixel coordinates to about 1; 0 where float32 has no room for it."""
    eye = np.array([view.eye_x, view.eye_y, view.eye_z])
    bounds = tree.nodes[0, :12].astype(np.float64).reshape(3, 4)
    reach = np.abs(bounds - eye[:, None]).max() * max(view.norm_x, view.norm_y, view.norm_z)
    if not 1e-30 < reach < 1e30:
        return 0.0
    return float(2.0 ** -np.ceil(np.log2(reach)))


def trace_primary(tree, rays, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """What the pixel-centre rays see first.

    Parameters
    ----------
    tree : BlockTree, or Bvh
        Of a Bvh the `BlockTree` is made first.
    rays : CameraRays
    threads : int, optional
        None: all cores. The result does not depend on it.

    Returns
    -------
    face : (H, W) int32
        -1 on a miss. Of triangles at the same t, the one with the lowest index.
    t : (H, W) float64
        In lengths of the pixel's direction; inf on a miss.

    Raises
    ------
    InputError
        Where directions of neighbouring pixels are too close, as `rasterise` does.
    """
    view, error = make_view(rays), direction_error(rays)
    if not isinstance(tree, BlockTree):
        tree = block_tree(tree, threads)
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    across, down = -(-rays.width // (WIDTH * _SUPER)), -(-rays.height // (HEIGHT * _SUPER))
    ticket = new_ticket(across * down * _SUPER * _SUPER, 1)
    run(_trace_tiles, thread_count(threads), ticket, tree, rays, view, error, _scale(tree, view), across, face, t)
    return face, t
