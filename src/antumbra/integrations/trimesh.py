"""trimesh: `trimesh_ray`, a ray intersector for ``mesh.ray`` with the calls and results of trimesh's own ones.

trimesh has two intersectors, `ray_triangle` and `ray_pyembree`. Where their conventions differ, this one follows
`ray_pyembree`, which trimesh prefers: the dtypes of indices, locations (h, 3) even without hits, all first hits before
all second hits, and one face for each location, also where a ray meets an edge or a vertex.
"""

from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import flag, rows_of, whole_number
from ..base.errors import InputError
from ..engine.scene import Scene

_STEEP = 1e-5  # least sine of the angle between ray and plane for which trimesh's planes give precise locations


def trimesh_ray(mesh: Any) -> "RayMeshIntersector":
    """An exact ray intersector for a trimesh mesh, in place of its own one.

    ``mesh.ray = at.trimesh_ray(mesh)``. From then on, ``mesh.contains``, ``trimesh.proximity.signed_distance`` and all
    other functions that use ``mesh.ray`` are answered exactly too. A changed mesh is read again at the next query.

    Parameters
    ----------
    mesh : trimesh.Trimesh

    Returns
    -------
    RayMeshIntersector
        With the methods, shapes, dtypes, order and miss values of ``trimesh.ray.ray_pyembree.RayMeshIntersector``.

    Raises
    ------
    InputError
        If `mesh` is not a trimesh mesh.
    """
    return RayMeshIntersector(mesh)


class _RayRows(NamedTuple):
    """Checked rays. trimesh's intersectors let rays without a direction miss; here, their interval is empty."""

    origins: np.ndarray  # (n, 3) float
    directions: np.ndarray  # (n, 3) float, none zero
    tmax: Any  # inf, or (n,) float64: 0 for rays without a direction


class _Hits(NamedTuple):
    """Hits of rays."""

    ray: NDArray[np.int64]  # (h,) index of the ray
    face: NDArray[np.int64]  # (h,)
    t: NDArray[np.float64]  # (h,) in lengths of the direction

    def take(self, index: NDArray[np.int64]) -> "_Hits":
        return _Hits(self.ray[index], self.face[index], self.t[index])


class RayMeshIntersector:
    """Ray queries about a trimesh mesh; `trimesh_ray` makes one.

    mesh : trimesh.Trimesh
    """

    def __init__(self, mesh: Any):
        if not all(hasattr(type(mesh), name) for name in ("vertices", "faces", "face_normals")):
            raise InputError(f"the mesh is a {type(mesh).__name__}; give a trimesh.Trimesh")
        self.mesh, self._scene, self._version = mesh, cast("Scene | None", None), 0

    def __getstate__(self) -> dict[str, Any]:
        return {"mesh": self.mesh}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    @property
    def scene(self) -> Scene:
        """The triangles of the mesh, z up. A new scene once vertices or faces have changed."""
        version = hash(self.mesh)  # trimesh hashes its arrays again only after writes
        if self._scene is None or version != self._version:
            vertices, faces = np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces)
            if not len(faces):  # a face without area blocks nothing
                vertices, faces = np.zeros((3, 3)), np.arange(3)[None]
            self._scene, self._version = Scene.from_arrays(vertices, faces, name="trimesh", up="z"), version
        return self._scene

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.bool_]:
        """(n,) bool: whether each ray hits the mesh.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions need not be unit vectors. Rays with a zero direction miss. A face through the origin is no hit.
        """
        rays = _checked(ray_origins, ray_directions)
        return self.scene.occluded(rays.origins, rays.directions, tmax=rays.tmax)

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.int32]:
        """(n,) int32: the first face that each ray hits, as `Scene.closest_hit` orders them; -1: none."""
        rays = _checked(ray_origins, ray_directions)
        return self.scene.closest_hit(rays.origins, rays.directions, tmax=rays.tmax).face

    def intersects_id(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = None,
        return_locations: bool = False,
    ) -> Any:
        """The faces that rays hit: at each location, the first one as `Scene.closest_hit` orders them.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
        multiple_hits : bool
            False: only the first hit of each ray.
        max_hits : int, optional
            At most this many hits of each ray, the nearest. None: all.
        return_locations : bool
            Also return locations.

        Returns
        -------
        index_tri, index_ray : (h,) int64
            All first hits in the order of their rays, then all second hits, and so on.
        locations : (h, 3) float64
            In the planes of the mesh's float64 faces. Only with `return_locations`.
        """
        rays = _checked(ray_origins, ray_directions)
        limit = None if max_hits is None else whole_number(max_hits, "max_hits", 1, 1 << 31)
        several = flag(multiple_hits, "multiple_hits")
        hits = self._all_hits(rays, limit) if several else self._first_hits(rays)
        if not flag(return_locations, "return_locations"):
            return hits.face, hits.ray
        return hits.face, hits.ray, self._locations(rays, hits)

    def intersects_location(
        self,
        ray_origins: ArrayLike,
        ray_directions: ArrayLike,
        multiple_hits: bool = True,
        max_hits: int | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """(locations, index_ray, index_tri): the unique locations where rays hit the mesh, as from `intersects_id`."""
        face, ray, locations = self.intersects_id(ray_origins, ray_directions, multiple_hits, max_hits, True)
        return locations, ray, face

    def contains_points(self, points: ArrayLike) -> NDArray[np.bool_]:
        """(n,) bool: whether the mesh contains each of the points, (n, 3) float. Points on the surface are inside."""
        return self.scene.contains(rows_of(points, "points", 3, 2))

    def _first_hits(self, rays: _RayRows) -> _Hits:
        hit = self.scene.closest_hit(rays.origins, rays.directions, tmax=rays.tmax)
        ray = np.flatnonzero(hit.mask)
        return _Hits(ray, hit.face[ray].astype(np.int64), hit.t[ray])

    def _all_hits(self, rays: _RayRows, limit: int | None) -> _Hits:
        found = self.scene.all_hits(rays.origins, rays.directions, tmax=rays.tmax)
        hits = _Hits(found.ray, found.face.astype(np.int64), found.t)
        new = np.ones(
            len(hits.t), bool
        )  # hits at one location have the same t, and the first one is that of `closest_hit`
        new[1:] = (hits.ray[1:] != hits.ray[:-1]) | (hits.t[1:] != hits.t[:-1])
        if not new.all():
            hits = hits.take(np.flatnonzero(new))
        counts = np.bincount(hits.ray, minlength=len(rays.origins))
        depth = np.arange(len(hits.ray)) - (np.cumsum(counts) - counts)[hits.ray]
        deepest = int(counts.max(initial=0))
        order = np.argsort(depth.astype(np.uint16 if deepest < 1 << 16 else np.int64), kind="stable")  # radix sort
        if limit is not None and limit < deepest:
            order = order[depth[order] < limit]
        return hits.take(order)

    def _locations(self, rays: _RayRows, hits: _Hits) -> NDArray[np.float64]:
        """(h, 3) float64: where rays meet the planes of the mesh's own faces, as trimesh computes it.

        The scene has float32 vertices, so its t gives these only to float32 precision. It stands in for rays almost in
        the plane, which trimesh drops.
        """
        mesh, origins, directions = self.mesh, rays.origins[hits.ray], rays.directions[hits.ray]
        normals, corners = mesh.face_normals[hits.face], mesh.vertices[mesh.faces[hits.face, 0]]
        slope = np.einsum("ij,ij->i", directions, normals)
        steep = np.abs(slope) > _STEEP * np.linalg.norm(directions, axis=1)
        height = np.einsum("ij,ij->i", corners - origins, normals)
        t = np.divide(height, slope, out=hits.t.copy(), where=steep)
        return np.asarray(origins + t[:, None] * directions)


def _checked(ray_origins: ArrayLike, ray_directions: ArrayLike) -> _RayRows:
    origins = rows_of(ray_origins, "ray_origins", 3, 2)
    directions = rows_of(ray_directions, "ray_directions", 3, 2)
    if origins.shape != directions.shape:
        raise InputError(f"{len(origins)} ray_origins and {len(directions)} ray_directions; give one of each per ray")
    zero = (directions == 0.0).all(axis=1)
    if not zero.any():
        return _RayRows(origins, directions, np.inf)
    return _RayRows(origins, np.where(zero[:, None], 1.0, directions), np.where(zero, 0.0, np.inf))
