"""CityJSON and CityJSONSeq files: versions, shared vertices, and templates."""

import gc
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

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
    file, (first, *others) = path.name, lines_of(path)
    head = parse(first, file)
    _check_head(head, path)
    transform = _transform(head)
    parts = [_part(head, transform)]
    for number, line in enumerate(others, 2):
        feature = parse(line, f"{file}, line {number}")
        if feature.text("type") != "CityJSONFeature":
            raise feature.bad("type", '"CityJSONFeature"')
        parts.append(_part(feature, transform))
    templates = head.object("geometry-templates")
    shapes: list[dict[str, Any]] = []
    corners = np.empty((0, 3))
    if templates is not None:
        shapes = templates.raw("templates", list, "a list of geometries")
        corners = _vertices(templates, "vertices-templates")
    crs, notes = _crs(head)
    return CityDocument(file, crs, parts, shapes, corners, notes)


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
