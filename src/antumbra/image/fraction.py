"""The fraction of a light that each pixel sees, from occlusion bits: unfiltered, filtered, or refined in penumbrae."""

from collections.abc import Callable

import numpy as np

from ..query.receivers import NOTHING
from ..query.refine import penumbra
from ..query.shadow import ShadowQuery, fraction_lit
from ..query.surface import PictureSurfaces
from ..scene.lights import AMBIENT, SPHERE, is_list
from .filter import filtered


def is_soft(query: ShadowQuery) -> bool:
    """Whether the query's samples estimate the visible fraction of one light that has an extent.

    All samples of a light without extent are one point, so there are no penumbrae and no noise. Each sample of a list
    is a light of its own, so other samples would not be finer.
    """
    light = query.light
    return light.kind in (SPHERE, AMBIENT) or (not is_list(light) and bool(light.u.any() or light.v.any()))


def as_needed(query: ShadowQuery) -> ShadowQuery:
    """The query, with a single sample if the light has no extent: all its samples would ask the same."""
    if is_soft(query) or is_list(query.light):
        return query
    return query._replace(samples=np.ascontiguousarray(query.samples[:, :1]))


def fraction(seen: PictureSurfaces, query: ShadowQuery, bits: np.ndarray, smooth: bool, threads=None) -> np.ndarray:
    """(H, W) float32: the fraction of samples that are not occluded; filtered if `smooth` and if the light is soft."""
    spp = query.samples.shape[1]
    if smooth and is_soft(query):
        return filtered(seen, occluded_samples(bits), spp, threads)
    return fraction_lit(bits, spp, threads)


def occluded_samples(bits: np.ndarray) -> np.ndarray:
    """(H, W) int32: the number of occluded samples of each pixel."""
    return np.bitwise_count(bits).sum(-1, dtype=np.int32)


def refine_penumbra(
    seen: PictureSurfaces,
    query: ShadowQuery,
    bits: np.ndarray,
    samples: np.ndarray,
    ask: Callable[[ShadowQuery], np.ndarray],
    smooth: bool,
    threads=None,
) -> tuple[ShadowQuery, np.ndarray]:
    """Ask again, with other samples, for the pixels in the penumbra of one light.

    Parameters
    ----------
    query, bits : ShadowQuery and its answer
    samples : (16, n, 3) float64, in the light's domain; nothing is asked if they are those of the query
    ask : function that returns the bits of a query
    smooth : whether the new fractions are filtered, among themselves

    Returns
    -------
    query : ShadowQuery
        The refining query. It has no receiver (side NOTHING) where nothing is refined.
    fraction : (H, W) float32
        The new fractions at the receivers of this query. Without `smooth` they equal those of a frame that uses these
        samples everywhere.
    """
    sides = np.zeros_like(query.sides)
    if is_soft(query) and not np.array_equal(samples, query.samples):
        where = penumbra(seen, occluded_samples(bits), query.samples.shape[1], threads)
        sides = np.where(where, query.sides, np.int8(NOTHING))
    finer = query._replace(sides=sides, samples=samples)
    return finer, fraction(seen._replace(side=sides), finer, ask(finer), smooth, threads)
