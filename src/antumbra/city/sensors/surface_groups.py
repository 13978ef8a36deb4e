"""Groups of faces: objects, buildings, surfaces and facades; types of surfaces; normals with their azimuth and tilt."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, choice, quoted, spelling_hint
from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...kernels.elementary import acos, atan2
from ...scene.scene_data import MemoryData
from ..cityjson.surface_types import BUILT, WALL, types_of_normals
from .planar_parts import planar_parts
from .sensors import corners_of

# --- Groups of faces --------------------------------------------------------------------------------------------------


GROUPINGS = "face", "surface", "facade", "object", "building"
"""Names of the ways in which `surface_groups` groups faces."""

Grouping: TypeAlias = "str | ArrayLike"
"""A name of `GROUPINGS`, or a group number for each face, (faces,) int, -1: none."""


class SurfaceGroups(NamedTuple):
    """Groups of the faces of a scene, such as its buildings. Each has at least one face."""

    names: list[str]  # of the groups
    types: list[str]  # such as "Building" or "RoofSurface"; "": unknown
    of_face: np.ndarray  # (faces,) int32: the group of each face, -1: none


def surface_groups(scene: AnyScene, per: Grouping) -> SurfaceGroups:
    """The faces of a scene in groups.

    - ``face``: each face is a group
    - ``surface``: semantic surfaces of a city model; faces without semantics form the planar parts of their objects,
      see `planar_parts`
    - ``facade``: the planar parts of the walls of objects; other faces belong to no group
    - ``object``: the objects of the scene
    - ``building``: the outermost objects, such as a Building with all its BuildingParts, apart from those with the
      type of something else, such as trees and roads, which belong to no group

    Raises
    ------
    InputError
        If the name is unknown, the scene has no buildings, or the numbers are not one for each face.
    """
    if not isinstance(per, str):
        return _numbered(as_array(per, "groups of faces"), scene.n_triangles)
    choice(per, "per", GROUPINGS)
    faces = np.arange(scene.n_triangles, dtype=np.int32)
    if per == "face":
        return SurfaceGroups([str(k) for k in range(len(faces))], [""] * len(faces), faces)
    if per == "facade":
        walls = np.flatnonzero(face_types(scene, faces) == WALL)
        return _parts_of(scene, walls, [WALL] * len(faces))
    if per == "surface":
        return _surfaces(scene)
    objects = np.asarray(scene.object_of_face[faces], np.int32)
    if per == "object":
        return _with_faces([each.name for each in scene.objects], [each.type for each in scene.objects], objects)
    names, types, building_of = buildings_of(scene)
    building_of[[bool(each.type) and not each.type.startswith(BUILT) for each in scene.objects]] = -1
    groups = _with_faces(names, types, building_of[objects])
    if not groups.names:
        kinds = _listing(sorted({each.type for each in scene.objects}))
        raise InputError(f"{scene.name} has no buildings, only {kinds}; use surface for the rows")
    return groups


def notes_on_buildings(scene: AnyScene, per: Grouping) -> list[str]:
    """A note if rows per building are of objects that nothing tells from trees or streets."""
    if not isinstance(per, str) or per != "building" or any(each.type for each in scene.objects):
        return []
    return [f"{scene.name}: its objects have no types, so each counts as a building"]


def buildings_of(scene: AnyScene) -> tuple[list[str], list[str], NDArray[np.int32]]:
    """Names and types of the outermost objects, and the index of that of each object. "" for types without faces."""
    if scene.city is None and not any(each.parent for each in scene.objects):
        names, types = [each.name for each in scene.objects], [each.type for each in scene.objects]
        return names, types, np.arange(len(names), dtype=np.int32)
    outermost = [each.parent or each.name for each in scene.objects]
    names = list(dict.fromkeys(outermost))
    type_of = {each.name: each.type for each in scene.objects if not each.parent}
    place = {name: k for k, name in enumerate(names)}
    return names, [type_of.get(name, "") for name in names], np.array([place[name] for name in outermost], np.int32)


def _numbered(numbers: np.ndarray, faces: int) -> SurfaceGroups:
    if numbers.shape != (faces,) or numbers.dtype.kind not in "iu":
        raise InputError(
            f"groups of faces must be ({faces},) whole numbers, one for each face, not {numbers.dtype} {numbers.shape}"
        )
    known = np.unique(numbers[numbers >= 0])
    of_face = np.searchsorted(known, numbers).astype(np.int32)
    of_face[numbers < 0] = -1
    return SurfaceGroups([str(k) for k in known.tolist()], [""] * len(known), of_face)


def _with_faces(names: Sequence[str], types: Sequence[str], of_face: NDArray[np.integer]) -> SurfaceGroups:
    """The groups that have faces; -1: none."""
    used, numbers = np.unique(of_face, return_inverse=True)
    none = int(np.count_nonzero(used < 0))
    used = used[none:]
    return SurfaceGroups([names[k] for k in used], [types[k] for k in used], (numbers - none).astype(np.int32))


def _surfaces(scene: AnyScene) -> SurfaceGroups:
    """Semantic surfaces, and planar parts of the faces without semantics."""
    city, faces = scene.city, np.arange(scene.n_triangles)
    if city is None:
        return _parts_of(scene, faces, face_types(scene, faces))
    types = face_types(scene, faces)
    surfaces = np.array(city.surface_of_face)
    plain = np.flatnonzero(np.array([not each.type for each in city.surfaces], bool)[surfaces])
    parts = _parts_of(scene, plain, types).of_face[plain]
    first = np.full(parts.max(initial=-1) + 1, len(city.surfaces), surfaces.dtype)  # a part bears its first number
    np.minimum.at(first, parts, surfaces[plain])
    surfaces[plain] = first[parts]
    names = [f"{city.objects[each.object]}/{k}" for k, each in enumerate(city.surfaces)]
    of_surface = np.full(len(names), "", object)
    of_surface[surfaces] = types
    return _with_faces(names, of_surface.tolist(), surfaces)


def _parts_of(scene: AnyScene, faces: NDArray[np.integer], types: Sequence[str] | np.ndarray) -> SurfaceGroups:
    """The planar parts of some faces, by object; names are "object/number", counted for each name of an object.

    types : of all faces
    """
    objects = np.asarray(scene.object_of_face[faces], np.int64)
    labels, first = planar_parts(_all_corners(scene)[faces], objects, 1.0 / scene.unit.metres)
    of_face = np.full(scene.n_triangles, -1, np.int32)
    of_face[faces] = labels
    names, counts = list[str](), dict[str, int]()
    for owner in objects[first].tolist():
        name = scene.objects[owner].name
        names.append(f"{name}/{counts.setdefault(name, 0)}")
        counts[name] += 1
    return SurfaceGroups(names, [types[face] for face in faces[first].tolist()], of_face)


def _all_corners(scene: AnyScene) -> NDArray[np.float64]:
    """`corners_of`, also of hidden faces, so that all states of a scene have the same parts and types."""
    if scene.data.hidden is None:
        return corners_of(scene)
    data = cast(MemoryData, scene.data)
    return data.hiding(np.zeros(data.n_triangles, bool)).corners()


# --- Types of surfaces ------------------------------------------------------------------------------------------------


def face_types(scene: AnyScene, faces: NDArray[np.integer]) -> NDArray[np.object_]:
    """(n,) str: the type of the surface of each face, (n,) int; "" if it is unknown, and for the face -1.

    That of its semantic surface. Without semantics it follows from the normal, see `types_of_normals`; in city models
    only for buildings and other constructions, since their other objects have neither walls nor roofs.

    Raises
    ------
    InputError
        If the scene is a store of a city model, whose semantic surfaces it does not have.
    """
    if scene.data.lacks_surfaces:
        raise InputError(f"{scene.name}: a store has no semantic surfaces; use the file that it was built from")
    types = np.full(len(faces), "", object)
    plain = faces >= 0
    if scene.city is not None:
        types[:] = scene.city.surface_types(faces)
        built = np.array([each.startswith(BUILT) for each in scene.city.types], bool)
        plain &= (types == "") & built[scene.city.object_of_face[np.maximum(faces, 0)]]
    if plain.any():
        normals = unit_normals(_all_corners(scene)[faces[plain]])
        types[plain] = types_of_normals(normals[:, "xyz".index(scene.up)])
    return types


# --- Normals ----------------------------------------------------------------------------------------------------------


_HORIZONTAL = 1e-3  # horizontal part of a unit normal below which a surface is horizontal, and faces nowhere


def unit_normals(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) float64: unit normals of faces, (n, 3, 3), on the side of counterclockwise corners; 0 without an area."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.asarray(np.divide(across, length, out=np.zeros_like(across), where=length > 0.0))


def azimuths(normals: NDArray[np.float64], up: str, north: float = 0.0) -> NDArray[np.float64]:
    """(n,) float64 in [0, 360): the direction that surfaces face, degrees clockwise from true north.

    NaN for horizontal ones.

    normals : (n, 3) float64, unit vectors
    north : degrees, as `Place.north`: true north, clockwise from the scene's own north axis
    """
    east, northward = normals[:, 0], normals[:, 1] if up == "z" else -normals[:, 2]
    degrees = (np.degrees(atan2(east, northward)) - north) % 360.0
    degrees[degrees == 360.0] = 0.0  # the remainder of a tiny negative number
    degrees[~(np.sqrt(east**2 + northward**2) >= _HORIZONTAL)] = np.nan
    return np.asarray(degrees)


def tilts(normals: NDArray[np.float64], up: str) -> NDArray[np.float64]:
    """(n,) float64: degrees between unit normals and up: 0 faces up, 90 is vertical, 180 faces down."""
    return np.asarray(np.degrees(acos(np.clip(normals[:, "xyz".index(up)], -1.0, 1.0))))


def faces_between(azimuth: NDArray[np.float64], first: float, last: float) -> NDArray[np.bool_]:
    """(n,) bool: whether azimuths lie between two others, clockwise and inclusive. False for NaN."""
    if abs(last - first) >= 360.0:
        return np.isfinite(azimuth)
    return np.asarray((azimuth - first) % 360.0 <= (last - first) % 360.0)


def checked_types(scene: AnyScene, types: Sequence[str]) -> list[str]:
    """Types of surfaces. Raises InputError if the scene has none of a type."""
    known = sorted(set(face_types(scene, np.arange(scene.n_triangles)).tolist()) - {""})
    for name in types:
        if name not in known:
            hint = spelling_hint(name, known)
            raise InputError(f"{scene.name} has no surfaces of type {quoted(name)}; {hint}it has {_listing(known)}")
    return list(types)


def _listing(names: list[Any]) -> str:
    return ", ".join(names) or "none with a type"
