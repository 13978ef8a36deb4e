"""The shadow query: which segments are asked. What every tracer gets, and all that it may depend on."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..kernels.predicate.exact import exact_plane_side
from ..kernels.predicate.filters import plane, widest
from ..kernels.simd import get, popcount, ptr
from ..scene.lights import AMBIENT, LightPatch
from .receivers import FREE, NOTHING
from .samples import patch_at, sample_point

CULL_FACES = {None: 0, "front": -1, "back": 1}
"""Name -> sign of d . n of the triangles that do not block, d the ray's direction and n the triangle's normal."""


class ShadowQuery(NamedTuple):
    """Receivers, a light, and sample sets: one segment for each receiver and sample.

    Receiver (y, x) uses sample set (x mod 4) + 4 (y mod 4); receivers that are not pixels form one row.
    """

    origins: np.ndarray  # (h, w, 3) float32, receivers moved off their surface, recentred frame
    faces: np.ndarray  # (h, w) int32, the receiver's own triangle in `corners`, -1 if it has none
    sides: np.ndarray  # (h, w) int8: +-1 the side of its surface it sees, FREE without surface, NOTHING: no receiver
    normals: np.ndarray  # (h, w, 3) float64 unit, to the seen side; (0, 0, 3) if no face is -1 and no light AMBIENT
    corners: np.ndarray  # (n, 9) float32, triangles that `faces` counts in
    light: LightPatch
    samples: np.ndarray  # (16, spp, 3) float64, (a, b, c) in the light's domain
    cull_faces: int  # a value of CULL_FACES
    ids: np.ndarray  # (h, w) int32: what trees call the own triangles; `faces`, unless `corners` has not all triangles


class Horizon(NamedTuple):
    """The plane of one receiver's surface: which light samples are above it? Float64 scalars."""

    side: int  # the side of the plane that the receiver sees; FREE: there is no plane
    face: int  # triangle that the plane belongs to, -1: known by its normal only
    px: float  # a point of the plane
    py: float
    pz: float
    nx: float  # its normal, any length
    ny: float
    nz: float
    error: float  # of the product (l - p) . n, for each unit of the largest component of l - p


@inlined
def patch_of(query, y, x):
    """The `Patch` of the query's light for receiver (y, x)."""
    ox, oy, oz = query.origins[y, x, 0], query.origins[y, x, 1], query.origins[y, x, 2]
    nx, ny, nz = np.float64(0.0), np.float64(0.0), np.float64(0.0)
    if query.light.kind == AMBIENT:
        nx, ny, nz = query.normals[y, x, 0], query.normals[y, x, 1], query.normals[y, x, 2]
    return patch_at(query.light, ox, oy, oz, nx, ny, nz)


@inlined
def horizon_of(query, y, x):
    """The `Horizon` of receiver (y, x)."""
    side, face = np.int64(query.sides[y, x]), np.int64(query.faces[y, x])
    f = np.float64
    if face >= 0:
        zero = np.float64(0.0)
        (px, py, pz), (nx, ny, nz), error = plane(query.corners, face, zero, zero, zero)
        return Horizon(side, face, px, py, pz, nx, ny, nz, error)
    px, py, pz = f(query.origins[y, x, 0]), f(query.origins[y, x, 1]), f(query.origins[y, x, 2])
    if side == FREE:
        return Horizon(side, face, px, py, pz, f(0.0), f(0.0), f(0.0), f(0.0))
    nx, ny, nz = query.normals[y, x, 0], query.normals[y, x, 1], query.normals[y, x, 2]
    return Horizon(side, face, px, py, pz, nx, ny, nz, f(0.0))


@inlined
def is_above(horizon, lx, ly, lz, corners):
    """Is the float32 light sample strictly on the receiver's side of its surface? Exact where a triangle is known."""
    if horizon.side == FREE:
        return True
    a = (np.float64(lx) - horizon.px, np.float64(ly) - horizon.py, np.float64(lz) - horizon.pz)
    height = a[0] * horizon.nx + a[1] * horizon.ny + a[2] * horizon.nz
    if abs(height) <= horizon.error * widest(a):
        if horizon.face < 0:
            return False
        return exact_plane_side(np.float64(lx), np.float64(ly), np.float64(lz), corners, horizon.face) == horizon.side
    return (height > 0.0) == (horizon.side > 0)


@kernel
def _segments_kernel(query, ends, above):
    h, w = query.sides.shape
    for y in range(h):
        for x in range(w):
            patch, horizon = patch_of(query, y, x), horizon_of(query, y, x)
            for s in range(query.samples.shape[1]):
                a, b, c = query.samples[(x & 3) + 4 * (y & 3), s]
                lx, ly, lz = sample_point(patch, a, b, c)
                ends[y, x, s, 0], ends[y, x, s, 1], ends[y, x, s, 2] = lx, ly, lz
                above[y, x, s] = query.sides[y, x] != NOTHING and is_above(horizon, lx, ly, lz, query.corners)


def segments(query: ShadowQuery) -> tuple[np.ndarray, np.ndarray]:
    """All light samples of a query, for checks against other tools: (ends, above).

    ends : (h, w, spp, 3) float32; the segments run from ``query.origins`` to these
    above : (h, w, spp) bool; False where the surface itself occludes the sample, or there is no receiver
    """
    h, w = query.sides.shape
    spp = query.samples.shape[1]
    ends, above = np.empty((h, w, spp, 3), np.float32), np.empty((h, w, spp), np.bool_)
    _segments_kernel(query, ends, above)
    return ends, above


@kernel
def _fraction_kernel(ticket, bits, spp, out):
    """Worker: of each row of words, the share of spp samples whose bit is not set."""
    p, words = ptr(bits), bits.shape[1]
    first = take(ticket)
    while first >= 0:
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            occluded = 0
            for k in range(words):
                occluded += popcount(get(p, i * words + k))
            out[i] = np.float32(1.0 - np.float64(occluded) / spp)
        first = take(ticket)


def fraction_lit(bits: np.ndarray, spp: int, threads=None) -> np.ndarray:
    """(...) float32: the share of samples that are not occluded, from bits (..., ceil(spp / 64)) uint64."""
    out = np.empty(bits.shape[:-1], np.float32)
    ticket = new_ticket(out.size, 1 << 16)
    run(_fraction_kernel, thread_count(threads), ticket, bits.reshape(-1, bits.shape[-1]), spp, out.reshape(-1))
    return out
