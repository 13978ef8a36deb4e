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
from ..query.pixel_refinement import penumbra
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, fraction_lit, patch_of, query_pointers, sample_of, set_of, three_at
from ..query.surface_links import PictureSurfaces
from ..scene.lights import AMBIENT, SPHERE, LightPatch, is_list
from ..trace.transmission import (
    TracedQuery,
    arriving,
    lit_fraction,
    occluded_count,
    row_of,
    transmission_pointers,
)
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


@inlined
def _weighted_share(pointers, words, i, at, facing, light, c):
    """The share of receiver i: weight of the light of its samples, times `terminator_factor`, over that of all samples.

    at : (patch, normal, geometric normal, bend) of the receiver
    c : channel of the light
    """
    patch, n, g, bend = at
    p, row = three_at(pointers.origins, i), row_of(light, i)
    w0, u, v = _edges_of(patch, p)
    axis = cross(u, v)
    flat = dot(axis, axis) > 0.0
    first, total, arrived = 3 * set_of(pointers, i) * pointers.spp, 0.0, 0.0
    for s in range(pointers.spp):
        a, b = get(pointers.samples, first + 3 * s), get(pointers.samples, first + 3 * s + 1)
        w = w0[0] + a * u[0] + b * v[0], w0[1] + a * u[1] + b * v[1], w0[2] + a * u[2] + b * v[2]
        r2 = dot(w, w)
        weight = max(dot(n, w), 0.0) * (abs(dot(axis, w)) / (r2 * r2) if flat else 1.0)
        weight = weight if r2 > 0.0 else 0.0
        total += weight
        if get(words, i * pointers.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
            passing = weight * arriving(light, row, s, c)
            arrived += passing * terminator_factor(g, n, bend, w) if facing.soft else passing
    return arrived / total if total > 0.0 else 0.0


@kernel
def _share_kernel(ticket, query, bits, light, facing, out):
    pointers, words, shares = query_pointers(query), ptr(bits), ptr(out)
    through, channels = transmission_pointers(light), out.shape[2]
    normals, geometric, bends = ptr(facing.normal), ptr(facing.geometric), ptr(facing.bend)
    for i in items(ticket):
        share, partial, hidden = 1.0, False, 0
        for k in range(pointers.words):
            hidden += popcount(get(words, i * pointers.words + k))
        if hidden == pointers.spp:
            share = 0.0
        elif get(pointers.sides, i) != NOTHING and (hidden > 0 or facing.soft or row_of(through, i) >= 0):
            bend = np.float64(get(bends, i)) if facing.soft else np.float64(0.0)
            at = patch_of(pointers, i), three_at(normals, i), three_at(geometric, i), bend
            partial = hidden > 0 or row_of(through, i) >= 0
            if not partial:
                c, u, v = _edges_of(at[0], three_at(pointers.origins, i))
                partial = _may_soften(c, u, v, at[1], bend)
        for c in range(channels):
            value = _weighted_share(pointers, words, i, at, facing, through, c) if partial else share
            put(shares, channels * i + c, np.float32(value))


def is_weighted(patch: LightPatch) -> bool:
    """Whether the samples of a light are weighted: those of ambient light and of lists count equally."""
    return patch.kind != AMBIENT and not is_list(patch)


def irradiance_shares(facing: PixelNormals, traced: TracedQuery, threads: int | None = None) -> NDArray[np.float32]:
    """The share of each receiver's unshadowed irradiance that arrives; 1 where there is no receiver.

    It is 0 where all samples are occluded or below the horizon, and exactly 1 where none is and no light comes through
    cut-outs. The shape is (H, W), or (H, W, 3) for red, green and blue if light comes through coloured surfaces.

    facing : normals of the receivers
    """
    query, light = traced.query, traced.light
    channels = 1 if light is None else light.values.shape[2]
    if not is_weighted(query.light):
        fraction = fraction_lit(traced.bits, traced.spp, threads)
        return fraction if light is None else light.mean_of(fraction) if channels == 1 else light.colour_of(fraction)
    out = np.empty((*query.sides.shape, channels), np.float32)
    ticket = new_ticket(query.sides.size, 1024)
    run(_share_kernel, thread_count(threads), ticket, query, traced.bits, traced.through, facing, out)
    return out if channels > 1 else out[..., 0]


# --- Visible fractions ------------------------------------------------------------------------------------------------


class LightFractions(NamedTuple):
    """The visibility of a light at the pixels."""

    fraction: np.ndarray  # (H, W) float32 in [0, 1]: mean light of its samples
    share: np.ndarray  # (H, W) or (H, W, 3) float32: share of its unshadowed irradiance, see `irradiance_shares`

    def replaced(self, where: np.ndarray, other: "LightFractions") -> "LightFractions":
        """Take the values of `other` where the mask `where`, (H, W) bool, is set."""
        new, old = other.share, self.share
        if new.ndim != old.ndim:
            new, old = (np.broadcast_to(s[..., None] if s.ndim == 2 else s, (*where.shape, 3)) for s in (new, old))
        share = np.where(where if new.ndim == 2 else where[..., None], new, old)
        return LightFractions(np.where(where, other.fraction, self.fraction), share)


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
    surfaces: PictureSurfaces, facing: PixelNormals, traced: TracedQuery, smooth: bool, threads: int | None = None
) -> LightFractions:
    """The visibility of a light, from the answer to its query; filtered if `smooth` and if the light is soft."""
    spp, smooth = traced.spp, smooth and is_soft(traced.query)
    if traced.light is not None:
        return _coloured_fractions(surfaces, facing, traced, smooth, threads)
    if not is_weighted(traced.query.light):
        fraction = (
            filter_fractions(surfaces, occluded_count(traced), spp, threads)
            if smooth
            else fraction_lit(traced.bits, spp, threads)
        )
        return LightFractions(fraction, fraction)
    share = irradiance_shares(facing, traced, threads)
    if smooth:
        return LightFractions(*filter_shares(surfaces, occluded_count(traced), share, spp, threads))
    return LightFractions(fraction_lit(traced.bits, spp, threads), share)


def _coloured_fractions(
    surfaces: PictureSurfaces, facing: PixelNormals, traced: TracedQuery, smooth: bool, threads: int | None
) -> LightFractions:
    """`light_fractions` of a light that comes through cut-outs. The filter smooths brightness, not colour."""
    fraction, share = lit_fraction(traced, threads), irradiance_shares(facing, traced, threads)
    if not smooth:
        return LightFractions(fraction, share)
    grey = share if share.ndim == 2 else share.mean(-1)
    counts = occluded_count(traced)
    fraction, even = (filter_shares(surfaces, counts, s, traced.spp, threads)[1] for s in (fraction, grey))
    if share.ndim == 2:
        return LightFractions(fraction, even)
    colour = np.divide(share, grey[..., None], out=np.ones_like(share), where=grey[..., None] > 0.0)
    return LightFractions(fraction, colour * even[..., None])


def finer_query(
    surfaces: PictureSurfaces, traced: TracedQuery, samples: np.ndarray, threads: int | None = None
) -> ShadowQuery:
    """A query with finer samples at the pixels in the penumbra of a light, which the answer to its query shows.

    Elsewhere it has no receiver (side NOTHING): everywhere if `samples` are those of the query.

    samples : (16, n, 3) float64, in the light's domain
    """
    query = traced.query
    sides = np.zeros_like(query.sides)
    if is_soft(query) and not np.array_equal(samples, query.samples):
        where = penumbra(surfaces, occluded_count(traced), traced.spp, threads)
        sides = np.where(where, query.sides, np.int8(NOTHING))
    return query._replace(sides=sides, samples=samples)


def refine_fractions(
    before: LightFractions,
    surfaces: PictureSurfaces,
    facing: PixelNormals,
    finer: TracedQuery,
    smooth: bool,
    threads: int | None = None,
) -> LightFractions:
    """The visibility of a light, with the values of a `finer_query` where it has receivers.

    Without `smooth`, these equal the values of a frame that uses the finer samples everywhere. With it, refined pixels
    are filtered among themselves.
    """
    sides = finer.query.sides
    better = light_fractions(surfaces.with_side(sides), facing, finer, smooth, threads)
    return before.replaced(sides != NOTHING, better)


# --- Unoccluded directions, for bent normals --------------------------------------------------------------------------


@kernel
def _directions_kernel(ticket, query, bits, light, out):
    pointers, words, sums, through = query_pointers(query), ptr(bits), ptr(out), transmission_pointers(light)
    for i in items(ticket):
        x = y = z = 0.0
        if get(pointers.sides, i) != NOTHING:
            patch, p, row = patch_of(pointers, i), three_at(pointers.origins, i), row_of(through, i)
            for s in range(pointers.spp):
                if get(words, i * pointers.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
                    q = sample_of(pointers, patch, i, s)
                    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    if r > 0.0:
                        share = arriving(through, row, s, 1) / r  # of green, which eyes see best
                        x, y, z = x + share * dx, y + share * dy, z + share * dz
        put(sums, 3 * i, np.float32(x))
        put(sums, 3 * i + 1, np.float32(y))
        put(sums, 3 * i + 2, np.float32(z))


def unoccluded_directions(traced: TracedQuery, threads: int | None = None) -> NDArray[np.float32]:
    """(h, w, 3) float32: the sum of unit vectors to the samples that each receiver sees, times their green light."""
    query = traced.query
    out = np.empty((*query.sides.shape, 3), np.float32)
    ticket = new_ticket(query.sides.size, 1024)
    run(_directions_kernel, thread_count(threads), ticket, query, traced.bits, traced.through, out)
    return out
