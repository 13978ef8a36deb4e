"""Smooth surfaces across pixels: which pixels of a 5 x 5 window see the same surface as its centre.

The filter, the refinement of penumbrae and silhouettes, and anti-aliasing all need the answer, so it is computed once
per picture, as the bits of a number per pixel. Being linked is symmetric, so a pixel holds only the links to the twelve
pixels of its window that follow it.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import cos
from ..kernels.jit import F32Ptr, I32Ptr, formula, inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import (
    absolute,
    all_lanes,
    as_i32,
    extract,
    get,
    load8,
    load16x3,
    minimum,
    ptr,
    ptr_at,
    put,
    select,
    splat8,
    store,
)
from ..kernels.small_matrices import length
from ..scene.camera import CameraRays, ExplicitRays
from .gbuffer import GBuffer
from .receivers import NOTHING

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

COSINE = np.float32(cos(np.radians(20.0)))
"""Normals of one smooth surface differ by less than 20 degrees."""

APART = np.float32(0.5)
"""Largest distance between a point and another point's tangent plane on one smooth surface, in pixel widths there."""

REACH = 2
"""The window of a pixel covers the pixels at most this far away in each direction."""

N_LINKS = 12
RIGHT, BELOW = 0, 4
"""The links to the pixel on the right and to the one below."""

_ALL = (1 << N_LINKS) - 1
_ADJACENT = 1 << RIGHT | 1 << BELOW


@inlined
def link_offset(k):
    """(rows, columns) from a pixel to the pixel that its link k leads to: right and down, row by row."""
    place = k + 13  # in the window of 25 pixels
    return place // 5 - REACH, place % 5 - REACH


# --- Deinterleaved rows -----------------------------------------------------------------------------------------------


@inlined
def deinterleave(source, first, n, planes, at, step):
    """Write n triples from element `first` of `source` to three planes, from element `at` on, `step` apart."""
    bulk = n - n % 16
    for x in range(0, bulk, 16):
        a, b, c = load16x3(source, first + 3 * x)
        store(planes, at + x, a)
        store(planes, at + step + x, b)
        store(planes, at + 2 * step + x, c)
    for x in range(bulk, n):
        for c in range(3):
            put(planes, at + c * step + x, get(source, first + 3 * x + c))


@inlined
def interleave(planes, at, step, n, out, first):
    """Write n triples from three planes to `out`, from element `first` on: the inverse of `deinterleave`."""
    for x in range(n):
        for c in range(3):
            put(out, first + 3 * x + c, get(planes, at + c * step + x))


# --- Links ------------------------------------------------------------------------------------------------------------


class SurfaceLinks(NamedTuple):
    """The links of a picture of (h, w) pixels, for kernels.

    Bit k of element ``pad + y w + x`` is set if pixel (y, x) sees the same surface as that at `link_offset` k. Bits
    towards pixels outside the picture, and those of the padding, are 0. Kernels therefore step through the flat picture
    without tests for its border: where a bit is set, both of its pixels exist.
    """

    bits: np.ndarray  # (pad + h w + pad,) int32
    pad: int  # at least a window and a vector
    h: int
    w: int


class _Pixels(NamedTuple):
    """The surfaces of pixels, for kernels; the arrays are those of `PictureSurfaces`."""

    position: np.ndarray
    normal: np.ndarray
    face: np.ndarray
    depth: np.ndarray
    side: np.ndarray
    pixel: np.float32


class _Planes(NamedTuple):
    """The surfaces of a few rows, deinterleaved, with a margin beside each row."""

    floats: F32Ptr  # seven planes: position, normal, and the largest distance from a tangent plane, -1 without surface
    faces: I32Ptr
    uniform: I32Ptr  # for eight pixels from each eighth column on: their face, or -1 if they see several or nothing
    step: int  # elements of a plane
    pitch: int  # elements of a row


_ROWS = 8  # of a share
_LIMIT = 6  # plane of the largest distance
_MARGIN = 16  # elements beside each row, for windows and vectors


@formula
def _plane_size(w):
    """Elements of a plane, for pictures of w columns."""
    return (_ROWS + REACH) * (w + _MARGIN)


@formula
def _blocks(w):
    """Blocks of eight columns."""
    return (w + 7) >> 3


@inlined
def _load_rows(pixels, first, last, planes):
    """Deinterleave the rows from `first` up to `last`, of which those below the picture have no surface."""
    h, w = pixels.side.shape
    positions, normals, faces = ptr(pixels.position), ptr(pixels.normal), ptr(pixels.face)
    depths, sides, limits = ptr(pixels.depth), ptr(pixels.side), ptr_at(planes.floats, _LIMIT * planes.step)
    for y in range(first, last):
        row, at = (y - first) * planes.pitch, y * w
        for x in range(planes.pitch):
            put(limits, row + x, np.float32(-1.0))
        if y < h:
            row += REACH
            deinterleave(positions, 3 * at, w, planes.floats, row, planes.step)
            deinterleave(normals, 3 * at, w, planes.floats, 3 * planes.step + row, planes.step)
            for x in range(w):
                limit = APART * pixels.pixel * get(depths, at + x)
                put(limits, row + x, limit if get(sides, at + x) != NOTHING else np.float32(-1.0))
                put(planes.faces, row + x, get(faces, at + x))
        for x in range(0, w, 8):
            face = load8(planes.faces, row + x)
            same = (face == extract(face, 0)) & (load8(limits, row + x) >= np.float32(0.0))
            put(planes.uniform, (y - first) * _blocks(w) + (x >> 3), extract(face, 0) if all_lanes(same) else -1)


@inlined
def _vector(planes, first, at):
    """Eight vectors, deinterleaved: the planes from plane `first` on."""
    at += first * planes.step
    return load8(planes.floats, at), load8(planes.floats, at + planes.step), load8(planes.floats, at + 2 * planes.step)


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _links_of_eight(planes, at, wanted):
    """The links of eight pixels, of those that are bits of `wanted`.

    Two faces belong to one surface if their normals are nearly equal and each point lies near the other's tangent
    plane. Unlike a depth difference, the distance to a plane does not grow at grazing angles. Finely tessellated
    surfaces, where every pixel sees a different face, also stay connected.
    """
    limit, face = load8(planes.floats, at + _LIMIT * planes.step), load8(planes.faces, at)
    found = splat8(0)
    for k in range(N_LINKS):
        if (wanted >> k) & 1 == 0:
            continue
        down, right = link_offset(k)
        other = at + down * planes.pitch + right
        apart = minimum(limit, load8(planes.floats, other + _LIMIT * planes.step))
        both, same = apart >= np.float32(0.0), load8(planes.faces, other) == face
        if not all_lanes(same | ~both):
            p, n = _vector(planes, 0, at), _vector(planes, 3, at)
            q, m = _vector(planes, 0, other), _vector(planes, 3, other)
            d = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            near = (absolute(_dot(n, d)) <= apart) & (absolute(_dot(m, d)) <= apart)
            same |= (_dot(n, m) >= COSINE) & near  # Eq. (2) of docs/design/filter.md
        found |= select(both & same, splat8(1 << k), 0)
    return found


@inlined
def _see_one_face(planes, row, block, blocks):
    """Whether all pixels in the windows of a block of eight see the same face."""
    if block < 1 or block + 1 >= blocks:
        return False
    at = row * blocks + block
    face, same = get(planes.uniform, at), True
    for down in range(REACH + 1):
        for right in range(-1, 2):
            same &= get(planes.uniform, at + down * blocks + right) == face
    return same and face >= 0


@kernel
def _link_rows(ticket, pixels, wanted, links, scratch):
    """Worker: write the links of rows. `scratch`: the thread's memory for `_Planes` and a row of links."""
    w, step = links.w, _plane_size(links.w)
    floats, blocks = ptr(scratch), _blocks(w)
    faces, uniform = as_i32(ptr_at(scratch, 7 * step)), as_i32(ptr_at(scratch, 8 * step + w + _MARGIN))
    planes = _Planes(floats, faces, uniform, step, w + _MARGIN)
    row, out = as_i32(ptr_at(scratch, 8 * step)), ptr_at(links.bits, links.pad)
    for first, last in shares(ticket):
        _load_rows(pixels, first, last + REACH, planes)
        for y in range(first, last):
            for x in range(0, w, 8):
                if _see_one_face(planes, y - first, x >> 3, blocks):
                    store(row, x, splat8(wanted))
                else:
                    store(row, x, _links_of_eight(planes, (y - first) * planes.pitch + REACH + x, wanted))
            for x in range(w):
                put(out, y * w + x, get(row, x))


# --- The surfaces of a picture ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PictureSurfaces:
    """The surfaces that the pixels of a picture see, and which of them are one; the arrays are those of `GBuffer`.

    The links are computed once; arrays must not change afterwards.
    """

    position: NDArray[np.float32]  # (H, W, 3) float32
    normal: NDArray[np.float32]  # (H, W, 3) float32
    face: NDArray[np.int32]  # (H, W) int32
    depth: NDArray[np.float32]  # (H, W) float32; 1 everywhere in an orthographic picture, whose pixels have one width
    side: NDArray[np.int8]  # (H, W) int8
    pixel: np.float32  # width of a pixel at depth 1
    _known: dict[int, SurfaceLinks] = field(default_factory=dict, init=False, repr=False)  # bits of links -> links

    def links(self, threads: int | None = None) -> SurfaceLinks:
        """All links between the pixels; `threads`: None for all cores, does not affect the result."""
        return self._links(_ALL, threads)

    def adjacent_links(self, threads: int | None = None) -> SurfaceLinks:
        """The links RIGHT and BELOW, perhaps with others."""
        return self._links(_ADJACENT, threads)

    def _links(self, wanted: int, threads: int | None) -> SurfaceLinks:
        """Links that include those that are bits of `wanted`."""
        for known in self._known:
            if known & wanted == wanted:
                return self._known[known]
        self._known[wanted] = links = self._find_links(wanted, thread_count(threads))
        return links

    def _find_links(self, wanted: int, threads: int) -> SurfaceLinks:
        (h, w), pad = self.face.shape, REACH * self.face.shape[1] + _MARGIN
        links = SurfaceLinks(np.empty(h * w + 2 * pad, np.int32), pad, h, w)
        links.bits[:pad] = links.bits[-pad:] = 0
        pixels = _Pixels(self.position, self.normal, self.face, self.depth, self.side, self.pixel)
        size = 8 * _plane_size(w) + w + _MARGIN + (_ROWS + REACH) * _blocks(w)
        scratch = lambda: (np.empty(size, np.float32),)
        run(_link_rows, threads, new_ticket(h, _ROWS), pixels, wanted, links, own=scratch)
        return links

    def with_side(self, side: NDArray[np.int8]) -> "PictureSurfaces":
        """The same surfaces, of which only those on a side other than NOTHING count."""
        return replace(self, side=side)


def picture_surfaces(gbuffer: GBuffer, rays: CameraRays | ExplicitRays) -> PictureSurfaces:
    """The surfaces of a G-buffer computed with these rays."""
    depth = gbuffer.depth
    pixel: float
    if not isinstance(rays, ExplicitRays):
        pixel = float(length(rays.dy))
    elif rays.extent is None:
        pixel = np.pi / rays.height
    else:
        pixel, depth = rays.extent / rays.height, np.ones_like(depth)
    return PictureSurfaces(gbuffer.position, gbuffer.normal, gbuffer.face, depth, gbuffer.side, np.float32(pixel))
