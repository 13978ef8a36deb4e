"""The share of a light's unshadowed irradiance that reaches each receiver: visible over all samples, both weighted.

A sample's weight is what its piece of the light adds to the irradiance: the cosine at the receiver times the cosine at
the light over the squared distance. So irradiance in closed form times this share is a consistent estimate, and has no
noise where nothing hides the light [Heitz et al. 2018].
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.predicate.filters import cross, dot
from ..kernels.simd import get, popcount, ptr, put
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, fraction_lit, patch_of, query_pointers, set_of, three_at
from ..scene.lights import AMBIENT, LightPatch, is_list
from .terminator import Facing, softened


@inlined
def _edges_of(patch, p):
    """The base of a patch relative to p, and its u and v."""
    c = patch.bx - p[0], patch.by - p[1], patch.bz - p[2]
    return c, (patch.ux, patch.uy, patch.uz), (patch.vx, patch.vy, patch.vz)


@inlined
def _fades(c, u, v, n, bend):
    """Whether `softened` may be less than 1 for a point c + a u + b v of a light, -1 <= a, b <= 1."""
    extent = np.sqrt(dot(u, u)) + np.sqrt(dot(v, v))
    return not dot(n, c) - extent >= 2.0 * bend * (np.sqrt(dot(c, c)) + extent)


@kernel
def _weighed(asked, words, patch, i, n, g, bend, soft):
    """The share of receiver i: weights of its visible samples, softened, over those of all samples."""
    c, u, v = _edges_of(patch, three_at(asked.origins, i))
    axis = cross(u, v)
    flat = dot(axis, axis) > 0.0
    at, total, seen = 3 * set_of(asked, i) * asked.spp, 0.0, 0.0
    for s in range(asked.spp):
        a, b = get(asked.samples, at + 3 * s), get(asked.samples, at + 3 * s + 1)
        w = c[0] + a * u[0] + b * v[0], c[1] + a * u[1] + b * v[1], c[2] + a * u[2] + b * v[2]
        r2 = dot(w, w)
        weight = max(dot(n, w), 0.0) * (abs(dot(axis, w)) / (r2 * r2) if flat else 1.0)
        weight = weight if r2 > 0.0 else 0.0
        total += weight
        if get(words, i * asked.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
            seen += weight * softened(g, n, bend, w) if soft else weight
    return seen / total if total > 0.0 else 0.0


@kernel
def _share_kernel(ticket, query, bits, facing, out):
    asked, words, found = query_pointers(query), ptr(bits), ptr(out)
    normals, geometric, bends = ptr(facing.normal), ptr(facing.geometric), ptr(facing.bend)
    for i in items(ticket):
        share, hidden = 1.0, 0
        for k in range(asked.words):
            hidden += popcount(get(words, i * asked.words + k))
        if hidden == asked.spp:
            share = 0.0
        elif get(asked.sides, i) != NOTHING and (hidden > 0 or facing.soft):
            patch, n, bend = patch_of(asked, i), three_at(normals, i), np.float64(0.0)
            weighs = hidden > 0
            if facing.soft:
                bend = np.float64(get(bends, i))
                c, u, v = _edges_of(patch, three_at(asked.origins, i))
                weighs = weighs or _fades(c, u, v, n, bend)
            if weighs:
                share = _weighed(asked, words, patch, i, n, three_at(geometric, i), bend, facing.soft)
        put(found, i, np.float32(share))


def weighs(patch: LightPatch) -> bool:
    """Whether the samples of a light have weights: those of ambient light and of lists count alike."""
    return patch.kind != AMBIENT and not is_list(patch)


def shares(facing: Facing, query: ShadowQuery, bits: np.ndarray, threads=None) -> np.ndarray:
    """(H, W) float32: the share of each receiver's unshadowed irradiance that arrives; 1 where there is no receiver.

    It is 0 where all samples are hidden or below the horizon, and exactly 1 where none is.

    facing : normals of the receivers
    query, bits : ShadowQuery and its answer
    """
    spp = query.samples.shape[1]
    if not weighs(query.light):
        return fraction_lit(bits, spp, threads)
    out = np.empty(query.sides.shape, np.float32)
    run(_share_kernel, thread_count(threads), new_ticket(out.size, 1024), query, bits, facing, out)
    return out
