"""Observers along lines such as roads, for cumulative viewsheds; each represents a length of line."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, choice, number, path_of, quoted
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_file
from ...scene.crs import parts_of_crs, reproject
from ..gis.vector_files import read_vectors
from ..sensors.sensor_files import read_point_file
from ..sensors.vector_points import crs_of_frame


class LinePoints(NamedTuple):
    """Points along lines, and the length that each stands for."""

    points: NDArray[np.float64]  # (k, 3) world
    lengths: NDArray[np.float64]  # (k,) world units; their sum is the length of the lines in plan


_MOST = 10_000_000  # points


def points_along(
    lines: ArrayLike | Sequence[ArrayLike] | str | PathLike[str], spacing: float, *, crs: str | None = None,
    up: str = "z",
) -> LinePoints:  # fmt: skip
    """Place points along lines at an even spacing, in the middle of equally long pieces.

    Parameters
    ----------
    lines : (n, 2) or (n, 3) float, a sequence of such arrays, str or path-like
        The vertices of one line or of several, easting, northing and height (0 if left out). A path names a vector file
        of lines, such as a GeoPackage or GeoJSON (``antumbra[gis]``), or a .csv file of the vertices of one line with
        the columns x, y and, optionally, z. Coordinates are those of the scene.
    spacing : float
        World units, in plan. Each line is divided into the fewest equal pieces not longer than this.
    crs : str, optional
        `Scene.crs`, to which lines of a file in another system are moved.
    up : "y" or "z"
        `Scene.up`. With "y", vertices (n, 3) and those of .csv files are x, y and z of the scene, with y up.

    Returns
    -------
    LinePoints
        For `antumbra.viewshed`. Lines without length have no points.

    Raises
    ------
    InputError
        If an argument is invalid, a file holds no lines, or there would be more than 10 million points.

    Examples
    --------
    >>> path = at.points_along([[0, 0, 2], [10, 0, 2]], spacing=5.0)
    >>> path.points
    array([[2.5, 0. , 2. ],
           [7.5, 0. , 2. ]])
    """
    spacing = number(spacing, "the spacing of points along lines", 0.0, np.inf)
    turns, found = choice(up, "up", ("y", "z")) == "y", _lines(lines, crs)
    vertices = [_checked(line) for line in found]
    if turns and _on_axes(lines):
        vertices = [line if np.shape(given)[-1] == 2 else _on_map(line) for given, line in zip(found, vertices)]
    total = sum(float(_side_lengths(line).sum()) for line in vertices)
    if total / spacing > _MOST:
        raise InputError(f"lines of {total:g} at a spacing of {spacing:g} have more than {_MOST:,} points; widen it")
    parts = [_divided(line, spacing) for line in vertices]
    points = np.concatenate([part.points for part in parts])
    if not len(points):
        raise InputError("the lines have no length; give lines of two or more different points")
    points = points[:, [0, 2, 1]] * [1.0, 1.0, -1.0] if turns else points
    return LinePoints(points, np.concatenate([part.lengths for part in parts]))


def _on_axes(lines: Any) -> bool:
    """Whether lines have the axes of the scene, unlike those of vector files, which are on a map."""
    return not isinstance(lines, (str, PathLike)) or Path(lines).suffix.lower() == ".csv"


def _on_map(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) float64: easting, northing and height of vertices with y up."""
    return line[:, [0, 2, 1]] * [1.0, -1.0, 1.0]


def _lines(lines: Any, crs: str | None) -> list[Any]:
    """The vertices of each line."""
    if isinstance(lines, (str, PathLike)):
        path = checked_file(path_of(lines, "lines"), Path(lines).name)
        return [_table_vertices(path, crs)] if path.suffix.lower() == ".csv" else _file_lines(path, crs)
    if isinstance(lines, np.ndarray):
        return [lines]
    if not isinstance(lines, Sequence):
        raise InputError(f"lines are {quoted(lines)}; they must be arrays of points, or a file")
    items = list(lines)
    if not items:
        raise InputError("there are no lines; give two or more points of a line")
    return [items] if np.ndim(items[0]) == 1 else items


def _checked(line: Any) -> NDArray[np.float64]:
    """(n, 3) float64: the vertices of a line."""
    vertices = as_array(line, "the vertices of a line").astype(np.float64)
    if vertices.ndim != 2 or vertices.shape[1] not in (2, 3) or len(vertices) < 2:
        raise InputError(f"a line must be two or more points (n, 2) or (n, 3), not {vertices.shape}")
    if not np.isfinite(vertices).all():
        raise InputError("the vertices of a line hold NaN or infinity")
    return vertices if vertices.shape[1] == 3 else np.column_stack([vertices, np.zeros(len(vertices))])


def _side_lengths(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n - 1,) float64: the horizontal lengths of the sides of a line of n vertices."""
    return np.asarray(np.sqrt((np.diff(line[:, :2], axis=0) ** 2).sum(1)))


def _divided(line: NDArray[np.float64], spacing: float) -> LinePoints:
    """The points along one line."""
    sides = _side_lengths(line)
    ends = np.append(0.0, np.cumsum(sides))
    pieces = max(int(np.ceil(ends[-1] / spacing - 1e-9)), 1) if ends[-1] > 0.0 else 0
    at = (np.arange(pieces) + 0.5) * (ends[-1] / max(pieces, 1))
    points = np.stack([np.interp(at, ends, line[:, k]) for k in range(3)], 1)
    return LinePoints(points, np.full(pieces, ends[-1] / max(pieces, 1)))


def _table_vertices(path: Path, crs: str | None) -> NDArray[np.float64]:
    """The vertices of the line in a .csv file."""
    file = read_point_file(path, flat=True)
    return _moved(file.sensors.points, file.crs, crs, path.name)


def _file_lines(path: Path, crs: str | None) -> list[NDArray[np.float64]]:
    """The lines of a vector file."""
    shapely = import_extra("shapely", "lines of vector files", "gis")
    table = read_vectors(path, "lines")
    parts = [part for shape in table.geometry if shape is not None for part in getattr(shape, "geoms", [shape])]
    lines = [part for part in parts if part.geom_type in ("LineString", "LinearRing") and not part.is_empty]
    if not lines:
        raise InputError(f"{path} has no lines; give a layer of LineStrings")
    own = crs_of_frame(table, path)
    vertices = [shapely.get_coordinates(line, include_z=bool(line.has_z)) for line in lines]
    return [_moved(each, own, crs, path.name) for each in vertices]


def _moved(at: NDArray[np.float64], own: str | None, crs: str | None, file: str) -> NDArray[np.float64]:
    """Vertices in the CRS of a file, in that of the scene; None: unknown, which matches everything but degrees."""
    if own is None or crs is None:
        if own is not None and parts_of_crs(own).plan.is_geographic:
            raise InputError(f"{file}: is in degrees, and the scene has no CRS; give it, as --crs does")
        return at
    if parts_of_crs(own).plan.equals(parts_of_crs(crs).plan, ignore_axis_order=True):
        return at
    return np.column_stack([reproject(at[:, :2], own, crs), at[:, 2:]])
