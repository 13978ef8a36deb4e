"""Open3D: `RaycastingScene`, with the calls and results of ``open3d.t.geometry.RaycastingScene``.

    scene = antumbra.integrations.open3d.RaycastingScene()
    scene.add_triangles(mesh)
    t_hit = scene.cast_rays(rays)["t_hit"]

Keys, shapes, dtypes and miss values are Open3D's. Arguments may be tensors in host memory or arrays. Results are
tensors, which share their memory with arrays, once the program has imported Open3D; otherwise they are NumPy arrays.
"""

import sys
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, number, rows_of, vector, whole_number
from ..base.errors import InputError
from ..engine.scene import Scene
from ..formats.library_meshes import KNOWN, is_mesh, meshes_of
from ..kernels.elementary import tan
from ..scene.mesh import Mesh, StaticMeshes, make_mesh, n_faces
from ..scene.scene_data import MemoryData
from ..scene.triangle_setup import face_rows
from ..scene.triangles import AllHits, ClosestPoints

_T = TypeVar("_T")


class RaycastingScene:
    """A scene of triangle meshes for queries by rays, which are exact, and by points.

    A hit lies strictly between the ends of its ray, so a face through the origin is none. Rays that are NaN or
    infinite, or have no direction, hit nothing. In all methods, `nthreads` 0 means all cores. An argument of a wrong
    shape or type raises an `InputError`.

    nthreads, device : ignored, since the first query builds the tree on all cores of the CPU

    Examples
    --------
    >>> from antumbra.integrations.open3d import RaycastingScene
    >>> scene = RaycastingScene()
    >>> roof = scene.add_triangles([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
    >>> scene.cast_rays([[1, 1, 0, 0, 0, 1], [3, 3, 0, 0, 0, 1]])["t_hit"]
    array([ 1., inf], dtype=float32)
    """

    INVALID_ID: ClassVar[int] = 0xFFFFFFFF
    """The geometry and primitive of a ray that hits nothing."""

    def __init__(self, nthreads: int = 0, device: object = None):
        _threads(nthreads)
        self._meshes: list[Mesh] = []
        self._counts: list[int] = []  # triangles of each geometry
        self._scene: Scene | None = None

    def add_triangles(self, vertex_positions: Any = None, triangle_indices: Any = None, *, mesh: Any = None) -> int:
        """Add a mesh, and return its geometry id: the number of meshes added before.

        Parameters
        ----------
        vertex_positions, triangle_indices : (n, 3) float, and (m, 3) int
        mesh : a mesh of Open3D, of either kind, or of trimesh, PyVista or meshio
            Instead of the others, also as the only argument without a name.
        """
        mesh = vertex_positions if mesh is None and triangle_indices is None else mesh
        if hasattr(getattr(mesh, "vertex", None), "positions"):  # a tensor mesh of Open3D
            vertex_positions, triangle_indices, mesh = mesh.vertex.positions, mesh.triangle.indices, None
        if mesh is None:
            vertices = rows_of(vertex_positions, "vertex_positions", 3, 2)
            parts = [make_mesh("mesh", vertices, as_array(triangle_indices, "triangle_indices"), None, "the mesh")]
        elif is_mesh(mesh):
            parts = meshes_of(mesh, type(mesh).__name__)[0]
        else:
            raise InputError(f"add_triangles got a {type(mesh).__name__}; give {KNOWN}, or vertices and triangles")
        self._meshes += parts
        self._counts.append(sum(n_faces(part.positions, part.faces) for part in parts))
        self._scene = None
        return len(self._counts) - 1

    # --- Rays ---------------------------------------------------------------------------------------------------------

    def cast_rays(self, rays: ArrayLike, nthreads: int = 0) -> dict[str, Any]:
        """The first hit of each of the rays, (..., 6) float: origins, and directions of any length.

        The result has t_hit (...) float32, in lengths of the direction, inf on a miss; geometry_ids and primitive_ids
        (...) uint32, `INVALID_ID` on a miss; primitive_uvs (..., 2) float32, weights of the second and third corner;
        primitive_normals (..., 3) float32, unit vectors by the winding order. The last two are 0 on a miss.
        """
        scene, threads = self._committed(), _threads(nthreads)
        hit = self._of_rays(lambda valid: scene.closest_hit(valid, threads=threads), rays)
        t = hit.t.astype(np.float32)
        surfaces = self._surfaces(hit.face, hit.u, hit.v, threads)
        return _results(t_hit=np.fmin(t, np.inf, out=t), **surfaces)  # not NaN

    def test_occlusions(self, rays: ArrayLike, tnear: float = 0.0, tfar: float = np.inf, nthreads: int = 0) -> Any:
        """(...) bool: whether each of the rays, (..., 6) float, hits anything between tnear and tfar.

        They may be negative, for hits behind the origin.
        """
        near, far, threads = float(tnear), float(tfar), _threads(nthreads)
        return _result(self._of_rays(lambda valid: self._occluded(valid, near, far, threads), rays))

    def _occluded(self, rays: NDArray[Any], near: float, far: float, threads: int | None) -> NDArray[np.bool_]:
        scene = self._committed()
        if not near < far:  # or one of them is NaN
            return np.zeros(rays.shape[:-1], np.bool_)
        if near >= 0.0:
            return scene.occluded(rays, None, near, far, threads=threads)
        blocked = self._occluded(rays * (1, 1, 1, -1, -1, -1), max(-far, 0.0), -near, threads)
        if far > 0.0:
            here = scene.closest_points(rays[..., :3], threads=threads).distance == 0.0
            blocked = blocked | here | self._occluded(rays, 0.0, far, threads)
        return blocked

    def count_intersections(self, rays: ArrayLike, nthreads: int = 0) -> Any:
        """(...) int32: how many hits `list_intersections` has for each of the rays, (..., 6) float."""
        scene, threads, rays = self._committed(), _threads(nthreads), _rows(rays, "rays", 6)
        flat, apart = rays.reshape(-1, 6), len(self._counts) > 1
        counts = self._of_rays(lambda valid: scene.engine._count_points(valid, apart, threads), flat)
        if len(unclear := np.flatnonzero(counts < 0)):
            hits, distinct = self._hits(flat[unclear], nthreads)
            ray = hits.ray if distinct is None else hits.ray[distinct]
            counts[unclear] = np.bincount(ray, minlength=len(unclear))
        return _result(counts.astype(np.int32).reshape(rays.shape[:-1]))

    def list_intersections(self, rays: ArrayLike, nthreads: int = 0) -> dict[str, Any]:
        """All hits of each ray, nearest first. Several triangles of a geometry that are hit at one point are one hit.

        The first hit of a ray is that of `cast_rays`.
        The result has ray_splits (n + 1,) uint32: ray i, in C order, has hits ray_splits[i] to ray_splits[i + 1],
        exclusive. For each of h hits, it has ray_ids, geometry_ids and primitive_ids (h,) uint32, t_hit (h,) float32,
        and primitive_uvs (h, 2) float32, as from `cast_rays`.
        """
        hits, distinct = self._hits(_rows(rays, "rays", 6), nthreads)
        ray, splits = hits.ray, hits.ray_offsets
        if distinct is not None:
            ray = ray[distinct]
            splits = np.append(0, np.cumsum(np.bincount(ray, minlength=len(splits) - 1)))
            hits = hits._replace(t=hits.t[distinct], face=hits.face[distinct], u=hits.u[distinct], v=hits.v[distinct])
        return _results(
            ray_splits=splits.astype(np.uint32),
            ray_ids=ray.astype(np.uint32),
            t_hit=hits.t.astype(np.float32),
            **self._ids(hits.face),
            primitive_uvs=_pairs(hits.u, hits.v),
        )

    def _hits(self, rays: NDArray[Any], nthreads: int) -> tuple[AllHits, NDArray[np.int64] | None]:
        """All hits of rays; and the indices of the first hit of each geometry at each point, None if they are all."""
        scene, threads = self._committed(), _threads(nthreads)
        flat = rays.reshape(-1, 6)
        hits = self._of_rays(lambda valid: scene.all_hits(valid, threads=threads), flat)
        again = hits.t[1:] == hits.t[:-1]  # hits at one point have the same t
        if not again.any():
            return hits, None
        ray = hits.ray
        again &= ray[1:] == ray[:-1]
        if len(self._counts) == 1:
            return hits, np.flatnonzero(np.append(True, ~again))
        points, geometry = np.append(0, np.cumsum(~again)), self._ids(hits.face)["geometry_ids"]
        keys = points * (np.int64(len(self._counts)) + 1) + geometry
        return hits, np.sort(np.unique(keys, return_index=True)[1])

    def _of_rays(self, query: Callable[[NDArray[Any]], _T], rays: ArrayLike) -> _T:
        """The result of a query for rays. Those that are not valid are replaced by one that misses the scene."""
        array = _rows(rays, "rays", 6)
        try:
            return query(array)
        except InputError:
            with np.errstate(over="ignore"):
                narrow = array.astype(np.float32)
            valid = np.asarray(np.isfinite(narrow).all(-1) & narrow[..., 3:].any(-1))
            if valid.all():
                raise
            lower, upper = self._committed().bounds
            beyond = upper + (upper - lower) + np.abs(upper)
            return query(np.where(valid[..., None], array, [*beyond, 1.0, 0.0, 0.0]))

    # --- Points -------------------------------------------------------------------------------------------------------

    def compute_closest_points(self, query_points: ArrayLike, nthreads: int = 0) -> dict[str, Any]:
        """The closest point of the meshes to each of the points, (..., 3) float.

        The result has points (..., 3) float32, and geometry_ids, primitive_ids, primitive_uvs and primitive_normals as
        from `cast_rays`. For points that are NaN or infinite, they are NaN, `INVALID_ID` and 0.
        """
        found = self._closest(_rows(query_points, "query_points", 3), nthreads)
        surfaces = self._surfaces(found.face, found.u, found.v, _threads(nthreads))
        return _results(points=found.position.astype(np.float32), **surfaces)

    def compute_distance(self, query_points: ArrayLike, nthreads: int = 0) -> Any:
        """(...) float32: the distance of each of the points, (..., 3) float, from the closest mesh."""
        found = self._closest(_rows(query_points, "query_points", 3), nthreads)
        return _result(found.distance.astype(np.float32))

    def compute_signed_distance(self, query_points: ArrayLike, nthreads: int = 0, nsamples: int = 1) -> Any:
        """(...) float32: `compute_distance`, negative for the points that `compute_occupancy` finds inside."""
        points = _rows(query_points, "query_points", 3)
        distance = self._closest(points, nthreads).distance
        inside = self._inside(points, nthreads, nsamples) & (distance > 0.0)
        return _result(np.where(inside, -distance, distance).astype(np.float32))

    def compute_occupancy(self, query_points: ArrayLike, nthreads: int = 0, nsamples: int = 1) -> Any:
        """(...) float32: 1 for points, (..., 3) float, inside the meshes, which must be closed; else 0.

        `nsamples` must be odd, as for Open3D, and changes nothing, since the first result is exact.
        """
        points = _rows(query_points, "query_points", 3)
        return _result(self._inside(points, nthreads, nsamples).astype(np.float32))

    def _closest(self, points: NDArray[Any], nthreads: int) -> ClosestPoints:
        """The closest points; for points that are NaN or infinite, these numbers, and face -1."""
        scene, threads = self._committed(), _threads(nthreads)
        found, valid = _of_points(lambda points: scene.closest_points(points, threads=threads), points)
        lost = np.isnan(found.distance) if valid is None else ~valid
        if lost.any():
            found.distance[lost] = np.abs(points[lost]).sum(-1)
            found.face[lost], found.u[lost], found.v[lost], found.position[lost] = -1, 0.0, 0.0, np.nan
        return found

    def _inside(self, points: NDArray[Any], nthreads: int, nsamples: int) -> NDArray[np.bool_]:
        if nsamples != 1 and whole_number(nsamples, "nsamples", 1, 1 << 31) % 2 == 0:
            raise InputError(f"nsamples is {nsamples}; it must be odd")
        scene, threads = self._committed(), _threads(nthreads)
        inside, valid = _of_points(lambda points: scene.contains(points, threads=threads), points)
        return inside if valid is None else inside & valid

    # --- Cameras ------------------------------------------------------------------------------------------------------

    @staticmethod
    def create_rays_pinhole(*arguments: Any, **named: Any) -> Any:
        """(height_px, width_px, 6) float32: rays through the centres of a pinhole camera's pixels.

        The arguments are ``(fov_deg, center, eye, up, width_px, height_px)``, with the horizontal field of view, 0 for
        rays that are all the same, or ``(intrinsic_matrix, extrinsic_matrix, width_px, height_px)``, with (3, 3) and
        (4, 4) matrices. Without a direction from eye to center, or one to the right, all rays are NaN.
        """
        rays = _rays_of_matrices if len(arguments) + len(named) == 4 else _rays_of_view
        return _result(rays(*arguments, **named))

    # --- Faces --------------------------------------------------------------------------------------------------------

    def _committed(self) -> Scene:
        """The scene of all meshes so far."""
        if self._scene is None:
            meshes = self._meshes or [make_mesh("none", np.zeros((3, 3)), np.arange(3)[None], None, "none")]
            self._scene = Scene.of_data(MemoryData(StaticMeshes(meshes, "RaycastingScene"), name="RaycastingScene"))
            self._faces: _Faces | None = None
        return self._scene

    def _ids(self, face: NDArray[np.int32]) -> dict[str, NDArray[np.uint32]]:
        """The ids of faces, (...) int32; `INVALID_ID` for -1."""
        if len(self._counts) <= 1:
            return {"geometry_ids": np.minimum(face, 0).view(np.uint32), "primitive_ids": face.view(np.uint32)}
        faces = self._table()
        return {"geometry_ids": _rows_at(faces.geometry, face), "primitive_ids": _rows_at(faces.primitive, face)}

    def _surfaces(
        self, face: NDArray[np.int32], u: NDArray[np.float32], v: NDArray[np.float32], threads: int | None
    ) -> dict[str, NDArray[Any]]:
        """What queries return for faces, (...) int32, -1: none, and the weights of their corners."""
        normals = face_rows(self._table().normals, np.ascontiguousarray(face.reshape(-1)), threads)
        return self._ids(face) | {"primitive_uvs": _pairs(u, v), "primitive_normals": normals.reshape(*face.shape, 3)}

    def _table(self) -> "_Faces":
        if self._faces is None:
            self._faces = _faces_of(self._committed(), self._counts)
        return self._faces


class _Faces(NamedTuple):
    """What queries return for a face."""

    geometry: NDArray[np.uint32]  # (f + 1,), the last one, at index -1, for a miss
    primitive: NDArray[np.uint32]  # (f + 1,), likewise
    normals: NDArray[np.float32]  # (f + 1, 3) unit, 0 for faces without area; the first one for a miss


def _faces_of(scene: Scene, counts: list[int]) -> _Faces:
    a, b, c = scene.triangles().vertices.astype(np.float64).swapaxes(0, 1)
    normals = np.append(np.zeros((1, 3)), np.cross(b - a, c - a), axis=0)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = normals / np.where(lengths > 0.0, lengths, 1.0)
    counts = counts or [scene.n_triangles]
    numbers = [np.repeat(np.arange(len(counts)), counts), np.concatenate([np.arange(n) for n in counts])]
    geometry, primitive = (np.append(each, RaycastingScene.INVALID_ID).astype(np.uint32) for each in numbers)
    return _Faces(geometry, primitive, unit.astype(np.float32))


# --- Arguments and results --------------------------------------------------------------------------------------------


def _result(array: NDArray[Any]) -> Any:
    """An array as a result: a tensor that shares its memory, if the program uses Open3D."""
    library = sys.modules.get("open3d")
    return array if library is None else library.core.Tensor.from_numpy(array)


def _results(**arrays: NDArray[Any]) -> dict[str, Any]:
    library = sys.modules.get("open3d")
    if library is None:
        return arrays
    tensor = library.core.Tensor.from_numpy
    return {name: tensor(array) for name, array in arrays.items()}


def _rows_at(table: NDArray[Any], index: NDArray[np.int32]) -> NDArray[Any]:
    """``table[index]`` for indices from -1 on, in 0.6 of its time."""
    return table.take(index, axis=0, mode="wrap")


def _pairs(u: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
    uv = np.empty((*u.shape, 2), np.float32)
    uv[..., 0], uv[..., 1] = u, v
    return uv


def _rows(value: Any, what: str, length: int) -> NDArray[Any]:
    """`rows_of`, faster for tensors and arrays that are right."""
    library = sys.modules.get("open3d")
    array = value.numpy() if library is not None and type(value) is library.core.Tensor else value
    if type(array) is np.ndarray and array.dtype.char in "fd" and array.shape[-1:] == (length,):
        return array
    return rows_of(value, what, length)


def _of_points(query: Callable[[NDArray[Any]], _T], points: NDArray[Any]) -> tuple[_T, NDArray[np.bool_] | None]:
    """(the result of a query for points, which of them are valid; None: all). It is meaningless for the others."""
    try:
        return query(points), None
    except InputError:
        with np.errstate(over="ignore"):
            valid = np.asarray(np.isfinite(points.astype(np.float32)).all(-1))
        if valid.all():
            raise
        return query(np.where(valid[..., None], points, 0.0)), valid


def _threads(nthreads: int) -> int | None:
    if type(nthreads) is int and nthreads <= 0:
        return None
    return whole_number(nthreads, "nthreads", 0, 1 << 16) or None


# --- Cameras ----------------------------------------------------------------------------------------------------------


def _rays_of_view(
    fov_deg: float, center: ArrayLike, eye: ArrayLike, up: ArrayLike, width_px: int, height_px: int
) -> NDArray[np.float32]:
    position, size = vector(eye, "eye"), (width_px, height_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = _unit(vector(center, "center") - position)
        right = _unit(np.cross(vector(up, "up"), ahead))
    pixel = 2.0 * tan(np.radians(number(fov_deg, "fov_deg")) / 2.0) / max(width_px, 1)  # of an image at distance 1
    inverse = np.array([[pixel, 0, -pixel * width_px / 2], [0, pixel, -pixel * height_px / 2], [0, 0, 1]])
    return _rays_through_pixels(position, np.stack([right, np.cross(ahead, right), ahead], axis=1) @ inverse, *size)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / np.linalg.norm(vector)


def _rays_of_matrices(
    intrinsic_matrix: ArrayLike, extrinsic_matrix: ArrayLike, width_px: int, height_px: int
) -> NDArray[np.float32]:
    intrinsic = as_array(intrinsic_matrix, "intrinsic_matrix")
    extrinsic = as_array(extrinsic_matrix, "extrinsic_matrix")
    if intrinsic.shape != (3, 3) or extrinsic.shape != (4, 4):
        raise InputError(f"the matrices must be (3, 3) and (4, 4), not {intrinsic.shape} and {extrinsic.shape}")
    turn, shift = extrinsic[:3, :3].T, extrinsic[:3, 3]
    return _rays_through_pixels(-turn @ shift, turn @ np.linalg.inv(intrinsic), width_px, height_px)


def _rays_through_pixels(
    position: NDArray[np.float64], directions: NDArray[np.float64], width_px: int, height_px: int
) -> NDArray[np.float32]:
    """Rays from a position; `directions`: (3, 3), from pixels (column, row, 1) to directions."""
    width, height = (whole_number(each, "pixels", 0, 1 << 16) for each in (width_px, height_px))
    rows, columns = np.indices((height, width))
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones((height, width))], axis=-1)
    ahead = pixels @ directions.T
    return np.concatenate([np.broadcast_to(position, ahead.shape), ahead], axis=-1).astype(np.float32)
