"""The contents of a CityJSON file beside its triangles: objects, and semantic surfaces of faces."""

from typing import NamedTuple

import numpy as np

from ...checks import as_array
from ...errors import InputError


class Surface(NamedTuple):
    """A semantic surface, such as a roof. A polygon without semantics is a surface of its own."""

    object: int  # index into `CityModel.objects`
    type: str | None  # such as "RoofSurface"; None: the polygon has no semantics
    geometry: int  # index into the object's "geometry"
    semantic: int | None  # index into the geometry's "semantics.surfaces"; None: the polygon has no semantics
    path: tuple[int, ...]  # indices into "boundaries" that lead to the first polygon of the surface


class CityModel(NamedTuple):
    """Which object and surface each face of a scene belongs to.

    `Scene.objects` has the same objects in the same order.
    """

    crs: str | None  # such as "EPSG:7415"; None: the file names none, or one without an EPSG code
    objects: list[str]  # ids of the objects with faces
    object_of_face: np.ndarray  # (n,) int32, index into `objects`
    surface_of_face: np.ndarray  # (n,) int32, index into `surfaces`
    surfaces: list[Surface]  # those with faces
    types: list[str]  # type of each object, such as "BuildingPart"
    parents: list[str]  # id of the outermost object that each one is a part of, such as the Building; "": none
    lods: list[str]  # all levels of detail of surfaces in the file, in ascending order

    def surface_types(self, faces) -> np.ndarray:
        """(...) str: the type of the semantic surface of each face, such as "RoofSurface".

        It is "" where the polygon has no semantics, and where the face is -1 (none).

        faces : (...) int, such as `Hit.face`

        Raises
        ------
        InputError
            If a face is no face of the city.
        """
        faces, n = as_array(faces, "faces"), len(self.surface_of_face)
        if faces.dtype.kind == "f" or (faces.size and (faces.min() < -1 or faces.max() >= n)):
            raise InputError(f"faces must be whole numbers from -1 to {n - 1}, the city's last face")
        names = np.array([surface.type or "" for surface in self.surfaces] + [""])
        return names[np.where(faces >= 0, self.surface_of_face[faces], len(self.surfaces))]
