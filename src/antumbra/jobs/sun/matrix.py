"""The bits of each sensor and sun, as a file of bits."""

from pathlib import Path

import numpy as np

_ROWS = 2048  # sensors whose bits are unpacked at a time


class MatrixFile:
    """A NumPy file (n, ceil(k / 64)) uint64: bit s of row i is set if sun s is hidden from sensor i.

    Suns are in the order of time. A sun of several samples is hidden if more than half of them are.
    """

    def __init__(self, path: Path, sensors: int, suns: int):
        shape = sensors, -(-suns // 64)
        self._rows = np.lib.format.open_memmap(path, "w+", np.uint64, shape)

    def write(self, which: np.ndarray, bits: np.ndarray, places: np.ndarray) -> None:
        """Write the rows of some sensors.

        bits : (n, w) uint64, in the order of bundles; places : (k, samples), see `Calendar`
        """
        for first in range(0, len(which), _ROWS):
            some = slice(first, first + _ROWS)
            packed = np.ascontiguousarray(bits[some]).view(np.uint8)
            hidden = np.unpackbits(packed, axis=1, bitorder="little")[:, places].mean(2) > 0.5
            out = np.zeros((len(packed), self._rows.shape[1] * 64), bool)
            out[:, : hidden.shape[1]] = hidden
            self._rows[which[some]] = np.packbits(out, axis=1, bitorder="little").view(np.uint64)

    def close(self) -> None:
        """Write what is still in memory."""
        self._rows.flush()
