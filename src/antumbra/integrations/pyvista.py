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
from typing import Any, NamedTuple

import numpy as np
import pyvista
from numpy.typing import ArrayLike, NDArray

from ..base.checks import choice, flag, rows_of
from ..base.errors import InputError
from ..city.sensors.sensors import Sensors, face_sensors, vertex_sensors
from ..city.sun.sun_hours import sky_view, sun_hours
from ..city.tables.result_table import Table
from ..city.tables.surface_columns import NAMES as SURFACE_COLUMNS
from ..engine.point_visibility import visibility
from ..engine.scene import Scene
from ..scene.light_lists import DirectionalLights, PointLights
from ..scene.lights import AmbientOcclusion, Light


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


def _surface_of(dataset: Any, on: str) -> _Surface:
    choice(on, "on", ("cells", "points"))
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
    scene = Scene.from_arrays(np.asarray(points), faces, name=type(dataset).__name__, up="z")
    if on == "cells":
        return _Surface(scene, face_sensors(scene), cells, corners, dataset.n_cells)
    return _Surface(scene, vertex_sensors(scene), cells, corners, dataset.n_points)


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

    All methods return a shallow copy of the data set with new arrays. They share two options:

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
        for name in ("surfaces", "facing", "per"):
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
