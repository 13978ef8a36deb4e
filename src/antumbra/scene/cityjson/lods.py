"""Levels of detail: which geometries of a city object are read."""

from collections.abc import Iterator
from typing import NamedTuple

from ...errors import InputError
from .document import Document, Part

DEPTHS = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2, "CompositeSolid": 2}
"""Type of geometry -> levels of lists around the polygons of its boundaries."""

INSTANCE = "GeometryInstance"


class Chosen(NamedTuple):
    """A geometry to read."""

    part: Part
    object: str  # id
    place: int  # in the object's "geometry"
    geometry: dict  # of a `GeometryInstance`, the template
    instance: dict | None  # the `GeometryInstance`


def chosen_geometries(document: Document, lod: str | None) -> tuple[list[Chosen], list[str]]:
    """(geometries of a level of detail, or the highest of each object; all levels of the file, in ascending order).

    An object is left out if a part of it, such as a BuildingPart, has a higher level: the parts are the whole object.

    Raises
    ------
    InputError
        If no geometry has the level `lod`, with all levels of the file.
    """
    found = {
        (k, name): list(_surfaces(document, part, name))
        for k, part in enumerate(document.parts)
        for name in part.objects
    }
    levels = sorted({lod_of(c.geometry) for shapes in found.values() for c in shapes} - {""}, key=_rank)
    if lod is not None:
        wanted = lod_of({"lod": lod})
        if wanted not in levels:
            known = f"there are {', '.join(levels)}" if levels else "its geometries have none; leave lod out"
            raise InputError(f"{document.file}: no geometry has lod {wanted!r}; {known}")
        return [c for shapes in found.values() for c in shapes if lod_of(c.geometry) == wanted], levels
    highest = {key: max((lod_of(c.geometry) for c in shapes), key=_rank) for key, shapes in found.items() if shapes}
    chosen = []
    for (k, name), level in highest.items():
        parts = [highest.get((k, child), "") for child in _parts(document.parts[k], name)]
        if not any(_rank(other) > _rank(level) for other in parts):
            chosen += [c for c in found[k, name] if lod_of(c.geometry) == level]
    return chosen, levels


def lod_of(geometry: dict) -> str:
    """The level of detail as text; "" if there is none. 2, 2.0 and "2.0" are "2"."""
    value = geometry.get("lod")
    if value is None or isinstance(value, (dict, list)):
        return ""
    try:
        return f"{float(value):g}"
    except ValueError:
        return str(value)


def _rank(lod: str) -> tuple[bool, float]:
    try:
        return True, float(lod)
    except ValueError:
        return False, 0.0


def _surfaces(document: Document, part: Part, name: str) -> Iterator[Chosen]:
    """The geometries of an object that have surfaces."""
    shapes = part.objects[name].get("geometry")
    for index, shape in enumerate(shapes if isinstance(shapes, list) else []):
        where = f'{part.where} CityObjects "{name[:60]}" geometry[{index}]'
        if not isinstance(shape, dict):
            raise InputError(f"{where} is no object; export the file again")
        instance = None
        if shape.get("type") == INSTANCE:
            number, instance = shape.get("template"), shape
            if not isinstance(number, int) or not 0 <= number < len(document.templates):
                raise InputError(f"{where}.template is {number!r}; there are {len(document.templates)} templates")
            shape = document.templates[number]
        if isinstance(shape, dict) and str(shape.get("type")) in DEPTHS:
            yield Chosen(part, name, index, shape, instance)


def _parts(part: Part, name: str) -> list[str]:
    """Ids of the children of an object that are parts of it, such as BuildingParts."""
    children = part.objects[name].get("children")
    known = [c for c in children if isinstance(c, str) and c in part.objects] if isinstance(children, list) else []
    return [c for c in known if str(part.objects[c].get("type")).endswith("Part")]
