"""Adaptive refinement: select pixels in penumbrae and at silhouettes, and split them into sixteen sub-pixels.

This follows [Benthin and Wald 2009, Sec. 5.4 and 6.1]. The sub-pixels of all selected pixels form a separate picture,
in which each selected pixel becomes a block of 4 x 4 pixels. So its sub-pixels use sixteen different sample sets, and
neighbours stay neighbours. This gives tracers coherent input: in multi-frusta tracing, a block is one group of 16
frusta [Benthin and Wald 2009, Sec. 6.1].
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import whole_number
from ..base.progress import check_interruption
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import bits, get, load8, lowest_bit, ptr, ptr_at, put
from ..scene.camera import CameraRays, ExplicitRays
from ..scene.light_lists import N_SETS
from ..scene.lights import MAX_SPP, Light
from ..scene.triangles import Triangles
from .gbuffer import GBuffer, face_normal, fill_pixel, pixel_direction, surface_of
from .light_samples import larcher_pillichshammer, light_samples
from .rasteriser import rasterise
from .ray_passes import RayPass, listed_pass
from .receivers import NOTHING
from .surface_links import BELOW, N_LINKS, RIGHT, PictureSurfaces, link_offset

# --- Pixels to refine [Benthin and Wald 2009, Sec. 5.4 and 6.1] -------------------------------------------------------


VISIBLE = np.float32(1.0 / 16.0)
"""Linear base colours form an edge if they differ by more than this in red, green or blue."""

NO_BOUNDARY, INNER, OUTLINE = np.int8(0), np.int8(1), np.int8(2)
"""Kinds of boundary between two neighbouring pixels; see `boundaries`."""


class FinerSamples(NamedTuple):
    """The samples of refined pixels, per light."""

    penumbra: list[np.ndarray]  # (16, n, 3) float64: one set per pixel
    edges: list[
        np.ndarray
    ]  # (16, ceil(n / 16), 3) float64: one set per sub-pixel; a pixel's sub-pixels share n samples


def finer_samples(lights: Sequence[Light], n: int, sampler: str, seed: int = 0) -> FinerSamples:
    """The samples for n shadow rays, 1 to 1024, per refined pixel; lights with a fixed number of samples keep it.

    Raises
    ------
    InputError
        If n is out of range, or the sampler is unknown.
    """
    n = whole_number(n, "adaptive", 1, MAX_SPP)
    shared = -(-n // N_SETS)
    return FinerSamples(
        [light_samples(s, n, sampler, seed) for s in lights], [light_samples(s, shared, sampler, seed) for s in lights]
    )


@inlined
def _differs(links, counts, i, count):
    """Whether a linked pixel next to pixel i has another count; `links`: pointer to the first pixel's."""
    linked, w = links
    for k in range(N_LINKS):
        down, right = link_offset(k)
        offset = down * w + right
        if down <= 1 and abs(right) <= 1:
            if (get(linked, i) >> k) & 1 and get(counts, i + offset) != count:
                return True
            if (get(linked, i - offset) >> k) & 1 and get(counts, i - offset) != count:
                return True
    return False


@kernel
def _penumbra_rows(ticket, links, side, counts, spp, out):
    linked, occluded, sides, refined = ptr_at(links.bits, links.pad), ptr(counts), ptr(side), ptr(out)
    for y in items(ticket):
        for i in range(y * links.w, (y + 1) * links.w):
            count = get(occluded, i)
            refine = 0 < count < spp or _differs((linked, links.w), occluded, i, count)
            put(refined, i, refine and get(sides, i) != NOTHING)


def penumbra(
    surfaces: PictureSurfaces, counts: NDArray[np.integer], spp: int, threads: int | None = None
) -> NDArray[np.bool_]:
    """(H, W) bool: pixels partly in shadow, or whose count differs from that of a neighbour on the same surface.

    counts : (H, W) int, how many of a pixel's `spp` samples of one light are occluded
    """
    threads, links = thread_count(threads), surfaces.links(threads)
    counts, out = np.ascontiguousarray(counts, np.int32), np.empty(counts.shape, np.bool_)
    run(_penumbra_rows, threads, new_ticket(len(out), 8), links, surfaces.side, counts, int(spp), out)
    return out


@inlined
def _other_colour(colour, i, k):
    """True if two faces (indices, or -1 for the background) have visibly different colours."""
    if i < 0 or k < 0:
        return i != k
    for c in range(3):
        if abs(colour[i, c] - colour[k, c]) > VISIBLE:
            return True
    return False


@inlined
def _boundary(surfaces, i, k, step):
    """The boundary between pixel i and that at the end of its link k, `step` pixels later."""
    links, faces, colour = surfaces
    face, other = get(faces, i), get(faces, i + step)
    if face == other:
        return NO_BOUNDARY
    if min(face, other) < 0:
        return OUTLINE
    linked = (get(links, i) >> k) & 1
    return INNER if not linked or _other_colour(colour, face, other) else NO_BOUNDARY


@inlined
def _boundaries_of(surfaces, i, n, k, step, out):
    """Write the boundaries of n pixels from pixel i on. Eight are compared at once, since few are boundaries."""
    bulk = n - n % 8
    for x in range(i, i + n):
        put(out, x, NO_BOUNDARY)
    for x in range(i, i + bulk, 8):
        other = bits(load8(surfaces[1], x) != load8(surfaces[1], x + step))
        while other != 0:
            lane = lowest_bit(other)
            put(out, x + lane, _boundary(surfaces, x + lane, k, step))
            other &= other - 1
    for x in range(i + bulk, i + n):
        put(out, x, _boundary(surfaces, x, k, step))


@kernel
def _boundary_rows(ticket, links, face, colour, below, right):
    surfaces, (h, w) = (ptr_at(links.bits, links.pad), ptr(face), colour), below.shape
    for y in items(ticket):
        _boundaries_of(surfaces, y * w, w - 1, RIGHT, 1, ptr(right))
        right[y, w - 1] = NO_BOUNDARY
        if y + 1 < h:
            _boundaries_of(surfaces, y * w, w, BELOW, w, ptr(below))
        else:
            for x in range(w):
                below[y, x] = NO_BOUNDARY


def boundaries(
    surfaces: PictureSurfaces, colour: NDArray[np.float32], threads: int | None = None
) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Two (H, W) int8: the boundary between each pixel and the pixel below it, and the pixel to its right.

    INNER between two surfaces or colours, OUTLINE between a surface and the background, otherwise NO_BOUNDARY.

    colour : (n, 3) float32, linear base colour of each face
    """
    threads, links = thread_count(threads), surfaces.adjacent_links(threads)
    below, right = (np.empty(surfaces.face.shape, np.int8) for _ in range(2))
    run(_boundary_rows, threads, new_ticket(len(below), 8), links, surfaces.face, colour, below, right)
    return below, right


def edges(surfaces: PictureSurfaces, colour: NDArray[np.float32], threads: int | None = None) -> NDArray[np.bool_]:
    """(H, W) bool: pixels with a direct neighbour on another surface, of another colour, or in the background.

    colour : (n, 3) float32, linear base colour of each face

    The paper finds silhouettes during traversal, as edges between a front-facing and a back-facing triangle. Visible
    silhouettes are discontinuities of the G-buffer, as are creases and intersections, which the paper's test misses.
    The G-buffer test needs no triangle adjacency, and does not mark hidden silhouettes. It misses objects narrower than
    a pixel that pass between all pixel centres.
    """
    below, right = boundaries(surfaces, colour, threads)
    out: NDArray[np.bool_] = (below | right) > 0
    out[1:] |= below[:-1] > 0
    out[:, 1:] |= right[:, :-1] > 0
    return out


# --- Sub-pixels -------------------------------------------------------------------------------------------------------


BLOCK = 4


def _offsets() -> np.ndarray:
    """(4, 4, 2) float64: x and y in (0, 1) of the sub-pixel in each row and column of a block.

    The points form a digital net: one per cell of 4 x 4, no two at the same x or y. So a moving edge of any direction,
    even a vertical one, crosses them one by one.
    """
    points = larcher_pillichshammer(BLOCK * BLOCK) + (0.0, 0.5 / BLOCK**2)
    column, row = (points * BLOCK).astype(int).T
    offsets = np.empty((BLOCK, BLOCK, 2))
    offsets[row, column] = points
    return offsets


OFFSETS = _offsets()


class _Subpixel(NamedTuple):
    """A sub-pixel of all selected pixels, with its place in their picture, and what its rays hit."""

    columns: int  # blocks per row of the picture
    row: int  # in a block
    column: int
    face: np.ndarray  # (H, W) int32, valid at the selected pixels
    t: np.ndarray  # (H, W) float64


@kernel
def _fill_subpixels(ticket, pixels, at, corners, rays, out):
    """Worker: write the surfaces of one sub-pixel of each pixel."""
    # In: pixels, (E, 2) int64; at, `_Subpixel`; corners, (n, 9) float32; rays, `CameraRays`. Out: out, `GBuffer`
    surface, width = surface_of(out), out.face.shape[1]
    for e in items(ticket):
        y, x = pixels[e]
        v, u = BLOCK * (e // at.columns) + at.row, BLOCK * (e % at.columns) + at.column
        i, t = at.face[y, x], at.t[y, x]
        if i >= 0:
            out.face[v, u], out.depth[v, u] = i, np.float32(t)
            normal = face_normal(ptr(corners), np.int64(i))
            fill_pixel(y, x, normal, t, rays, surface, v * width + u)


def subpixel_gbuffer(
    triangles: Triangles,
    rays: CameraRays,
    mask: NDArray[np.bool_],
    threads: int | None = None,
    hits: Callable[[CameraRays], tuple[NDArray[np.int32], NDArray[np.float64]]] | None = None,
) -> GBuffer:
    """The G-buffer of the sub-pixels of selected pixels.

    mask : (H, W) bool, with E true entries; row by row they become the blocks of a roughly square picture of
        (4 R, 4 C) pixels, whose last blocks are background if E < R C
    hits : returns (face, t) for `CameraRays`, valid where `mask` is True; None: `rasterise`

    The rasteriser runs once per sub-pixel, with the camera's window shifted so that the sub-pixel lies at the centre of
    its pixel. Rasterising the whole picture sixteen times takes about as long as tracing rays through a few per cent of
    its pixels, and needs no tree of all visible triangles.
    """
    threads = thread_count(threads)
    pixels = np.ascontiguousarray(np.argwhere(mask))
    shape = _shape(len(pixels))
    out, columns = _background(*shape, triangles.origin), shape[1] // BLOCK
    corners = triangles.vertices.reshape(-1, 9)
    for row, column in np.ndindex(BLOCK, BLOCK) if len(pixels) else ():
        check_interruption()
        shifted = _shifted(rays, row, column)
        face, t = rasterise(corners, shifted, threads) if hits is None else hits(shifted)
        ticket = new_ticket(len(pixels), 1024)
        run(_fill_subpixels, threads, ticket, pixels, _Subpixel(columns, row, column, face, t), corners, shifted, out)
    return out


@kernel
def _subpixel_rays(ticket, pixels, columns, row, column, rays, directions):
    """Worker: write the direction of one sub-pixel of each pixel."""
    for e in items(ticket):
        v, u = BLOCK * (e // columns) + row, BLOCK * (e % columns) + column
        d = pixel_direction(rays, pixels[e, 1], pixels[e, 0])
        directions[v, u, 0], directions[v, u, 1], directions[v, u, 2] = d


def subpixel_rays(
    rays: CameraRays | ExplicitRays, mask: NDArray[np.bool_], threads: int | None = None
) -> tuple[RayPass, tuple[int, int]]:
    """The rays of the sub-pixels of selected pixels, and the shape of their picture: see `subpixel_gbuffer`."""
    threads, pixels = thread_count(threads), np.ascontiguousarray(np.argwhere(mask))
    shape = _shape(len(pixels))
    if isinstance(rays, ExplicitRays):
        return _listed_subpixels(rays, pixels, shape), shape
    directions = np.zeros((*shape, 3), np.float32)
    for row, column in np.ndindex(BLOCK, BLOCK) if len(pixels) else ():
        shifted, ticket = _shifted(rays, row, column), new_ticket(len(pixels), 1024)
        run(_subpixel_rays, threads, ticket, pixels, shape[1] // BLOCK, row, column, shifted, directions)
    m = shape[0] * shape[1]
    origins = np.broadcast_to(rays.origin.astype(np.float32), (m, 3)).copy()
    return RayPass(origins, directions.reshape(m, 3), np.full(m, -1, np.int32)), shape


def _listed_subpixels(rays: ExplicitRays, pixels: np.ndarray, shape: tuple[int, int]) -> RayPass:
    down, right = pixels.T[..., None, None].astype(np.float64)
    origins, directions = rays.through(right + OFFSETS[..., 0], down + OFFSETS[..., 1])
    return listed_pass(*(block_values(part, shape) for part in (origins, directions)))


def _shape(pixels: int) -> tuple[int, int]:
    """The shape (4 R, 4 C) of the picture that holds the sub-pixels of this many pixels."""
    columns = max(1, math.isqrt(pixels))
    return BLOCK * -(-pixels // columns), BLOCK * columns


def _shifted(rays: CameraRays, row: int, column: int) -> CameraRays:
    """The camera's rays, shifted so that a sub-pixel lies at the centre of its pixel."""
    x, y = OFFSETS[row, column]
    return rays._replace(corner=rays.corner + (x - 0.5) * rays.dx + (y - 0.5) * rays.dy)


def _background(h: int, w: int, origin: NDArray[np.float64]) -> GBuffer:
    position, normal = np.zeros((h, w, 3), np.float32), np.zeros((h, w, 3), np.float32)
    depth, side = np.full((h, w), np.inf, np.float32), np.full((h, w), NOTHING, np.int8)
    return GBuffer(position, normal, np.full((h, w), -1, np.int32), depth, side, origin)


def block_copies(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(4 R, 4 C, ...): a picture of sub-pixels with each of n values copied over its block; 0 in the other blocks."""
    return block_values(values[:, None, None].repeat(BLOCK, 1).repeat(BLOCK, 2), shape)


def block_values(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(4 R, 4 C, ...): a picture of sub-pixels from the values of n blocks, (n, 4, 4, ...); 0 in the other blocks."""
    rows, columns = shape[0] // BLOCK, shape[1] // BLOCK
    blocks = np.zeros((rows * columns, *values.shape[1:]), values.dtype)
    blocks[: len(values)] = values
    return blocks.reshape(rows, columns, *values.shape[1:]).swapaxes(1, 2).reshape(*shape, *values.shape[3:])


def block_means(picture: np.ndarray, n: int) -> np.ndarray:
    """(n, ...): the mean over each of the first n blocks of a picture (4 R, 4 C, ...) of sub-pixels."""
    h, w = picture.shape[:2]
    blocks = picture.reshape(h // BLOCK, BLOCK, w // BLOCK, BLOCK, *picture.shape[2:])
    means = blocks.mean((1, 3), dtype=np.float64).reshape(-1, *picture.shape[2:])[:n]
    return np.asarray(means).astype(picture.dtype)


def blocks_of(picture: np.ndarray) -> np.ndarray:
    """(R C, 4, 4, ...): the blocks of a picture (4 R, 4 C, ...) of sub-pixels, row by row."""
    h, w, *more = picture.shape
    blocks = picture.reshape(h // BLOCK, BLOCK, w // BLOCK, BLOCK, *more).swapaxes(1, 2)
    return blocks.reshape(-1, BLOCK, BLOCK, *more)


def picture_of(blocks: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(4 R, 4 C, ...): the picture of this shape made of these blocks, row by row; 0 in the other blocks."""
    rows, columns, more = shape[0] // BLOCK, shape[1] // BLOCK, blocks.shape[3:]
    out = np.zeros((rows * columns, BLOCK, BLOCK, *more), blocks.dtype)
    out[: len(blocks)] = blocks
    return out.reshape(rows, columns, BLOCK, BLOCK, *more).swapaxes(1, 2).reshape(*shape, *more)
