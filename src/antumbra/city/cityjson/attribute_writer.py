"""Write per-face values, such as sun hours, to the semantic surfaces and objects in a copy of a CityJSON file.

Values are averaged over the faces of each surface and object, weighted by area.
"""

import json
from collections.abc import Mapping
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, path_of, quoted
from ...base.checks import text as checked_text
from ...base.errors import InputError
from ...base.files import atomic_output, checked_file, checked_output
from ...base.wording import counted
from ...scene.mesh import Mesh
from ...scene.scene_data import CityModel, SemanticSurface
from .city_geometries import DEPTHS, INSTANCE
from .city_polygons import RESERVED
from .cityjson_file import SUFFIXES, lines_of, many_lists
from .cityjson_source import read_cityjson
from .surface_types import surface_type


class _Means(NamedTuple):
    """Area-weighted means of one attribute; NaN where no face has a value."""

    name: str
    surfaces: NDArray[np.float64]  # (s,) float64
    objects: NDArray[np.float64]  # (o,) float64


def write_attributes(
    source_path: str | PathLike[str],
    target_path: str | PathLike[str],
    values: Mapping[str, np.ndarray],
    *,
    lod: str | None = None,
) -> None:
    """Write a copy of a CityJSON file with attributes on semantic surfaces and on objects.

    A surface gets the area-weighted mean of its faces, and an object the mean of all its faces. Faces with non-finite
    values are ignored. A polygon without semantics gets its own semantic surface, whose type follows from its object
    and its normal. Surfaces of geometry templates are shared by all their instances, so only the objects of instances
    get attributes. Everything else is unchanged.

    Parameters
    ----------
    source_path, target_path : str or path-like
        .json or .jsonl, the same for both.
    values : dict of str to (n,) float
        Attribute name -> one value per face of ``load(source_path, lod=lod)``.
    lod : str, optional
        The level of detail that was loaded.

    Raises
    ------
    InputError
        If the source cannot be read, the target cannot be written, or values do not fit the faces.
    """
    source = path_of(source_path, "source_path")
    checked_file(source, source.name)
    if source.suffix.lower() not in SUFFIXES:
        raise InputError(f"{source.name}: attributes are written to CityJSON only; name a .json or .jsonl file")
    target = checked_output(target_path, (source.suffix.lower(),))
    if lod is not None:
        checked_text(lod, "lod")
    if not isinstance(values, Mapping):
        raise InputError(f"values are {quoted(values)}; give a dict of the attribute's name to a value for each face")
    city_file = read_cityjson(source, lod)
    vectors = _vector_areas(city_file.source.mesh)
    means = [_means(name, face_values, city_file.city, vectors) for name, face_values in values.items()]
    with many_lists():
        texts = [json.loads(line) for line in lines_of(source)]
        _write(texts, city_file.city, means, _heights(city_file.city, vectors))
        with atomic_output(target) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as stream:
            for text in texts:
                stream.write(json.dumps(text, ensure_ascii=False, separators=(",", ":")) + "\n")


def _write(texts: list[dict[str, Any]], city: CityModel, means: list[_Means], heights: np.ndarray) -> None:
    """Set the attributes in the JSON texts of a file."""
    city_objects = {name: thing for text in texts for name, thing in text.get("CityObjects", {}).items()}
    for geometry in _without_semantics(city_objects, city):
        _fill_semantics(geometry)
    for k, surface in enumerate(city.surfaces):
        _write_surface(city_objects, city, surface, {m.name: m.surfaces[k] for m in means}, heights[k])
    for k, name in enumerate(city.objects):
        attributes = _of_kind(dict, city_objects[name].get("attributes"))
        _update(attributes, {m.name: m.objects[k] for m in means})
        if attributes:
            city_objects[name]["attributes"] = attributes


def _vector_areas(mesh: Mesh) -> NDArray[np.float64]:
    """Face normals scaled by face area, (n, 3) float64."""
    assert mesh.faces is not None
    a, b, c = (mesh.positions[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2.0


def _means(name: str, face_values: ArrayLike, city: CityModel, vectors: np.ndarray) -> _Means:
    if not isinstance(name, str) or not name or name in RESERVED:
        raise InputError(f"attribute {name!r} cannot be written; choose another name")
    flags = isinstance(face_values, np.ndarray) and face_values.dtype.kind == "b"  # whose means are shares
    values = as_array(np.asarray(face_values, np.uint8) if flags else face_values, f"attribute {name!r}")
    if values.shape != city.object_of_face.shape:
        raise InputError(
            f"attribute {name!r} is {values.dtype} {values.shape}; it must be numbers, one for each of "
            f"{counted(len(city.object_of_face), 'face')}"
        )
    values, area = values.astype(np.float64), np.linalg.norm(vectors, axis=1)
    weights = np.where(np.isfinite(values), area, 0.0)
    values = np.where(np.isfinite(values), values, 0.0)
    groups = (city.surface_of_face, len(city.surfaces)), (city.object_of_face, len(city.objects))
    with np.errstate(invalid="ignore"):
        means = (np.bincount(group, values * weights, n) / np.bincount(group, weights, n) for group, n in groups)
        return _Means(name, *means)


def _heights(city: CityModel, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vertical component of each surface's unit normal, (s,) float64."""
    n = len(city.surfaces)
    total = np.stack([np.bincount(city.surface_of_face, column, n) for column in vectors.T], axis=1)
    out: NDArray[np.float64] = total[:, 2] / np.maximum(np.linalg.norm(total, axis=1), np.finfo(float).tiny)
    return out


def _geometry(city_objects: dict[str, Any], city: CityModel, surface: SemanticSurface) -> dict[str, Any]:
    geometry: dict[str, Any] = city_objects[city.objects[surface.object]]["geometry"][surface.geometry]
    return geometry


def _without_semantics(city_objects: dict[str, Any], city: CityModel) -> list[dict[str, Any]]:
    """The geometries, each once, with polygons without semantics. Instances are skipped: they have no polygons."""
    geometries = {(s.object, s.geometry): _geometry(city_objects, city, s) for s in city.surfaces if s.semantic is None}
    return [geometry for geometry in geometries.values() if geometry["type"] != INSTANCE]


def _fill_semantics(geometry: dict[str, Any]) -> None:
    """Complete a geometry's "semantics", with a value (or null) for each polygon."""
    semantics = _of_kind(dict, geometry.get("semantics"))
    values = _padded_values(geometry["boundaries"], semantics.get("values"), DEPTHS[geometry["type"]])
    geometry["semantics"] = {**semantics, "surfaces": _of_kind(list, semantics.get("surfaces")), "values": values}


def _write_surface(
    city_objects: dict[str, Any], city: CityModel, surface: SemanticSurface, values: dict[str, float], height: float
) -> None:
    geometry = _geometry(city_objects, city, surface)
    if geometry["type"] == INSTANCE:
        return
    surfaces, index = geometry["semantics"]["surfaces"], surface.semantic
    if index is None:
        index = len(surfaces)
        surfaces.append({"type": surface_type(city.types[surface.object], height)})
        *path, last = surface.path
        inner = geometry["semantics"]["values"]
        for step in path:
            inner = inner[step]
        inner[last] = index
    _update(surfaces[index], values)


def _padded_values(boundaries: list[Any], values: Any, depth: int) -> Any:
    """`values`, padded with null to the shape of the boundaries."""
    values = _of_kind(list, values)
    values += [None] * (len(boundaries) - len(values))
    if depth:
        for k, inner in enumerate(boundaries):
            values[k] = _padded_values(inner, values[k], depth - 1)
    return values


def _of_kind(kind: type, value: Any) -> Any:
    """`value`, or an empty `kind` if it has another type."""
    return value if isinstance(value, kind) else kind()


def _update(attributes: dict[str, Any], values: dict[str, float]) -> None:
    """Set the finite values in a JSON object; JSON cannot represent others."""
    attributes.update((name, float(value)) for name, value in values.items() if np.isfinite(value))
