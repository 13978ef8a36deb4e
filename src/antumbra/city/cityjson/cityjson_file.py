"""CityJSON and CityJSONSeq files: versions, shared vertices, and templates."""

import gc
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...formats.foreign_formats import cure_of_json
from ...formats.json_fields import Fields, parse

# --- Files, objects and vertices --------------------------------------------------------------------------------------


SUFFIXES = (".json", ".jsonl")
_CODES = re.compile(r"EPSG(?::[^:,]*:|/[^/]*/|:)(\d+)", re.IGNORECASE)


class CityPart(NamedTuple):
    """Objects that share a list of vertices: a whole .json file, or one line of a .jsonl file."""

    where: str  # name in errors
    objects: dict[str, dict[str, Any]]  # id -> CityObject
    vertices: NDArray[np.float64]  # (v, 3) float64, world


class CityDocument(NamedTuple):
    """A CityJSON file."""

    file: str
    crs: str | None  # such as "EPSG:7415"
    parts: list[CityPart]
    templates: list[dict[str, Any]]  # geometries
    template_vertices: NDArray[np.float64]  # (v, 3) float64, in the frame of the templates
    notes: list[str]


@contextmanager
def many_lists() -> Iterator[None]:
    """Pause garbage collection, which takes as long as the work itself when there are millions of lists."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def lines_of(path: Path) -> list[bytes]:
    """The JSON texts in a file: one in a .json file, one per line in a .jsonl file."""
    data = path.read_bytes()
    if path.suffix.lower() == ".json":
        return [data]
    lines = [line for line in data.splitlines() if line.strip()]
    if not lines:
        raise InputError(f"{path.name}: the file is empty; export or copy it again")
    return lines


def open_cityjson(path: Path) -> CityDocument:
    """Read a .json or .jsonl file. Raises InputError if it is not CityJSON or its version is unsupported."""
    first, *others = lines_of(path)
    head = CityHead(first, path)
    parts = [head.part, *(head.feature(line, number) for number, line in enumerate(others, 2))]
    return head.document._replace(parts=parts)


class CityHead:
    """The first text of a file: what all its parts share, and its own part.

    document : without parts
    """

    def __init__(self, text: bytes, path: Path):
        head = parse(text, path.name)
        _check_head(head, path)
        self._file, self._transform = path.name, _transform(head)
        self.part = _part(head, self._transform)
        templates = head.object("geometry-templates")
        shapes: list[dict[str, Any]] = []
        corners = np.empty((0, 3))
        if templates is not None:
            shapes = templates.raw("templates", list, "a list of geometries")
            corners = _vertices(templates, "vertices-templates")
        crs, notes = _crs(head)
        self.document = CityDocument(path.name, crs, [], shapes, corners, notes)

    def feature(self, text: bytes, number: int) -> CityPart:
        """The part of a line; `number`: of the line, from 1."""
        feature = parse(text, f"{self._file}, line {number}")
        if feature.text("type") != "CityJSONFeature":
            raise feature.bad("type", '"CityJSONFeature"')
        return _part(feature, self._transform)


# --- Files of lines, a few of them at a time --------------------------------------------------------------------------


_TEXT = 1 << 21  # bytes of lines that are parsed at once, at least
Place: TypeAlias = int
"""Where a line begins: its first byte in the file."""


class CityLines:
    """A .jsonl file, whose lines are never in memory all at once."""

    def __init__(self, path: Path):
        self._path = path
        first = next(self._texts(), None)
        if first is None:
            raise InputError(f"{path.name}: the file is empty; export or copy it again")
        self.head, self._first = CityHead(first[1], path), first[0]

    def documents(self) -> Iterator[tuple[CityDocument, list[Place]]]:
        """Yield some of the lines as documents, with the places of their parts."""
        parts, places, size = list[CityPart](), list[Place](), 0
        for number, (place, text) in enumerate(self._texts(), 1):
            parts.append(self.head.part if number == 1 else self.head.feature(text, number))
            places.append(place)
            size += len(text)
            if size >= _TEXT:
                yield self.head.document._replace(parts=parts), places
                parts, places, size = [], [], 0
        if parts:
            yield self.head.document._replace(parts=parts), places

    def document_at(self, place: Place) -> CityDocument:
        """The document of one line."""
        if place == self._first:
            return self.head.document._replace(parts=[self.head.part])
        with self._path.open("rb") as stream:
            stream.seek(place)
            text = stream.readline().splitlines()[0]
        return self.head.document._replace(parts=[self.head.feature(text, 0)])

    def _texts(self) -> Iterator[tuple[Place, bytes]]:
        """Yield the lines that are not blank. A carriage return ends a line, too."""
        start = 0
        with self._path.open("rb") as stream:
            for text in stream:
                for line in text.splitlines(keepends=True):
                    if line.strip():
                        yield start, line
                    start += len(line)


def _check_head(head: Fields, path: Path) -> None:
    kind = head.text("type", None)
    if kind == "CityJSONFeature":
        raise InputError(f"{path.name}: begins with a CityJSONFeature; put the line of type CityJSON before it")
    if kind != "CityJSON":
        if cure := cure_of_json(path, kind, head.data):
            raise InputError(f"{path.name}: {cure}")
        raise InputError(
            f"{path.name}: not a CityJSON file (its type is {kind!r}); of {path.suffix} files, only CityJSON is read"
        )
    version = head.text("version")
    if version.split(".")[0] not in ("1", "2"):
        raise InputError(
            f"{path.name}: CityJSON version is {version[:20]!r}; convert it to 2.0 with: cjio FILE upgrade save OUT"
        )


def _transform(head: Fields) -> tuple[np.ndarray, np.ndarray]:
    """(scale, translation), (3,) float64 each."""
    fields = head.object("transform")
    if fields is None:
        return np.ones(3), np.zeros(3)
    return fields.numbers("scale", 3), fields.numbers("translate", 3)


def _part(fields: Fields, transform: tuple[np.ndarray, np.ndarray]) -> CityPart:
    objects = fields.raw("CityObjects", dict, "an object of CityObjects")
    for name, city_object in objects.items():
        if not isinstance(city_object, dict):
            raise InputError(
                f"{fields.where} CityObjects has {name[:60]!r}, which is not an object; export the file again"
            )
    scale, translation = transform
    return CityPart(fields.where, objects, _vertices(fields, "vertices") * scale + translation)


def _vertices(fields: Fields, key: str) -> np.ndarray:
    rows: Any = fields.raw(key, list, "a list of vertices")
    if not rows:
        return np.empty((0, 3))
    try:
        vertices = np.array(rows)
    except ValueError:  # lists of different lengths
        vertices = np.empty(0, object)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or vertices.dtype.kind not in "iuf":
        raise fields.bad(key, "a list of vertices, [x, y, z] each")
    return vertices.astype(np.float64)


def _crs(head: Fields) -> tuple[str | None, list[str]]:
    """(reference system in pyproj's notation, notes)."""
    metadata = head.object("metadata")
    text = None if metadata is None else metadata.text("referenceSystem", None)
    if text is None:
        return None, []
    codes = _CODES.findall(text)
    if not codes:
        return None, [f"{head.where} reference system {text[:80]!r} is left out: it has no EPSG code"]
    return "EPSG:" + "+".join(codes), []
