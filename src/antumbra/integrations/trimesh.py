"""trimesh: rays for ``mesh.ray`` and distances for ``mesh.nearest``, with the calls and results of trimesh's own ones.

`trimesh_ray` and `trimesh_nearest` make them for a mesh, and `use_in_trimesh` those of all meshes that a program makes.

trimesh has two intersectors, `ray_triangle` and `ray_pyembree`. Where their conventions differ, this one follows
`ray_pyembree`, which trimesh prefers: the dtypes of indices, locations (h, 3) even without hits, all first hits before
all second hits, and one face for each location, also where a ray meets an edge or a vertex.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Self, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import rows_of, whole_number
from ..base.errors import InputError
from ..base.extras import import_extra
from ..engine.scene import Scene
from ..formats.library_meshes import MESH_UP
from ..scene.triangles import Hit

_T = TypeVar("_T")

_STEEP = 1e-5  # least sine of the angle between ray and plane for which trimesh's planes give precise locations


def trimesh_ray(mesh: Any) -> "RayMeshIntersector":
    """An exact ray intersector that replaces a trimesh mesh's own.

    ``mesh.ray = at.trimesh_ray(mesh)``. From then on, ``mesh.contains``, ``trimesh.proximity.signed_distance`` and all
    other functions that use ``mesh.ray`` are answered exactly too. A changed mesh is read again at the next query, and
    ``mesh.copy()`` keeps the intersector.

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

    Examples
    --------
    >>> import trimesh
    >>> mesh = trimesh.creation.box((2, 2, 2))
    >>> mesh.ray = at.trimesh_ray(mesh)
    >>> mesh.contains([[0, 0, 0], [0, 0, 3]])
    array([ True, False])
    """
    rays = RayMeshIntersector(mesh)
    _keep_in_copies(mesh)
    return rays


def trimesh_nearest(mesh: Any) -> "ProximityQuery":
    """Proximity queries that replace a trimesh mesh's own: ``mesh.nearest = at.trimesh_nearest(mesh)``.

    A changed mesh is read again at the next query, and ``mesh.copy()`` keeps the queries.

    Parameters
    ----------
    mesh : trimesh.Trimesh

    Returns
    -------
    ProximityQuery
        With the methods, shapes, dtypes and signs of ``trimesh.proximity.ProximityQuery``.

    Raises
    ------
    InputError
        If `mesh` is not a trimesh mesh.

    Examples
    --------
    >>> import trimesh
    >>> mesh = trimesh.creation.box((2, 2, 2))
    >>> mesh.nearest = at.trimesh_nearest(mesh)
    >>> mesh.nearest.signed_distance([[0, 0, 0.5], [0, 0, 3]])
    array([ 0.5, -2. ])
    """
    query = ProximityQuery(mesh)
    _keep_in_copies(mesh)
    return query


def use_in_trimesh() -> "TrimeshRays":
    """Answer the ray and proximity queries of all trimesh meshes made from now on, parts of meshes included.

    trimesh gives each new mesh an intersector and a proximity query. This function replaces the classes that trimesh
    chooses from with `RayMeshIntersector` and `ProximityQuery`. Existing meshes keep theirs.

    Returns
    -------
    TrimeshRays
        Its method `undo` restores trimesh's own classes. As a context manager, it does so at the end::

            with at.use_in_trimesh():
                parts = trimesh.load_mesh("machine.stl").split()

    Raises
    ------
    InputError
        If trimesh is not installed.
    """
    return TrimeshRays()


class TrimeshRays:
    """The queries of trimesh's new meshes, set by `use_in_trimesh` until `undo`."""

    def __init__(self) -> None:
        rays = import_extra("trimesh.ray", "use_in_trimesh", "meshes")
        modules = [rays.ray_triangle, *([rays.ray_pyembree] if rays.has_embree else [])]
        proximity = import_extra("trimesh.proximity", "use_in_trimesh", "meshes")
        ours = [(module, RayMeshIntersector) for module in modules] + [(proximity, ProximityQuery)]
        self._before = [(module, getattr(module, kind.__name__)) for module, kind in ours]
        for module, kind in ours:
            setattr(module, kind.__name__, kind)

    def undo(self) -> None:
        """Restore the classes that were there before. Meshes made in between keep their intersector."""
        for module, kind in self._before:
            setattr(module, kind.__name__, kind)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.undo()


def _keep_in_copies(mesh: Any) -> None:
    """Let ``mesh.copy()``, which makes a mesh with queries of its own, keep those of this library."""
    mesh.copy = partial(_copy, mesh)


def _copy(mesh: Any, *arguments: Any, **options: Any) -> Any:
    copied = type(mesh).copy(mesh, *arguments, **options)
    for name, kind in (("ray", RayMeshIntersector), ("nearest", ProximityQuery)):
        queries = getattr(mesh, name)
        if isinstance(queries, kind) and queries.mesh is mesh:
            setattr(copied, name, queries.copied_to(copied))
    _keep_in_copies(copied)
    return copied


# --- Rays -------------------------------------------------------------------------------------------------------------


class _RayRows(NamedTuple):
    """Rays with checked shapes. trimesh's intersectors let rays without a direction miss, see `_traced`."""

    origins: np.ndarray  # (n, 3) float
    directions: np.ndarray  # (n, 3) float
    tmax: Any  # inf, or (n,) float64: 0 for rays that miss everything


class _Hits(NamedTuple):
    """Hits of rays."""

    ray: NDArray[np.int64]  # (h,) index of the ray
    face: NDArray[np.int64]  # (h,)
    t: NDArray[np.float64]  # (h,) in lengths of the direction

    def take(self, index: NDArray[np.int64]) -> "_Hits":
        return _Hits(self.ray[index], self.face[index], self.t[index])


class RayMeshIntersector:
    """Ray queries about a trimesh mesh; `trimesh_ray` makes one.

    Parameters
    ----------
    geometry : trimesh.Trimesh
    scale_to_box : bool
        For trimesh, which scales meshes before it rounds them. Answers here do not depend on it.
    """

    def __init__(self, geometry: Any, scale_to_box: bool = True):
        if not all(hasattr(type(geometry), name) for name in ("vertices", "faces", "face_normals")):
            raise InputError(f"the mesh is a {type(geometry).__name__}; give a trimesh.Trimesh")
        self.mesh, self._scene, self._version = geometry, cast("Scene | None", None), 0

    def __getstate__(self) -> dict[str, Any]:
        return {"geometry": self.mesh}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def copied_to(self, mesh: Any) -> "RayMeshIntersector":
        """The intersector of an equal mesh, with the same trees until one of them changes."""
        other = RayMeshIntersector(mesh)
        if self._scene is not None and hash(mesh) == self._version:
            other._scene, other._version = self._scene, self._version
        return other

    @property
    def scene(self) -> Scene:
        """The triangles of the mesh, z up. A new scene once vertices or faces have changed."""
        version = hash(self.mesh)  # trimesh hashes its arrays again only after writes
        if self._scene is None or version != self._version:
            vertices, faces = np.asarray(self.mesh.vertices), np.asarray(self.mesh.faces)
            if not len(faces):  # a face without area blocks nothing
                vertices, faces = np.zeros((3, 3)), np.arange(3)[None]
            self._scene, self._version = Scene.from_arrays(vertices, faces, name="trimesh", up=MESH_UP), version
        return self._scene

    def intersects_any(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.bool_]:
        """(n,) bool: whether each ray hits the mesh.

        Parameters
        ----------
        ray_origins, ray_directions : (n, 3) float
            Directions need not be unit vectors. Rays whose direction is zero, NaN or infinite miss, as do those whose
            origin is not finite. A face through the origin is no hit.
        """
        scene = self.scene
        return _traced(
            lambda rays: scene.occluded(rays.origins, rays.directions, tmax=rays.tmax),
            _checked(ray_origins, ray_directions),
        )

    def intersects_first(self, ray_origins: ArrayLike, ray_directions: ArrayLike) -> NDArray[np.int32]:
        """(n,) int32: the first face that each ray hits, as `Scene.closest_hit` orders them; -1: none."""
        return self._closest(_checked(ray_origins, ray_directions)).face

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
        hits = self._all_hits(rays, limit) if multiple_hits else self._first_hits(rays)
        if not return_locations:
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

    def _closest(self, rays: _RayRows) -> Hit:
        scene = self.scene
        return _traced(lambda rays: scene.closest_hit(rays.origins, rays.directions, tmax=rays.tmax), rays)

    def _first_hits(self, rays: _RayRows) -> _Hits:
        hit = self._closest(rays)
        ray = np.flatnonzero(hit.mask)
        return _Hits(ray, hit.face[ray].astype(np.int64), hit.t[ray])

    def _all_hits(self, rays: _RayRows, limit: int | None) -> _Hits:
        scene = self.scene
        found = _traced(lambda rays: scene.all_hits(rays.origins, rays.directions, tmax=rays.tmax), rays)
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
        origins, directions = rays.origins[hits.ray], rays.directions[hits.ray].astype(np.float64)
        # plain views: a part of a tracked array makes trimesh hash the whole mesh again
        vertices, faces, normals = (
            np.asarray(each) for each in (self.mesh.vertices, self.mesh.faces, self.mesh.face_normals)
        )
        normals, corners = normals[hits.face], vertices[faces[hits.face, 0]]
        slope = np.einsum("ij,ij->i", directions, normals)
        steep = np.abs(slope) > _STEEP * np.linalg.norm(directions, axis=1)
        height = np.einsum("ij,ij->i", corners - origins, normals)
        t = np.divide(height, slope, out=hits.t.copy(), where=steep)
        return np.asarray(origins + t[:, None] * directions)


_LARGEST = 2.0**100  # coordinates up to it fit float32, also after recentring
_ORDINARY = 2.0**-60, 2.0**60  # lengths of float64 directions that are passed on as they are


def _checked(ray_origins: ArrayLike, ray_directions: ArrayLike) -> _RayRows:
    """Rays whose directions fit float32: as they are, if that is certain; otherwise scaled, without those that miss."""
    origins, directions = _rows(ray_origins, "ray_origins"), _rows(ray_directions, "ray_directions")
    if origins.shape != directions.shape:
        raise InputError(f"{len(origins)} ray_origins and {len(directions)} ray_directions; give one of each per ray")
    rays = _RayRows(origins, directions, np.inf)
    near = float(np.einsum("ij,ij->", origins, origins)) <= _LARGEST**2  # false for NaN, too
    if near and (directions.dtype == np.float32 or _are_ordinary(directions)):
        return rays
    origins, directions, tmax = _without_misses(rays)
    _, exponents = np.frexp(np.abs(directions).max(axis=1, initial=0.0).astype(np.float64))
    return _RayRows(origins, np.ldexp(directions.astype(np.float64), -exponents[:, None]), tmax)  # exact


def _are_ordinary(directions: NDArray[Any]) -> bool:
    """Whether all lengths are ordinary, by their squares, since other tests take longer than tracing."""
    # not `vdot`, whose threads stay busy for a while, and take the cores from rays
    if not len(directions):
        return True
    squares = np.einsum("ij,ij->i", directions, directions)  # without a dtype, five times as fast
    low, high = _ORDINARY
    return bool(squares.min() >= low**2 and squares.max() <= high**2)  # false for NaN


def _without_misses(rays: _RayRows) -> _RayRows:
    """The rays, with empty intervals in place of those that miss everything, and numbers in place of theirs."""
    longest, farthest = (np.abs(each).max(axis=1, initial=0.0) for each in (rays.directions, rays.origins))
    misses = ~((longest > 0.0) & (longest < np.inf) & (farthest <= _LARGEST))  # NaN, too
    blank = misses[:, None]
    origins, directions = np.where(blank, 0.0, rays.origins), np.where(blank, 1.0, rays.directions)
    return _RayRows(origins, directions, np.where(misses, 0.0, np.inf))


def _traced(query: Callable[[_RayRows], _T], rays: _RayRows) -> _T:
    """The result of a query for rays, whose numbers it checks. Those that are not valid miss everything."""
    try:
        return query(rays)
    except InputError:
        return query(_without_misses(rays))


def _rows(value: ArrayLike, what: str) -> NDArray[Any]:
    """(n, 3) numbers; trimesh takes arrays of Python objects, too."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        value = value.tolist()
    return rows_of(value, what, 3, 2)


# --- Distances --------------------------------------------------------------------------------------------------------


class ProximityQuery:
    """Distances of points from a trimesh mesh; `trimesh_nearest` makes one.

    The face is found among the faces rounded to float32, as in all scenes, and its closest point on the mesh's own
    float64 face. So a distance is never too small, and too large by at most twice the rounding of a coordinate:
    2**-23 of the largest distance of a vertex from the middle of the mesh.
    """

    def __init__(self, mesh: Any):
        self.mesh, self._rays = mesh, RayMeshIntersector(mesh)

    def __getstate__(self) -> dict[str, Any]:
        return {"mesh": self.mesh}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def copied_to(self, mesh: Any) -> "ProximityQuery":
        """The queries of an equal mesh, with the same trees."""
        other = ProximityQuery(mesh)
        other._rays = self._rays.copied_to(mesh)
        return other

    def on_surface(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """The closest point of the mesh to each point.

        Parameters
        ----------
        points : (m, 3) float

        Returns
        -------
        closest : (m, 3) float64
        distance : (m,) float64
        triangle_id : (m,) int64
            Of equally distant faces, the first. A point that is NaN or infinite has none: -1, at the distance NaN.
        """
        points = rows_of(points, "points", 3, 2).astype(np.float64, copy=False)
        face = self._rays.scene.closest_points(points).face.astype(np.int64)
        measured = np.isfinite(points).all(1)
        if (measured & (face < 0)).any():
            raise InputError(
                "the mesh has no face with area, from which distances could be measured; give another mesh"
            )
        corners = np.asarray(self.mesh.vertices)[np.asarray(self.mesh.faces)[face]]
        on_faces = import_extra("trimesh.triangles", "trimesh_nearest", "meshes").closest_point
        closest = np.full(points.shape, np.nan)
        closest[measured] = on_faces(corners[measured], points[measured]) if measured.any() else np.nan
        return closest, np.linalg.norm(points - closest, axis=1), face

    def signed_distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """(m,) float64: the distance of points, (m, 3) float, from the mesh, positive inside it, as trimesh has it.

        The sign is exact, see `Scene.contains`.
        """
        points = rows_of(points, "points", 3, 2)
        distance = self.on_surface(points)[1]
        inside, measured = np.zeros(len(points), np.bool_), ~np.isnan(distance)
        inside[measured] = self._rays.contains_points(points[measured])
        return np.where(inside, distance, -distance)

    def vertex(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """(distance, vertex_id): the closest vertex to each point, by trimesh's own tree."""
        distance, vertex = self.mesh.kdtree.query(rows_of(points, "points", 3, 2))
        return distance, vertex
