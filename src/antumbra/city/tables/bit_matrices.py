"""Bit matrices with 64 columns per word: pack, transpose, reorder, and write as .npy row by row or as CSR.

Column j is bit j % 64 of word j // 64. ``scipy.sparse.load_npz`` reads the CSR files.
"""

import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...base.extras import import_extra
from ...base.files import reserve
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import get, ptr, put

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# --- Packing and transposing ------------------------------------------------------------------------------------------


WORD = 64
_TRANSPOSE_ROUNDS = [
    (32, 0x00000000FFFFFFFF),
    (16, 0x0000FFFF0000FFFF),
    (8, 0x00FF00FF00FF00FF),
    (4, 0x0F0F0F0F0F0F0F0F),
    (2, 0x3333333333333333),
    (1, 0x5555555555555555),
]


def words_of(columns: int) -> int:
    """Words per row."""
    return -(-columns // WORD)


def unpack_bits(words: NDArray[np.uint64], columns: int) -> NDArray[np.bool_]:
    """(n, columns) bool, from (n, words) uint64."""
    little = np.ascontiguousarray(words, "<u8").view(np.uint8)
    return np.unpackbits(little, axis=1, count=columns, bitorder="little").view(bool)


def pack_bits(rows: NDArray[np.bool_]) -> NDArray[np.uint64]:
    """(n, words) uint64, from (n, columns) bool. Bits beyond the last column are 0."""
    out = np.zeros((len(rows), 8 * words_of(rows.shape[1])), np.uint8)
    bits = np.packbits(rows, axis=1, bitorder="little")
    out[:, : bits.shape[1]] = bits
    return out.view("<u8").astype(np.uint64, copy=False)


def full_row(columns: int) -> NDArray[np.uint64]:
    """(words,) uint64: a row with all columns set, and 0 beyond them."""
    return np.asarray(pack_bits(np.ones((1, columns), bool))[0])


def transpose_bits(words: NDArray[np.uint64], columns: int) -> NDArray[np.uint64]:
    """(columns, words of n) uint64, from (n, words) uint64 [Warren, Hacker's Delight, Sec. 7-3]."""
    n = len(words)
    high, wide = words_of(n), words.shape[1]
    blocks = np.zeros((wide, high, WORD), np.uint64)
    blocks.reshape(wide, -1)[:, :n] = words.T
    for shift, low in _TRANSPOSE_ROUNDS:
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


def reorder_bits(
    words: NDArray[np.uint64], places: NDArray[np.integer], threads: int | None = None
) -> NDArray[np.uint64]:
    """(n, words) uint64: `words` with its columns permuted; column j of the result is column ``places[j]``."""
    out = np.empty((len(words), words_of(len(places))), np.uint64)
    words, columns = np.ascontiguousarray(words, np.uint64), np.ascontiguousarray(places, np.int32)
    run(_reorder_rows, thread_count(threads), new_ticket(len(words), 16), words, columns, out)
    return out


# --- .npy files written row by row ------------------------------------------------------------------------------------


_COPIED_ROWS = 1 << 12  # rows copied at a time
_HEADER = 128  # bytes, for any shape: numpy pads headers to 64


def row_file_size(shape: tuple[int, int]) -> int:
    """Bytes of a .npy file that holds uint64 of this shape."""
    return _HEADER + 8 * shape[0] * shape[1]


class RowFile:
    """A .npy file of uint64 whose rows may be written in any order; a context manager that closes the file.

    Space is reserved when the file is opened, so a full disk raises OSError before the first row. Rows are not written
    through a memory map, since its pages would count as memory and a full disk would kill the process.
    """

    def __init__(self, path: Path, shape: tuple[int, ...]):
        self._file = open(path, "wb", buffering=0)  # noqa: SIM115 - closed by `__exit__`
        try:
            header = {"descr": "<u8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(self._file, header)
            self._start, self._width = self._file.tell(), 8 * shape[1]
            reserve(self._file.fileno(), self._start + shape[0] * self._width)
        except BaseException:
            self._file.close()
            raise

    def put(self, numbers: np.ndarray, rows: np.ndarray) -> None:
        """Write rows, (n, words) uint64, at the row numbers `numbers`, (n,) int. Adjacent rows share one write."""
        order = np.argsort(numbers, kind="stable")
        numbers, rows = numbers[order], np.ascontiguousarray(rows[order], "<u8")
        starts = np.flatnonzero(np.diff(numbers, prepend=-2) != 1).tolist()
        for first, last in zip(starts, [*starts[1:], len(numbers)]):
            self._file.seek(self._start + int(numbers[first]) * self._width)
            self._write(rows[first:last].tobytes())

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]

    def __enter__(self) -> "RowFile":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def write_rows(path: Path, rows: np.ndarray) -> None:
    """Write a matrix, (n, words) uint64, as a .npy file."""
    with RowFile(path, rows.shape) as file:
        for first in range(0, len(rows), _COPIED_ROWS):
            batch = rows[first : first + _COPIED_ROWS]
            file.put(np.arange(first, first + len(batch)), batch)


# --- Sparse matrices (CSR), as ``scipy.sparse.load_npz`` reads them ---------------------------------------------------


_UNPACKED_ROWS = 256  # rows unpacked at a time


def _index_type(counts: np.ndarray) -> type[np.int32] | type[np.int64]:
    return np.int32 if counts.sum() < 2**31 else np.int64


def _starts(counts: np.ndarray) -> np.ndarray:
    """(n + 1,): where each row begins in the indices."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(_index_type(counts))


def _indices(
    bits: NDArray[np.uint64], columns: int, kind: type[np.int32] | type[np.int64]
) -> Iterator[NDArray[np.integer]]:
    """Yield the columns of the set bits, a few hundred rows at a time."""
    for first in range(0, len(bits), _UNPACKED_ROWS):
        yield np.nonzero(unpack_bits(bits[first : first + _UNPACKED_ROWS], columns))[1].astype(kind)


def sparse_matrix(bits: NDArray[np.uint64], columns: int, counts: NDArray[np.int64]) -> "csr_array":
    """The set bits as a ``scipy.sparse.csr_array`` of bool."""
    import_extra("scipy", "a sparse matrix", "sparse")
    from scipy.sparse import csr_array

    kind = _index_type(counts)
    indices = np.concatenate([np.empty(0, kind), *_indices(bits, columns, kind)])
    return csr_array((np.ones(len(indices), bool), indices, _starts(counts)), shape=(len(bits), columns))


def write_sparse(file: BinaryIO, bits: NDArray[np.uint64], columns: int, counts: NDArray[np.int64]) -> None:
    """Write the set bits to a .npz file, a few hundred rows at a time."""
    total, kind = int(counts.sum()), _index_type(counts)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        arrays = {
            "format": np.array(b"csr"),
            "_is_array": np.array(True),
            "shape": np.array((len(bits), columns), np.int64),
            "indptr": _starts(counts),
        }
        for name, array in arrays.items():
            _write_member(archive, name, array.dtype, array.shape, [array])
        _write_member(archive, "indices", np.dtype(kind), (total,), _indices(bits, columns, kind))
        steps = range(0, total, 1 << 20)
        _write_member(
            archive, "data", np.dtype(bool), (total,), (np.ones(min(1 << 20, total - k), bool) for k in steps)
        )


def _write_member(
    archive: zipfile.ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...], pieces: Iterable[np.ndarray]
) -> None:
    """Write an array to an archive piece by piece."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
        header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        for piece in pieces:
            member.write(piece.tobytes())


# --- Hidden suns of each sensor ---------------------------------------------------------------------------------------


_SENSOR_ROWS = 2048  # sensors whose bits are unpacked at a time


def hidden_sun_rows(bits: NDArray[np.uint64], places: NDArray[np.int32]) -> NDArray[np.uint64]:
    """(n, ceil(k / 64)) uint64: bit s of row i is set if sun s is hidden from sensor i.

    Suns are in chronological order. A sun with several samples is hidden if more than half of them are.

    bits : (n, w) uint64, in bundle order; places : (k, samples), see `Calendar`
    """
    rows = np.zeros((len(bits), -(-len(places) // 64)), np.uint64)
    for first in range(0, len(bits), _SENSOR_ROWS):
        batch = slice(first, first + _SENSOR_ROWS)
        packed = np.ascontiguousarray(bits[batch]).view(np.uint8)
        hidden = np.unpackbits(packed, axis=1, bitorder="little")[:, places].mean(2) > 0.5
        out = np.zeros((len(packed), rows.shape[1] * 64), bool)
        out[:, : hidden.shape[1]] = hidden
        rows[batch] = np.packbits(out, axis=1, bitorder="little").view(np.uint64)
    return rows
