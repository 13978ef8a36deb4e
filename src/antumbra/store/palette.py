"""Palettes: colours of triangles as indices of rows. Most scenes have few colours, so an index takes a byte."""

import numpy as np

from ..kernels.jit import kernel

_NONE = np.int32(-1)


@kernel
def _index(colours, table, palette, index):
    """Fill the palette with the colours, in order of occurrence, and fill the index. Return the number of colours.

    `colours` is (n, 3) int32, the bits of float32. `table` is (2**b,) int32, all -1: a hash table of more than n rows.
    """
    last, n = np.int64(len(table) - 1), 0
    for i in range(len(colours)):
        r, g, b = colours[i, 0], colours[i, 1], colours[i, 2]
        h = np.int64(r) * 73856093 ^ np.int64(g) * 19349663 ^ np.int64(b) * 83492791
        h = (h ^ h >> 13 ^ h >> 29) & last
        row = table[h]
        while row != _NONE and (palette[row, 0] != r or palette[row, 1] != g or palette[row, 2] != b):
            h = (h + 1) & last
            row = table[h]
        if row == _NONE:
            row = np.int32(n)
            table[h] = row
            palette[n, 0], palette[n, 1], palette[n, 2] = r, g, b
            n += 1
        index[i] = row
    return n


def palette_of(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(palette, index) of colours, (n, 3) float32. ``palette[index]`` equals the colours bit for bit."""
    n = len(colours)
    bits = np.ascontiguousarray(colours, np.float32).view(np.int32)
    table = np.full(1 << (2 * n).bit_length(), _NONE)
    palette, index = np.empty((n, 3), np.int32), np.empty(n, np.int32)
    count = _index(bits, table, palette, index)
    return palette[:count].view(np.float32), index
