"""Which geometries of a CityJSON file are read: one level of detail (LoD) per object, and each surface once.

Files may hold the same shape several times: as a Solid and as a MultiSurface, or in a Building and in its parts. Roof
areas and energy would count them all. Geometries that fill the same box are therefore taken for the same shape.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.memory import check_reading
from ...base.wording import agreeing, counted
from ...kernels.small_matrices import product
from .cityjson_file import CityDocument, CityPart, Place

DEPTHS = {"MultiSurface": 0, "CompositeSurface": 0, "Solid": 1, "MultiSolid": 2, "CompositeSolid": 2}
"""Type of geometry -> nesting depth of the polygons in its boundaries."""

INSTANCE = "GeometryInstance"

_PREFERENCE = ("Solid", "CompositeSolid", "MultiSolid", "CompositeSurface", "MultiSurface")
_COVERED = 0.5  # share of a box along each axis
_TOLERANCE = 0.01  # of a box's longest side: heights differ between models of one building

_OBJECT_BYTES = 400  # of memory for the id of an object and its place, and as much for the rest of a build

_MOST_POLYGONS, _MOST_PER_INSTANCE = 1_000_000, 1_000
"""Polygons that instances of templates may have in any case, and on average."""


_NOTES = (
    "geometries left out that repeat another one of their object (a Solid is preferred){others}",
    "geometries left out, of objects whose parts repeat them{others}",
    "objects with a geometry beside those of their parts; all are read, so areas may count twice",
    "objects left out that an earlier line has at the same place",
)

_Key = tuple[int, str]
"""The index of a part of the document, and the id of an object."""


class ChosenGeometry(NamedTuple):
    """A geometry to read."""

    part: CityPart
    object: str  # id
    place: int  # in the object's "geometry"
    geometry: dict[str, Any]  # the template if it is a `GeometryInstance`
    instance: dict[str, Any] | None  # the `GeometryInstance`; None: no instance


class ChosenGeometries(NamedTuple):
    """The result of `chosen_geometries`."""

    geometries: list[ChosenGeometry]
    levels: list[str]  # all levels of detail in the file, ascending
    notes: list[str]


def chosen_geometries(document: CityDocument, lod: str | None) -> ChosenGeometries:
    """Geometries at the given level of detail, or at the highest of each object.

    An object is left out if one of its parts, such as a BuildingPart, has a higher level, or the same one and the parts
    fill its box: the parts then represent the whole object. Of several geometries of an object that fill the same box,
    the first type in `_PREFERENCE` is read.

    Raises
    ------
    InputError
        If no geometry has the level `lod`; the message lists all levels in the file.
    """
    choice = GeometryChoice(document.file, lod)
    geometries = choice.of(document)
    return ChosenGeometries(geometries, *choice.end())


class GeometryChoice:
    """The choice of `chosen_geometries` in a file, whose lines may come one after the other.

    again : the document of an earlier line, by its place; None: all lines are in one document
    """

    def __init__(self, file: str, lod: str | None, again: Callable[[Place], CityDocument] | None = None):
        self._file, self._lod, self._again = file, None if lod is None else lod_of({"lod": lod}), again
        self._levels, self._counts = set[str](), np.zeros(len(_NOTES), np.int64)
        self._first = dict[str, Place | list[ChosenGeometry]]()  # id -> those of the first object
        self._polygons_in = dict[int, int]()  # id of a template -> its polygons
        self._n_placed = self._n_polygons = 0  # instances, and their polygons

    def of(self, document: CityDocument, places: Sequence[Place] | None = None) -> list[ChosenGeometry]:
        """The geometries to read of some lines; `places`: of these."""
        shapes = {
            (k, name): choices
            for k, part in enumerate(document.parts)
            for name in part.objects
            if (choices := self._of_one_level(list(_surfaces(document, part, name))))
        }
        self._check_expansion([c for choices in shapes.values() for c in choices])
        remaining = self._without_repeats(document, shapes)
        if places is not None:  # keep no geometry
            self._first |= {name: places[k] for k, name in reversed(shapes) if isinstance(self._first[name], list)}
            size, n = _OBJECT_BYTES * len(self._first), len(self._first)
            check_reading(size, f"{self._file}: the list of the first {counted(n, 'object')}", cure="split the file")
        return remaining

    def _of_one_level(self, choices: list[ChosenGeometry]) -> list[ChosenGeometry]:
        """Those of the given level, or of the highest one."""
        levels = [lod_of(c.geometry) for c in choices]
        self._levels.update(levels)
        level = max(levels, key=_rank, default="") if self._lod is None else self._lod
        return [c for c in choices if lod_of(c.geometry) == level]

    def end(self) -> tuple[list[str], list[str]]:
        """(all levels of detail, ascending; notes), once all lines have been read.

        Raises
        ------
        InputError
            If no geometry has the given level.
        """
        levels = sorted(self._levels - {""}, key=_rank)
        if self._lod is not None and self._lod not in levels:
            levels_text = f"there are {', '.join(levels)}" if levels else "its geometries have none; leave lod out"
            raise InputError(f"{self._file}: no geometry has lod {self._lod!r}; {levels_text}")
        others = f"; choose another level of {', '.join(levels)} with lod" if len(levels) > 1 else ""
        texts = [text.format(others=others) for text in _NOTES]
        return levels, [f"{self._file}: {text}: {count}" for count, text in zip(self._counts, texts) if count]

    def _check_expansion(self, chosen: list[ChosenGeometry]) -> None:
        """Raise an InputError if instances have far more polygons than a scene needs."""
        for template in (choice.geometry for choice in chosen if choice.instance is not None):
            if id(template) not in self._polygons_in:
                count = _polygon_count(template.get("boundaries"), DEPTHS[template["type"]])
                self._polygons_in[id(template)] = count
            self._n_polygons += self._polygons_in[id(template)]
            self._n_placed += 1
        if self._n_polygons > _MOST_POLYGONS + _MOST_PER_INSTANCE * self._n_placed:
            raise InputError(
                f"{self._file}: {counted(self._n_placed, 'instance')} of templates {agreeing(self._n_placed, 'have')} "
                f"{counted(self._n_polygons, 'polygon')}, more than {_MOST_PER_INSTANCE:,} each; take simpler templates"
            )

    def _without_repeats(
        self, document: CityDocument, shapes: dict[_Key, list[ChosenGeometry]]
    ) -> list[ChosenGeometry]:
        """The geometries without those that others repeat; `shapes`: those of each object, of one level."""
        boxes = _Boxes(document)
        alone = {key: _distinct(boxes, choices) for key, choices in shapes.items()}
        n_repeats = sum(len(choices) - len(alone[key]) for key, choices in shapes.items())
        listed = self._listed_once(boxes, alone)
        n_twice, alone = len(alone) - len(listed), listed
        parts_of = [_parts_of(part) for part in document.parts]
        remaining, n_wholes, n_beside = list[ChosenGeometry](), 0, 0
        for (k, name), choices in alone.items():
            parts = [alone[k, child] for child in parts_of[k][name] if (k, child) in alone]
            level = _rank(lod_of(choices[0].geometry))
            same = [c for part in parts for c in part if _rank(lod_of(c.geometry)) == level]
            if self._lod is None and any(_rank(lod_of(part[0].geometry)) > level for part in parts):
                continue
            if same and _covers(boxes.of(same), boxes.of(choices)):
                n_wholes += 1
                continue
            n_beside += bool(same)
            remaining += choices
        self._counts += n_repeats, n_wholes, n_beside, n_twice
        return remaining

    def _listed_once(
        self, boxes: "_Boxes", alone: dict[_Key, list[ChosenGeometry]]
    ) -> dict[_Key, list[ChosenGeometry]]:
        """The objects without those that an earlier line lists at the same place, under the same id."""
        remaining = dict[_Key, list[ChosenGeometry]]()
        for (k, name), choices in alone.items():
            earlier = self._first.setdefault(name, choices)
            a, b = (None, None) if earlier is choices else (self._box_of(earlier, name, boxes), boxes.of(choices))
            if a is None or b is None or not _same_place(a, b):
                remaining[k, name] = choices
        return remaining

    def _box_of(self, earlier: Place | list[ChosenGeometry], name: str, boxes: "_Boxes") -> "_Box | None":
        """The box of the geometries of the first object of a name."""
        if isinstance(earlier, list):
            return boxes.of(earlier)
        assert self._again is not None
        document = self._again(earlier)
        boxes = _Boxes(document)
        return boxes.of(_distinct(boxes, self._of_one_level(list(_surfaces(document, document.parts[0], name)))))


def _polygon_count(nested: Any, depth: int) -> int:
    """The polygons in the boundaries of a geometry; anything but lists is reported when they are read."""
    if not isinstance(nested, list):
        return 0
    return len(nested) if depth == 0 else sum(_polygon_count(each, depth - 1) for each in nested)


def _distinct(boxes: "_Boxes", choices: list[ChosenGeometry]) -> list[ChosenGeometry]:
    """The geometries of an object without those that repeat a preferred one, in the order of the file."""
    if len(choices) == 1:
        return choices
    remaining, places = list[ChosenGeometry](), np.empty((len(choices), 2, 3))
    n_places = 0
    for each in sorted(choices, key=lambda c: _PREFERENCE.index(c.geometry["type"])):
        box = boxes.of([each])
        if box is None:
            remaining.append(each)
        elif not _same_place(places[:n_places], box).any():
            remaining.append(each)
            places[n_places], n_places = box, n_places + 1
    return sorted(remaining, key=lambda c: c.place)


# --- Boxes ------------------------------------------------------------------------------------------------------------


_Box = NDArray[np.float64]
"""(..., 2, 3) float64: lower and upper corners."""


class _Boxes:
    """The bounding boxes of geometries. Those of templates are flattened once."""

    def __init__(self, document: CityDocument) -> None:
        self._document, self._corners = document, dict[int, list[Any]]()

    def of(self, choices: Iterable[ChosenGeometry]) -> _Box | None:
        """(2, 3) float64; None: the geometries are damaged, which reading them reports."""
        with suppress(TypeError, ValueError, IndexError, KeyError, OverflowError, RecursionError):
            points = np.concatenate([self._points(each) for each in choices])
            return np.stack([points.min(0), points.max(0)])
        return None

    def _points(self, choice: ChosenGeometry) -> NDArray[np.float64]:
        """(n, 3) float64, world: the corners of a geometry."""
        if choice.instance is None:
            return np.asarray(choice.part.vertices[list(_flattened(choice.geometry["boundaries"]))])
        corners = self._corners.get(id(choice.geometry))
        if corners is None:
            corners = self._corners[id(choice.geometry)] = list(_flattened(choice.geometry["boundaries"]))
        matrix = np.array(choice.instance["transformationMatrix"], np.float64).reshape(4, 4)
        anchor = choice.part.vertices[choice.instance["boundaries"][0]]
        vertices = self._document.template_vertices[corners]
        return np.asarray(product(vertices, matrix[:3, :3].T) + matrix[:3, 3] + anchor)


def _flattened(nested: Any) -> Iterator[Any]:
    for each in nested:
        if isinstance(each, list):
            yield from _flattened(each)
        else:
            yield each


def _same_place(a: _Box, b: _Box) -> NDArray[np.bool_]:
    """Whether boxes share most of the smaller one; `a`: any number of them."""
    return _is_covered(a, b, np.minimum(a[..., 1, :] - a[..., 0, :], b[1] - b[0]))


def _covers(a: _Box | None, b: _Box | None) -> bool:
    """Whether box `a` covers most of box `b`."""
    return a is not None and b is not None and bool(_is_covered(a, b, b[1] - b[0]))


def _is_covered(a: _Box, b: _Box, sides: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether boxes overlap, along each axis, by most of a length ((..., 3))."""
    common = np.minimum(a[..., 1, :], b[1]) - np.maximum(a[..., 0, :], b[0])
    return np.asarray((common >= _COVERED * sides - _TOLERANCE * (b[1] - b[0]).max()).all(-1))


# --- Levels of detail -------------------------------------------------------------------------------------------------


def lod_of(geometry: dict[str, Any]) -> str:
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


def _surfaces(document: CityDocument, part: CityPart, name: str) -> Iterator[ChosenGeometry]:
    """The geometries of an object that have surfaces."""
    shapes = part.objects[name].get("geometry")
    for index, shape in enumerate(shapes if isinstance(shapes, list) else []):
        where = f'{part.where} CityObjects "{name[:60]}" geometry[{index}]'
        if not isinstance(shape, dict):
            raise InputError(f"{where} is not an object; export the file again")
        instance = None
        if shape.get("type") == INSTANCE:
            number, instance = shape.get("template"), shape
            if not isinstance(number, int) or not 0 <= number < len(document.templates):
                raise InputError(
                    f"{where}.template is {number!r}; there are {counted(len(document.templates), 'template')}"
                )
            shape = document.templates[number]
        if isinstance(shape, dict) and str(shape.get("type")) in DEPTHS:
            yield ChosenGeometry(part, name, index, shape, instance)


# --- Objects in objects -----------------------------------------------------------------------------------------------


GROUP = "CityObjectGroup"
"""Type of objects whose members do not count as their parts."""


def containers(part: CityPart) -> dict[str, str]:
    """Id of each object in another one -> id of that object. Groups do not count.

    Objects name the others in "parents". Some files have only "children".
    """
    out: dict[str, str] = {}
    for name, city_object in part.objects.items():
        for child in _ids(city_object, "children") if city_object.get("type") != GROUP else ():
            out.setdefault(child, name)
    for name, city_object in part.objects.items():
        above = (p for p in _ids(city_object, "parents") if p in part.objects and part.objects[p].get("type") != GROUP)
        parent = next(above, None)
        if parent is not None:
            out[name] = parent
    return out


def _ids(city_object: dict[str, Any], key: str) -> list[str]:
    ids = city_object.get(key)
    return [each for each in ids if isinstance(each, str)] if isinstance(ids, list) else []


def _parts_of(part: CityPart) -> dict[str, list[str]]:
    """Id of each object -> those of its parts, such as BuildingParts."""
    parts: dict[str, list[str]] = defaultdict(list)
    for child, parent in containers(part).items():
        if child in part.objects and str(part.objects[child].get("type")).endswith("Part"):
            parts[parent].append(child)
    return parts
