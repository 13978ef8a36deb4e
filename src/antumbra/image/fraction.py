"""From bits to the fraction of a light that each pixel sees: as it is, filtered, or refined in penumbrae."""

from collections.abc import Callable

import numpy as np

from ..query.receivers import NOTHING
from ..query.refine import penumbra
from ..query.shadow import ShadowQuery, fraction_lit
from ..query.surface import Seen
from ..scene.lights import AMBIENT, LIST, SPHERE
from .filter import filtered


def is_soft(query: ShadowQuery) -> bool:
    """Does the share of samples that are occluded estimate how much is seen of one light, which has an extent?

    Without extent, all samples are one point: there are no penumbrae, and nothing is noisy. Of a list, each sample is a
    light of its own, to be asked by itself, and no other samples would be finer.
    """
    light = query.light
    return light.kind in (SPHERE, AMBIENT) or (light.kind != LIST and bool(light.u.any() or light.v.any()))


def as_needed(query: ShadowQuery) -> ShadowQuery:
    """The query, with one sample if the light has no extent: the others would ask the same again."""
    if is_soft(query) or query.light.kind == LIST:
        return query
    return query._replace(samples=np.ascontiguousarray(query.samples[:, :1]))


def fraction(seen: Seen, query: ShadowQuery, bits: np.ndarray, smooth: bool, threads=None) -> np.ndarray:
    """(H, W) float32: the share of samples that are not occluded; filtered if `smooth`, and if that can help."""
    spp = query.samples.shape[1]
    if smooth and is_soft(query):
        return filtered(seen, occluded_samples(bits), spp, threads)
    return fraction_lit(bits, spp, threads)


def occluded_samples(bits: np.ndarray) -> np.ndarray:
    """(H, W) int32: how many samples of each pixel are occluded."""
    return np.bitwise_count(bits).sum(-1, dtype=np.int32)


def refine_penumbra(
    seen: Seen,
    query: ShadowQuery,
    bits: np.ndarray,
    samples: np.ndarray,
    ask: Callable[[ShadowQuery], np.ndarray],
    smooth: bool,
    threads=None,
) -> tuple[ShadowQuery, np.ndarray]:
    """Ask again, with other samples, about the pixels in the penumbra of one light.

    Parameters
    ----------
    query, bits : ShadowQuery and its answer
    samples : (16, n, 3) float64, in the light's domain; nothing is asked if they are those of the query
    ask : gives the bits of a query
    smooth : filter the new fractions, among themselves

    Returns
    -------
    query : ShadowQuery
        What was asked: no receiver (side NOTHING) where nothing is refined.
    fraction : (H, W) float32
        Where there is a receiver, and `smooth` is false: what a frame with these samples everywhere has there.
    """
    sides = np.zeros_like(query.sides)
    if is_soft(query) and not np.array_equal(samples, query.samples):
        where = penumbra(seen, occluded_samples(bits), query.samples.shape[1], threads)
        sides = np.where(where, query.sides, np.int8(NOTHING))
    finer = query._replace(sides=sides, samples=samples)
    return finer, fraction(seen._replace(side=sides), finer, ask(finer), smooth, threads)
