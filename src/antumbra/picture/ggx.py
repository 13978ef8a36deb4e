"""The GGX lobe of glTF's metallic-roughness model: Trowbridge-Reitz, Smith's correlated masking, and Schlick's Fresnel.

A surface with normal n, seen along v and lit along l, with h halfway between them, reflects

    F D V + (1 - F) base (1 - metallic) / pi,  F = f0 + (1 - f0) (1 - v . h)^5

where D is the distribution of half vectors and V the visibility term [glTF 2.0, Appendix B]. All terms are linear in
(1 - v . h)^5, so a lobe is two numbers that do not depend on colour, and one for the diffuse part.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import cos
from ..kernels.exact.filters import cross, dot
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import (
    get,
    iota16,
    load16,
    mask_from_bits16,
    maximum,
    popcount,
    ptr,
    put,
    select,
    splat16,
    square_root,
)
from ..query.shadow_query import query_pointers, set_of, without_corners
from ..scene.rough_mirrors import LEAST_ALPHA
from ..trace.transmission import TracedQuery
from .light_visibility import LANES, SampleRows, emitter_at, sample_rows, sample_weights, sum_lanes, to_samples

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

DIELECTRIC = np.float32(0.04)
"""Reflectance of dielectrics seen perpendicularly, of index of refraction 1.5."""


class LobePoints(NamedTuple):
    """The pixels with a GGX lobe, n of them."""

    at: NDArray[np.int64]  # (n,): their places in the picture
    normal: NDArray[np.float32]  # (n, 3): shading normals, unit
    view: NDArray[np.float32]  # (n, 3): unit vectors to the eye
    alpha: NDArray[np.float32]  # (n,): squared roughness


def alpha_of(roughness: NDArray[np.float32]) -> NDArray[np.float32]:
    """The parameter of GGX: the squared roughness, at least `LEAST_ALPHA`."""
    return np.asarray(np.maximum(roughness * roughness, np.float32(LEAST_ALPHA)))


# --- Lobes towards a light --------------------------------------------------------------------------------------------


@inlined
def _terms(n, v, w, alpha2, nv):
    """(D V, (1 - v . h)^5) of light along 16 vectors w; nv: n . v."""
    zero, one = np.float32(0.0), np.float32(1.0)
    scale = one / square_root(maximum(dot(w, w), np.float32(1e-30)))
    l = w[0] * scale, w[1] * scale, w[2] * scale
    h = l[0] + v[0], l[1] + v[1], l[2] + v[2]
    scale = one / square_root(maximum(dot(h, h), np.float32(1e-30)))
    h = h[0] * scale, h[1] * scale, h[2] * scale
    nl, nh, tilt = maximum(dot(l, n), zero), dot(h, n), cross(n, h)
    spread = dot(tilt, tilt) + alpha2 * nh * nh  # (n . h)^2 (alpha^2 - 1) + 1, without cancellation
    masking = nl * np.sqrt(alpha2 + nv * nv * (one - alpha2)) + nv * square_root(alpha2 + nl * nl * (one - alpha2))
    lobe = alpha2 / (np.float32(np.pi) * spread * spread) * (np.float32(0.5) / maximum(masking, np.float32(1e-9)))
    grazing = maximum(one - dot(h, v), zero)
    square = grazing * grazing
    return lobe, square * square * grazing


@inlined
def _mean_lobe(pointers, samples, words, i, n, v, alpha2):
    """(D V, D V f, f) of receiver i: means over the light samples that it sees, or over all if it sees none."""
    zero, first, emitter = np.float32(0.0), 2 * set_of(pointers, i) * samples.step, emitter_at(pointers, i)
    hidden = 0
    for k in range(pointers.words):
        hidden += popcount(get(words, i * pointers.words + k))
    seen = hidden < pointers.spp
    nv = max(dot(n, v), np.float32(1e-4))
    total, lobe, grazing, both = splat16(zero), splat16(zero), splat16(zero), splat16(zero)
    for s in range(0, pointers.spp, LANES):
        a, b = load16(samples.values, first + s), load16(samples.values, first + samples.step + s)
        w = to_samples(emitter, a, b)
        weight = select(iota16() < pointers.spp - s, sample_weights(emitter, n, w), zero)
        if seen:
            dark = get(words, i * pointers.words + (s >> 6)) >> np.uint64(s & 63)
            weight = select(mask_from_bits16(dark), zero, weight)
        value, f = _terms(n, v, w, alpha2, nv)
        total, lobe = total + weight, lobe + weight * value
        grazing, both = grazing + weight * f, both + weight * value * f
    whole = sum_lanes(total)
    scale = np.float32(1.0) / whole if whole > zero else zero
    return sum_lanes(lobe) * scale, sum_lanes(both) * scale, sum_lanes(grazing) * scale


@inlined
def _vector(values, i):
    return get(values, 3 * i), get(values, 3 * i + 1), get(values, 3 * i + 2)


@kernel
def _lobe_kernel(ticket, points, query, samples, bits, out):
    """Worker: the mean lobes of pixels."""
    # In: points, `LobePoints`; query, `ShadowQuery`; samples, from `sample_rows`; bits, its answer. Out: out, (n, 3)
    pointers, words, table = query_pointers(query), ptr(bits), SampleRows(ptr(samples), samples.shape[2])
    normals, views, alphas, places, lobes = ptr(points.normal), ptr(points.view), ptr(points.alpha), points.at, ptr(out)
    for k in items(ticket):
        alpha = get(alphas, k)
        n, v = _vector(normals, k), _vector(views, k)
        a, b, c = _mean_lobe(pointers, table, words, places[k], n, v, alpha * alpha)
        put(lobes, 3 * k, a)
        put(lobes, 3 * k + 1, b)
        put(lobes, 3 * k + 2, c)


def mean_lobes(points: LobePoints, traced: TracedQuery, threads: int | None = None) -> NDArray[np.float32]:
    """(n, 3) float32: D V, D V f and f = (1 - v . h)^5 of each pixel, means over the samples of the light that it sees.

    Samples are weighted by their irradiance. If none is seen, all count: smoothed visibility may still let some light
    arrive.
    """
    out = np.empty((len(points.at), 3), np.float32)
    query = without_corners(traced.query)
    args = points, query, sample_rows(query.samples), traced.bits, out
    run(_lobe_kernel, thread_count(threads), new_ticket(len(out), 256), *args)
    return out


# --- Light from all sides ---------------------------------------------------------------------------------------------


_STEPS = 32  # of the table, along both axes
_HEIGHTS, _ANGLES = 192, 10  # directions of the quadrature


@cache
def _albedo_table() -> NDArray[np.float32]:
    """(32, 32, 3) float32: rows of equal roughness, columns of equal n . v; see `uniform_lobes`."""
    nv = np.maximum(np.linspace(0.0, 1.0, _STEPS) ** 2, 1e-4)
    v = np.stack([np.sqrt(1.0 - nv * nv), np.zeros(_STEPS), nv], 1)
    heights, angles = ((np.arange(n) + 0.5) / n for n in (_HEIGHTS, _ANGLES))
    x, y = (each.reshape(-1) for each in np.meshgrid(heights, angles, indexing="ij"))
    around = cos(np.pi * y)  # lobes are symmetric about the plane of view
    out = np.empty((_STEPS, _STEPS, 3), np.float32)
    out[..., 2] = _diffuse_shares(v, x, around)
    for row, roughness in enumerate(np.linspace(0.0, 1.0, _STEPS)):
        alpha = max(roughness * roughness, LEAST_ALPHA)
        vh, nl = _visible_half_vectors(v, alpha, x, around)
        ours, theirs = (np.sqrt(alpha**2 + (1.0 - alpha**2) * c * c) for c in (nl, v[:, 2:]))
        weight = nl * (v[:, 2:] + theirs) / np.maximum(nl * theirs + v[:, 2:] * ours, 1e-30)  # G2 / G1
        grazing = np.clip(1.0 - vh, 0.0, 1.0) ** 5
        out[row, :, 0], out[row, :, 1] = weight.mean(1), (weight * grazing).mean(1)
    return out


def _visible_half_vectors(
    v: NDArray[np.float64], alpha: float, x: NDArray[np.float64], around: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(v . h, n . l), (k, q) each, of half vectors distributed as they are seen along v [Dupuy and Benyoub 2023]."""
    stretched = v * (alpha, alpha, 1.0)
    stretched /= np.linalg.norm(stretched, axis=1, keepdims=True)
    height = (1.0 - x) * (1.0 + stretched[:, 2:]) - stretched[:, 2:]
    width = np.sqrt(np.maximum(1.0 - height * height, 0.0))
    h = np.stack([alpha * (width * around + stretched[:, :1]), height + stretched[:, 2:]])
    side = alpha * width * np.sqrt(np.maximum(1.0 - around * around, 0.0))
    h /= np.maximum(np.sqrt(h[0] ** 2 + h[1] ** 2 + side**2), 1e-30)
    vh = v[:, :1] * h[0] + v[:, 2:] * h[1]
    return vh, np.maximum(2.0 * vh * h[1] - v[:, 2:], 0.0)


def _diffuse_shares(v: NDArray[np.float64], x: NDArray[np.float64], around: NDArray[np.float64]) -> np.ndarray:
    """(k,): the mean of 1 - (1 - v . h)^5 over cosine-weighted light."""
    height, width = np.sqrt(1.0 - x), np.sqrt(x)
    cosine = v[:, 0, None] * width * around + v[:, 2, None] * height  # v . l
    vh = np.sqrt(np.maximum((1.0 + cosine) / 2.0, 0.0))
    return np.asarray((1.0 - np.clip(1.0 - vh, 0.0, 1.0) ** 5).mean(1))


def uniform_lobes(points: LobePoints, roughness: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, 3) float32: the reflectance under light from all sides.

    The first two are the shares that the lobe reflects, D V and D V f integrated with the cosine. The third is the
    share of the light that reaches the diffuse part, the mean of 1 - f.
    """
    table, last = _albedo_table(), np.float32(_STEPS - 1)
    nv = np.clip((points.normal * points.view).sum(1), 0.0, 1.0)
    x, y = np.sqrt(nv) * last, np.clip(roughness, 0.0, 1.0) * last
    column, row = (np.minimum(each.astype(np.int64), _STEPS - 2) for each in (x, y))
    fx, fy = (x - column)[:, None], (y - row)[:, None]
    upper = table[row, column] * (1.0 - fx) + table[row, column + 1] * fx
    lower = table[row + 1, column] * (1.0 - fx) + table[row + 1, column + 1] * fx
    return np.asarray(upper * (1.0 - fy) + lower * fy, np.float32)
