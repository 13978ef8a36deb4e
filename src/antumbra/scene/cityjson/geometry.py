"""Triangles of polygons in space, which may have holes and need not be quite flat.

Each polygon is projected along the axis that is nearest to its normal, in float64. The projection leaves two of the
three coordinates as they are, so it rounds nothing. Newell's formula gives the normal: its sum over the edges of the
outer ring is the ring's vector area. The triangles keep the ring's orientation, so their normals point the same way.
"""

from typing import NamedTuple

import numpy as np

from ...extras import needed

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
    ears = needed("mapbox_earcut", "CityJSON", "gis").triangulate_float64
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
