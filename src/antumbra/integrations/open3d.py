"""Open3D: `RaycastingScene`, with the calls and results of ``open3d.t.geometry.RaycastingScene``, as NumPy arrays.

    scene = antumbra.integrations.open3d.RaycastingScene()
    scene.add_triangles(mesh)
    t_hit = scene.cast_rays(rays)["t_hit"]

Keys, shapes, dtypes and miss values are Open3D's. Results are arrays; arguments may be tensors in host memory too.
"""

from typing import Any, ClassVar, NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, number, rows_of, unit_vectors, vector, whole_number
from ..base.errors import InputError
from ..engine.scene import Scene
from ..formats.library_meshes import KNOWN, is_mesh, meshes_of
from ..kernels.elementary import tan
from ..scene.mesh import Mesh, StaticMeshes, make_mesh, n_faces
from ..scene.scene_data import MemoryData


class _Faces(NamedTuple):
    """What queries return for the face that was hit; the last elements, at index -1, are those of a miss."""

    geometry: NDArray[np.uint32]  # (f + 1,)
    primitive: NDArray[np.uint32]  # (f + 1,)
    normals: NDArray[np.float32]  # (f + 1, 3) unit, 0 for faces without area


class RaycastingScene:
    """A scene of triangle meshes for ray queries, which are exact.

    A hit lies strictly between the ends of its ray, so a face through the origin is none. In all methods, `nthreads` 0
    means all cores. Wrong values raise an `InputError`, as do queries of distances, which rays do not answer.

    nthreads, device : ignored, since the first query builds the tree on all cores of the CPU
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

    def cast_rays(self, rays: ArrayLike, nthreads: int = 0) -> dict[str, NDArray[Any]]:
        """The first hit of each of the rays, (..., 6) float: origins, and directions of any length.

        The result has t_hit (...) float32, in lengths of the direction, inf on a miss; geometry_ids and primitive_ids
        (...) uint32, `INVALID_ID` on a miss; primitive_uvs (..., 2) float32, weights of the second and third corner;
        primitive_normals (..., 3) float32, unit vectors by the winding order. The last two are 0 on a miss.
        """
        hit = self._committed().closest_hit(rows_of(rays, "rays", 6), threads=_threads(nthreads))
        return {
            "t_hit": hit.t.astype(np.float32),
            "geometry_ids": self._faces.geometry[hit.face],
            "primitive_ids": self._faces.primitive[hit.face],
            "primitive_uvs": np.stack([hit.u, hit.v], axis=-1),
            "primitive_normals": self._faces.normals[hit.face],
        }

    def test_occlusions(
        self, rays: ArrayLike, tnear: float = 0.0, tfar: float = np.inf, nthreads: int = 0
    ) -> NDArray[np.bool_]:
        """(...) bool: whether each of the rays, (..., 6) float, hits anything between tnear and tfar."""
        ends = number(tnear, "tnear", 0.0, ends="[)"), number(tfar, "tfar", ends="[]")
        return self._committed().occluded(rows_of(rays, "rays", 6), None, *ends, threads=_threads(nthreads))

    def count_intersections(self, rays: ArrayLike, nthreads: int = 0) -> NDArray[np.int32]:
        """(...) int32: how often each of the rays, (..., 6) float, crosses a surface.

        A crossing of a shared edge or vertex counts once. Where Open3D's counts depend on rounding, these are exact.
        """
        counts = self._committed().count_hits(rows_of(rays, "rays", 6), merge="surface", threads=_threads(nthreads))
        return counts.astype(np.int32)

    def list_intersections(self, rays: ArrayLike, nthreads: int = 0) -> dict[str, NDArray[Any]]:
        """All hits of each ray, nearest first. Several triangles of a geometry that are hit at one point are one hit.

        The first hit of a ray is that of `cast_rays`.
        The result has ray_splits (n + 1,) uint32: ray i, in C order, has hits ray_splits[i] to ray_splits[i + 1],
        exclusive. For each of h hits, it has ray_ids, geometry_ids and primitive_ids (h,) uint32, t_hit (h,) float32,
        and primitive_uvs (h, 2) float32, as from `cast_rays`.
        """
        flat = rows_of(rays, "rays", 6).reshape(-1, 6)
        hits = self._committed().all_hits(flat, threads=_threads(nthreads))
        ray, geometry = hits.ray, self._faces.geometry[hits.face]
        apart = np.ones(len(ray), bool)  # hits at one point have the same t
        apart[1:] = (ray[1:] != ray[:-1]) | (hits.t[1:] != hits.t[:-1])
        new = np.arange(len(ray))
        if not apart.all():
            keys = np.cumsum(apart) * (np.int64(geometry.max()) + 1) + geometry
            new = np.sort(np.unique(keys, return_index=True)[1])
        return {
            "ray_splits": np.append(0, np.cumsum(np.bincount(ray[new], minlength=len(flat)))).astype(np.uint32),
            "ray_ids": ray[new].astype(np.uint32),
            "t_hit": hits.t[new].astype(np.float32),
            "geometry_ids": geometry[new],
            "primitive_ids": self._faces.primitive[hits.face[new]],
            "primitive_uvs": np.stack([hits.u, hits.v], axis=-1)[new],
        }

    def compute_occupancy(self, query_points: ArrayLike, nthreads: int = 0, nsamples: int = 1) -> NDArray[np.float32]:
        """(...) float32: 1 for points, (..., 3) float, inside the meshes, which must be closed; else 0.

        `nsamples` must be odd, as for Open3D, and changes nothing, since the first result is exact.
        """
        if whole_number(nsamples, "nsamples", 1, 1 << 31) % 2 == 0:
            raise InputError(f"nsamples is {nsamples}; it must be odd")
        inside = self._committed().contains(rows_of(query_points, "query_points", 3), threads=_threads(nthreads))
        return inside.astype(np.float32)

    def compute_distance(self, *arguments: object, **named: object) -> NoReturn:
        """Refused, as are `compute_signed_distance` and `compute_closest_points`: rays do not measure distances."""
        refused = "compute_distance, compute_signed_distance and compute_closest_points"
        raise InputError(f"rays do not measure distances; use Open3D's own RaycastingScene for {refused}")

    compute_closest_points = compute_signed_distance = compute_distance

    @staticmethod
    def create_rays_pinhole(*arguments: Any, **named: Any) -> NDArray[np.float32]:
        """(height_px, width_px, 6) float32: rays through the centres of a pinhole camera's pixels.

        The arguments are ``(fov_deg, center, eye, up, width_px, height_px)``, with the horizontal field of view, or
        ``(intrinsic_matrix, extrinsic_matrix, width_px, height_px)``, with (3, 3) and (4, 4) matrices.
        """
        rays = _rays_of_matrices if len(arguments) + len(named) == 4 else _rays_of_view
        return rays(*arguments, **named)

    def _committed(self) -> Scene:
        """The scene of all meshes so far."""
        if self._scene is None:
            meshes = self._meshes or [make_mesh("none", np.zeros((3, 3)), np.arange(3)[None], None, "none")]
            self._scene = Scene.of_data(MemoryData(StaticMeshes(meshes, "RaycastingScene"), name="RaycastingScene"))
            self._faces = _faces_of(self._scene, self._counts)
        return self._scene


def _faces_of(scene: Scene, counts: list[int]) -> _Faces:
    a, b, c = scene.triangles().vertices.astype(np.float64).swapaxes(0, 1)
    normals = np.append(np.cross(b - a, c - a), np.zeros((1, 3)), axis=0)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = normals / np.where(lengths > 0.0, lengths, 1.0)
    counts = counts or [scene.n_triangles]
    numbers = [np.repeat(np.arange(len(counts)), counts), np.concatenate([np.arange(n) for n in counts])]
    geometry, primitive = (np.append(each, RaycastingScene.INVALID_ID).astype(np.uint32) for each in numbers)
    return _Faces(geometry, primitive, unit.astype(np.float32))


def _rays_of_view(
    fov_deg: float, center: ArrayLike, eye: ArrayLike, up: ArrayLike, width_px: int, height_px: int
) -> NDArray[np.float32]:
    focal_length = width_px / 2.0 / tan(np.radians(number(fov_deg, "fov_deg", 0.0, 180.0)) / 2.0)
    position = vector(eye, "eye")
    ahead = unit_vectors(vector(center, "center") - position, "the view from eye to center")
    right = unit_vectors(np.cross(vector(up, "up"), ahead), "up, seen from eye,")
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = right, np.cross(ahead, right), ahead
    extrinsic[:3, 3] = -extrinsic[:3, :3] @ position
    intrinsic = np.array([[focal_length, 0, width_px / 2], [0, focal_length, height_px / 2], [0, 0, 1]])
    return _rays_of_matrices(intrinsic, extrinsic, width_px, height_px)


def _rays_of_matrices(
    intrinsic_matrix: ArrayLike, extrinsic_matrix: ArrayLike, width_px: int, height_px: int
) -> NDArray[np.float32]:
    intrinsic = as_array(intrinsic_matrix, "intrinsic_matrix")
    extrinsic = as_array(extrinsic_matrix, "extrinsic_matrix")
    if intrinsic.shape != (3, 3) or extrinsic.shape != (4, 4):
        raise InputError(f"the matrices must be (3, 3) and (4, 4), not {intrinsic.shape} and {extrinsic.shape}")
    width, height = (whole_number(each, "pixels", 1, 1 << 16) for each in (width_px, height_px))
    turn, shift = extrinsic[:3, :3].T, extrinsic[:3, 3]
    rows, columns = np.indices((height, width))
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones((height, width))], axis=-1)
    directions = pixels @ (turn @ np.linalg.inv(intrinsic)).T
    return np.concatenate([np.broadcast_to(-turn @ shift, directions.shape), directions], axis=-1).astype(np.float32)


def _threads(nthreads: int) -> int | None:
    return whole_number(nthreads, "nthreads", 0, 1 << 16) or None
