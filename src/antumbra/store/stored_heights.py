"""The heights of terrain in a store: a section after the chunks, from which rays over terrain are traced as in memory.

Rows follow one another as they were read, in float32 or float64. Each band of rows has a checksum in the metadata; that
of the last one includes the zeros up to the next page.
"""

import zlib
from collections.abc import Callable
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.progress import report_progress
from ..scene.height_surveys import survey_heights
from ..scene.raster import CellWindow, Raster
from ..scene.terrain import Heights, HeightsByRow
from ..trace.terrain.bordered_terrain import BorderedTerrain
from ..trace.terrain.paged_terrain import PAGED_BYTES, PagedTerrain
from .store_format import BAND, HeightSection

_DTYPES = "<f4", "<f8"


def write_heights(stream: BinaryIO, surface: Heights, page: int) -> HeightSection:
    """Append the heights of a surface, band by band, and zeros up to a multiple of `page` bytes."""
    grid, dtype = surface.grid, _DTYPES[surface.dtype != np.float32]
    begin, crcs = stream.tell(), list[int]()
    size = grid.rows * grid.columns * np.dtype(dtype).itemsize
    for first in range(0, grid.rows, BAND):
        last = min(first + BAND, grid.rows)
        data = np.ascontiguousarray(surface.rows(first, last), dtype).tobytes()
        data += bytes(-size % page) if last == grid.rows else b""
        crcs.append(zlib.crc32(data))
        stream.write(data)
    return HeightSection(begin, stream.tell() - begin, grid, dtype, tuple(crcs))


def section_fault(section: HeightSection, raster: Raster | None, most_cells: int) -> str:
    """The first fault of a section, whose fields may be anything, in words; "" if there is none."""
    grid, sizes = section.grid, (section.offset, section.bytes, section.grid.rows, section.grid.columns)
    place = np.array([grid.west, grid.north, grid.dx, grid.dy], np.float64)
    if not all(type(each) is int for each in (*sizes, *section.crcs)) or not np.isfinite(place).all():
        return "its heights have no place"
    rows, columns = grid.rows, grid.columns
    if min(grid.dx, grid.dy) <= 0.0 or min(rows, columns) < 2 or rows * columns > most_cells:
        return f"its heights have {columns} x {rows} points"
    if section.dtype not in _DTYPES or len(section.crcs) != -(-rows // BAND):
        return f"its heights are {str(section.dtype)[:9]!r} in {len(section.crcs)} bands"
    size = rows * columns * np.dtype(section.dtype).itemsize
    if not size <= section.bytes < size + (1 << 16):
        return f"its heights have {section.bytes} bytes, and {rows * columns} points"
    if raster is not None and raster != grid.raster(raster.crs):
        return "its heights do not lie in its raster"
    return ""


class StoredHeights(HeightsByRow):
    """The heights in a store: `scene.terrain.Heights`.

    name : of the scene
    read : fills a view with the bytes of the file from an offset on, and returns their number
    damaged : makes the error about heights that are damaged, from words
    """

    def __init__(
        self, name: str, crs: str | None, section: HeightSection, read: Callable[[memoryview, int], int],
        damaged: Callable[[str], InputError],
    ):  # fmt: skip
        self.name, self.grid, self.crs, self.dtype = name, section.grid, crs, np.dtype(section.dtype)
        self._section, self._read, self.damaged = section, read, damaged
        self._bands: dict[int, NDArray[Any]] = {}  # the last ones that were read, by number

    def rows(self, first: int, last: int) -> NDArray[Any]:
        """(last - first, columns) float32 or float64: heights of some rows, perhaps read-only; NaN: no data."""
        if first % BAND == 0 and last == min(first + BAND, self.grid.rows):
            return self._band(first // BAND)
        heights = np.empty((last - first, self.grid.columns), self.dtype)
        while first < last:
            part = self._band(first // BAND)[first % BAND :][: last - first]
            heights[len(heights) - (last - first) :][: len(part)] = part
            first += len(part)
        return heights

    def _band(self, k: int) -> NDArray[Any]:
        """The heights of a band; the last two are kept, since blocks of terrain share a row."""
        if k not in self._bands:
            offset, size = self._section.band(k)
            data = np.empty(size, np.uint8)
            try:
                n_read = self._read(data.data, offset)
            except OSError as error:
                raise self.damaged(f"cannot be read ({error.strerror or error})") from None
            if n_read < size or zlib.crc32(data.data) != self._section.crcs[k]:
                raise self.damaged("are damaged")
            rows = min(BAND, self.grid.rows - k * BAND)
            values = data[: rows * self.grid.columns * self.dtype.itemsize].view(self.dtype)
            values = values.reshape(rows, self.grid.columns)
            if np.isinf(values).any():
                raise self.damaged("are infinite")
            values.flags.writeable = False
            self._bands = {**dict(list(self._bands.items())[-1:]), k: values}
        return self._bands[k]

    def check(self) -> None:
        """Read all bands. Raises the InputError of the first one that is damaged."""
        for k in range(len(self._section.crcs)):
            self._bands = {}
            self._band(k)


class StoredTerrain:
    """The terrain that is the scene of a store.

    bounds, n_triangles : of the scene, which must be those of the heights
    """

    def __init__(self, heights: StoredHeights, bounds: NDArray[np.float64], n_triangles: int):
        self.heights, self._bounds, self._n_triangles = heights, bounds, n_triangles

    @cached_property
    def pages(self) -> PagedTerrain:
        """The heights, once all of them have been read. InputError if they are not those of the triangles."""
        heights = self.heights
        with report_progress(f"{heights.name}: heights of {heights.grid.rows:,} rows") as progress:
            survey = survey_heights(heights, heights.name, progress, is_digested=False)
        if not (np.array_equal(survey.bounds, self._bounds) and survey.triangles.sum() == self._n_triangles):
            raise heights.damaged("are not those of its triangles")
        return PagedTerrain(heights, survey, heights.name)

    def towards(
        self, offsets: NDArray[np.float64] | None, height: float, window: CellWindow | None, room: Callable[[], float]
    ) -> BorderedTerrain | None:
        """The terrain that rays may meet; None if it does not fit into memory.

        offsets : (n, 3) from the begin to the end of each ray; None: any
        height : the lowest one at which some of the rays begin, in the frame
        window : the cells over which they begin; None: not known
        room : finds the bytes of memory that are left
        """
        pages = self.pages
        if (terrain := pages.read(pages.whole, 0.0)) is not None:
            return terrain
        most = room() + pages.held
        if offsets is None or window is None or PAGED_BYTES * pages.whole.n_cells <= most:
            return pages.read(pages.whole, most)
        return pages.read(pages.reached(offsets, height, window), most)
