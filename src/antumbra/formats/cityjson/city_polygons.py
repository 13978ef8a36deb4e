"""Polygons of CityJSON geometries: boundaries with their semantic surfaces, and their triangulation."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from operator import index
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError
from ...extras import import_extra
from ...scene.scene_data import SemanticSurface
from ..json_fields import Fields
from .cityjson_file import DEPTHS, ChosenGeometry, CityDocument, CityPart

# --- Triangles of polygons in space, which may have holes and need not be quite flat ----------------------------------
#
# Each polygon is projected along the axis that is nearest to its normal, in float64. The projection leaves two of the
# three coordinates as they are, so it rounds nothing. Newell's formula gives the normal: its sum over the edges of the
# outer ring is the ring's vector area. The triangles keep the ring's orientation, so their normals point the same way.


_SAME_AREA = 1e-6  # of a polygon and its triangles, relative: more than rounding can explain


class Rings(NamedTuple):
    """Polygons as lists of rings; the first ring of each polygon is its outer boundary."""

    corners: np.ndarray  # (c,) int64, vertices of one ring after the other
    sizes: np.ndarray  # (r,) int64, corners of each ring
    rings_in: np.ndarray  # (p,) int64, rings of each polygon


class Triangulation(NamedTuple):
    """Triangles, in the order of their polygons."""

    faces: np.ndarray  # (f, 3) int64, vertices
    polygon: np.ndarray  # (f,) int64
    flat: int  # polygons without area, which have no triangles
    crossed: int  # polygons whose triangles have another area than they: their rings cross


class _Flat(NamedTuple):
    """Polygons in the plane, each with its own axes in which its outer ring turns to the left."""

    rings: Rings
    points: np.ndarray  # (c, 2) float64, relative to the first corner of the polygon
    first: np.ndarray  # (p + 1,) int64, first corner of each polygon
    ring_end: np.ndarray  # (r,) uint32, end of each ring, counted from the first corner of its polygon
    area: np.ndarray  # (p,) float64, twice the area of each polygon without its holes; 0: none


def triangulate(vertices: np.ndarray, rings: Rings) -> Triangulation:
    """Triangles of polygons.

    vertices : (v, 3) float64
    """
    rings = _without_short_rings(rings)
    flat = _flattened(vertices, rings)
    alone = (rings.rings_in == 1) & (flat.area > 0.0)
    size = np.diff(flat.first)
    quads, split = _quads(flat, np.flatnonzero(alone & (size == 4)))
    three = np.flatnonzero(alone & (size == 3))
    others = flat.area > 0.0
    others[three] = others[quads] = False
    cut, polygon, crossed = _cut(flat, np.flatnonzero(others))
    corners = np.concatenate([flat.first[three, None] + np.arange(3), split, cut])
    owner = np.concatenate([three, np.repeat(quads, 2), polygon])
    order = np.argsort(owner, kind="stable")
    return Triangulation(rings.corners[corners[order]], owner[order], int((flat.area <= 0.0).sum()), crossed)


def _without_short_rings(rings: Rings) -> Rings:
    """The rings without those of fewer than three corners, and without the holes of such an outer ring."""
    polygon = np.repeat(np.arange(len(rings.rings_in)), rings.rings_in)
    fine = rings.sizes >= 3
    if fine.all():
        return rings
    outer = np.zeros(len(polygon), bool)
    outer[(np.cumsum(rings.rings_in) - rings.rings_in)[rings.rings_in > 0]] = True
    lost = np.zeros(len(rings.rings_in), bool)
    lost[polygon[outer & ~fine]] = True
    fine &= ~lost[polygon]
    kept = np.repeat(fine, rings.sizes)
    return Rings(rings.corners[kept], rings.sizes[fine], np.bincount(polygon[fine], minlength=len(rings.rings_in)))


def _flattened(vertices: np.ndarray, rings: Rings) -> _Flat:
    n = len(rings.rings_in)
    ring_start = np.cumsum(rings.sizes) - rings.sizes
    first_ring = np.concatenate([[0], np.cumsum(rings.rings_in)])
    first = np.concatenate([ring_start, [len(rings.corners)]])[first_ring]
    polygon_of_ring = np.repeat(np.arange(n), rings.rings_in)
    polygon = np.repeat(polygon_of_ring, rings.sizes)
    points = vertices[rings.corners]
    points -= points[first[polygon]]
    following = np.arange(1, len(points) + 1)
    following[ring_start + rings.sizes - 1] = ring_start
    vector_area = np.zeros((n, 3))
    has = rings.rings_in > 0
    if len(points):
        edges = np.cross(points, points[following])
        of_ring = np.add.reduceat(edges, ring_start, axis=0)
        vector_area[has] = of_ring[first_ring[:-1][has]]
    axis = np.abs(vector_area).argmax(axis=1)
    area = np.take_along_axis(vector_area, axis[:, None], 1)[:, 0]
    turned = (area < 0.0).astype(np.int64)
    u, v = (axis + 1 + turned) % 3, (axis + 2 - turned) % 3  # a ring that turns to the right is seen from behind
    rows = np.arange(len(points))
    plane = np.stack([points[rows, u[polygon]], points[rows, v[polygon]]], axis=1)
    area = np.abs(area)
    if len(points):
        holes = np.abs(of_ring[np.arange(len(of_ring)), axis[polygon_of_ring]])
        holes[first_ring[:-1][has]] = 0.0
        area = np.where(
            area > 0.0, np.maximum(area - np.bincount(polygon_of_ring, holes, n), np.finfo(float).tiny), 0.0
        )
    ring_end = (ring_start + rings.sizes - first[polygon_of_ring]).astype(np.uint32)
    return _Flat(rings, plane, first, ring_end, area)


def _quads(flat: _Flat, polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(those of some quads that a diagonal cuts into two triangles; their triangles, (2 q, 3) corners)."""
    corners = flat.first[polygons, None] + np.arange(4)
    halves = [np.array([[0, 1, 2], [0, 2, 3]]), np.array([[1, 2, 3], [1, 3, 0]])]
    fits = [np.asarray((_doubled_areas(flat.points, corners[:, half]) > 0.0).all(axis=1)) for half in halves]
    picked = np.where(fits[0][:, None, None], corners[:, halves[0]], corners[:, halves[1]])
    fine = fits[0] | fits[1]
    return polygons[fine], picked[fine].reshape(-1, 3)


def _cut(flat: _Flat, polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Triangles of any polygons by ear clipping: ((f, 3) corners, (f,) polygons, number of crossed ones)."""
    if len(polygons) == 0:
        return np.empty((0, 3), np.int64), np.empty(0, np.int64), 0
    ears = import_extra("mapbox_earcut", "CityJSON", "gis").triangulate_float64
    first_ring = np.concatenate([[0], np.cumsum(flat.rings.rings_in)])
    spans = zip(*(a[polygons + k].tolist() for a in (flat.first, first_ring) for k in (0, 1)))
    found = [ears(flat.points[a:b], flat.ring_end[i:j]) for a, b, i, j in spans]
    counts = np.array([len(f) for f in found]) // 3
    place = np.repeat(np.arange(len(polygons)), counts)
    triangles = np.concatenate(found).astype(np.int64).reshape(-1, 3) + flat.first[polygons][place, None]
    area = _doubled_areas(flat.points, triangles)
    right = area < 0.0
    triangles[right] = triangles[right][:, ::-1]
    difference = np.abs(np.bincount(place, np.abs(area), len(polygons)) - flat.area[polygons])
    crossed = int((difference > _SAME_AREA * flat.area[polygons]).sum())
    solid = area != 0.0
    return triangles[solid], polygons[place[solid]], crossed


def _doubled_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Twice the signed area, (...), of triangles, (..., 3) corners."""
    a, b, c = (points[triangles[..., k]] for k in range(3))
    return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])


# --- Boundaries of geometries as one list of polygons, each with its semantic surface ---------------------------------


GROUP = "CityObjectGroup"
"""Type of the objects whose members are no parts of them."""


class Polygons(NamedTuple):
    """All polygons of the chosen geometries."""

    vertices: np.ndarray  # (v, 3) float64, world
    rings: Rings
    surface: np.ndarray  # (p,) int32, index into `surfaces`
    mirrored: np.ndarray  # (p,) bool: an instance's matrix turns the polygon inside out
    surfaces: list[SemanticSurface]
    objects: list[str]  # ids
    types: list[str]
    parents: list[str]  # ids of the outermost objects; "": none


def iter_polygons(
    boundaries, values, depth: int, path: tuple[int, ...] = ()
) -> Iterator[tuple[tuple[int, ...], Any, Any]]:
    """(path, rings, semantic index or None) of each polygon in nested lists."""
    for i, inner in enumerate(boundaries):
        value = values[i] if isinstance(values, list) and i < len(values) else None
        if depth:
            yield from iter_polygons(inner, value, depth - 1, (*path, i))
        else:
            yield (*path, i), inner, value


def polygons_of(document: CityDocument, chosen: list[ChosenGeometry]) -> Polygons:
    """The polygons of geometries, in their order."""
    collector = _Collector(document)
    for choice in chosen:
        collector.add(choice)
    return collector.polygons()


def outermost(part: CityPart, name: str) -> str:
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

    def __init__(self, document: CityDocument):
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
        self._surfaces: list[SemanticSurface] = []
        self._spans: dict[int, tuple[int, int]] = {}  # id of a template -> range of its vertices

    def add(self, choice: ChosenGeometry) -> None:
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

    def _add_polygons(self, choice: ChosenGeometry) -> None:
        semantics = choice.geometry.get("semantics")
        semantics = semantics if isinstance(semantics, dict) else {}
        known, values = semantics.get("surfaces"), semantics.get("values")
        kinds = (
            {k: s.get("type") for k, s in enumerate(known) if isinstance(s, dict)} if isinstance(known, list) else {}
        )
        boundaries, depth = choice.geometry.get("boundaries") or [], DEPTHS[choice.geometry["type"]]
        owner, surface_of = self._object(choice), {}
        for path, rings, value in iter_polygons(boundaries, values, depth):
            value = value if isinstance(value, int) and value in kinds else None
            if value is None or value not in surface_of:
                kind = None if value is None else str(kinds[value])
                surface_of[value] = len(self._surfaces)
                self._surfaces.append(SemanticSurface(owner, kind, choice.place, value, path))
            self._rings_in.append(len(rings))
            self._rings += rings
            self._surface.append(surface_of[value])

    def _object(self, choice: ChosenGeometry) -> int:
        key = choice.part.where, choice.object
        if key not in self._objects:
            self._objects[key] = len(self._objects)
            self._types.append(str(choice.part.objects[choice.object].get("type", "")))
            self._parents.append(outermost(choice.part, choice.object))
        return self._objects[key]

    def _place(self, choice: ChosenGeometry, where: str) -> tuple[int, int, bool]:
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
                nested = iter_polygons(template.get("boundaries") or [], None, DEPTHS[template["type"]])
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
