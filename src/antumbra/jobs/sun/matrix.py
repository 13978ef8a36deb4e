"""The bits of each sensor and sun."""

import numpy as np

_ROWS = 2048  # sensors whose bits are unpacked at a time


def matrix_rows(bits: np.ndarray, places: np.ndarray) -> np.ndarray:
    """(n, ceil(k / 64)) uint64: bit s of row i is set if sun s is hidden from sensor i.

    Suns are in the order of time. A sun of several samples is hidden if more than half of them are.

    bits : (n, w) uint64, in the order of bundles; places : (k, samples), see `Calendar`
    """
    rows = np.zeros((len(bits), -(-len(places) // 64)), np.uint64)
    for first in range(0, len(bits), _ROWS):
        some = slice(first, first + _ROWS)
        packed = np.ascontiguousarray(bits[some]).view(np.uint8)
        hidden = np.unpackbits(packed, axis=1, bitorder="little")[:, places].mean(2) > 0.5
        out = np.zeros((len(packed), rows.shape[1] * 64), bool)
        out[:, : hidden.shape[1]] = hidden
        rows[some] = np.packbits(out, axis=1, bitorder="little").view(np.uint64)
    return rows
