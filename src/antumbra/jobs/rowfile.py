"""Matrices of bits in .npy files, written row by row."""

from pathlib import Path

import numpy as np

from ..files import reserve

_ROWS = 1 << 12  # rows that are copied at a time
_HEADER = 128  # bytes, for any shape: numpy pads headers to 64


def row_file_size(shape: tuple[int, int]) -> int:
    """Bytes of a .npy file of this shape of uint64."""
    return _HEADER + 8 * shape[0] * shape[1]


class RowFile:
    """A .npy file of uint64 whose rows are written in any order; a context manager that closes it.

    Its space is reserved first, so that a full disk is an OSError before the first row. Rows are not written through a
    memory map: its pages would count as memory, and a full disk would end the process.
    """

    def __init__(self, path: Path, shape: tuple[int, ...]):
        self._file = open(path, "wb", buffering=0)  # noqa: SIM115 - closed by `__exit__`
        try:
            about = {"descr": "<u8", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(self._file, about)
            self._start, self._width = self._file.tell(), 8 * shape[1]
            reserve(self._file.fileno(), self._start + shape[0] * self._width)
        except BaseException:
            self._file.close()
            raise

    def put(self, numbers: np.ndarray, rows: np.ndarray) -> None:
        """Write rows, (n, words) uint64, at these numbers, (n,) int. Neighbours are written at once."""
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

    def __exit__(self, *_) -> None:
        self._file.close()


def write_rows(path: Path, rows: np.ndarray) -> None:
    """Write a matrix, (n, words) uint64, as a .npy file."""
    with RowFile(path, rows.shape) as file:
        for first in range(0, len(rows), _ROWS):
            some = rows[first : first + _ROWS]
            file.put(np.arange(first, first + len(some)), some)
