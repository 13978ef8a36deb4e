"""Ladybug Tools: `intersection_matrix` and `sky_intersection_matrix`, with the calls and results of ladybug_radiance.

ladybug_radiance writes sensors, vectors and geometry to files for Radiance's ``oconv`` and ``rcontrib``. The functions
here trace the same rays in memory, exactly, and need neither Radiance nor ladybug_radiance. Geometry is recognised by
its attributes, so this module imports ladybug only for the vectors of a sky.
"""

import math
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..base.checks import flag, number, quoted, unit_vectors
from ..base.checks import points as checked_points
from ..base.errors import InputError
from ..base.wording import counted
from ..city.sun.sun_visibility import direction_order, sensor_order
from ..city.tables.bit_matrices import unpack_bits
from ..engine.scene import Scene
from ..query.receivers import Receivers
from ..scene.light_lists import DirectionalLights
from ..scene.lights import MAX_SPP

VectorsLike: TypeAlias = "Sequence[Any] | NDArray[np.floating]"
"""Vectors or points of ladybug_geometry, or an array (n, 3)."""

_TRIANGLE, _QUAD = 3, 4  # corners
_CURE = "give Face3D or Mesh3D of ladybug_geometry"


def intersection_matrix(
    vectors: VectorsLike, points: VectorsLike, normals: VectorsLike, context_geometry: Iterable[Any],
    offset_distance: float = 0, numericalize: bool = False, sim_folder: Any = None, use_radiance_mesh: Any = False,
) -> NDArray[Any]:  # fmt: skip
    """Find which vectors are visible from which points, as ``ladybug_radiance.intersection.intersection_matrix`` does.

    Parameters
    ----------
    vectors : sequence of Vector3D, or (k, 3) float
        Directions from the points, such as towards suns or sky patches, of any length.
    points : sequence of Point3D, or (n, 3) float
        The sensors. z is up.
    normals : sequence of Vector3D, or (n, 3) float
        Of the surface at each point, of any length.
    context_geometry : iterable of Face3D and Mesh3D
        Blocks the view. Holes of faces are open.
    offset_distance : float
        First moves the points along their normals.
    numericalize : bool
        True: cosines in place of booleans.
    sim_folder, use_radiance_mesh
        Accepted, and not used: there are no files.

    Returns
    -------
    (n, k) bool, or float64 if `numericalize`
        Whether each vector is seen: it is above the surface at the point, and no geometry is in the way. As numbers:
        the cosine of the angle between vector and normal where it is seen, else 0.

    Raises
    ------
    InputError
        If an argument is invalid, or geometry is neither faces nor meshes.
    """
    towards = unit_vectors(_rows(vectors, "vectors"), "vector")
    places, facing = _rows(points, "points"), _rows(normals, "normals")
    if len(places) != len(facing):
        raise InputError(
            f"{counted(len(places), 'point')} and {counted(len(facing), 'normal')}; give a normal for each point"
        )
    facing = unit_vectors(facing, "the normal of point")
    places = places + number(offset_distance, "offset_distance") * facing
    cosines = flag(numericalize, "numericalize")
    seen = _seen(Scene.from_arrays(_soup(context_geometry), name="context", up="z"), places, facing, towards)
    return np.where(seen, np.maximum(facing @ towards.T, 0.0), 0.0) if cosines else seen


def sky_intersection_matrix(
    sky_matrix: Any, points: VectorsLike, normals: VectorsLike, context_geometry: Iterable[Any],
    offset_distance: float = 0, numericalize: bool = False, sim_folder: Any = None, use_radiance_mesh: Any = False,
) -> NDArray[Any]:  # fmt: skip
    """Find which sky patches are visible, as ``ladybug_radiance.intersection.sky_intersection_matrix`` does.

    Parameters
    ----------
    sky_matrix : ladybug_radiance.skymatrix.SkyMatrix
        Its `north` and `high_density` are used.
    points, normals, context_geometry, offset_distance, numericalize, sim_folder, use_radiance_mesh
        As for `intersection_matrix`.

    Returns
    -------
    (n, 2 k) bool, or float64 if `numericalize`
        For k patches of the sky, then for their opposites on the ground.

    Raises
    ------
    InputError
        As for `intersection_matrix`, and if ladybug is not installed.
    """
    try:
        view_sphere = import_module("ladybug.viewsphere").view_sphere
    except ImportError:
        raise InputError("a sky matrix needs ladybug: pip install ladybug-core") from None
    vectors = view_sphere.reinhart_dome_vectors if sky_matrix.high_density else view_sphere.tregenza_dome_vectors
    if sky_matrix.north != 0:
        vectors = [each.rotate_xy(math.radians(sky_matrix.north)) for each in vectors]
    towards = _rows(vectors, "vectors")
    towards = np.concatenate([towards, -towards])
    return intersection_matrix(towards, points, normals, context_geometry, offset_distance, numericalize)


def _seen(
    scene: Scene, places: NDArray[np.float64], facing: NDArray[np.float64], towards: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """(n, k) bool: which directions are seen from points. Neighbouring points and directions are traced together."""
    seen = np.zeros((len(places), len(towards)), bool)
    if not seen.size:
        return seen
    rows, columns = sensor_order(places, facing), direction_order(towards)
    receivers = Receivers.on_surface(places[rows], facing[rows], scene.origin, scene.middle)
    for first in range(0, len(columns), MAX_SPP):
        batch = columns[first : first + MAX_SPP]
        found = scene.engine.visibility(receivers, DirectionalLights(-towards[batch]))
        seen[np.ix_(rows, batch)] = ~unpack_bits(found.bits[:, 0], len(batch))
    return seen


def _rows(values: VectorsLike, what: str) -> NDArray[np.float64]:
    """(n, 3) float64, from an array or from vectors of ladybug_geometry."""
    if isinstance(values, np.ndarray):
        return checked_points(values, what)
    try:
        rows = [tuple(each) for each in values]
    except TypeError:
        raise InputError(f"{what} are {quoted(values)}; give Vector3D or Point3D, or an array (n, 3)") from None
    return checked_points(np.array(rows) if rows else np.empty((0, 3)), what)


# --- Triangles of faces and meshes ------------------------------------------------------------------------------------


def _soup(geometry: Iterable[Any]) -> NDArray[np.float64]:
    """(n, 3, 3) float64: the triangles of faces and meshes. A triangle without area, if there are none."""
    try:
        parts = [_triangles(each) for each in geometry]
    except TypeError:
        raise InputError(f"context_geometry is {quoted(geometry)}; give a list of Face3D and Mesh3D") from None
    soup = np.concatenate([np.empty((0, 3, 3)), *parts])
    return soup if len(soup) else np.zeros((1, 3, 3))


def _triangles(geometry: Any) -> NDArray[np.float64]:
    """(n, 3, 3) float64: the triangles of a Face3D or Mesh3D."""
    if hasattr(geometry, "triangulated_mesh3d"):  # a Face3D
        if not geometry.has_holes and len(geometry.vertices) == _TRIANGLE:
            return np.array([[tuple(each) for each in geometry.vertices]], np.float64)
        geometry = geometry.triangulated_mesh3d
    if not hasattr(geometry, "vertices") or not hasattr(geometry, "faces"):
        raise InputError(f"context_geometry holds a {type(geometry).__name__}; {_CURE}")
    vertices = np.array([tuple(each) for each in geometry.vertices], np.float64).reshape(-1, 3)
    faces = [tuple(each) for each in geometry.faces]
    triangles = np.array([each for each in faces if len(each) == _TRIANGLE], np.int64).reshape(-1, _TRIANGLE)
    quads = np.array([each for each in faces if len(each) == _QUAD], np.int64).reshape(-1, _QUAD)
    if len(triangles) + len(quads) != len(faces):
        raise InputError(f"context_geometry holds a {type(geometry).__name__} of polygons; {_CURE}")
    return np.concatenate([vertices[triangles], _halves(vertices[quads])])


def _halves(quads: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2 n, 3, 3): the triangles of (n, 4, 3) quads, which may be concave: the diagonal lies inside."""
    a, b, c, d = quads.transpose(1, 0, 2)
    outside = (np.cross(b - a, c - a) * np.cross(c - a, d - a)).sum(1) < 0.0  # a diagonal from a lies outside
    turned = np.where(outside[:, None, None], np.roll(quads, -1, 1), quads)
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])
