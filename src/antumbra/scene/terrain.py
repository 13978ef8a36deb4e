"""Terrain: the triangulated surface of a raster of heights, as the source of a scene.

The surface has a vertex at the centre of each cell with a height. Four neighbouring vertices form a square, which the
diagonal from its north-west to its south-east corner splits into two triangles. A triangle exists if its three cells
have heights, so cells without data leave holes. Triangles are never stored: they are generated block by block from the
heights, which take 4 bytes per cell where the triangles take about 100.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .crs import unit_of_crs
from .mesh import WHITE, MeshInfo, ObjectInfo, Piece
from .raster import CellWindow, Raster
from .units import LengthUnit

TERRAIN_TYPE = "TINRelief"
"""The type of terrain among city objects, as in CityJSON."""

BLOCK = _HIGH, _WIDE = 256, 512
"""Rows and columns of squares per block: 2^18 triangles, what a store stages at a time."""

_SAME = 1e-6  # relative difference of the sides of a square cell

# --- The grid and its heights -----------------------------------------------------------------------------------------


class GridPoints(NamedTuple):
    """The points of a horizontal grid, the centres of the cells of a raster. Row 0 is the northernmost."""

    west: float  # easting of column 0
    north: float  # northing of row 0
    dx: float  # between columns, positive
    dy: float  # between rows, positive
    rows: int
    columns: int

    def eastings(self, first: int = 0, last: int | None = None) -> NDArray[np.float64]:
        """(n,) float64: of the columns from `first` to `last`, exclusive."""
        return self.west + np.arange(first, self.columns if last is None else last, dtype=np.float64) * self.dx

    def northings(self, first: int = 0, last: int | None = None) -> NDArray[np.float64]:
        """(n,) float64: of the rows from `first` to `last`, exclusive."""
        return self.north - np.arange(first, self.rows if last is None else last, dtype=np.float64) * self.dy

    def cells_of(self, plan: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) float64: fractional columns and rows of points, (n, 2) easting and northing."""
        out: NDArray[np.float64] = (plan - [self.west, self.north]) / [self.dx, -self.dy]
        return out

    def raster(self, crs: str | None) -> Raster | None:
        """The cells of which these are the centres; None if they are not square."""
        if abs(self.dx - self.dy) > _SAME * self.dx:
            return None
        west, north = self.west - self.dx / 2.0, self.north + self.dy / 2.0
        return Raster(west, north, self.dx, self.columns, self.rows, crs)


class Heights(Protocol):
    """Heights at the points of a grid, in memory or in a file."""

    @property
    def name(self) -> str: ...

    @property
    def grid(self) -> GridPoints: ...

    @property
    def crs(self) -> str | None: ...

    @property
    def dtype(self) -> np.dtype[Any]: ...

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """(last - first, columns) float32 or float64: heights of some rows; NaN: no data."""
        ...


class HeightGrid(NamedTuple):
    """Heights in memory."""

    name: str
    grid: GridPoints
    crs: str | None
    heights: NDArray[Any]  # (rows, columns) float32 or float64; NaN: no data

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the heights."""
        return self.heights.dtype

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """Heights of some rows, a view."""
        return self.heights[first:last]

    def at(self, plan: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) float64: the height of the surface at places, (n, 2) world; NaN where there is none."""
        return self.at_cells(*self.grid.cells_of(plan).T)

    def at_cells(self, column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) float64: the height of the surface at fractional columns and rows; NaN where there is none."""
        rows, columns = self.heights.shape
        inside = (column >= 0.0) & (column <= columns - 1) & (row >= 0.0) & (row <= rows - 1)
        u, v = np.where(inside, column, 0.0), np.where(inside, row, 0.0)
        j, i = (np.minimum(np.floor(w), n - 2).astype(np.int64) for w, n in ((u, columns), (v, rows)))
        a, b, h = u - j, v - i, self.heights
        corner = np.where(b > a, h[i + 1, j], h[i, j + 1]).astype(np.float64)  # of the triangle: south-west, north-east
        north_west, south_east = h[i, j].astype(np.float64), h[i + 1, j + 1].astype(np.float64)
        first, second = np.maximum(a, b), np.minimum(a, b)  # steps from the north-west to the corner, and on
        height = north_west + first * (corner - north_west) + second * (south_east - corner)
        out: NDArray[np.float64] = np.where(inside, height, np.nan)
        return out


class HeightsByRow(ABC):
    """`Heights` that are read where they are needed; the surface is as of a `HeightGrid`."""

    name: str
    grid: GridPoints
    crs: str | None
    dtype: np.dtype[Any]

    @abstractmethod
    def rows(self, first: int, last: int) -> NDArray[Any]: ...

    def at(self, plan: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) float64: as `HeightGrid.at`."""
        return self.at_cells(*self.grid.cells_of(plan).T)

    def at_cells(self, column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) float64: as `HeightGrid.at_cells`, from the rows around the places."""
        if not len(row):
            return np.empty(0)
        first, last = (int(np.clip(np.floor(at), 0, self.grid.rows - 2)) for at in (row.min(), row.max()))
        return HeightGrid(self.name, self.grid, self.crs, self.rows(first, last + 2)).at_cells(column, row - first)


# --- Triangles --------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def _squares(rows: int, columns: int) -> NDArray[np.int32]:
    """(2 rows columns, 3) int32: the triangles of a block of squares, counter-clockwise seen from above. Read only."""
    north_west = np.arange(rows, dtype=np.int32)[:, None] * np.int32(columns + 1) + np.arange(columns, dtype=np.int32)
    south_west = north_west + np.int32(columns + 1)
    corners = (north_west, south_west, south_west + 1, north_west, south_west + 1, north_west + 1)
    faces = np.asarray(np.stack(corners, -1), np.int32).reshape(-1, 3)
    faces.flags.writeable = False
    return faces


def _blocks(grid: GridPoints) -> Generator[tuple[int, int, int, int], None, None]:
    """Yield blocks of squares in order: (first row, last row, first column, last column), the last ones exclusive."""
    for row in range(0, grid.rows - 1, _HIGH):
        for column in range(0, grid.columns - 1, _WIDE):
            yield row, min(row + _HIGH, grid.rows - 1), column, min(column + _WIDE, grid.columns - 1)


class _TerrainBlock(NamedTuple):
    """The vertices and triangles of a block."""

    vertices: NDArray[np.float64]  # (v, 3), world
    faces: NDArray[np.int32]  # (f, 3)
    used: NDArray[np.bool_] | None  # (cells,): which cells of the block are vertices; None: all


def _triangles(grid: GridPoints, block: tuple[int, int, int, int], heights: np.ndarray) -> _TerrainBlock:
    """The triangles of a block; `heights`: (rows + 1, columns + 1) of it."""
    row, last_row, column, last_column = block
    vertices = np.empty((*heights.shape, 3))
    vertices[..., 0] = grid.eastings(column, last_column + 1)
    vertices[..., 1] = grid.northings(row, last_row + 1)[:, None]
    vertices[..., 2] = heights
    vertices, faces = vertices.reshape(-1, 3), _squares(last_row - row, last_column - column)
    holes = np.isnan(vertices[:, 2])
    if not holes.any():
        return _TerrainBlock(vertices, faces, None)
    faces = faces[~holes[faces].any(1)]
    used = np.zeros(len(vertices), bool)
    used[faces.reshape(-1)] = True
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return _TerrainBlock(vertices[used], number[faces], used)


def _blocks_of_heights(surface: Heights) -> Generator[tuple[tuple[int, int, int, int], NDArray[Any]], None, None]:
    """Yield blocks of squares with the heights of their vertices; each row of heights is read about once."""
    rows, band = np.empty((0, 0)), (0, 0)
    for block in _blocks(surface.grid):
        row, last_row, column, last_column = block
        if band != (row, last_row):
            rows, band = surface.rows(row, last_row + 1), (row, last_row)
        yield block, rows[:, column : last_column + 1]


def terrain_blocks(surface: Heights) -> Generator[_TerrainBlock, None, None]:
    """The triangles of a surface, block by block, without empty ones."""
    blocks = (_triangles(surface.grid, block, heights) for block, heights in _blocks_of_heights(surface))
    return (triangles for triangles in blocks if len(triangles.faces))


def face_of_cells(surface: Heights) -> NDArray[np.int32]:
    """(rows, columns) int32: a triangle at each vertex, the last one; -1 for cells that are not vertices."""
    out, first = np.full((surface.grid.rows, surface.grid.columns), -1, np.int32), 0
    for block, heights in _blocks_of_heights(surface):
        row, last_row, column, last_column = block
        first += number_vertices(heights, first, out[row : last_row + 1, column : last_column + 1])
    return out


def number_vertices(heights: NDArray[Any], first: int, faces: NDArray[np.integer]) -> int:
    """Write the last triangle at each vertex of a block; return the number of its triangles.

    heights : (rows + 1, columns + 1) of the block
    first : the number of its first triangle
    faces : (rows + 1, columns + 1), changed where vertices have triangles of the block
    """
    (rows, columns), kind = (int(n) - 1 for n in heights.shape), faces.dtype.type
    if not np.isnan(heights).any():
        faces[:] = _last_faces(rows, columns) + kind(first)
        return 2 * rows * columns
    triangles = _triangles(GridPoints(0.0, 0.0, 1.0, 1.0, rows + 1, columns + 1), (0, rows, 0, columns), heights)
    of_vertex = np.empty(len(triangles.vertices), kind)
    of_vertex[triangles.faces] = np.arange(first, first + len(triangles.faces), dtype=kind)[:, None]
    faces[np.asarray(triangles.used).reshape(faces.shape)] = of_vertex
    return len(triangles.faces)


def faces_of_squares(surface: Heights) -> NDArray[np.int32]:
    """(rows - 1, columns - 1) int32: the first triangle of each square; -1 for squares without any."""
    out, first = np.empty((surface.grid.rows - 1, surface.grid.columns - 1), np.int32), 0
    for (row, last_row, column, last_column), heights in _blocks_of_heights(surface):
        there = ~np.isnan(heights)
        diagonal = there[:-1, :-1] & there[1:, 1:]
        count = (diagonal & there[1:, :-1]).astype(np.int32) + (diagonal & there[:-1, 1:])
        ends = np.cumsum(count, dtype=np.int32).reshape(count.shape)
        out[row:last_row, column:last_column] = np.where(count > 0, ends - count + np.int32(first), -1)
        first += int(ends[-1, -1])
    return out


def _last_faces(rows: int, columns: int) -> NDArray[np.int32]:
    """(rows + 1, columns + 1) int32: the last triangle at each vertex of a block of squares without holes.

    It is the second one of the square to the south-east, or of the last one to the south-west. On the southern border,
    it is the first one of the square to the north-east, or the very last triangle.
    """
    squares = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    out = np.pad(2 * squares + 1, ((0, 1), (0, 1)), mode="edge")
    out[rows, :columns] -= 1
    return out


def triangles_of(heights: NDArray[Any]) -> int:
    """The number of triangles of a surface, from its heights ((rows, columns), NaN: no data)."""
    count = 0
    for first in range(0, len(heights) - 1, _HIGH):
        there = ~np.isnan(heights[first : first + _HIGH + 1])
        diagonal = there[:-1, :-1] & there[1:, 1:]
        count += int((diagonal & there[1:, :-1]).sum()) + int((diagonal & there[:-1, 1:]).sum())
    return count


# --- Sources ----------------------------------------------------------------------------------------------------------


class TerrainSurfaces:
    """The source of surfaces over grids of heights, each of which is an object; they never move.

    colours : of each surface, (3,) float32, linear
    """

    duration = 0.0

    def __init__(self, surfaces: Sequence[Heights], file: str, colours: Sequence[NDArray[np.float32]] | None = None):
        self.file, self._surfaces = file, list(surfaces)
        self._colours = [WHITE] * len(self._surfaces) if colours is None else list(colours)
        kind = TERRAIN_TYPE
        self.objects = [ObjectInfo(each.name, k, 0, kind) for k, each in enumerate(self._surfaces)]
        counts = [triangles_of(each.heights) if isinstance(each, HeightGrid) else 0 for each in self._surfaces]
        self.meshes = [MeshInfo(each.name, n, 1) for each, n in zip(self._surfaces, counts)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        """The blocks of all surfaces."""
        for k, (surface, colour) in enumerate(zip(self._surfaces, self._colours)):
            for block in terrain_blocks(surface):
                yield Piece(block.vertices[None], block.faces, colour, self.file, first=k)

    @property
    def surface(self) -> Heights | None:
        """The surface, if there is only one."""
        return self._surfaces[0] if len(self._surfaces) == 1 else None

    @property
    def height_grid(self) -> HeightGrid | None:
        """The surface, if there is only one and its heights are in memory."""
        return self.surface if isinstance(self.surface, HeightGrid) else None

    def tops(self, window: CellWindow | None = None) -> tuple[NDArray[np.float64], NDArray[np.integer]] | None:
        """(cells,) float64 heights, as they were read, and (cells,) int faces, of a window, row by row; None: of all.

        Cells without a surface have the height NaN and the face -1. None if there are several surfaces.
        """
        if (surface := self.surface) is None:
            return None
        rows, columns = (window or CellWindow(0, 0, surface.grid.rows, surface.grid.columns)).slices
        heights = surface.rows(rows.start, rows.stop)[:, columns].reshape(-1).astype(np.float64)
        faces = self._face_of_cells[rows, columns].reshape(-1)
        heights[faces < 0] = np.nan
        return heights, faces

    @cached_property
    def _face_of_cells(self) -> NDArray[np.int32]:
        """(rows, columns) int32: `face_of_cells`, which numbers all triangles before that of a cell."""
        assert self.surface is not None
        return face_of_cells(self.surface)

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []


class StreamedTerrain(TerrainSurfaces):
    """A raster file of heights as a stream of pieces that are never in memory all at once. It is its own source.

    Its pieces equal those of the `Scene` of the file, with faces in the same order.
    """

    up = "z"
    animated = False

    def __init__(
        self, surface: Heights, notes: Callable[[], Iterable[str]], colour: NDArray[np.float32] = WHITE,
        unit: LengthUnit | None = None,
    ):  # fmt: skip
        super().__init__([surface], surface.name, [colour])
        self.name, self.crs, self._notes = surface.name, surface.crs, notes
        self.raster = surface.grid.raster(surface.crs)
        self._grid, self.given_unit = surface.grid, unit

    def open_faces(self) -> None:
        """None: all faces are solid."""

    def looks(self) -> None:
        """None: all faces have plain colours."""

    @property
    def unit(self) -> LengthUnit:
        """The unit of the coordinates, as `SceneData.unit`."""
        return unit_of_crs(self.crs, self.given_unit)

    @property
    def terrain(self) -> Heights | None:
        """The heights, as `SceneData.terrain`; None for several rasters."""
        return self.surface

    @property
    def n_triangles(self) -> int:
        """An upper bound of the number of triangles, reached without holes."""
        return 2 * (self._grid.rows - 1) * (self._grid.columns - 1)

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes about the heights read so far; about all of them once the pieces have been read."""
        return tuple(self._notes())

    @property
    def source(self) -> "StreamedTerrain":
        return self
