"""Primary rays by multi-frusta tracing: the G-buffer by ray tracing, the same bits as the rasteriser's.

A tile of 32 x 16 pixels is 16 frusta of 8 x 4 pixels, which go through a `BlockTree` together, front to back, each up
to the farthest of what its pixels see [Benthin and Wald 2009, Sec. 4]. Blocks are culled and tested by halves of
frusta, *cells* of 4 x 4 pixels: one for each lane. For each pixel the tile keeps the triangle in front and an interval
of its depth key 1 / t; what float32 cannot decide is put aside, and settled by the contract's own predicates after each
block. The float64 t of what is seen is computed once, after the tree (`finish`).

What is traced is a forest (`trace.forest`): each tile goes through the trees of its list, one after the other, and may
do so again with another list, from what it has seen already.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.blocks import BlockTree, block_tree
from ...bvh.nodes import MAX_DEPTH, boxes_of
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import new_ticket, run, take, thread_count
from ...kernels.simd import bits, get, load16, popcount, ptr, put, stack_f32, stack_f64, stack_i32, store
from ...query.raster_setup import direction_error, make_view
from ..blocktest import fetch
from ..forest import Forest, Hits, forest_pointers, item, list_of, root_in, tree_in, whole
from .frusta import FLOATS, bound_directions, meet_mixed, meet_uniform, prepare
from .pixelblock import ASIDE, CELLS, PIXELS, Pixels, trace_block
from .pixelsetup import HEIGHT, WIDTH, WORK, frame_of
from .pixelstate import keep, resume, settle, shorten, start
from .resolve import KNOWN_FLOATS, KNOWN_PLANES, MARK_WORDS, PLANE_FLOATS, Seen, finish

_F = np.float32
_DEPTH = 2 * MAX_DEPTH
_ENTRIES = 16 * _DEPTH
_NO_BLOCK = -1  # the link of a block of no triangles
_SUPER = 4  # tiles of a square that is traced in Morton order


class PictureSeen(NamedTuple):
    """What is asked, and what is known of it."""

    rays: object  # CameraRays
    hits: Hits
    camera: object  # View
    error: object  # of directions
    scale: float


class _Tile(NamedTuple):
    """A tile of frusta."""

    x0: int  # first pixel
    y0: int
    frame: object
    alive: int  # bits of the frusta that have pixels
    one_way: bool  # do they go one way along each axis?
    uniforms: object  # then


class _Scratch(NamedTuple):
    """Pointers to a thread's memory."""

    pixels: Pixels
    seen: Seen
    slabs: object
    work: object  # for a block
    stack: object
    entries: object  # where the frusta enter what is on the stack


@kernel
def _walk(forest, k, alive, picture, tile, scratch):
    """Trace the frusta in `alive` (bits) through tree k. Each block waits until the next one is found, while memory
    fetches it."""
    tree, link = tree_in(forest, k), root_in(forest, k)
    nodes, links, rays, hits, scale = tree.nodes, tree.links, picture.rays, picture.hits, picture.scale
    pixels, slabs, stack, entries = scratch.pixels, scratch.slabs, scratch.stack, scratch.entries
    mask, height = alive, np.int64(0)
    waiting, waiting_mask = np.int64(_NO_BLOCK), np.int64(0)
    while True:
        if link >= 0:
            far, at = load16(pixels.far, 0), link * 16
            if tile.one_way:
                near_l, left = meet_uniform(nodes, at, tile.uniforms, far)
                near_r, right = meet_uniform(nodes, at + 1, tile.uniforms, far)
            else:
                near_l, left = meet_mixed(nodes, at, slabs, far)
                near_r, right = meet_mixed(nodes, at + 1, slabs, far)
            left &= mask
            right &= mask
            if left | right != 0:
                first, second = np.int64(get(links, at + 12)), np.int64(get(links, at + 13))
                if left != 0:
                    fetch(tree, first)
                if right != 0:
                    fetch(tree, second)
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
            seen = trace_block(tile.frame, tree, ~ready >> 5, ~ready & 31, ready_mask, pixels, scratch.work)
            if get(pixels.aside, 0) != 0:
                settle(pixels, forest, k, rays, tile.x0, tile.y0, scale, ptr(hits.face), ptr(hits.t))
                seen = True
            if seen:
                shorten(pixels, _F(scale))
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


@inlined
def _start(picture, x0, y0, fresh, scratch):
    """The tile at pixel (x0, y0), where nothing is known of it, or what is."""
    rays, hits = picture.rays, picture.hits
    if fresh:
        alive = start(scratch.pixels, x0, y0, rays)
    else:
        alive = resume(scratch.pixels, x0, y0, rays, ptr(hits.face), ptr(hits.t), picture.scale)
    bound_directions(rays, picture.error, x0, y0, scratch.slabs)
    frame = frame_of(picture.camera, x0, y0, picture.scale)
    one_way, uniforms = prepare(scratch.slabs, frame.eye)
    return _Tile(x0, y0, frame, alive, one_way, uniforms)


@kernel
def _trace_tile(forest, begin, end, picture, tile, scratch):
    """The frusta of a tile through the trees begin .. end of the lists."""
    pixels, new = scratch.pixels, forest.fresh
    for i in range(begin, end):
        k, far = item(forest, i), load16(pixels.far, 0)
        if tile.one_way:
            met = meet_uniform(forest.heads, k * 16, tile.uniforms, far)[1]
        else:
            met = meet_mixed(forest.heads, k * 16, scratch.slabs, far)[1]
        met &= tile.alive
        if met != 0:
            _walk(forest, k, met, picture, tile, scratch)
            new |= keep(pixels, k)
    if new:
        finish(pixels, forest, picture.rays, tile.x0, tile.y0, scratch.seen, picture.hits)


@kernel
def _trace_tiles(ticket, arrays, picture, across):
    """Worker: whole tiles, each by one thread."""
    pixels = Pixels(
        stack_f32(PIXELS), stack_f32(PIXELS), stack_i32(PIXELS), stack_f32(CELLS), stack_f32(16), stack_i32(PIXELS),
        stack_i32(PIXELS), stack_i32(ASIDE),
    )  # fmt: skip
    seen = Seen(
        stack_f64(PLANE_FLOATS), stack_i32(PIXELS), stack_f64(KNOWN_FLOATS), stack_i32(KNOWN_PLANES),
        stack_i32(MARK_WORDS),
    )  # fmt: skip
    scratch = _Scratch(pixels, seen, stack_f32(FLOATS), stack_f32(WORK), stack_i32(_DEPTH), stack_f32(_ENTRIES))
    forest = forest_pointers(arrays)
    k = take(ticket)
    while k >= 0:
        x0, y0 = _place(k, across)
        if x0 < picture.rays.width and y0 < picture.rays.height:
            begin, end = list_of(forest, y0, x0, np.int64(0))
            if begin < end:
                tile = _start(picture, x0, y0, forest.fresh, scratch)
                _trace_tile(forest, begin, end, picture, tile, scratch)
        k = take(ticket)


def _scale(box, view) -> float:
    """A power of two that brings pixel coordinates to about 1; 0 where float32 has no room for it."""
    eye = np.array([view.eye_x, view.eye_y, view.eye_z])
    reach = np.abs(box.astype(np.float64) - eye).max() * max(view.norm_x, view.norm_y, view.norm_z)
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
    if not isinstance(tree, BlockTree):
        tree = block_tree(tree, threads)
    shape, nowhere = (rays.height, rays.width), np.empty((0, 0), np.int32)
    hits = Hits(np.empty(shape, np.int32), np.empty(shape), nowhere, nowhere)
    trace_hits(whole(tree), picture_seen(rays, boxes_of(tree.nodes[:1])[0], hits), thread_count(threads))
    return hits.face, hits.t


def picture_seen(rays, box: np.ndarray, hits: Hits) -> PictureSeen:
    """A camera's picture, ready to be traced.

    Parameters
    ----------
    rays : CameraRays
    box : (2, 3) float32
        Around all triangles.
    hits : Hits
        What is known, and what tracing changes.
    """
    view = make_view(rays)
    return PictureSeen(rays, hits, view, direction_error(rays), _scale(box, view))


def trace_hits(forest: Forest, picture: PictureSeen, threads: int) -> None:
    """Trace pixel-centre rays through a forest, from what they have hit already unless it is fresh.

    Parameters
    ----------
    forest : Forest
        Its tiles are at least 32 pixels wide and 16 high. If it is fresh, of the hits only the pixels of tiles that
        have trees are written.
    picture : PictureSeen
        Its hits are changed in place.
    """
    width, height = picture.rays.width, picture.rays.height
    across, down = -(-width // (WIDTH * _SUPER)), -(-height // (HEIGHT * _SUPER))
    ticket = new_ticket(across * down * _SUPER * _SUPER, 1)
    run(_trace_tiles, threads, ticket, forest, picture, across)
