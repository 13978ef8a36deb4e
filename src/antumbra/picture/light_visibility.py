"""Visibility of lights from occlusion bits: visible fractions, shares of irradiance, and unoccluded directions.

The visible fraction of a light counts samples; its share of irradiance weights them. Both can be filtered, or refined
in penumbrae.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.exact.filters import cross, dot
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, popcount, ptr, put
from ..query.gbuffer import PictureSurfaces
from ..query.pixel_refinement import penumbra
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, fraction_lit, patch_of, query_pointers, sample_of, set_of, three_at
from ..scene.lights import AMBIENT, SPHERE, LightPatch, is_list
from .discontinuity_filter import filter_fractions, filter_shares
from .irradiance import PixelNormals, terminator_factor

# --- Shares of irradiance ---------------------------------------------------------------------------------------------
#
# The share of a light's unshadowed irradiance that reaches a receiver is the weight of visible samples over the weight
# of all samples. A sample's weight is the contribution of its piece of the light: the cosine at the receiver times the
# cosine at the light over the squared distance. The closed-form irradiance times this share is a consistent estimate
# without noise where nothing hides the light [Heitz et al. 2018].

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)


@inlined
def _edges_of(patch, p):
    """The base of a patch relative to p, and its u and v."""
    c = patch.bx - p[0], patch.by - p[1], patch.bz - p[2]
    return c, (patch.ux, patch.uy, patch.uz), (patch.vx, patch.vy, patch.vz)


@inlined
def _may_soften(c, u, v, n, bend):
    """Whether `terminator_factor` may be less than 1 for a point c + a u + b v of a light, -1 <= a, b <= 1."""
    extent = np.sqrt(dot(u, u)) + np.sqrt(dot(v, v))
    return not dot(n, c) - extent >= 2.0 * bend * (np.sqrt(dot(c, c)) + extent)


@kernel
def _weighted_share(pointers, words, patch, i, n, g, bend, soft):
    """The share of receiver i: weight of its visible samples, times `terminator_factor`, over that of all samples."""
    c, u, v = _edges_of(patch, three_at(pointers.origins, i))
    axis = cross(u, v)
    flat = dot(axis, axis) > 0.0
    at, total, surfaces = 3 * set_of(pointers, i) * pointers.spp, 0.0, 0.0
    for s in range(pointers.spp):
        a, b = get(pointers.samples, at + 3 * s), get(pointers.samples, at + 3 * s + 1)
        w = c[0] + a * u[0] + b * v[0], c[1] + a * u[1] + b * v[1], c[2] + a * u[2] + b * v[2]
        r2 = dot(w, w)
        weight = max(dot(n, w), 0.0) * (abs(dot(axis, w)) / (r2 * r2) if flat else 1.0)
        weight = weight if r2 > 0.0 else 0.0
        total += weight
        if get(words, i * pointers.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
            surfaces += weight * terminator_factor(g, n, bend, w) if soft else weight
    return surfaces / total if total > 0.0 else 0.0


@kernel
def _share_kernel(ticket, query, bits, facing, out):
    pointers, words, shares = query_pointers(query), ptr(bits), ptr(out)
    normals, geometric, bends = ptr(facing.normal), ptr(facing.geometric), ptr(facing.bend)
    for i in items(ticket):
        share, hidden = 1.0, 0
        for k in range(pointers.words):
            hidden += popcount(get(words, i * pointers.words + k))
        if hidden == pointers.spp:
            share = 0.0
        elif get(pointers.sides, i) != NOTHING and (hidden > 0 or facing.soft):
            patch, n, bend = patch_of(pointers, i), three_at(normals, i), np.float64(0.0)
            partial = hidden > 0
            if facing.soft:
                bend = np.float64(get(bends, i))
                c, u, v = _edges_of(patch, three_at(pointers.origins, i))
                partial = partial or _may_soften(c, u, v, n, bend)
            if partial:
                share = _weighted_share(pointers, words, patch, i, n, three_at(geometric, i), bend, facing.soft)
        put(shares, i, np.float32(share))


def is_weighted(patch: LightPatch) -> bool:
    """Whether the samples of a light are weighted: those of ambient light and of lists count equally."""
    return patch.kind != AMBIENT and not is_list(patch)


def irradiance_shares(
    facing: PixelNormals, query: ShadowQuery, bits: np.ndarray, threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W) float32: the share of each receiver's unshadowed irradiance that arrives; 1 where there is no receiver.

    It is 0 where all samples are occluded or below the horizon, and exactly 1 where none is.

    facing : normals of the receivers
    query, bits : a query and its answer
    """
    spp = query.samples.shape[1]
    if not is_weighted(query.light):
        return fraction_lit(bits, spp, threads)
    out = np.empty(query.sides.shape, np.float32)
    run(_share_kernel, thread_count(threads), new_ticket(out.size, 1024), query, bits, facing, out)
    return out


# --- Visible fractions ------------------------------------------------------------------------------------------------


class LightFractions(NamedTuple):
    """The visibility of a light at the pixels: two (H, W) float32 in [0, 1]."""

    fraction: np.ndarray  # visible fraction of its samples
    share: np.ndarray  # share of its unshadowed irradiance, see `irradiance_shares`

    def replaced(self, where: np.ndarray, other: "LightFractions") -> "LightFractions":
        """Take the values of `other` where the mask `where`, (H, W) bool, is set."""
        return LightFractions(*(np.where(where, new, old) for new, old in zip(other, self)))


def is_soft(query: ShadowQuery) -> bool:
    """Whether the query's samples estimate the visible fraction of one light with an extent.

    All samples of a light without extent are the same point, so it has neither penumbrae nor noise. Each sample of a
    list is a separate light, so more samples would not be finer.
    """
    light = query.light
    return light.kind in (SPHERE, AMBIENT) or (not is_list(light) and bool(light.u.any() or light.v.any()))


def without_equal_samples(query: ShadowQuery) -> ShadowQuery:
    """The query, with a single sample if the light has no extent, since all its samples are equal."""
    if is_soft(query) or is_list(query.light):
        return query
    return query._replace(samples=np.ascontiguousarray(query.samples[:, :1]))


def light_fractions(
    surfaces: PictureSurfaces,
    facing: PixelNormals,
    query: ShadowQuery,
    bits: np.ndarray,
    smooth: bool,
    threads: int | None = None,
) -> LightFractions:
    """The visibility of a light, from the bits of its query; filtered if `smooth` and if the light is soft."""
    spp, smooth = query.samples.shape[1], smooth and is_soft(query)
    if not is_weighted(query.light):
        fraction = (
            filter_fractions(surfaces, occluded_samples(bits), spp, threads)
            if smooth
            else fraction_lit(bits, spp, threads)
        )
        return LightFractions(fraction, fraction)
    share = irradiance_shares(facing, query, bits, threads)
    if smooth:
        return LightFractions(*filter_shares(surfaces, occluded_samples(bits), share, spp, threads))
    return LightFractions(fraction_lit(bits, spp, threads), share)


def occluded_samples(bits: np.ndarray) -> NDArray[np.int32]:
    """(H, W) int32: the number of occluded samples of each pixel."""
    counts: NDArray[np.int32] = np.bitwise_count(bits).sum(-1, dtype=np.int32)
    return counts


def finer_query(
    surfaces: PictureSurfaces, query: ShadowQuery, bits: np.ndarray, samples: np.ndarray, threads: int | None = None
) -> ShadowQuery:
    """A query with finer samples at the pixels in the penumbra of a light, which the bits of its query show.

    Elsewhere it has no receiver (side NOTHING): everywhere if `samples` are those of the query.

    samples : (16, n, 3) float64, in the light's domain
    """
    sides = np.zeros_like(query.sides)
    if is_soft(query) and not np.array_equal(samples, query.samples):
        where = penumbra(surfaces, occluded_samples(bits), query.samples.shape[1], threads)
        sides = np.where(where, query.sides, np.int8(NOTHING))
    return query._replace(sides=sides, samples=samples)


def refine_fractions(
    before: LightFractions,
    surfaces: PictureSurfaces,
    facing: PixelNormals,
    finer: ShadowQuery,
    bits: np.ndarray,
    smooth: bool,
    threads: int | None = None,
) -> LightFractions:
    """The visibility of a light, with the values of a `finer_query` where it has receivers.

    Without `smooth`, these equal the values of a frame that uses the finer samples everywhere. With it, refined pixels
    are filtered among themselves.
    """
    better = light_fractions(surfaces._replace(side=finer.sides), facing, finer, bits, smooth, threads)
    return before.replaced(finer.sides != NOTHING, better)


# --- Unoccluded directions, for bent normals --------------------------------------------------------------------------


@kernel
def _directions_kernel(ticket, query, bits, out):
    pointers, words, sums = query_pointers(query), ptr(bits), ptr(out)
    for i in items(ticket):
        x = y = z = 0.0
        if get(pointers.sides, i) != NOTHING:
            patch, p = patch_of(pointers, i), three_at(pointers.origins, i)
            for s in range(pointers.spp):
                if get(words, i * pointers.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
                    q = sample_of(pointers, patch, i, s)
                    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    if r > 0.0:
                        x, y, z = x + dx / r, y + dy / r, z + dz / r
        put(sums, 3 * i, np.float32(x))
        put(sums, 3 * i + 1, np.float32(y))
        put(sums, 3 * i + 2, np.float32(z))


def unoccluded_directions(query: ShadowQuery, bits: np.ndarray, threads: int | None = None) -> NDArray[np.float32]:
    """(h, w, 3) float32: the sum of unit vectors to the samples that each receiver sees; `bits`: the query's answer."""
    out = np.empty((*query.sides.shape, 3), np.float32)
    ticket = new_ticket(query.sides.size, 1024)
    run(_directions_kernel, thread_count(threads), ticket, query, bits, out)
    return out
