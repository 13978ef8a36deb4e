"""How much of a light each pixel sees, from occlusion bits: unfiltered, filtered, or refined in penumbrae."""

from typing import NamedTuple

import numpy as np

from ..query.gbuffer import PictureSurfaces
from ..query.pixel_refinement import penumbra
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, fraction_lit
from ..scene.lights import AMBIENT, SPHERE, is_list
from .filter import filtered, filtered_shares
from .shares import shares, weighs
from .terminator import Facing


class Visible(NamedTuple):
    """How much of a light the pixels of a picture see, both (H, W) float32 in [0, 1]."""

    fraction: np.ndarray  # of its samples
    share: np.ndarray  # of its unshadowed irradiance; see `image.shares`

    def replaced(self, where: np.ndarray, other: "Visible") -> "Visible":
        """The values of another one where `where`, (H, W) bool."""
        return Visible(*(np.where(where, new, old) for new, old in zip(other, self)))


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


def visible(
    seen: PictureSurfaces, facing: Facing, query: ShadowQuery, bits: np.ndarray, smooth: bool, threads=None
) -> Visible:
    """How much of a light is visible, by the bits of its query; filtered if `smooth` and if the light is soft."""
    spp, smooth = query.samples.shape[1], smooth and is_soft(query)
    if not weighs(query.light):
        fraction = filtered(seen, occluded_samples(bits), spp, threads) if smooth else fraction_lit(bits, spp, threads)
        return Visible(fraction, fraction)
    share = shares(facing, query, bits, threads)
    if smooth:
        return Visible(*filtered_shares(seen, occluded_samples(bits), share, spp, threads))
    return Visible(fraction_lit(bits, spp, threads), share)


def occluded_samples(bits: np.ndarray) -> np.ndarray:
    """(H, W) int32: the number of occluded samples of each pixel."""
    return np.bitwise_count(bits).sum(-1, dtype=np.int32)


def finer_query(seen: PictureSurfaces, query: ShadowQuery, bits: np.ndarray, samples, threads=None) -> ShadowQuery:
    """The query of other samples at the pixels in the penumbra of one light, by the bits of its query.

    It has no receiver (side NOTHING) where nothing is refined: everywhere if the samples are those of the query.

    samples : (16, n, 3) float64, in the light's domain
    """
    sides = np.zeros_like(query.sides)
    if is_soft(query) and not np.array_equal(samples, query.samples):
        where = penumbra(seen, occluded_samples(bits), query.samples.shape[1], threads)
        sides = np.where(where, query.sides, np.int8(NOTHING))
    return query._replace(sides=sides, samples=samples)


def refined(
    before: Visible, seen: PictureSurfaces, facing: Facing, finer: ShadowQuery, bits: np.ndarray, smooth: bool,
    threads=None,
) -> Visible:  # fmt: skip
    """How much of a light is visible, with the values of a `finer_query` where it has receivers.

    Without `smooth` they equal those of a frame that uses its samples everywhere. Else they are filtered among
    themselves.
    """
    better = visible(seen._replace(side=finer.sides), facing, finer, bits, smooth, threads)
    return before.replaced(finer.sides != NOTHING, better)
