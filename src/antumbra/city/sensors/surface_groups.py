"""Groups of faces: objects, buildings and surfaces; normals with their azimuth, tilt and tangents."""

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, choice, quoted, spelling_hint
from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...kernels.elementary import acos, atan2, cos
from ...scene.scene_data import MemoryData
from .sensors import corners_of

# --- Groups of faces --------------------------------------------------------------------------------------------------


GROUPINGS = "face", "surface", "object", "building"
"""Names of the ways in which `surface_groups` groups faces."""

Grouping: TypeAlias = "str | ArrayLike"
"""A name of `GROUPINGS`, or a group number for each face, (faces,) int, -1: none."""

_SAME_PLANE = float(cos(np.radians(0.1)))  # cosine of the angle between the normals of joined faces
_ACROSS = np.array([0.5257, 0.3129, 0.7911])  # a direction in which different normals have different components


class SurfaceGroups(NamedTuple):
    """Groups of the faces of a scene, such as its buildings. Each has at least one face."""

    names: list[str]  # of the groups
    types: list[str]  # such as "Building" or "RoofSurface"; "": unknown
    of_face: np.ndarray  # (faces,) int32: the group of each face, -1: none


def surface_groups(scene: AnyScene, by: Grouping) -> SurfaceGroups:
    """The faces of a scene in groups.

    - ``face``: each face is a group
    - ``surface``: semantic surfaces of a city model; otherwise the planar parts of objects: faces that are joined by an
      edge, and whose normals differ by less than 0.1 degrees
    - ``object``: the objects of the scene
    - ``building``: the outermost objects, such as a Building with all its BuildingParts; otherwise the objects

    Raises
    ------
    InputError
        If the name is unknown, or the numbers are not one for each face.
    """
    if not isinstance(by, str):
        return _numbered(as_array(by, "groups of faces"), scene.n_triangles)
    choice(by, "surfaces", GROUPINGS)
    faces = np.arange(scene.n_triangles, dtype=np.int32)
    if by == "face":
        return SurfaceGroups([str(k) for k in range(len(faces))], [""] * len(faces), faces)
    if by == "surface":
        if scene.city is None:
            return _planar_parts(scene)
        names = [f"{scene.city.objects[each.object]}/{k}" for k, each in enumerate(scene.city.surfaces)]
        types = [each.type or "" for each in scene.city.surfaces]
        return _with_faces(names, types, scene.city.surface_of_face)
    objects = np.asarray(scene.object_of_face[faces], np.int32)
    if by == "object" or scene.city is None:
        return _with_faces([each.name for each in scene.objects], [each.type for each in scene.objects], objects)
    names, types, building_of = buildings_of(scene)
    return _with_faces(names, types, building_of[objects])


def buildings_of(scene: AnyScene) -> tuple[list[str], list[str], NDArray[np.int32]]:
    """Names and types of the outermost objects, and the index of that of each object. "" for types without faces."""
    if scene.city is None:
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
    """The groups that have faces."""
    used, numbers = np.unique(of_face, return_inverse=True)
    return SurfaceGroups([names[k] for k in used], [types[k] for k in used], numbers.astype(np.int32))


def _planar_parts(scene: AnyScene) -> SurfaceGroups:
    """Faces of an object that are joined by edges, with nearly the same normal; names are "object/number"."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = corners_of(scene) if scene.data.hidden is None else _all_corners(scene)
    n, objects = len(corners), np.asarray(scene.object_of_face[np.arange(len(corners))])
    normals = unit_normals(corners)
    vertices = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    ends = np.sort(np.stack([vertices, np.roll(vertices, -1, 1)], -1).reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(n), 3)
    keys = np.column_stack([objects[face], ends])
    order = np.lexsort([(normals @ _ACROSS)[face], *keys.T[::-1]])  # the sides of coincident faces, one after the other
    before, after = order[:-1], order[1:]
    same = (keys[before] == keys[after]).all(1)
    a, b = face[before[same]], face[after[same]]
    flat = (normals[a] * normals[b]).sum(1) > _SAME_PLANE
    joined = coo_array((np.ones(flat.sum(), bool), (a[flat], b[flat])), shape=(n, n))
    labels = connected_components(joined, directed=False)[1]
    first = np.unique(labels, return_index=True)[1]
    ranks = np.empty(len(first), np.int32)
    ranks[np.argsort(first)] = np.arange(len(first), dtype=np.int32)  # in the order of their first faces
    owners = objects[np.sort(first)]
    names = [f"{scene.objects[k].name}/{i}" for i, k in enumerate(owners.tolist())]
    return SurfaceGroups(names, [scene.objects[k].type for k in owners], ranks[labels])


def _all_corners(scene: AnyScene) -> NDArray[np.float64]:
    """`corners_of`, also of hidden faces, so that all states of a scene have the same parts."""
    data = cast(MemoryData, scene.data)
    return data.hiding(np.zeros(data.n_triangles, bool)).corners()


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
    """Types of semantic surfaces. Raises InputError if the scene has none, or none of a type."""
    if scene.city is None:
        names = quoted(",".join(types))
        raise InputError(
            f"surfaces is {names}, and {scene.name} has no semantic surfaces as CityJSON has; leave it out"
        )
    known = sorted({each.type for each in scene.city.surfaces if each.type})
    for name in types:
        if name not in known:
            hint = spelling_hint(name, known)
            raise InputError(f"{scene.name} has no surfaces of type {quoted(name)}; {hint}it has {_listing(known)}")
    return list(types)


def _listing(names: list[Any]) -> str:
    return ", ".join(names) or "none with a type"
