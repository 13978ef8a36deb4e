"""The rows of PLY files that trimesh reads, checked before it does: it drops or invents rows of files that are cut.

The header declares elements and their properties. The rest of the file must hold exactly these numbers.
"""

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.wording import counted
from .text_numbers import parsed_numbers

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
"""Name of a type in a header -> that of NumPy, without its byte order."""

INDICES = ("vertex_indices", "vertex_index")
"""Names of the list of a face's corners."""

_LINE = re.compile(rb"^(element|property)\s+(.+?)\s*$", re.MULTILINE)
_END = re.compile(rb"^end_header[ \t]*\r?\n", re.MULTILINE)
_CURE = "export the mesh again"
_LEAST_CORNERS = 3


class PlyProperty(NamedTuple):
    """A property: a number per row, or a list of numbers."""

    name: str
    kind: str  # of NumPy
    of_count: str | None  # type of the length of a list; None: a number


class PlyElement(NamedTuple):
    """The rows of one kind."""

    name: str
    n_rows: int
    properties: list[PlyProperty]


def elements_of(head: bytes, file: str) -> list[PlyElement]:
    """The elements that a header declares."""
    elements = list[PlyElement]()
    for kind, line in _LINE.findall(head):
        words = line.decode("ascii", "replace").split()
        if kind == b"element":
            if len(words) != 2 or not words[1].isdecimal():
                raise InputError(f"{file}: PLY header declares {' '.join(words)[:40]!r}; write a name and a count")
            elements.append(PlyElement(words[0], int(words[1]), []))
        elif elements:
            is_list = words[0] == "list"
            if len(words) != (4 if is_list else 2) or not {*words[:-1]} <= {*TYPES, "list"}:
                raise InputError(f"{file}: PLY header has the property {' '.join(words)[:40]!r}, which is unknown")
            of_count = TYPES[words[1]] if is_list else None
            elements[-1].properties.append(PlyProperty(words[-1], TYPES[words[-2]], of_count))
    return elements


def check_rows(data: bytes, file: str) -> list[str]:
    """Notes on faces of a PLY file that are left out.

    Raises
    ------
    InputError
        If the file holds fewer or more numbers than its header declares, or anything else.
    """
    end = _END.search(data)
    if end is None:
        raise InputError(f"{file}: PLY header has no end_header; copy the file again")
    head, body = data[: end.start()], data[end.end() :]
    elements = elements_of(head, file)
    if b"format ascii" in head:
        rows: _PlyRows = _TextRows(_numbers_of(body, file), file)
    else:
        rows = _BinaryRows(body, ">" if b"format binary_big_endian" in head else "<", file)
    n_thin = 0
    for element in elements:
        if all(each.of_count is None for each in element.properties):
            rows.skip(element)
            continue
        for row in range(element.n_rows):
            for each in element.properties:
                length = rows.read(each, f"{file}: {element.name} {row}")
                n_thin += element.name == "face" and each.name in INDICES and length < _LEAST_CORNERS
    if rows.left:
        raise InputError(f"{file}: has {rows.left} more than its PLY header declares; {_CURE}")
    n_lines = sum(bool(line.strip()) for line in body.splitlines()) if n_thin and isinstance(rows, _TextRows) else None
    if n_lines not in (None, sum(each.n_rows for each in elements)):  # a row that is lacking shifts all others
        raise InputError(f"{file}: its rows are not those that its PLY header declares; copy the file again")
    return [f"{file}: left out {counted(n_thin, 'face')} with fewer than {_LEAST_CORNERS} corners"] if n_thin else []


def _numbers_of(body: bytes, file: str) -> NDArray[np.float64]:
    numbers = parsed_numbers(body, np.float64)
    if numbers is None:
        word = next((word for word in body.split() if parsed_numbers(word, np.float64) is None), b"")
        raise InputError(f"{file}: {word[:20].decode('utf-8', 'replace')!r} is not a number; {_CURE}")
    return numbers


class _PlyRows:
    """Reads properties one after another. `left` says what has not been read, "" at the end."""

    left: str

    def skip(self, element: PlyElement) -> None:
        """Pass the rows of an element without lists."""
        raise NotImplementedError

    def read(self, each: PlyProperty, where: str) -> int:
        """Pass a property of one row; the length of a list, 1 for a number."""
        raise NotImplementedError


def _checked_length(length: float, where: str, name: str) -> int:
    if not (length >= 0 and length == int(length)):
        raise InputError(f"{where}: its list {name} says it has {length:g} entries; {_CURE}")
    return int(length)


class _TextRows(_PlyRows):
    def __init__(self, numbers: NDArray[np.float64], file: str):
        self._numbers, self._at, self._file = numbers, 0, file

    @property
    def left(self) -> str:  # type: ignore[override]
        n = len(self._numbers) - self._at
        return f"{counted(n, 'number')}" if n else ""

    def _take(self, n: int, where: str) -> NDArray[np.float64]:
        taken = self._numbers[self._at : self._at + n]
        if len(taken) < n:
            raise InputError(
                f"{where}: needs {counted(n, 'number')}, {len(taken)} are left; the file is cut short, copy it again"
            )
        self._at += n
        return taken

    def skip(self, element: PlyElement) -> None:
        self._take(element.n_rows * len(element.properties), f"{self._file}: {element.name} rows")

    def read(self, each: PlyProperty, where: str) -> int:
        if each.of_count is None:
            self._take(1, where)
            return 1
        length = _checked_length(float(self._take(1, where)[0]), where, each.name)
        values = self._take(length, f"{where}: its list {each.name}")
        if each.kind[0] != "f" and (values != np.floor(values)).any():
            raise InputError(f"{where}: its list {each.name} holds numbers that are not whole; {_CURE}")
        return length


class _BinaryRows(_PlyRows):
    def __init__(self, data: bytes, order: str, file: str):
        self._data, self._order, self._at, self._file = data, order, 0, file

    @property
    def left(self) -> str:  # type: ignore[override]
        n = len(self._data) - self._at
        return f"{n} bytes" if n else ""

    def _take(self, size: int, where: str) -> None:
        available = len(self._data) - self._at
        if available < size:
            raise InputError(f"{where}: needs {size} bytes, {available} are left; the file is cut short, copy it again")
        self._at += size

    def skip(self, element: PlyElement) -> None:
        size = element.n_rows * sum(int(each.kind[1]) for each in element.properties)
        self._take(size, f"{self._file}: {element.name} rows")

    def read(self, each: PlyProperty, where: str) -> int:
        if each.of_count is None:
            self._take(int(each.kind[1]), where)
            return 1
        self._take(int(each.of_count[1]), where)
        width = int(each.of_count[1])
        (stored,) = np.frombuffer(self._data, self._order + each.of_count, 1, self._at - width).tolist()
        length = _checked_length(stored, where, each.name)
        self._take(length * int(each.kind[1]), f"{where}: its list {each.name} of {length:,} entries")
        return length
