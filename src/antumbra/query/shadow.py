"""The shadow query: which segments are asked. What every tracer gets, and all that it may depend on."""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from ..predicate.filters import plane_side
from ..scene.lights import LightPatch
from .receivers import FREE, NOTHING
from .samples import patch_at, sample_point

CULL_FACES = {None: 0, "front": -1, "back": 1}
"""Name -> sign of d . n of the triangles that do not block, d the ray's direction and n the triangle's normal."""


class ShadowQuery(NamedTuple):
    """Receivers, a light, and sample sets: one segment for each receiver and sample.

    Receiver (y, x) uses sample set (x mod 4) + 4 (y mod 4); receivers that are not pixels form one row.
    """

    origins: np.ndarray  # (h, w, 3) float32, receivers moved off their surface, recentred frame
    faces: np.ndarray  # (h, w) int32, the receiver's own triangle, -1 if it has none
    sides: np.ndarray  # (h, w) int8: +-1 the side of its surface it sees, FREE without surface, NOTHING: no receiver
    normals: np.ndarray  # (h, w, 3) float64 towards the seen side where faces == -1; (0, 0, 3) if never needed
    corners: np.ndarray  # (n, 9) float32, triangles that `faces` counts in
    light: LightPatch
    samples: np.ndarray  # (16, spp, 2) float64, (a, b) in the light's domain
    cull_faces: int  # a value of CULL_FACES


@kernel
def above_horizon(query, y, x, lx, ly, lz):
    """Is the light sample on the side of the receiver's surface that the receiver is on?"""
    side = query.sides[y, x]
    if side == FREE:
        return True
    face = query.faces[y, x]
    if face >= 0:
        return plane_side(lx, ly, lz, query.corners, face) == side
    n, o = query.normals[y, x], query.origins[y, x]
    f = np.float64
    return n[0] * (f(lx) - f(o[0])) + n[1] * (f(ly) - f(o[1])) + n[2] * (f(lz) - f(o[2])) > 0.0


@kernel
def _segments_kernel(query, ends, above):
    h, w = query.sides.shape
    for y in range(h):
        for x in range(w):
            o = query.origins[y, x]
            patch = patch_at(query.light, o[0], o[1], o[2])
            for s in range(query.samples.shape[1]):
                a, b = query.samples[(x & 3) + 4 * (y & 3), s]
                lx, ly, lz = sample_point(patch, a, b)
                ends[y, x, s, 0], ends[y, x, s, 1], ends[y, x, s, 2] = lx, ly, lz
                above[y, x, s] = query.sides[y, x] != NOTHING and above_horizon(query, y, x, lx, ly, lz)


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


def fraction_lit(bits: np.ndarray, spp: int) -> np.ndarray:
    """(...) float32: the share of samples that are not occluded, from bits (..., ceil(spp / 64)) uint64."""
    return (1.0 - np.bitwise_count(bits).sum(-1, dtype=np.int32) / spp).astype(np.float32)
