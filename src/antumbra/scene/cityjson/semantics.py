"""Boundaries of geometries as one list of polygons, each with its semantic surface."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from operator import index
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError
from ..gltf.fields import Fields
from .document import Document, Part
from .geometry import Rings
from .lods import DEPTHS, Chosen
from .model import Surface

GROUP = "CityObjectGroup"
"""Type of the objects whose members are no parts of them."""


class Polygons(NamedTuple):
    """All polygons of the chosen geometries."""

    vertices: np.ndarray  # (v, 3) float64, world
    rings: Rings
    surface: np.ndarray  # (p,) int32, index into `surfaces`
    mirrored: np.ndarray  # (p,) bool: an instance's matrix turns the polygon inside out
    surfaces: list[Surface]
    objects: list[str]  # ids
    types: list[str]
    parents: list[str]  # ids of the outermost objects; "": none


def walk(boundaries, values, depth: int, path: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], Any, Any]]:
    """(path, rings, semantic index or None) of each polygon in nested lists."""
    for i, inner in enumerate(boundaries):
        value = values[i] if isinstance(values, list) and i < len(values) else None
        if depth:
            yield from walk(inner, value, depth - 1, (*path, i))
        else:
            yield (*path, i), inner, value


def polygons_of(document: Document, chosen: list[Chosen]) -> Polygons:
    """The polygons of geometries, in their order."""
    collector = _Collector(document)
    for choice in chosen:
        collector.add(choice)
    return collector.polygons()


def outermost(part: Part, name: str) -> str:
    """The id of the outermost object that an object is a part of; "" if there is none. Groups do not count."""
    path = [name]
    while True:
        given = part.objects[path[-1]].get("parents")
        known = [p for p in given if isinstance(p, str) and p in part.objects] if isinstance(given, list) else []
        above = [p for p in known if part.objects[p].get("type") != GROUP and p not in path]
        if not above:
            return path[-1] if len(path) > 1 else ""
        path.append(above[0])


class _Collector:
    """Lists that grow by one geometry after the other."""

    def __init__(self, document: Document):
        self._document = document
        starts = np.cumsum([0] + [len(part.vertices) for part in document.parts])
        self._start = {part.where: int(start) for part, start in zip(document.parts, starts)}
        self._blocks = [part.vertices for part in document.parts]
        self._n_vertices = int(starts[-1])
        self._rings: list[list[int]] = []
        self._rings_in: list[int] = []  # number of rings of each polygon
        self._base: list[int] = []  # of each polygon: number of its vertex 0
        self._limit: list[int] = []  # of each polygon: number of its vertices
        self._surface: list[int] = []
        self._mirrored: list[bool] = []
        self._objects: dict[tuple[str, str], int] = {}
        self._types: list[str] = []
        self._parents: list[str] = []
        self._surfaces: list[Surface] = []
        self._spans: dict[int, tuple[int, int]] = {}  # id of a template -> range of its vertices

    def add(self, choice: Chosen) -> None:
        where = f'{choice.part.where} CityObjects "{choice.object[:60]}" geometry[{choice.place}]'
        if choice.instance is None:
            base, limit, mirrored = self._start[choice.part.where], len(choice.part.vertices), False
        else:
            base, limit, mirrored = self._place(choice, where)
        n_polygons = len(self._rings_in)
        try:
            self._add_polygons(choice)
        except (TypeError, ValueError):
            raise InputError(f"{where}.boundaries are not nested lists, as its type demands; export it again") from None
        added = len(self._rings_in) - n_polygons
        self._base += [base] * added
        self._limit += [limit] * added
        self._mirrored += [mirrored] * added

    def _add_polygons(self, choice: Chosen) -> None:
        semantics = choice.geometry.get("semantics")
        semantics = semantics if isinstance(semantics, dict) else {}
        known, values = semantics.get("surfaces"), semantics.get("values")
        kinds = (
            {k: s.get("type") for k, s in enumerate(known) if isinstance(s, dict)} if isinstance(known, list) else {}
        )
        boundaries, depth = choice.geometry.get("boundaries") or [], DEPTHS[choice.geometry["type"]]
        owner, surface_of = self._object(choice), {}
        for path, rings, value in walk(boundaries, values, depth):
            value = value if isinstance(value, int) and value in kinds else None
            if value is None or value not in surface_of:
                kind = None if value is None else str(kinds[value])
                surface_of[value] = len(self._surfaces)
                self._surfaces.append(Surface(owner, kind, choice.place, value, path))
            self._rings_in.append(len(rings))
            self._rings += rings
            self._surface.append(surface_of[value])

    def _object(self, choice: Chosen) -> int:
        key = choice.part.where, choice.object
        if key not in self._objects:
            self._objects[key] = len(self._objects)
            self._types.append(str(choice.part.objects[choice.object].get("type", "")))
            self._parents.append(outermost(choice.part, choice.object))
        return self._objects[key]

    def _place(self, choice: Chosen, where: str) -> tuple[int, int, bool]:
        """Add the vertices of the templates, moved to an instance: (number of the first one, how many, mirrored)."""
        instance, vertices = Fields(choice.instance, where), choice.part.vertices
        matrix = instance.numbers("transformationMatrix", 16).reshape(4, 4)
        anchor = instance.indices("boundaries", len(vertices))
        if len(anchor) != 1:
            raise instance.bad("boundaries", "a list of one vertex")
        first, last = self._template_span(choice.geometry)
        corners = self._document.template_vertices[first:last]
        placed = corners @ matrix[:3, :3].T + matrix[:3, 3] + vertices[anchor[0]]
        self._blocks.append(placed)
        base, self._n_vertices = self._n_vertices - first, self._n_vertices + len(placed)
        return base, first + len(placed), bool(np.linalg.det(matrix[:3, :3]) < 0.0)

    def _template_span(self, template: dict) -> tuple[int, int]:
        """The range of template vertices that a template uses, so that an instance copies no others."""
        key = id(template)
        if key not in self._spans:
            used = [0]
            with suppress(TypeError, ValueError):  # reported when its polygons are added
                nested = walk(template.get("boundaries") or [], None, DEPTHS[template["type"]])
                used = list(chain.from_iterable(chain.from_iterable(rings for _, rings, _ in nested))) or used
                self._spans[key] = max(0, index(min(used))), index(max(used)) + 1
        return self._spans.get(key, (0, 0))

    def polygons(self) -> Polygons:
        rings_in, sizes, corners = np.array(self._rings_in, np.int64), *self._flat()
        owner = np.repeat(np.repeat(np.arange(len(rings_in)), rings_in), sizes)  # polygon of each corner
        base, limit = np.array(self._base, np.int64), np.array(self._limit, np.int64)
        bad = np.flatnonzero((corners < 0) | (corners >= limit[owner]))
        if len(bad):
            k = owner[bad[0]]
            raise self._bad(k, f"uses vertex {corners[bad[0]]}, but there are {limit[k]} vertices")
        return Polygons(
            np.concatenate(self._blocks),
            Rings(corners + base[owner], sizes, rings_in),
            np.array(self._surface, np.int32),
            np.array(self._mirrored, bool),
            self._surfaces,
            [name for _, name in self._objects],
            self._types,
            self._parents,
        )

    def _flat(self) -> tuple[np.ndarray, np.ndarray]:
        """(corners in each ring, vertices of all rings), (r,) and (c,) int64."""
        try:
            sizes = np.array([len(ring) for ring in self._rings], np.int64)
            corners = np.array(list(chain.from_iterable(self._rings)) or np.empty(0, np.int64))
            if corners.ndim == 1 and corners.dtype.kind in "iu":
                return sizes, corners.astype(np.int64)
        except (TypeError, ValueError):
            pass
        fine = lambda ring: isinstance(ring, list) and all(type(i) is int and abs(i) < 2**62 for i in ring)
        ring = next(k for k, ring in enumerate(self._rings) if not fine(ring))
        polygon = int(np.searchsorted(np.cumsum(self._rings_in), ring, side="right"))
        raise self._bad(polygon, "has boundaries that are not nested lists of vertices, as its type demands")

    def _bad(self, polygon: int, problem: str) -> InputError:
        name = list(self._objects)[self._surfaces[self._surface[polygon]].object][1]
        return InputError(f'{self._document.file}: CityObjects "{name[:60]}" {problem}; export the file again')
