"""Visibility of lights from occlusion bits: visible fractions, shares of irradiance, and unoccluded directions.

The visible fraction of a light counts samples; its share of irradiance weights them. Both can be filtered, or refined
in penumbrae.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..kernels.exact.filters import cross, dot
from ..kernels.jit import F32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import (
    absolute,
    extract,
    gather,
    get,
    iota16,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr,
    put,
    select,
    shuffle,
    splat16,
    swap_halves,
)
from ..query.equal_samples import with_distinct_samples
from ..query.pixel_refinement import penumbra
from ..query.receivers import NOTHING
from ..query.shadow_query import (
    ShadowQuery,
    fraction_lit,
    patch_of,
    query_pointers,
    sample_of,
    set_of,
    three_at,
    without_corners,
)
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


LANES = 16
_TINY = np.float32(1e-14)  # squared distance below which a sample has no weight, relative to that of the light


Vector32: TypeAlias = tuple[np.float32, np.float32, np.float32]


class SampleRows(NamedTuple):
    """The samples of a query, as pointers to rows of whole vectors: first the a, then the b of each set."""

    values: F32Ptr
    step: int  # elements of a row


class _Emitter(NamedTuple):
    """A light as a receiver sees it: the points c + a u + b v relative to the receiver, in units of its distance."""

    c: Vector32
    u: Vector32
    v: Vector32
    axis: Vector32  # u x v
    flat: bool  # whether the axis is not 0


@inlined
def emitter_at(pointers, i):
    """The `_Emitter` of receiver i."""
    patch, p = patch_of(pointers, i), three_at(pointers.origins, i)
    c = patch.bx - p[0], patch.by - p[1], patch.bz - p[2]
    u, v = (patch.ux, patch.uy, patch.uz), (patch.vx, patch.vy, patch.vz)
    size = max(dot(c, c), dot(u, u), dot(v, v))
    scale = 1.0 / np.sqrt(size) if size > 0.0 else 0.0
    c, u, v = _scaled(c, scale), _scaled(u, scale), _scaled(v, scale)
    axis = cross(u, v)
    return _Emitter(c, u, v, axis, dot(axis, axis) > np.float32(0.0))


@inlined
def _scaled(a, scale):
    return np.float32(a[0] * scale), np.float32(a[1] * scale), np.float32(a[2] * scale)


@inlined
def to_samples(emitter, a, b):
    """The vectors to 16 samples (a, b)."""
    c, u, v = emitter.c, emitter.u, emitter.v
    return c[0] + a * u[0] + b * v[0], c[1] + a * u[1] + b * v[1], c[2] + a * u[2] + b * v[2]


@inlined
def sample_weights(emitter, n, w):
    """The weights of 16 samples along w, at a receiver with normal n."""
    zero, r2 = np.float32(0.0), dot(w, w)
    weight = maximum(dot(w, n), zero)
    if emitter.flat:
        weight = weight * absolute(dot(w, emitter.axis)) / (r2 * r2)
    return select(r2 > _TINY, weight, zero)


@inlined
def sum_lanes(v):
    """The sum of 16 lanes."""
    v = v + swap_halves(v)
    v = v + shuffle(v, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11)
    v = v + shuffle(v, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13)
    return extract(v, 0) + extract(v, 1)


@inlined
def _arriving(light, row, s, c):
    """The shares of channel c that arrive from 16 samples from s on, which are not occluded."""
    last, channel = light.spp - 1, min(c, light.channels - 1)
    samples = minimum(iota16() + s, last)
    return gather(light.values, (samples + row * light.spp) * light.channels + channel)


@inlined
def _weighted_share(pointers, samples, words, i, at, light, c):
    """The share of receiver i: weight of the light of its samples, times `terminator_factor`, over that of all samples.

    at : (emitter, normal, geometric normal, bend, soft) of the receiver
    c : channel of the light
    """
    (emitter, n, g, bend, soft), row = at, row_of(light, i)
    first, zero = 2 * set_of(pointers, i) * samples.step, np.float32(0.0)
    total, arrived = splat16(zero), splat16(zero)
    for s in range(0, pointers.spp, LANES):
        a, b = load16(samples.values, first + s), load16(samples.values, first + samples.step + s)
        w = to_samples(emitter, a, b)
        weight = select(iota16() < pointers.spp - s, sample_weights(emitter, n, w), zero)
        hidden = get(words, i * pointers.words + (s >> 6)) >> np.uint64(s & 63)
        passing = select(mask_from_bits16(hidden), zero, weight)
        if row >= 0:
            passing = passing * _arriving(light, row, s, c)
        if soft:
            passing = passing * terminator_factor(g, n, bend, w)
        total, arrived = total + weight, arrived + passing
    whole = sum_lanes(total)
    return sum_lanes(arrived) / whole if whole > zero else zero


@inlined
def _may_soften(pointers, i, n, bend):
    """Whether `terminator_factor` may be less than 1 for a sample of receiver i."""
    p, z = three_at(pointers.origins, i), np.float64(0.0)
    if pointers.light.kind == SPHERE:
        base, extent = pointers.light.base, pointers.light.radius
        c = base[0] - p[0], base[1] - p[1], base[2] - p[2]
    else:
        patch = patch_of(pointers, i)
        c, extent = (patch.bx - p[0], patch.by - p[1], patch.bz - p[2]), z
        extent += np.sqrt(patch.ux * patch.ux + patch.uy * patch.uy + patch.uz * patch.uz)
        extent += np.sqrt(patch.vx * patch.vx + patch.vy * patch.vy + patch.vz * patch.vz)
    return not dot(n, c) - extent >= 2.0 * bend * (np.sqrt(dot(c, c)) + extent)


@inlined
def single_at(pointer, i):
    """Vector i, in float32."""
    return get(pointer, 3 * i), get(pointer, 3 * i + 1), get(pointer, 3 * i + 2)


@kernel
def _share_kernel(ticket, query, samples, bits, light, facing, out):
    pointers, words, shares = query_pointers(query), ptr(bits), ptr(out)
    table, soft = SampleRows(ptr(samples), samples.shape[2]), facing.soft
    through, channels = transmission_pointers(light), out.shape[2]
    normals, geometric, bends = ptr(facing.normal), ptr(facing.geometric), ptr(facing.bend)
    for i in items(ticket):
        share, partial, hidden = np.float32(1.0), False, 0
        for k in range(pointers.words):
            hidden += popcount(get(words, i * pointers.words + k))
        bend = get(bends, i) if soft else np.float32(0.0)
        if hidden == pointers.spp:
            share = np.float32(0.0)
        elif get(pointers.sides, i) != NOTHING:
            partial = hidden > 0 or row_of(through, i) >= 0
            if soft and not partial:
                partial = _may_soften(pointers, i, three_at(normals, i), np.float64(bend))
        if partial:
            at = emitter_at(pointers, i), single_at(normals, i), single_at(geometric, i), bend, soft
            for c in range(channels):
                put(shares, channels * i + c, _weighted_share(pointers, table, words, i, at, through, c))
        else:
            for c in range(channels):
                put(shares, channels * i + c, share)


def sample_rows(samples: NDArray[np.float64]) -> NDArray[np.float32]:
    """(16, 2, n) float32: the a and b of samples (16, spp, 3), in whole vectors."""
    sets, spp, _ = samples.shape
    rows = np.zeros((sets, 2, -(-spp // LANES) * LANES), np.float32)
    rows[:, :, :spp] = samples[:, :, :2].transpose(0, 2, 1)
    return rows


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
    args = without_corners(query), sample_rows(query.samples), traced.bits, traced.through, facing, out
    run(_share_kernel, thread_count(threads), ticket, *args)
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
    """The query with a single sample if all samples of a light are equal. Lists keep theirs: each is another light."""
    return query if is_list(query.light) else with_distinct_samples(query)


def light_fractions(
    surfaces: PictureSurfaces, facing: PixelNormals, traced: TracedQuery, smooth: bool, threads: int | None = None
) -> LightFractions:
    """The visibility of a light, from the answer to its query; filtered if `smooth` and if the light is soft."""
    spp, smooth = traced.spp, smooth and is_soft(traced.query)
    if traced.light is not None:
        return _coloured_fractions(surfaces, facing, traced, smooth, threads)
    if not is_weighted(traced.query.light):
        fraction = (
            filter_fractions(surfaces, occluded_count(traced, threads), spp, threads)
            if smooth
            else fraction_lit(traced.bits, spp, threads)
        )
        return LightFractions(fraction, fraction)
    share = irradiance_shares(facing, traced, threads)
    if smooth:
        return LightFractions(*filter_shares(surfaces, occluded_count(traced, threads), share, spp, threads))
    return LightFractions(fraction_lit(traced.bits, spp, threads), share)


def _coloured_fractions(
    surfaces: PictureSurfaces, facing: PixelNormals, traced: TracedQuery, smooth: bool, threads: int | None
) -> LightFractions:
    """`light_fractions` of a light that comes through cut-outs. The filter smooths brightness, not colour."""
    fraction, share = lit_fraction(traced, threads), irradiance_shares(facing, traced, threads)
    if not smooth:
        return LightFractions(fraction, share)
    grey = share if share.ndim == 2 else share.mean(-1)
    counts = occluded_count(traced, threads)
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
        where = penumbra(surfaces, occluded_count(traced, threads), traced.spp, threads)
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
