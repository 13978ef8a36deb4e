"""Matrices of bits, 64 columns in a word: bit j % 64 of word j // 64 is column j."""

import numpy as np

from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import get, ptr, put

WORD = 64
_ROUNDS = [(32, 0x00000000FFFFFFFF), (16, 0x0000FFFF0000FFFF), (8, 0x00FF00FF00FF00FF), (4, 0x0F0F0F0F0F0F0F0F),
           (2, 0x3333333333333333), (1, 0x5555555555555555)]  # fmt: skip


def words_of(columns: int) -> int:
    """The words of a row."""
    return -(-columns // WORD)


def unpacked(words: np.ndarray, columns: int) -> np.ndarray:
    """(n, columns) bool, from (n, words) uint64."""
    little = np.ascontiguousarray(words, "<u8").view(np.uint8)
    return np.unpackbits(little, axis=1, count=columns, bitorder="little").view(bool)


def packed(rows: np.ndarray) -> np.ndarray:
    """(n, words) uint64, from (n, columns) bool. Bits beyond the last column are 0."""
    out = np.zeros((len(rows), 8 * words_of(rows.shape[1])), np.uint8)
    bits = np.packbits(rows, axis=1, bitorder="little")
    out[:, : bits.shape[1]] = bits
    return out.view("<u8").astype(np.uint64, copy=False)


def ones(columns: int) -> np.ndarray:
    """(words,) uint64: a row whose columns are all set, and no bit beyond them."""
    return packed(np.ones((1, columns), bool))[0]


def transposed(words: np.ndarray, columns: int) -> np.ndarray:
    """(columns, words of n) uint64, from (n, words) uint64 [Warren, Hacker's Delight, Sec. 7-3]."""
    n = len(words)
    high, wide = words_of(n), words.shape[1]
    blocks = np.zeros((wide, high, WORD), np.uint64)
    blocks.reshape(wide, -1)[:, :n] = words.T
    for shift, low in _ROUNDS:
        pairs = blocks.reshape(wide, high, -1, 2, shift)
        upper, lower = pairs[..., 0, :], pairs[..., 1, :]
        swapped = (upper >> np.uint64(shift) ^ lower) & np.uint64(low)
        lower ^= swapped
        upper ^= swapped << np.uint64(shift)
    return np.ascontiguousarray(blocks.transpose(0, 2, 1).reshape(-1, high)[:columns])


@kernel
def _reorder_rows(ticket, words, places, out):
    source, at, target = ptr(words), ptr(places), ptr(out)
    n, wide, width = len(places), words.shape[1], out.shape[1]
    for i in items(ticket):
        for w in range(width):
            word = np.uint64(0)
            for j in range(64 * w, min(64 * w + 64, n)):
                p = np.int64(get(at, j))
                word |= (get(source, i * wide + (p >> 6)) >> np.uint64(p & 63) & np.uint64(1)) << np.uint64(j & 63)
            put(target, i * width + w, word)


def reordered(words: np.ndarray, places: np.ndarray, threads: int | None = None) -> np.ndarray:
    """Rows, (n, words) uint64, whose column j is the column ``places[j]`` of `words`."""
    out = np.empty((len(words), words_of(len(places))), np.uint64)
    run(
        _reorder_rows, thread_count(threads), new_ticket(len(words), 16), np.ascontiguousarray(words, np.uint64),
        np.ascontiguousarray(places, np.int32), out,
    )  # fmt: skip
    return out
