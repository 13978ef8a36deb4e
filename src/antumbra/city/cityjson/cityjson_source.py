"""The CityJSON reader: `read_cityjson` returns coloured triangles with their city objects and semantic surfaces."""

from collections.abc import Generator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...base.errors import InputError
from ...base.wording import counted
from ...scene.crs import in_one_unit, parts_of_crs
from ...scene.materials import srgb_to_linear
from ...scene.mesh import Mesh, MeshInfo, ObjectInfo, Piece, StaticMeshes, make_mesh
from ...scene.scene_data import CityModel, SemanticSurface
from .city_geometries import GeometryChoice, chosen_geometries
from .city_polygons import Polygons, Triangulation, polygons_of, triangulate
from .cityjson_file import CityDocument, CityLines, many_lists, open_cityjson
from .repeated_faces import StreamedRepeats, repeated_faces_notes, repeats_notes
from .staged_mesh import StagedMesh

# --- Colours of semantic surfaces and city objects --------------------------------------------------------------------


SURFACES = {
    "RoofSurface": "#b8684e",
    "WallSurface": "#e2d6c0",
    "GroundSurface": "#c9c2b6",
    "ClosureSurface": "#dcd8d0",
    "OuterCeilingSurface": "#d5cdc0",
    "OuterFloorSurface": "#cfc7ba",
    "Window": "#7795a8",
    "Door": "#8f6f52",
    "WaterSurface": "#7fabc9",
    "WaterGroundSurface": "#b9b3a2",
    "WaterClosureSurface": "#b6cfdf",
    "TrafficArea": "#8e8e91",
    "AuxiliaryTrafficArea": "#b3b0a4",
    "TransportationMarking": "#e6e6e6",
    "TransportationHole": "#8f8f92",
}
"""Type of a semantic surface -> sRGB."""

OBJECTS = {
    "Building": "#e2d6c0",
    "Bridge": "#cfcac4",
    "Tunnel": "#bdb8b2",
    "OtherConstruction": "#d6cfc6",
    "Road": "#8e8e91",
    "Railway": "#b5aaa0",
    "Waterway": "#7fabc9",
    "TransportSquare": "#c4c1bd",
    "TransportationSquare": "#c4c1bd",
    "WaterBody": "#7fabc9",
    "LandUse": "#b9bf93",
    "PlantCover": "#8aa65f",
    "SolitaryVegetationObject": "#5f8445",
    "TINRelief": "#d6cfb6",
    "CityFurniture": "#c7b7a6",
}
"""Type of a city object, or a prefix of it -> sRGB."""

OTHERS = "#dddad5"


def colours_of(surface_types: list[str | None], object_types: list[str]) -> np.ndarray:
    """Linear colours, (n, 3) float32, of surfaces, from the types of each surface and of its object."""
    pairs: dict[tuple[str | None, str], int] = {}
    indices = [pairs.setdefault(pair, len(pairs)) for pair in zip(surface_types, object_types)]
    table = np.array([_linear(_hex(*pair)) for pair in pairs], np.float32).reshape(-1, 3)
    return table[indices]


def _hex(surface: str | None, object_type: str) -> str:
    if surface in SURFACES:
        return SURFACES[surface]
    if object_type in OBJECTS:
        return OBJECTS[object_type]
    return next((colour for begin, colour in OBJECTS.items() if object_type.startswith(begin)), OTHERS)  # BuildingPart


def _linear(colour: str) -> np.ndarray:
    return srgb_to_linear([int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])


# --- Reading ----------------------------------------------------------------------------------------------------------


class CityMeshes(StaticMeshes):
    """All city objects in one mesh, which is faster than one mesh per object: files have many small objects."""

    def __init__(self, mesh: Mesh, file: str, city: CityModel):
        super().__init__([mesh], file)
        counts = np.bincount(city.object_of_face, minlength=len(city.objects)).tolist()
        entries = zip(city.objects, city.types, city.parents)
        self.mesh, self._owners = mesh, city.object_of_face
        self.meshes = [MeshInfo(name, n, 1) for name, n in zip(city.objects, counts)]
        self.objects = [ObjectInfo(name, k, 0, kind, parent) for k, (name, kind, parent) in enumerate(entries)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for piece in super().pieces(time):
            yield piece._replace(owners=self._owners)


class CityFile(NamedTuple):
    """The result of `read_cityjson`."""

    source: CityMeshes
    notes: list[str]
    city: CityModel


def read_cityjson(path: Path, lod: str | None = None, crs: str | None = None) -> CityFile:
    """Read a .json or .jsonl file. Faces are in the order of the file.

    Heights in another unit than the plan, by the CRS, are converted to that of the plan.

    lod : level of detail, such as "2.2"; None: the highest of each object. Of several geometries of an object at this
        level, one is read; see `city_geometries`.
    crs : instead of that of the file

    Raises
    ------
    InputError
        If the file is not CityJSON, is damaged, or lacks the level of detail.
    """
    with many_lists():
        document = open_cityjson(path)
        choice = chosen_geometries(document, lod)
        polygons = polygons_of(document, choice.geometries)
    polygons, converted = _in_one_unit(polygons, document, crs or document.crs)
    cut = triangulate(polygons.vertices, polygons.rings)
    surface = polygons.surface[cut.polygon]
    used, surface, owner = _drop_unused(polygons, surface)
    ids, types, parents = ([of[k] for k in used.objects] for of in (polygons.objects, polygons.types, polygons.parents))
    attributes = [polygons.attributes[k] for k in used.objects]
    if not len(cut.faces):
        raise _nothing_in(document.file)
    mesh = _mesh_of(polygons, cut, used, surface, document.file)
    city = CityModel(document.crs, ids, owner, surface, used.surfaces, types, parents, choice.levels, attributes)
    notes = document.notes + choice.notes + converted + _notes(document.file, cut.flat, cut.crossed)
    notes += repeated_faces_notes(mesh, document.file)
    return CityFile(CityMeshes(mesh, document.file, city), notes, city)


class StreamedCityFile(NamedTuple):
    """The result of `stream_cityjson`."""

    source: StagedMesh
    notes: list[str]
    crs: str | None  # of the file


def stream_cityjson(path: Path, lod: str | None = None, crs: str | None = None) -> StreamedCityFile:
    """Read a .jsonl file as `read_cityjson`, a few lines at a time, into a scratch file of faces and colours."""
    lines, scratch = CityLines(path), StagedMesh(path.name)
    file, choice = path.name, GeometryChoice(path.name, lod, lines.document_at)
    repeats, converted, flat, crossed = StreamedRepeats(scratch.folder), list[str](), 0, 0
    for document, places in lines.documents():
        with many_lists():
            polygons = polygons_of(document, choice.of(document, places))
        polygons, converted = _in_one_unit(polygons, document, crs or document.crs)
        cut = triangulate(polygons.vertices, polygons.rings)
        flat, crossed = flat + cut.flat, crossed + cut.crossed
        if len(cut.faces):
            used, surface, owner = _drop_unused(polygons, polygons.surface[cut.polygon])
            names, types, parents = polygons.objects, polygons.types, polygons.parents
            mesh = _mesh_of(polygons, cut, used, surface, file)
            repeats.add(mesh)
            scratch.add(mesh, owner, [ObjectInfo(names[k], 0, 0, types[k], parents[k]) for k in used.objects])
    _, notes = choice.end()
    scratch.end()
    if not scratch.meshes[0].triangles:
        raise _nothing_in(file)
    notes = lines.head.document.notes + notes + converted + _notes(file, flat, crossed)
    notes += repeats_notes(repeats.count(lambda: scratch.pieces(0.0)), file)
    return StreamedCityFile(scratch, notes, lines.head.document.crs)


def _nothing_in(file: str) -> InputError:
    return InputError(f"{file}: no object has a surface with an area; take a file with such geometry")


def _mesh_of(polygons: Polygons, cut: Triangulation, used: "_UsedParts", surface: np.ndarray, file: str) -> Mesh:
    """The coloured triangles of polygons; `surface`: that of each triangle."""
    faces = np.where(polygons.mirrored[cut.polygon, None], cut.faces[:, ::-1], cut.faces)
    types = [polygons.types[k] for k in used.objects]
    colours = colours_of([s.type for s in used.surfaces], [types[s.object] for s in used.surfaces])
    return make_mesh(file, polygons.vertices, faces, colours[surface], file)


def _in_one_unit(polygons: Polygons, document: CityDocument, crs: str | None) -> tuple[Polygons, list[str]]:
    """Polygons whose heights are in the unit of the plan of a CRS, and a note if that changed them."""
    if crs is None or (factor := in_one_unit(crs)[1]) == 1.0:
        return polygons, []
    parts, vertices = parts_of_crs(crs), polygons.vertices.copy()
    assert parts.unit is not None and parts.height_unit is not None
    vertices[:, 2] *= factor
    note = f"heights are converted from {parts.height_unit.name} to {parts.unit.name}, the unit of the plan of {crs}"
    return polygons._replace(vertices=vertices), [f"{document.file}: {note}"]


class _UsedParts(NamedTuple):
    """The objects and surfaces with faces."""

    objects: list[int]  # indices into `Polygons.objects`
    surfaces: list[SemanticSurface]


def _drop_unused(polygons: Polygons, surface: np.ndarray) -> tuple[_UsedParts, np.ndarray, np.ndarray]:
    """Drop surfaces and objects without faces: (the others, surface of each face, object of each face)."""
    surfaces, surface = np.unique(surface, return_inverse=True)
    owners = np.array([polygons.surfaces[k].object for k in surfaces.tolist()], np.int64)
    objects, owner = np.unique(owners, return_inverse=True)
    pairs = zip(surfaces.tolist(), owner.tolist())
    used = _UsedParts(objects.tolist(), [polygons.surfaces[k]._replace(object=new) for k, new in pairs])
    return used, surface.astype(np.int32), owner[surface].astype(np.int32)


def _notes(file: str, flat: int, crossed: int) -> list[str]:
    notes = []
    if flat:
        notes.append(f"{file}: left out {counted(flat, 'polygon')} without area")
    if crossed:
        notes.append(
            f"{file}: {counted(crossed, 'polygon', 'have')} rings that cross; their triangles cover another area"
        )
    return notes
