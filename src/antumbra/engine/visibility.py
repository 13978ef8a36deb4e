"""Which samples of lights points see."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..query.shadow_query import fraction_lit


class Visibility(NamedTuple):
    """What points see of a light, or of several; (...) is the points' leading shape, and (..., lights) for several."""

    bits: np.ndarray  # (..., ceil(n / 64)) uint64: bit s = sample s occluded; 0 beyond the samples of a light
    fraction: np.ndarray  # (...) float32 in [0, 1]: share of the samples that are not occluded
    samples: np.ndarray  # int64, () or (lights,): number of samples of each light

    @property
    def seen(self) -> np.ndarray:
        """(...) bool: whether the point sees any sample. For a light of one sample, whether it sees the light."""
        return self.fraction > 0.0

    @property
    def seen_samples(self) -> np.ndarray:
        """(..., n) bool: whether the point sees sample s. n: the most samples of a light; False beyond its own."""
        words = np.ascontiguousarray(self.bits).astype("<u8", copy=False)
        n = int(self.samples.max(initial=0))
        occluded = np.unpackbits(words.view(np.uint8), axis=-1, count=n, bitorder="little")
        return (occluded == 0) & (np.arange(n) < self.samples[..., None])

    def reshaped(self, shape: tuple[int, ...], alone: bool) -> "Visibility":
        """The same for points of another leading shape; `alone`: of the only light, without the axis of lights."""
        words = self.bits.shape[-1]
        lights = () if alone else (len(self.samples),)
        samples = self.samples.reshape(()) if alone else self.samples
        return Visibility(
            self.bits.reshape((*shape, *lights, words)), self.fraction.reshape((*shape, *lights)), samples
        )

    def __repr__(self) -> str:
        samples = "/".join(map(str, np.unique(self.samples)))
        mean = f", {self.fraction.mean():.3g} of the samples seen" if self.fraction.size else ""
        return f"Visibility({self.fraction.shape}, {samples} samples{mean}; bits, fraction, samples, seen)"


def visibility_of(bits: Sequence[np.ndarray], counts: Sequence[int]) -> Visibility:
    """The `Visibility` of a list of n points, (n, lights), from the bits of each light, (1, n, words) uint64."""
    words = max(each.shape[-1] for each in bits)
    fraction = _last_axis([fraction_lit(each, n)[0] for each, n in zip(bits, counts)])
    return Visibility(_side_by_side(bits, words)[0], fraction, np.array(counts, np.int64))


def _last_axis(arrays: Sequence[np.ndarray]) -> np.ndarray:
    return arrays[0][..., None] if len(arrays) == 1 else np.stack(arrays, axis=-1)


def _side_by_side(found: Sequence[np.ndarray], words: int) -> np.ndarray:
    """The bits of the lights, (1, m, lights, words)."""
    if len(found) == 1:
        return found[0][:, :, None]
    bits = np.zeros((*found[0].shape[:2], len(found), words), np.uint64)
    for k, of_light in enumerate(found):
        bits[:, :, k, : of_light.shape[-1]] = of_light
    return bits
