"""Scene data of two scenes as one: the faces and objects of the first, then those of the second, which never moves.

`PlacedSource` is the second one at another place.
"""

from collections.abc import Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from .alpha_masks import join_cutouts
from .camera import Camera
from .lights import Light
from .mesh import Piece, Source
from .moved_geometry import at_corners, look_of_corners
from .scene_data import CityModel, MemoryData, SceneData, SemanticSurface
from .units import LengthUnit

# --- Scenes at another place ------------------------------------------------------------------------------------------


class PlacedSource:
    """A source at time 0 in other coordinates: turned and scaled by a matrix, then moved.

    Parameters
    ----------
    source : Source
    linear : (3, 3) float64
    offsets : (3,) or (objects, 3) float64
        The way that all objects, or each of them, are moved.
    """

    duration = 0.0

    def __init__(self, source: Source, linear: NDArray[np.float64], offsets: NDArray[np.float64]):
        self._source, self._linear = source, linear
        self.file, self.meshes, self.objects = source.file, source.meshes, source.objects
        self._offsets = np.broadcast_to(offsets, (max(len(self.objects), 1), 3))

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for piece in self._source.pieces(0.0):
            linear = self._linear if piece.linear is None else self._linear @ piece.linear
            turned = piece.vertices.astype(np.float64) @ self._linear.T
            of_copies = slice(piece.first, piece.first + len(turned))
            if piece.owners is None:
                moved = piece._replace(vertices=turned + self._offsets[of_copies, None])
            else:
                corners = turned.reshape(-1, 3, 3) if piece.faces is None else turned[0, piece.faces]
                moved = at_corners(piece, corners + self._offsets[piece.owners, None], look_of_corners(piece))
            yield moved._replace(linear=np.broadcast_to(linear, (len(turned), 3, 3)))

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []


# --- Two scenes as one ------------------------------------------------------------------------------------------------


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


def joined_system(first: SceneData, second: SceneData) -> tuple[str | None, LengthUnit | None]:
    """The CRS and the given unit of two scenes as one. InputError if both have a unit, and these differ."""
    crs, unit = first.crs or second.crs, first.given_unit or second.given_unit
    if not first.unit.same_as(second.unit) and (unit is not None or (first.crs and second.crs)):
        raise InputError(f"{first.name} is in {first.unit.name}, and {second.name} in {second.unit.name}; scale one")
    return crs, unit


def join_data(first: MemoryData, second: MemoryData, name: str) -> MemoryData:
    """The data of both scenes, with the CRS, the unit, the up axis and the raster of the first.

    Cut-outs and transmittances that were set stay, hidden faces stay hidden, and so does the state after an update. If
    the first is a city, the objects of the second become city objects, with their semantic surfaces if they have any.

    Raises
    ------
    InputError
        If both have a unit, and these differ.
    """
    city = None if first.city is None else _with_objects(first.city, second)
    notes = (*first.notes, *second.notes)
    crs, unit = joined_system(first, second)
    source = JoinedSources(first.source, second.source, name)
    data = MemoryData(source, name=name, up=first.up, notes=notes, crs=crs, unit=unit)
    data.city, data.raster = city, first.raster
    data.cutouts = join_cutouts([(each.cutouts, each.n_triangles) for each in (first, second)])
    hidden = [np.zeros(each.n_triangles, bool) if each.hidden is None else each.hidden for each in (first, second)]
    return data.hiding(np.concatenate(hidden))


def _with_objects(city: CityModel, second: MemoryData) -> CityModel:
    """A city with the objects of another scene."""
    n, first, other = len(city.objects), len(city.surfaces), second.city
    objects, of_face = second.objects, second.object_of_face
    if other is None:
        surfaces, surface_of_face = [SemanticSurface(k, None, 0, None, ()) for k in range(len(objects))], of_face
    else:
        surfaces, surface_of_face = other.surfaces, other.surface_of_face
    attributes = list(city.attributes) or [{} for _ in city.objects]
    more = list(other.attributes) if other is not None and other.attributes else [{} for _ in objects]
    return city._replace(
        objects=[*city.objects, *(each.name for each in objects)],
        object_of_face=np.concatenate([city.object_of_face, of_face + np.int32(n)]),
        surface_of_face=np.concatenate([city.surface_of_face, surface_of_face + np.int32(first)]),
        surfaces=[*city.surfaces, *(each._replace(object=n + each.object) for each in surfaces)],
        types=[*city.types, *(each.type for each in objects)],
        parents=[*city.parents, *(each.parent for each in objects)],
        attributes=[*attributes, *more] if any(attributes) or any(more) else (),
    )
