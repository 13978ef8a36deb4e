"""Footprints as closed solids: a flat roof, a floor at the base, and a wall along each edge, with normals outwards.

Each roof, floor and wall is a semantic surface of its building, named as in CityJSON. A building stands on its base;
on terrain, that is the lowest terrain under the footprint, so no gap opens below a wall on a slope.
"""

from collections.abc import Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.wording import counted
from ...scene.mesh import Mesh, MeshInfo, ObjectInfo, Piece, make_mesh
from ...scene.scene_data import CityModel, SemanticSurface
from ...scene.terrain import TERRAIN_TYPE, HeightGrid, TerrainSurfaces, terrain_blocks
from ..cityjson.city_polygons import Rings, triangulate
from ..cityjson.cityjson_source import CityMeshes, colours_of
from ..cityjson.repeated_faces import repeated_faces_notes
from .footprint_bases import lowest_under
from .footprint_table import Footprints, PolygonRings

BUILDING = "Building"
_ROOF, _WALL, _FLOOR = "RoofSurface", "WallSurface", "GroundSurface"

# --- Buildings on terrain ---------------------------------------------------------------------------------------------


def on_terrain(footprints: Footprints, terrain: HeightGrid, invalid: str) -> Footprints:
    """Footprints whose bases are the lowest terrain under them.

    invalid : "raise": a footprint off the terrain is an InputError; "skip": it is left out, with a note
    """
    lowest = np.full(len(footprints.ids), np.nan)
    np.fmin.at(lowest, footprints.rings.footprint, lowest_under(terrain, footprints.rings))
    off = np.flatnonzero(np.isnan(lowest))
    if not len(off):
        return footprints._replace(bases=lowest)
    file, name, more = footprints.file, footprints.ids[off[0]], f" (and {len(off) - 1} more)" if len(off) > 1 else ""
    if invalid == "raise" or len(off) == len(lowest):
        raise InputError(
            f"{file}: footprint {name!r}{more} lies off the heights of {terrain.name}; take a larger raster, or leave "
            "such footprints out: invalid='skip', or FILE?invalid=skip"
        )
    note = f"{file}: left out {counted(len(off), 'footprint')} off the heights of the terrain; the first is {name!r}"
    return _chosen(footprints._replace(bases=lowest, notes=[*footprints.notes, note]), ~np.isnan(lowest))


def _chosen(footprints: Footprints, chosen: NDArray[np.bool_]) -> Footprints:
    """Some of the footprints."""
    rings = footprints.rings
    polygons = chosen[rings.footprint]
    in_ring = np.repeat(polygons, rings.rings_in)
    number = np.cumsum(chosen) - 1
    some = PolygonRings(
        rings.corners[np.repeat(in_ring, rings.sizes)],
        rings.sizes[in_ring],
        rings.rings_in[polygons],
        number[rings.footprint[polygons]],
    )
    ids = [name for name, one in zip(footprints.ids, chosen.tolist()) if one]
    attributes = {name: values[chosen] for name, values in footprints.attributes.items()}
    return footprints._replace(
        rings=some, ids=ids, heights=footprints.heights[chosen], bases=footprints.bases[chosen], attributes=attributes
    )


# --- Solids -----------------------------------------------------------------------------------------------------------


class BuildingSolids(CityMeshes):
    """The source of solids, which may stand on terrain: its triangles follow theirs, as one more object."""

    def __init__(self, mesh: Mesh, file: str, city: CityModel, terrain: HeightGrid | None):
        super().__init__(mesh, file, city)
        self.terrain = terrain
        if terrain is not None:
            surface = TerrainSurfaces([terrain], file)
            self._n_buildings = len(self.objects)
            self.objects.append(ObjectInfo(terrain.name, self._n_buildings, 0, TERRAIN_TYPE))
            self.meshes.append(MeshInfo(terrain.name, surface.meshes[0].triangles, 1))

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        yield from super().pieces(time)
        if self.terrain is not None:
            (colour,) = colours_of([None], [TERRAIN_TYPE])
            for block in terrain_blocks(self.terrain):
                yield Piece(block.vertices[None], block.faces, colour, self.file, first=self._n_buildings)


def solids_of(footprints: Footprints, terrain: HeightGrid | None) -> tuple[BuildingSolids, CityModel, list[str]]:
    """The solids of footprints, their city objects, and notes.

    Raises
    ------
    InputError
        If no footprint has an area.
    """
    rings = footprints.rings
    corners, polygon_of = len(rings.corners), rings.polygon_of_corner
    base, height = footprints.bases[rings.footprint], footprints.heights[rings.footprint]
    vertices = np.empty((2, corners, 3))
    vertices[:, :, :2] = rings.corners
    vertices[0, :, 2], vertices[1, :, 2] = base[polygon_of], (base + height)[polygon_of]
    faces, face_surface = _faces(vertices[1], rings)
    surfaces, types = _surfaces(rings)
    owner = rings.footprint[np.repeat(np.arange(len(rings.rings_in)), _surface_counts(rings))]
    n = len(footprints.ids)
    colours = colours_of([*types], [BUILDING] * len(types))[face_surface]
    mesh = make_mesh(footprints.file, vertices.reshape(-1, 3), faces, colours, footprints.file)
    of_face = owner[face_surface].astype(np.int32)
    city = CityModel(
        footprints.crs, footprints.ids, of_face, face_surface, surfaces, [BUILDING] * n, [""] * n, [],
        _rows(footprints.attributes),
    )  # fmt: skip
    source = BuildingSolids(mesh, footprints.file, city, terrain)
    if terrain is not None:
        city = _with_terrain(city, terrain.name, source.meshes[-1].triangles)
    return source, city, footprints.notes + repeated_faces_notes(mesh, footprints.file)


def _with_terrain(city: CityModel, name: str, triangles: int) -> CityModel:
    """A city with one more object, which has no semantics."""
    n, surfaces = len(city.objects), [*city.surfaces, SemanticSurface(len(city.objects), None, 0, None, ())]
    return city._replace(
        objects=[*city.objects, name],
        object_of_face=np.concatenate([city.object_of_face, np.full(triangles, n, np.int32)]),
        surface_of_face=np.concatenate([city.surface_of_face, np.full(triangles, len(surfaces) - 1, np.int32)]),
        surfaces=surfaces,
        types=[*city.types, TERRAIN_TYPE],
        parents=[*city.parents, ""],
        attributes=[*city.attributes, {}] if city.attributes else (),
    )


def _rows(columns: dict[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """The columns of a table as one mapping a row, of Python's numbers and text."""
    names, values = list(columns), [[_plain(value) for value in column.tolist()] for column in columns.values()]
    return [dict(zip(names, row)) for row in zip(*values)]


def _plain(value: Any) -> Any:
    """A value as JSON has it; dates as text."""
    return value if value is None or isinstance(value, (bool, int, float, str, list, dict)) else str(value)


def _corner_counts(rings: PolygonRings) -> NDArray[np.int64]:
    """(p,) int64: number of corners of each polygon."""
    return np.bincount(rings.polygon_of_corner, minlength=len(rings.rings_in))


def _surface_counts(rings: PolygonRings) -> NDArray[np.int64]:
    """(p,) int64: number of surfaces of each polygon: a roof, a wall for each corner, and a floor."""
    return _corner_counts(rings) + 2


def _faces(roof: NDArray[np.float64], rings: PolygonRings) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Faces, (f, 3), of polygon after polygon, and the surface of each.

    Vertex i is corner i of the floor, and vertex c + i that of the roof.

    roof : (c, 3) float64, corners
    """
    c, polygon_of = len(rings.corners), rings.polygon_of_corner
    cut = triangulate(roof, Rings(np.arange(c), rings.sizes, rings.rings_in))
    this, after = np.arange(c), rings.following
    walls = np.stack([this, after, after + c, this, after + c, this + c], 1).reshape(-1, 3)
    counts = _surface_counts(rings)
    first = np.cumsum(counts) - counts
    of_wall = first[polygon_of] + 1 + this - (np.cumsum(counts - 2) - (counts - 2))[polygon_of]
    surface = np.concatenate([first[cut.polygon], np.repeat(of_wall, 2), (first + counts - 1)[cut.polygon]])
    order = np.argsort(surface, kind="stable")
    faces = np.concatenate([cut.faces + c, walls, cut.faces[:, ::-1]])
    return faces[order], surface[order].astype(np.int32)


def _surfaces(rings: PolygonRings) -> tuple[list[SemanticSurface], list[str | None]]:
    """The semantic surfaces of all polygons, numbered within their footprint, and their types."""
    counts = _surface_counts(rings)
    last = np.cumsum(counts)
    kinds = np.full(int(counts.sum()), _WALL, object)
    kinds[last - counts], kinds[last - 1] = _ROOF, _FLOOR
    owner = np.repeat(rings.footprint, counts)
    begins = np.flatnonzero(np.diff(owner, prepend=-1))  # surfaces with which a footprint begins
    number = np.arange(len(owner)) - np.repeat(begins, np.diff(np.append(begins, len(owner))))
    entries = zip(owner.tolist(), kinds.tolist(), number.tolist())
    return [SemanticSurface(one, kind, 0, k, ()) for one, kind, k in entries], kinds.tolist()
