"""Scene data of two scenes as one: the faces and objects of the first, then those of the second, which never moves."""

from collections.abc import Generator

import numpy as np

from ...base.errors import InputError
from ...scene.alpha_masks import join_cutouts
from ...scene.camera import Camera
from ...scene.lights import Light
from ...scene.mesh import Piece, Source
from ...scene.scene_data import CityModel, MemoryData, SemanticSurface


class JoinedSources:
    """The geometry of two sources; cameras, lights and duration are those of the first."""

    def __init__(self, first: Source, second: Source, file: str):
        self._first, self._second, self.file, self.duration = first, second, file, first.duration
        self._n_objects, n_meshes = len(first.objects), len(first.meshes)
        self.meshes = [*first.meshes, *second.meshes]
        self.objects = [*first.objects, *(each._replace(mesh=each.mesh + n_meshes) for each in second.objects)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        yield from self._first.pieces(time)
        for piece in self._second.pieces(0.0):
            owners = None if piece.owners is None else piece.owners + np.int32(self._n_objects)
            yield piece._replace(first=piece.first + self._n_objects, owners=owners)

    def cameras(self, time: float) -> list[Camera]:
        return self._first.cameras(time)

    def lights(self, time: float) -> list[Light]:
        return self._first.lights(time)


def join_data(first: MemoryData, second: MemoryData, name: str) -> MemoryData:
    """The data of both scenes, with the CRS, the unit, the up axis and the raster of the first.

    Cut-outs and transmittances that were set stay, and so does the state after an update. If the first is a city, the
    objects of the second become city objects without semantic surfaces.

    Raises
    ------
    InputError
        If both have a unit, and these differ.
    """
    city = None if first.city is None else _with_objects(first.city, second)
    notes = (*first.notes, *second.notes)
    crs, unit = first.crs or second.crs, first.given_unit or second.given_unit
    if not first.unit.same_as(second.unit) and (unit is not None or (first.crs and second.crs)):
        raise InputError(f"{first.name} is in {first.unit.name}, and {second.name} in {second.unit.name}; scale one")
    source = JoinedSources(first.source, second.source, name)
    data = MemoryData(source, name=name, up=first.up, notes=notes, crs=crs, unit=unit)
    data.city, data.raster = city, first.raster
    data.cutouts = join_cutouts([(each.cutouts, each.n_triangles) for each in (first, second)])
    return data


def _with_objects(city: CityModel, second: MemoryData) -> CityModel:
    """A city with the objects of another scene."""
    n, first = len(city.objects), len(city.surfaces)
    objects, of_face = second.objects, second.object_of_face
    surfaces = [SemanticSurface(n + k, None, 0, None, ()) for k in range(len(objects))]
    return city._replace(
        objects=[*city.objects, *(each.name for each in objects)],
        object_of_face=np.concatenate([city.object_of_face, of_face + np.int32(n)]),
        surface_of_face=np.concatenate([city.surface_of_face, of_face + np.int32(first)]),
        surfaces=[*city.surfaces, *surfaces],
        types=[*city.types, *(each.type for each in objects)],
        parents=[*city.parents, *(each.parent for each in objects)],
    )
