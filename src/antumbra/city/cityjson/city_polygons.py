"""Polygons of CityJSON geometries: boundaries with their semantic surfaces, and their triangulation.

Each polygon is projected along the coordinate axis closest to its normal, in float64. The projection keeps two of the
three coordinates, so it introduces no rounding. The normal comes from Newell's formula: the sum over the edges of the
outer ring is the ring's vector area. Triangles keep the orientation of the ring, so their normals agree with it.
"""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import chain
from operator import index
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.wording import counted
from ...formats.json_fields import Fields
from ...kernels.small_matrices import determinant, product
from ...scene.scene_data import SemanticSurface
from .city_geometries import DEPTHS, ChosenGeometry, containers
from .cityjson_file import CityDocument

# --- Triangulation of polygons in space, possibly with holes and not exactly planar -----------------------------------


_SAME_AREA = 1e-6  # relative tolerance of a polygon's area and that of its triangles: above rounding error


class Rings(NamedTuple):
    """Polygons as lists of rings; the first ring of each polygon is its outer boundary."""

    corners: NDArray[np.int64]  # (c,) int64, vertices of all rings, concatenated
    sizes: NDArray[np.int64]  # (r,) int64, number of corners of each ring
    rings_in: NDArray[np.int64]  # (p,) int64, number of rings of each polygon


class Triangulation(NamedTuple):
    """Triangles, in the order of their polygons."""

    faces: NDArray[np.int64]  # (f, 3) int64, vertices
    polygon: NDArray[np.int64]  # (f,) int64
    flat: int  # number of polygons without area, which have no triangles
    crossed: int  # number of polygons whose area differs from that of their triangles: their rings cross


class _ProjectedPolygons(NamedTuple):
    """Polygons in the plane, each with its own axes, in which its outer ring is counter-clockwise."""

    rings: Rings
    points: NDArray[np.float64]  # (c, 2) float64, relative to the first corner of the polygon
    first: NDArray[np.int64]  # (p + 1,) int64, first corner of each polygon
    ring_end: NDArray[np.uint32]  # (r,) uint32, end of each ring, relative to the first corner of its polygon
    area: NDArray[np.float64]  # (p,) float64, twice the area of each polygon, holes subtracted; 0: degenerate


def triangulate(vertices: NDArray[np.float64], rings: Rings) -> Triangulation:
    """Triangulate polygons: triangles and quads directly, all others by ear clipping.

    vertices : (v, 3) float64
    """
    rings = _without_short_rings(rings)
    flat = _projected(vertices, rings)
    alone = (rings.rings_in == 1) & (flat.area > 0.0)
    size = np.diff(flat.first)
    quads, split = _quads(flat, np.flatnonzero(alone & (size == 4)))
    three = np.flatnonzero(alone & (size == 3))
    others = flat.area > 0.0
    others[three] = others[quads] = False
    cut, polygon, crossed = _clip_ears(flat, np.flatnonzero(others))
    corners = np.concatenate([flat.first[three, None] + np.arange(3), split, cut])
    owner = np.concatenate([three, np.repeat(quads, 2), polygon])
    order = np.argsort(owner, kind="stable")
    return Triangulation(rings.corners[corners[order]], owner[order], int((flat.area <= 0.0).sum()), crossed)


def _without_short_rings(rings: Rings) -> Rings:
    """The rings without those of fewer than three corners, and without the holes of such outer rings."""
    polygon = np.repeat(np.arange(len(rings.rings_in)), rings.rings_in)
    valid = rings.sizes >= 3
    if valid.all():
        return rings
    outer = np.zeros(len(polygon), bool)
    outer[(np.cumsum(rings.rings_in) - rings.rings_in)[rings.rings_in > 0]] = True
    dropped = np.zeros(len(rings.rings_in), bool)
    dropped[polygon[outer & ~valid]] = True
    valid &= ~dropped[polygon]
    in_valid_ring = np.repeat(valid, rings.sizes)
    return Rings(
        rings.corners[in_valid_ring], rings.sizes[valid], np.bincount(polygon[valid], minlength=len(rings.rings_in))
    )


def _projected(vertices: np.ndarray, rings: Rings) -> _ProjectedPolygons:
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
    u, v = (axis + 1 + turned) % 3, (axis + 2 - turned) % 3  # a clockwise ring is viewed from behind
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
    return _ProjectedPolygons(rings, plane, first, ring_end, area)


def _quads(flat: _ProjectedPolygons, polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(the quads that a diagonal splits into two valid triangles; their triangles, (2 q, 3) corners)."""
    corners = flat.first[polygons, None] + np.arange(4)
    halves = [np.array([[0, 1, 2], [0, 2, 3]]), np.array([[1, 2, 3], [1, 3, 0]])]
    fits = [np.asarray((_doubled_areas(flat.points, corners[:, half]) > 0.0).all(axis=1)) for half in halves]
    triangles = np.where(fits[0][:, None, None], corners[:, halves[0]], corners[:, halves[1]])
    valid = fits[0] | fits[1]
    return polygons[valid], triangles[valid].reshape(-1, 3)


def _clip_ears(flat: _ProjectedPolygons, polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Triangles by ear clipping: ((f, 3) corners, (f,) polygons, number of polygons with crossing rings)."""
    if len(polygons) == 0:
        return np.empty((0, 3), np.int64), np.empty(0, np.int64), 0
    ears = import_extra("mapbox_earcut", "CityJSON", "gis").triangulate_float64
    first_ring = np.concatenate([[0], np.cumsum(flat.rings.rings_in)])
    spans = zip(*(a[polygons + k].tolist() for a in (flat.first, first_ring) for k in (0, 1)))
    indices = [ears(flat.points[a:b], flat.ring_end[i:j]) for a, b, i, j in spans]
    counts = np.array([len(f) for f in indices]) // 3
    place = np.repeat(np.arange(len(polygons)), counts)
    triangles = np.concatenate(indices).astype(np.int64).reshape(-1, 3) + flat.first[polygons][place, None]
    area = _doubled_areas(flat.points, triangles)
    clockwise = area < 0.0
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    difference = np.abs(np.bincount(place, np.abs(area), len(polygons)) - flat.area[polygons])
    crossed = int((difference > _SAME_AREA * flat.area[polygons]).sum())
    solid = area != 0.0
    return triangles[solid], polygons[place[solid]], crossed


def _doubled_areas(points: NDArray[np.float64], triangles: np.ndarray) -> NDArray[np.float64]:
    """Twice the signed areas, (...), of triangles given by (..., 3) corners."""
    a, b, c = (points[triangles[..., k]] for k in range(3))
    areas: NDArray[np.float64]
    areas = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    return areas


# --- Polygons of boundaries, with their semantic surfaces -------------------------------------------------------------


RESERVED = "type", "parent", "children"
"""Members of a semantic surface that are not attributes."""


class Polygons(NamedTuple):
    """All polygons of the chosen geometries."""

    vertices: NDArray[np.float64]  # (v, 3) float64, world
    rings: Rings
    surface: NDArray[np.int32]  # (p,) int32, index into `surfaces`
    mirrored: NDArray[np.bool_]  # (p,) bool: the instance's matrix flips the polygon's orientation
    surfaces: list[SemanticSurface]
    objects: list[str]  # ids
    types: list[str]
    parents: list[str]  # ids of the outermost objects; "": none
    attributes: list[dict[str, Any]]  # of the objects, with those of the objects that contain them


def iter_polygons(
    boundaries: Any, values: Any, depth: int, path: tuple[int, ...] = ()
) -> Iterator[tuple[tuple[int, ...], Any, Any]]:
    """(path, rings, semantic index or None) of each polygon in nested lists."""
    for i, inner in enumerate(boundaries):
        value = values[i] if isinstance(values, list) and i < len(values) else None
        if depth:
            yield from iter_polygons(inner, value, depth - 1, (*path, i))
        else:
            yield (*path, i), inner, value


_MANY_CORNERS, _DISTINCT = 1024, 0.25  # of polygons with more corners, at least this share must be distinct
_DEEPEST = 100  # objects within one another


def polygons_of(document: CityDocument, chosen: list[ChosenGeometry]) -> Polygons:
    """The polygons of geometries, in their order.

    Raises
    ------
    InputError
        If a geometry is damaged.
    """
    collector = _Collector(document)
    for choice in chosen:
        collector.add(choice)
    return collector.polygons()


def containers_of(name: str, above: dict[str, str]) -> list[str]:
    """Ids of the objects that contain an object, from the inside out. A loop of parents ends where it closes.

    Raises
    ------
    InputError
        If more than `_DEEPEST` objects contain it.
    """
    path = [name]
    while (parent := above.get(path[-1])) is not None and parent not in path:
        if len(path) > _DEEPEST:
            raise InputError(f"more than {_DEEPEST} CityObjects contain {name[:60]!r}; export the file again")
        path.append(parent)
    return path[1:]


def _merged_attributes(objects: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The attributes of objects; the first object that has one counts."""
    out: dict[str, Any] = {}
    for city_object in objects:
        attributes = city_object.get("attributes")
        if isinstance(attributes, dict):
            out = {**{name: value for name, value in attributes.items() if value is not None}, **out}
    return out


def _with_semantics(surface: SemanticSurface, semantics: dict[str, Any]) -> SemanticSurface:
    """The surface with its type, parent and attributes."""
    parent = semantics.get("parent")
    return surface._replace(
        type=str(semantics.get("type")),
        parent=parent if type(parent) is int else None,
        attributes={k: v for k, v in semantics.items() if k not in RESERVED} or None,
    )


class _Collector:
    """Accumulates the polygons of geometries in lists."""

    def __init__(self, document: CityDocument):
        self._document = document
        starts = np.cumsum([0] + [len(part.vertices) for part in document.parts])
        self._start = {part.where: int(start) for part, start in zip(document.parts, starts)}
        self._blocks = [part.vertices for part in document.parts]
        self._n_vertices = int(starts[-1])
        self._rings: list[list[int]] = []
        self._rings_in: list[int] = []  # number of rings of each polygon
        self._base: list[int] = []  # of each polygon: index of its vertex 0
        self._limit: list[int] = []  # of each polygon: number of vertices it may use
        self._surface: list[int] = []
        self._mirrored: list[bool] = []
        self._objects: dict[tuple[str, str], int] = {}
        self._types: list[str] = []
        self._parents: list[str] = []
        self._attributes: list[dict[str, Any]] = []
        self._containers = {part.where: containers(part) for part in document.parts}
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
        except InputError:
            raise
        except (TypeError, ValueError):
            raise InputError(f"{where}.boundaries are not nested lists, as its type demands; export it again") from None
        n_added = len(self._rings_in) - n_polygons
        self._base += [base] * n_added
        self._limit += [limit] * n_added
        self._mirrored += [mirrored] * n_added

    def _add_polygons(self, choice: ChosenGeometry) -> None:
        semantics = choice.geometry.get("semantics")
        semantics = semantics if isinstance(semantics, dict) else {}
        surfaces, values = semantics.get("surfaces"), semantics.get("values")
        listed = surfaces if isinstance(surfaces, list) else []
        known = {k: surface for k, surface in enumerate(listed) if isinstance(surface, dict)}
        boundaries, depth = choice.geometry.get("boundaries") or [], DEPTHS[choice.geometry["type"]]
        owner, surface_of = self._object(choice), {}
        for path, rings, value in iter_polygons(boundaries, values, depth):
            value = value if isinstance(value, int) and value in known else None
            if value is None or value not in surface_of:
                surface_of[value] = len(self._surfaces)
                surface = SemanticSurface(owner, None, choice.place, value, path)
                self._surfaces.append(surface if value is None else _with_semantics(surface, known[value]))
            self._rings_in.append(len(rings))
            self._rings += rings
            self._surface.append(surface_of[value])

    def _object(self, choice: ChosenGeometry) -> int:
        key = choice.part.where, choice.object
        if key not in self._objects:
            self._objects[key] = len(self._objects)
            objects, above = choice.part.objects, self._containers[choice.part.where]
            outwards = containers_of(choice.object, above)
            self._types.append(str(objects[choice.object].get("type", "")))
            self._parents.append(outwards[-1] if outwards else "")
            self._attributes.append(_merged_attributes(objects[name] for name in (choice.object, *outwards)))
        return self._objects[key]

    def _place(self, choice: ChosenGeometry, where: str) -> tuple[int, int, bool]:
        """Add a template's vertices, transformed for an instance: (index of vertex 0, vertex limit, mirrored)."""
        instance, vertices = Fields(choice.instance, where), choice.part.vertices
        matrix = instance.numbers("transformationMatrix", 16).reshape(4, 4)
        anchor = instance.indices("boundaries", len(vertices))
        if len(anchor) != 1:
            raise instance.bad("boundaries", "a list of one vertex")
        first, last = self._template_span(choice.geometry)
        corners = self._document.template_vertices[first:last]
        placed = product(corners, matrix[:3, :3].T) + matrix[:3, 3] + vertices[anchor[0]]
        self._blocks.append(placed)
        base, self._n_vertices = self._n_vertices - first, self._n_vertices + len(placed)
        return base, first + len(placed), bool(determinant(matrix[:3, :3]) < 0.0)

    def _template_span(self, template: dict[str, Any]) -> tuple[int, int]:
        """The range of template vertices that a template uses; an instance copies only these."""
        key = id(template)
        if key not in self._spans:
            used = [0]
            with suppress(TypeError, ValueError):  # reported when its polygons are added
                polygons = iter_polygons(template.get("boundaries") or [], None, DEPTHS[template["type"]])
                used = list(chain.from_iterable(chain.from_iterable(rings for _, rings, _ in polygons))) or used
                self._spans[key] = max(0, index(min(used))), index(max(used)) + 1
        return self._spans.get(key, (0, 0))

    def polygons(self) -> Polygons:
        rings_in, sizes, corners = np.array(self._rings_in, np.int64), *self._corner_arrays()
        owner = np.repeat(np.repeat(np.arange(len(rings_in)), rings_in), sizes)  # polygon of each corner
        base, limit = np.array(self._base, np.int64), np.array(self._limit, np.int64)
        bad = np.flatnonzero((corners < 0) | (corners >= limit[owner]))
        if len(bad):
            k = owner[bad[0]]
            raise self._bad(k, f"uses vertex {corners[bad[0]]}, but there are {counted(limit[k], 'vertex')}")
        vertices, rings = np.concatenate(self._blocks), Rings(corners + base[owner], sizes, rings_in)
        self._check_distinct(vertices, rings, owner)
        return Polygons(
            vertices,
            rings,
            np.array(self._surface, np.int32),
            np.array(self._mirrored, bool),
            self._surfaces,
            [name for _, name in self._objects],
            self._types,
            self._parents,
            self._attributes,
        )

    def _check_distinct(self, vertices: np.ndarray, rings: Rings, owner: np.ndarray) -> None:
        """Raise an InputError for a large polygon that passes the same corners again and again.

        Ear clipping takes quadratic time for it. Corners that repeat their predecessor do not count.
        """
        counts = np.bincount(owner, minlength=len(rings.rings_in))
        for k in np.flatnonzero(counts > _MANY_CORNERS).tolist():
            points = vertices[rings.corners[slice(*np.searchsorted(owner, [k, k + 1]))]]
            passed = 1 + int((points[1:] != points[:-1]).any(1).sum())
            distinct = len(np.unique(points, axis=0))
            if passed > _MANY_CORNERS and distinct < _DISTINCT * passed:
                raise self._bad(k, f"has a polygon that passes {counted(distinct, 'point')} {counted(passed, 'time')}")

    def _corner_arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """(number of corners of each ring, vertices of all rings), (r,) and (c,) int64."""
        try:
            sizes = np.array([len(ring) for ring in self._rings], np.int64)
            corners = np.array(list(chain.from_iterable(self._rings)) or np.empty(0, np.int64))
            if corners.ndim == 1 and corners.dtype.kind in "iu":
                return sizes, corners.astype(np.int64)
        except (TypeError, ValueError):
            pass

        def fine(ring: Any) -> bool:
            return isinstance(ring, list) and all(type(i) is int and abs(i) < 2**62 for i in ring)

        ring = next(k for k, ring in enumerate(self._rings) if not fine(ring))
        polygon = int(np.searchsorted(np.cumsum(self._rings_in), ring, side="right"))
        raise self._bad(polygon, "has boundaries that are not nested lists of vertices, as its type demands")

    def _bad(self, polygon: int, problem: str) -> InputError:
        name = list(self._objects)[self._surfaces[self._surface[polygon]].object][1]
        return InputError(f'{self._document.file}: CityObjects "{name[:60]}" {problem}; export the file again')
