"""The shading of vertices that several pieces share, of meshes that are read in ranges of faces, for stores.

Smooth shading depends on all faces around a vertex. A first pass over the pieces adds these up in scratch files, by the
numbers of the vertices; the next one finds there what the faces of all pieces decide.
"""

import weakref
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import temporary_folder
from .appearance import VertexShading, add_shading
from .materials import pbr_of
from .mesh import Piece

_ANGLE, _ALL = 1, 7  # numbers of a vertex: its widest angle; and two sums of tangents
_GAP, _WINDOW = 1 << 8, 1 << 18  # rows between two that are read rather than skipped; rows read at once


class SharedVertices:
    """The `VertexShading` of the vertices of all ranges, in scratch files that are removed with this object.

    file : name in errors
    """

    def __init__(self, file: str):
        self._file, self._names = file, dict[tuple[int, str], str]()  # of the file of each mesh, by its object
        with ExitStack() as stack:
            self._folder = stack.enter_context(temporary_folder())
            weakref.finalize(self, stack.pop_all().close)

    def add(self, piece: Piece) -> None:
        """Add the faces of a range, which follow those of the ranges before. InputError if the disk is full."""
        shading = self.of(piece)
        add_shading(piece, shading)
        n = len(shading.widest)
        rows = np.concatenate([shading.widest[:, None], shading.tangents[:n], shading.tangents[n:]], 1)
        try:
            _write(self._path(piece), piece.numbers, rows[:, : _width(piece)])
        except OSError as error:
            raise InputError(
                f"{self._file}: its vertices have no room in {self._folder.parent} ({error.strerror}); set TMPDIR"
            ) from None

    def of(self, piece: Piece) -> VertexShading:
        """What the faces that were added decide at the vertices of a range."""
        assert piece.numbers is not None
        rows = np.zeros((len(piece.numbers), _ALL))
        rows[:, : _width(piece)] = _read(self._path(piece), piece.numbers, _width(piece))
        return VertexShading(rows[:, 0].copy(), np.concatenate([rows[:, 1:4], rows[:, 4:]]))

    def _path(self, piece: Piece) -> Path:
        return self._folder / self._names.setdefault((piece.first, piece.where), str(len(self._names)))


def shares_vertices(piece: Piece) -> bool:
    """Whether the smooth shading of a piece depends on others, and the numbers of its vertices are known."""
    return piece.is_range and piece.numbers is not None and piece.look is not None and piece.look.normals is not None


def _width(piece: Piece) -> int:
    """The numbers of a vertex in the file of its mesh."""
    look = piece.look
    assert look is not None
    return _ALL if any(pbr_of(material).normal_map is not None for material in look.materials) else _ANGLE


def _segments(numbers: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Ascending numbers in groups that are near each other."""
    is_break = (np.diff(numbers) > _GAP) | (np.diff(numbers // _WINDOW) > 0)
    return np.split(numbers, np.flatnonzero(is_break) + 1)


def _read(path: Path, numbers: NDArray[np.int64], width: int) -> NDArray[np.float64]:
    """(n, width): the rows with some numbers, which ascend; zeros where none was written."""
    found = [np.empty((0, width))]
    if not path.exists():
        return np.zeros((len(numbers), width))
    with path.open("rb") as stream:
        for each in _segments(numbers):
            found.append(_block(stream, int(each[0]), int(each[-1]) + 1, width)[each - each[0]])
    return np.concatenate(found)


def _write(path: Path, numbers: NDArray[np.int64] | None, rows: NDArray[np.float64]) -> None:
    """Write the rows with some numbers, which ascend; others stay."""
    assert numbers is not None
    path.touch()
    first, width = 0, rows.shape[1]
    with path.open("r+b") as stream:
        for each in _segments(numbers):
            low = int(each[0])
            block = _block(stream, low, int(each[-1]) + 1, width)
            block[each - low] = rows[first : first + len(each)]
            stream.seek(low * width * 8)
            stream.write(block.data)
            first += len(each)


def _block(stream: BinaryIO, first: int, last: int, width: int) -> NDArray[np.float64]:
    """(n, width): consecutive rows; zeros beyond the end of the file."""
    out = np.zeros((last - first, width))
    stream.seek(first * width * 8)
    data = stream.read(out.nbytes)
    out.reshape(-1)[: len(data) // 8] = np.frombuffer(data, np.float64)
    return out
