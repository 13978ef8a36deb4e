"""What travels in a pickle: what cannot be computed again, and arrays in fewer bytes, without loss."""

import zlib
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


def without_cached(thing: object) -> dict[str, Any]:
    """The attributes of an object, without the values of its cached properties."""
    kind = type(thing)
    return {
        name: value for name, value in vars(thing).items() if not isinstance(getattr(kind, name, None), cached_property)
    }


class Runs(NamedTuple):
    """An array whose rows repeat: each distinct row of a run once."""

    rows: np.ndarray
    lengths: NDArray[np.int64]

    def array(self) -> np.ndarray:
        """All rows."""
        return np.repeat(self.rows, self.lengths, axis=0)


def in_runs(array: np.ndarray) -> "Runs | np.ndarray":
    """An (n, c) float32 array as `Runs`, if that halves it; the bits of equal rows are equal."""
    bits = array.view(np.uint32)
    first = np.ones(len(array), bool)
    first[1:] = (bits[1:] != bits[:-1]).any(1)
    starts = np.flatnonzero(first)
    if 4 * len(starts) > len(array):
        return array
    return Runs(array[starts], np.diff(starts, append=len(array)))


class Squeezed(NamedTuple):
    """Compressed pixels, (h, w, c) uint8: differences between neighbours in a row, which are small in pictures."""

    data: bytes
    shape: tuple[int, ...]

    def array(self) -> NDArray[np.uint8]:
        """The pixels."""
        steps = np.frombuffer(zlib.decompress(self.data), np.uint8).reshape(self.shape)
        return np.cumsum(steps, axis=1, dtype=np.uint8)


def squeezed(pixels: NDArray[np.uint8]) -> Squeezed:
    """Pixels, (h, w, c) uint8, in fewer bytes."""
    steps = np.diff(pixels, axis=1, prepend=np.uint8(0))
    return Squeezed(zlib.compress(steps.tobytes(), 1), pixels.shape)
