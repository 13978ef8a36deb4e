"""`Visibility`: which samples of lights points see, and the light that arrives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..query.shadow_query import fraction_lit
from ..trace.transmission import TracedQuery, lit_fraction


class Visibility(NamedTuple):
    """Visibility of light samples from points.

    The leading shape (...) is that of the points for a single light, and (..., lights) for a list of lights.
    """

    bits: NDArray[np.uint64]  # (..., ceil(n / 64)) uint64: bit s = sample s occluded; 0 beyond the samples of a light
    fraction: NDArray[np.float32]  # (...) float32 in [0, 1]: mean over the light's samples that arrive; NaN: failed
    samples: NDArray[np.int64]  # int64, () or (lights,): number of samples of each light
    colour: NDArray[np.float32] | None = None  # (..., 3) float32: `fraction` of red, green and blue; None: all equal

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(...) bool: whether any sample is visible. For a light with one sample, whether the light is visible."""
        return self.fraction > 0.0

    @property
    def seen_samples(self) -> NDArray[np.bool_]:
        """(..., n) bool: whether sample s is visible; False beyond the samples of a light. n is the largest count."""
        words = np.ascontiguousarray(self.bits).astype("<u8", copy=False)
        n = int(self.samples.max(initial=0))
        occluded = np.unpackbits(words.view(np.uint8), axis=-1, count=n, bitorder="little")
        visible: NDArray[np.bool_] = (occluded == 0) & (np.arange(n) < self.samples[..., None])
        return visible

    def reshaped(self, shape: tuple[int, ...], single: bool) -> "Visibility":
        """The same values with another leading shape; `single`: drop the axis of lights, which has length 1."""
        words = self.bits.shape[-1]
        lights = () if single else (len(self.samples),)
        samples = self.samples.reshape(()) if single else self.samples
        fraction = self.fraction.reshape((*shape, *lights))
        colour = None if self.colour is None else self.colour.reshape((*shape, *lights, 3))
        return Visibility(self.bits.reshape((*shape, *lights, words)), fraction, samples, colour)

    def __repr__(self) -> str:
        samples = "/".join(map(str, np.unique(self.samples)))
        mean = f", {self.fraction.mean():.3g} of the light arrives" if self.fraction.size else ""
        return f"Visibility({self.fraction.shape}, {samples} samples{mean}; bits, fraction, samples, seen)"


def visibility_of(answers: Sequence[TracedQuery]) -> Visibility:
    """The `Visibility` of n points, (n, lights), from the answer for each light, whose receivers are a single row."""
    words = max(each.bits.shape[-1] for each in answers)
    fraction = _stack_last([lit_fraction(each)[0] for each in answers])
    counts = np.array([each.spp for each in answers], np.int64)
    colour = None
    if any(each.light is not None and each.light.values.shape[2] > 1 for each in answers):
        colour = np.stack([_colour_of(each)[0] for each in answers], axis=-2)
    return Visibility(_stack_bits([each.bits for each in answers], words)[0], fraction, counts, colour)


def mark_failed(found: Visibility, failed: NDArray[np.intp]) -> Visibility:
    """A `Visibility`, (n, lights), with the points of these indices marked as failed; changes it in place."""
    if len(failed):
        whole = np.clip(found.samples[:, None] - 64 * np.arange(found.bits.shape[-1]), 0, 64)  # samples in each word
        ones = np.where(whole == 64, ~np.uint64(0), (np.uint64(1) << (whole % 64).astype(np.uint64)) - np.uint64(1))
        found.bits[failed], found.fraction[failed] = ones, np.nan
        if found.colour is not None:
            found.colour[failed] = np.nan
    return found


def _colour_of(traced: TracedQuery) -> NDArray[np.float32]:
    fraction = fraction_lit(traced.bits, traced.spp)
    return np.repeat(fraction[..., None], 3, -1) if traced.light is None else traced.light.colour_of(fraction)


def _stack_last(arrays: Sequence[np.ndarray]) -> np.ndarray:
    return arrays[0][..., None] if len(arrays) == 1 else np.stack(arrays, axis=-1)


def _stack_bits(bits_per_light: Sequence[np.ndarray], words: int) -> np.ndarray:
    """(1, m, lights, words): the bits of all lights, padded to the same number of words."""
    if len(bits_per_light) == 1:
        return bits_per_light[0][:, :, None]
    bits = np.zeros((*bits_per_light[0].shape[:2], len(bits_per_light), words), np.uint64)
    for k, light_bits in enumerate(bits_per_light):
        bits[:, :, k, : light_bits.shape[-1]] = light_bits
    return bits
