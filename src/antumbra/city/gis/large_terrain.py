"""`LargeTerrain`: the scene of a raster file whose triangles do not fit into memory, for shadows at its own cells.

It has the frame, the bits and the faces of the scene of the same file, at 4.6 bytes a cell. For a window of the cells,
only the pages are read whose heights rays from the window can reach, up to the far horizon.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.memory import memory_limit, readable_size
from ...base.progress import report_progress
from ...engine.scene import AnyScene, Scene
from ...scene.camera import Camera
from ...scene.height_surveys import PAGE, survey_heights
from ...scene.lights import Light
from ...scene.mesh import MeshInfo, ObjectInfo
from ...scene.raster import CellWindow, window_within
from ...scene.scene_bounds import frame_origin
from ...scene.scene_data import SceneData
from ...scene.terrain import TERRAIN_TYPE
from ...scene.triangles import Triangles
from ...scene.units import checked_unit
from ...trace.terrain.bordered_terrain import BorderedTerrain
from ...trace.terrain.paged_terrain import PAGED_BYTES, PagedTerrain
from .gis_data import CELL_BYTES, height_file
from .gis_scenes import from_raster
from .height_files import HeightFile


class LargeTerrain(SceneData):
    """The data of a raster file; it has no triangles.

    window : the cells at which there will be sensors; None: all
    """

    up = "z"
    duration = 0.0

    def __init__(self, file: HeightFile, unit: str | None = None, window: CellWindow | None = None):
        self.file, self.name, self.crs, grid = file, file.name, file.crs, file.grid
        self.given_unit = None if unit is None else checked_unit(unit)
        self.raster = grid.raster(file.crs)
        self.window = window or CellWindow(0, 0, grid.rows, grid.columns)
        with report_progress(f"{file.path.name}: heights of {grid.rows:,} rows") as progress:
            self._survey = survey_heights(file, file.path.name, progress)
        self._pages = PagedTerrain(file, self._survey, file.path.name)
        self.bounds, self.origin = self._survey.bounds, self._survey.origin
        self.middle = frame_origin(*self.bounds)
        self.meshes = [MeshInfo(file.name, self.n_triangles, 1)]
        self.objects = [ObjectInfo(file.name, 0, 0, TERRAIN_TYPE)]
        self.notes, self._cameras, self._lights = tuple(file.notes()), list[Camera](), list[Light]()
        rows, columns = (slice(each.start // PAGE, -(-each.stop // PAGE)) for each in self.window.slices)
        self._bottom = float(self._survey.lows[rows, columns].min()) - self.origin[2]  # height in the window

    @property
    def n_triangles(self) -> int:
        return int(self._survey.triangles.sum())

    @property
    def terrain(self) -> Any:
        """The file, whose heights are read where they are needed, in place of a `HeightGrid`."""
        return self.file

    @property
    def object_of_face(self) -> NDArray[np.int32]:
        """(n,) int32, all 0, a read-only broadcast array."""
        return np.broadcast_to(np.int32(0), self.n_triangles)

    def terrain_towards(self, offsets: NDArray[np.float64] | None, height: float, *_: Any) -> BorderedTerrain:
        """The terrain that rays from the window may meet.

        offsets : (n, 3) from the begin to the end of each ray; None: any, so that all of the raster is read
        height : the lowest one at which some of the rays begin, in the frame

        Raises
        ------
        InputError
            If it does not fit into memory.
        """
        pages, limit = self._pages, memory_limit()
        part = pages.whole if offsets is None else pages.reached(offsets, min(height, self._bottom), self.window)
        if (terrain := pages.read(part, np.inf if limit is None else limit)) is not None:
            return terrain
        assert limit is not None
        raise InputError(
            f"{self.file.path.name}: {part.n_cells:,} cells around these sensors and up to the far horizon take "
            f"about {readable_size(PAGED_BYTES * part.n_cells)} of memory, more than {readable_size(limit)}; raise "
            "--max-memory, give --bounds of fewer cells, or --lowest of a higher sun"
        )

    def cell_tops(self, window: CellWindow | None = None) -> tuple[NDArray[np.float64], NDArray[np.integer]]:
        return self._pages.cell_tops(window)

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        """As that of the scene in memory."""
        yield repr((self.file.grid, self.origin.tolist())).encode()
        yield self._survey.digest

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """Always raises InputError: there are none."""
        raise self.refusal()

    def refusal(self) -> InputError:
        """The error raised by what needs triangles."""
        return InputError(
            f"{self.file.path.name}: its triangles do not fit into memory, and this needs them; study its own cells "
            "(--sensors raster), cut it with gdal_translate -projwin, or raise --max-memory"
        )


def open_raster(
    path: Path, unit: str | None = None, bounds: Sequence[float] | None = None, **keywords: Any
) -> AnyScene:
    """The scene of a raster file: `LargeTerrain` if another one does not fit into memory.

    bounds : of the cells that will have sensors, (x0, n0, x1, n1); None: all
    keywords : of `antumbra.from_raster`

    Raises
    ------
    InputError
        If the file cannot be read, or not even `LargeTerrain` fits.
    """
    file, limit = height_file(path, {**keywords, "unit": unit}), memory_limit()
    cells = file.grid.rows * file.grid.columns
    if limit is None or CELL_BYTES * cells <= limit:
        return from_raster(path, unit=unit, **keywords)
    raster, window = file.grid.raster(file.crs), None
    if bounds is not None and raster is not None:
        window = window_within(raster, bounds)
    elif PAGED_BYTES * cells > limit:
        raise InputError(
            f"{path.name}: {cells:,} cells take about {readable_size(PAGED_BYTES * cells)} of memory, more than "
            f"{readable_size(limit)}; raise --max-memory, or study some with --bounds"
        )
    data = LargeTerrain(file, unit, window)
    whole, most = readable_size(CELL_BYTES * cells), readable_size(limit)
    data.notes += (f"{path.name}: {cells:,} cells take about {whole} at once, more than {most}; studied by block",)
    return Scene.of_data(data)
