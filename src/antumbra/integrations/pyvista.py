"""PyVista: an accessor, ``mesh.antumbra``, whose results become arrays of the mesh's cells or points.

    lit = mesh.antumbra.sun_hours("2026-06-21", place=at.Place(52.0, 4.4))
    lit.plot(scalars="sun_hours")

PyVista 0.48 and later find the accessor themselves; with an earlier one, call ``DatasetAccessor(mesh).sun_hours(...)``.

Every data set with a surface has results: polygons of any number of corners, triangle strips, and grids. The z axis
points up. Each triangle of the surface is a sensor, on the side from which its corners run counterclockwise, and a cell
gets the area-weighted mean of its triangles. Cells and points without any area on the surface get NaN.
"""

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np
import pyvista
from numpy.typing import ArrayLike, NDArray

from ..base.checks import choice, flag, rows_of, vector
from ..base.errors import InputError
from ..base.wording import counted
from ..city.sensors.sensors import Sensors, face_sensors, vertex_sensors
from ..city.sensors.surface_groups import unit_normals
from ..city.sun.sun_hours import sky_view, sun_hours
from ..city.tables.result_table import Table
from ..city.tables.surface_columns import NAMES as SURFACE_COLUMNS
from ..engine.point_visibility import visibility
from ..engine.scene import Scene
from ..formats.library_meshes import MESH_UP
from ..scene.light_lists import DirectionalLights, PointLights
from ..scene.lights import AmbientOcclusion, Light
from .trimesh import RayMeshIntersector


class _Surface(NamedTuple):
    """The triangles of a data set's surface, their origin in it, and sensors on them."""

    scene: Scene
    sensors: Sensors  # one per triangle with an area, or per vertex of these
    cells: NDArray[np.int64]  # (f,) cell of each triangle
    corners: NDArray[np.int64]  # (f, 3) points of each triangle, -1: none
    size: int  # number of cells or points of the data set

    def seen(self, light: Light, single: bool) -> NDArray[np.float64]:
        """(n, k) float64: 1 where sensors see the samples of a light, else 0; `single`: (n,), of the only sample."""
        sensors = self.sensors
        samples = visibility(self.scene, sensors.points, light, sensors.normals).seen_samples.astype(np.float64)
        return samples[:, 0] if single else samples

    def array(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """(size, ...) float64: values of sensors, (n, ...), as values of cells or points; NaN where there are none."""
        sensors, out = self.sensors, np.full((self.size, *values.shape[1:]), np.nan)
        if sensors.corners is not None:
            has_both = (sensors.corners >= 0) & (self.corners >= 0)
            out[self.corners[has_both]] = values[sensors.corners[has_both]]
            return out
        assert sensors.faces is not None and sensors.areas is not None
        cell, areas = self.cells[sensors.faces], sensors.areas
        total = np.bincount(cell, areas, self.size)
        columns = [np.bincount(cell, areas * column, self.size) for column in values.reshape(len(values), -1).T]
        sums = np.stack(columns, axis=-1).reshape(out.shape)
        covered = total > 0.0
        out[covered] = (sums[covered].T / total[covered]).T
        return out


class _TriangleMesh:
    """The triangles of a data set's surface, with the attributes of a trimesh mesh that rays need."""

    __slots__ = "cells", "face_normals", "faces", "vertices"

    def __init__(self, dataset: Any):
        points, self.faces, self.cells, _ = _triangles_in(dataset)
        self.vertices = np.asarray(points, np.float64)
        self.face_normals = unit_normals(self.vertices[self.faces])


class _SurfaceTriangles(NamedTuple):
    """The triangles of a data set's surface."""

    points: Any  # (p, 3) float
    faces: NDArray[np.int64]  # (f, 3) rows of `points`
    cells: NDArray[np.int64]  # (f,) cell of each triangle
    corners: NDArray[np.int64]  # (f, 3) points of the data set, -1: none


def _surface_of(dataset: Any, on: str) -> _Surface:
    choice(on, "on", ("cells", "points"))
    points, faces, cells, corners = _triangles_in(dataset)
    scene = Scene.from_arrays(np.asarray(points), faces, name=type(dataset).__name__, up=MESH_UP)
    if on == "cells":
        return _Surface(scene, face_sensors(scene), cells, corners, dataset.n_cells)
    return _Surface(scene, vertex_sensors(scene), cells, corners, dataset.n_points)


def _triangles_in(dataset: Any) -> _SurfaceTriangles:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyVista warns about its own defaults
        if isinstance(dataset, pyvista.PolyData):
            faces, cells = _triangles_of(dataset)
            points, corners = dataset.points, faces
        else:
            surface = dataset.extract_surface(pass_cellid=True, pass_pointid=True)
            faces, polygons = _triangles_of(surface)
            cells = np.asarray(surface.cell_data["vtkOriginalCellIds"])[polygons]
            points, corners = surface.points, np.asarray(surface.point_data["vtkOriginalPointIds"])[faces]
    if not len(faces):
        raise InputError(f"the {type(dataset).__name__} has no surface; give one with polygons or cells")
    return _SurfaceTriangles(points, faces, cells, corners)


def _triangles_of(mesh: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(points of each triangle, (f, 3); its cell, (f,)) of a PolyData.

    Its cells are vertices, lines, polygons and strips, in this order. VTK mixes up their arrays when it triangulates
    several kinds at once, so it gets polygons only.
    """
    polygons = pyvista.PolyData()
    polygons.points, polygons.faces = mesh.points, mesh.faces
    polygons.cell_data["id"] = np.arange(polygons.n_cells)
    triangles, first = polygons.triangulate(), mesh.n_verts + mesh.n_lines
    faces = [np.asarray(triangles.faces).reshape(-1, 4)[:, 1:]]
    cells = [first + np.asarray(triangles.cell_data["id"])]
    first += polygons.n_cells
    strips = np.asarray(mesh.strips)
    while len(strips):
        strip, strips = strips[1 : strips[0] + 1], strips[strips[0] + 1 :]
        windows = np.lib.stride_tricks.sliding_window_view(strip, 3).copy()
        windows[1::2, :2] = windows[1::2, 1::-1]  # every second triangle has the opposite order
        faces.append(windows)
        cells.append(np.full(len(windows), first))
        first += 1
    return np.concatenate(faces).astype(np.int64), np.concatenate(cells).astype(np.int64)


class DatasetAccessor:
    """Shadow queries on the surface of a PyVista data set, ``mesh.antumbra``.

    `ray_trace`, `multi_ray_trace` and `select_interior_points` are PyVista's own filters of these names, with exact
    answers. All other methods return a shallow copy of the data set with new arrays, and share two options:

    on : "cells" or "points"
        Whether results are arrays of ``cell_data``, or of ``point_data`` with the mean normals of points.
    inplace : bool
        True: add the arrays to the data set itself, and return it.

    dataset : pyvista.DataSet
    """

    def __init__(self, dataset: Any):
        if not isinstance(dataset, pyvista.DataSet):
            raise InputError(f"the mesh is a {type(dataset).__name__}; give a pyvista.DataSet, such as a PolyData")
        self._dataset = dataset
        self._rays, self._version = cast("RayMeshIntersector | None", None), -1

    def ray_trace(
        self,
        origin: ArrayLike,
        end_point: ArrayLike,
        first_point: bool = False,
        plot: bool = False,
        off_screen: bool | None = None,
    ) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """Intersect the surface with a line segment, as ``mesh.ray_trace``.

        A change of the data set that VTK knows of makes the next call read it again.

        Parameters
        ----------
        origin, end_point : (3,) float
            Intersections lie strictly between them.
        first_point : bool
            True: the points are the first one, (3,), if there is any.
        plot, off_screen : bool
            True: show the segment and its intersections.

        Returns
        -------
        points : (n, 3), or (3,)
            In the dtype of the data set's points. One where several cells meet.
        cells : (n,) int64
        """
        start, end = vector(origin, "origin"), vector(end_point, "end_point")
        rays = self._intersector()
        found = rays.scene.all_hits(start[None], targets=end[None])
        new = np.diff(found.t, prepend=-1.0) > 0.0
        points = (start + found.t[new, None] * (end - start)).astype(self._dataset.points.dtype)
        cells = rays.mesh.cells[found.face[new]]
        shown = points[0] if first_point and len(points) else points
        if plot:
            plotter: Any = pyvista.Plotter(off_screen=off_screen)
            plotter.add_mesh(self._dataset, label="Test Mesh")
            plotter.add_lines(np.stack([start, end]), color="b", label="Ray Segment")
            if len(points):
                plotter.add_mesh(np.atleast_2d(shown), color="r", point_size=10, label="Intersection Points")
            plotter.add_legend()
            plotter.add_axes()
            plotter.show()
        return shown, cells

    def multi_ray_trace(
        self, origins: ArrayLike, directions: ArrayLike, first_point: bool = False, retry: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Intersect the surface with rays, as ``mesh.multi_ray_trace``; polygons may have any number of corners.

        Parameters
        ----------
        origins, directions : (n, 3) float
        first_point : bool
            True: only the first intersection of each ray.
        retry : bool
            True: results are sorted by ray. No ray needs a second try.

        Returns
        -------
        points : (m, 3) float64
            One where several cells meet; all first ones, then all second ones, and so on.
        rays, cells : (m,) int64
        """
        found = self._intersector()
        points, ray, face = found.intersects_location(origins, directions, multiple_hits=not first_point)
        order = np.argsort(ray, kind="stable") if retry else slice(None)
        return points[order], ray[order], found.mesh.cells[face[order]]

    def select_interior_points(
        self,
        surface: Any,
        *,
        method: str = "signed_distance",
        inside_out: bool = False,
        check_surface: bool = True,
        locator_tolerance: float | None = None,
    ) -> Any:
        """Add "selected_points": whether a closed surface contains each point, as ``mesh.select_interior_points``.

        Parameters
        ----------
        surface : pyvista.PolyData
            Points on it are inside.
        inside_out : bool
            True: whether points are outside.
        check_surface : bool
            True: refuse a surface that is not closed.
        method, locator_tolerance
            Choose among PyVista's approximations. The answer here is exact, and does not depend on them.

        Raises
        ------
        InputError
            If the surface is no PolyData or not closed.
        """
        if not isinstance(surface, pyvista.PolyData):
            raise InputError(f"the surface is a {type(surface).__name__}; give a pyvista.PolyData")
        if flag(check_surface, "check_surface") and surface.n_open_edges:
            raise InputError(
                f"the surface has {counted(surface.n_open_edges, 'open edge')}; close it, or set check_surface=False"
            )
        inside = np.zeros(self._dataset.n_points, bool)
        if surface.n_cells:
            inside = DatasetAccessor(surface)._intersector().scene.contains(np.asarray(self._dataset.points))
        selected = self._dataset.copy(deep=False)
        selected["selected_points"] = inside != flag(inside_out, "inside_out")
        selected.set_active_scalars("selected_points")
        return selected

    def _intersector(self) -> RayMeshIntersector:
        """The rays of the surface; new ones once VTK has counted a change of the data set."""
        version = self._dataset.GetMTime()
        if self._rays is None or version != self._version:
            self._rays, self._version = RayMeshIntersector(_TriangleMesh(self._dataset)), version
        return self._rays

    def occluded(self, directions: ArrayLike, *, on: str = "cells", inplace: bool = False) -> Any:
        """Add "occluded": 1 where the mesh blocks the view in a direction, or faces away from it; else 0.

        directions : (3,) or (k, 3) float
            Towards the sky, of any length. For k directions, at most 1024, the array has k components.
        """
        towards = rows_of(directions, "directions", 3)
        surface = _surface_of(self._dataset, on)
        seen = surface.seen(DirectionalLights(-np.atleast_2d(towards)), towards.ndim == 1)
        return self._with(surface, {"occluded": 1.0 - seen}, inplace)

    def visible_from(self, points: ArrayLike, *, on: str = "cells", inplace: bool = False) -> Any:
        """Add "visible_from": 1 where a surface is visible from a point, 0 where it is hidden or faces away.

        points : (3,) or (k, 3) float
            For k points, at most 1024, the array has k components.
        """
        eyes = rows_of(points, "points", 3)
        surface = _surface_of(self._dataset, on)
        seen = surface.seen(PointLights(np.atleast_2d(eyes)), eyes.ndim == 1)
        return self._with(surface, {"visible_from": seen}, inplace)

    def ambient_occlusion(
        self, *, spp: int = 256, radius: float | None = None, on: str = "cells", inplace: bool = False
    ) -> Any:
        """Add "ambient_occlusion": the cosine-weighted share of the hemisphere that is free, 1 for open surfaces.

        spp : int
            Rays per sensor, 1 to 1024.
        radius : float, optional
            Blockers farther away do not count. None: all count.
        """
        light, surface = AmbientOcclusion(radius=radius), _surface_of(self._dataset, on)
        sensors = surface.sensors
        free = visibility(surface.scene, sensors.points, light, sensors.normals, spp=spp).fraction
        return self._with(surface, {"ambient_occlusion": free}, inplace)

    def sun_hours(self, days: Any = None, *, on: str = "cells", inplace: bool = False, **keywords: Any) -> Any:
        """Add the numbers that `antumbra.sun_hours` finds: "sun_hours", "sun_share", "longest" and optional ones.

        days, keywords
            As in `antumbra.sun_hours`.
        """
        for name in ("surfaces", "facing", "tilt", "per"):
            if name in keywords:
                raise InputError(f"{name} chooses rows of a table, and arrays have a value for each cell; leave it out")
        surface = _surface_of(self._dataset, on)
        return self._with(surface, _numbers(sun_hours(surface.scene, surface.sensors, days, **keywords)), inplace)

    def sky_view(self, *, on: str = "cells", inplace: bool = False, **keywords: Any) -> Any:
        """Add "sky_view" and "sky_share", which `antumbra.sky_view` documents with its keywords."""
        surface = _surface_of(self._dataset, on)
        return self._with(surface, _numbers(sky_view(surface.scene, surface.sensors, **keywords)), inplace)

    def _with(self, surface: _Surface, arrays: Mapping[str, NDArray[Any]], inplace: bool) -> Any:
        dataset = self._dataset if flag(inplace, "inplace") else self._dataset.copy(deep=False)
        data = dataset.cell_data if surface.sensors.kind == "face" else dataset.point_data
        for name, values in arrays.items():
            data[name] = surface.array(values)
        return dataset


def _numbers(table: Table) -> dict[str, NDArray[Any]]:
    """The columns of a table that hold numbers or flags, besides those that describe the surfaces."""
    values = {name: column.values for name, column in table.columns.items() if name not in SURFACE_COLUMNS}
    return {name: array.astype(np.float64) for name, array in values.items() if array.dtype.kind in "fiub"}


def _register() -> None:
    if hasattr(pyvista, "register_dataset_accessor"):
        pyvista.register_dataset_accessor("antumbra", pyvista.DataSet)(DatasetAccessor)
    else:
        message = f"PyVista {pyvista.__version__} has no accessors, so no mesh.antumbra"
        warnings.warn(f"{message}; update it to 0.48, or call DatasetAccessor(mesh)", UserWarning, stacklevel=3)


_register()
