"""`save_raster_viewshed`: the viewshed of the cells of a raster file, in bands, without the scene's triangles.

It needs about 5 bytes a cell, and an eighth for each observer, where `viewshed` needs 64 or more. The GeoTIFF is that
of the table of `viewshed`, band for band and bit for bit.
"""

import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import number
from ...base.errors import InputError
from ...base.files import checked_output
from ...base.memory import available_memory, readable_size
from ...base.progress import ProgressCallback
from ...base.wording import counted, place_text
from ...engine.measured_scenes import measured_scene
from ...engine.precompilation import precompile
from ...engine.scene import Scene
from ...kernels.parallel import thread_count
from ...query.receivers import Receivers, receivers_above
from ...scene.raster import Raster
from ...trace.terrain.terrain_views import SEEN, UNDECIDED, decided, view_from
from ...work.result_summary import Summary
from ..gis.height_files import HeightFile
from ..gis.height_grounds import HeightGround, height_ground, plane_of
from ..sensors.point_checks import notes_on_bare_points, notes_on_points, tell
from ..sensors.sensors import Sensors, point_sensors
from ..tables.result_table import BANDS
from .observers import Observers, observers_of
from .viewshed_options import ViewshedOptions

CELL_BYTES = 64
"""Memory of a cell of a raster in `viewshed`, with its scene, if sensors are made and written by block."""

CURVED_BYTES = 112
"""Memory of a cell with the lowered copy of the scene."""

TABLE_BYTES = 200
"""Memory of a cell if the table is in memory."""

_BANDS = "seen", "first", "nearest", "distance"
_ROWS = 256  # written at a time; a multiple of the blocks of the file
_LEAST = 400e6  # bytes, apart from the cells
_UNDECIDED = 1 << 20  # cells at a time


class RasterNeed(NamedTuple):
    """The memory that a viewshed of a raster file takes."""

    cells: int
    observers: int

    def whole(self, by_block: bool, curved: bool) -> float:
        """Bytes of `viewshed`; `by_block`: its table is never in memory."""
        return _LEAST + (TABLE_BYTES if not by_block else CURVED_BYTES if curved else CELL_BYTES) * self.cells

    def banded(self, in_memory: bool) -> float:
        """Bytes of `save_raster_viewshed`, with the heights in memory or in a scratch file."""
        return _LEAST + self.cells * ((5.3 if in_memory else 1.3) + self.observers / 8)

    def check(self, name: str, limit: float) -> None:
        """Raise an InputError if not even bands fit; `name`: of the raster."""
        if self.banded(False) > limit:
            raise InputError(
                f"{name}: a viewshed of {self.cells:,} cells and {counted(self.observers, 'observer')} takes about "
                f"{readable_size(self.banded(False))} of memory, more than {readable_size(limit)}; give fewer "
                "observers, raise --max-memory, or cut the raster with gdal_translate -projwin"
            )


class RasterViewshed(NamedTuple):
    """What observers see of a raster file, in a GeoTIFF."""

    observers: NDArray[np.float64]  # (k, 3) the eyes
    sensors: int  # cells with a surface
    seen: int  # by any observer
    cell_area: float  # m2

    def summary(self, scene: str, seconds: float) -> Summary:
        """How many cells are seen, and their area, as `Viewshed.summary`."""
        values: dict[str, Any] = {"scene": scene, "sensors": self.sensors, "observers": len(self.observers)}
        values |= {"seen": self.seen, "seconds": seconds}
        values |= {"area": self.cell_area * self.sensors, "area_seen": self.cell_area * self.seen}
        share = 100.0 * self.seen / max(self.sensors, 1)
        lines = [("sensors", f"{self.sensors:,}"), ("observers", f"{len(self.observers):,}")]
        lines.append(("seen by any", f"{self.seen:,} ({share:.1f} %)"))
        lines.append(("area seen", f"{values['area_seen']:,.6g} of {values['area']:,.6g} m2"))
        return Summary(values, lines)


def save_raster_viewshed(
    file: HeightFile, output: str | os.PathLike[str], observers: ArrayLike | Sensors, options: ViewshedOptions,
    progress: ProgressCallback, height: float = 0.0, max_memory: int | None = None,
) -> RasterViewshed:  # fmt: skip
    """Write the viewshed of the cells of a raster file as a GeoTIFF or in Zarr.

    Parameters
    ----------
    file : HeightFile
    output : str or path-like
        A .tif or .zarr file with the bands ``seen``, ``first``, ``nearest`` and ``distance``; NaN: no surface.
    observers : (3,) or (k, 3) float, or Sensors
        As for `antumbra.viewshed`.
    options : ViewshedOptions
        Without `curvature`, `bits`, `each` and `least_height`.
    height : float
        Of the sensors above the cells, world units.
    max_memory : int, optional
        Bytes. Heights that do not fit go to a scratch file beside the output. None: what is available.

    Raises
    ------
    InputError
        If an option is not supported, the raster has no square cells, it cannot fit, or an observer is not above the
        surface.

    Warns
    -----
    UserWarning
        As `antumbra.viewshed`, for observers.
    """
    target, height = checked_output(output, tuple(BANDS)), number(height, "the height of sensors")
    raster = file.grid.raster(file.crs)
    if raster is None:
        raise InputError(f"{file.path.name}: its cells are not square; warp it to square cells: gdalwarp -tr SIZE SIZE")
    for name in ("curvature", "each", "bits", "least_height"):
        if getattr(options, name):
            raise InputError(
                f"{file.path.name}: {name} needs its cells in memory at once; leave it out, or cut the raster"
            )
    measured_scene(Scene.of_data(plane_of(file)))
    rows = observers if isinstance(observers, Sensors) else point_sensors(np.atleast_2d(np.asarray(observers)))
    limit, need = max_memory or available_memory() or np.inf, RasterNeed(raster.n_cells, len(rows))
    need.check(file.path.name, limit)
    scratch = None if need.banded(True) <= limit else target
    threads = thread_count(options.threads)
    precompile("terrain views")
    with height_ground(file, scratch, lambda done, total: progress(done, 3 * total)) as ground:
        seers, notes = _observers(ground, rows, options)
        warned = tell(notes)
        bits = [_seen_by(ground, raster, seers.eyes[k], height, threads) for k in range(len(rows))]
        about: dict[str, Any] = {"job": "viewshed", "observers": len(rows)}
        recorded = "eye_height", "min_distance", "max_distance", "azimuth", "elevation"
        about |= {name: getattr(options, name) for name in recorded} | warned
        unit = Scene.of_data(ground.window(seers.eyes[0, :2])).unit
        about = {"length_unit": unit.name, "up": "z", **about}
        about = about if file.crs is None else {"crs": file.crs, **about}
        units = {"seen": "", "first": "", "nearest": "", "distance": unit.name}
        sensors = seen = 0
        with BANDS[target.suffix.lower()](target, raster, units, about) as write:
            for first, part in _parts(ground, raster, seers, bits, height):
                write(first, part)
                progress(2 * raster.rows + first, 3 * raster.rows)
                sensors += int((part[0] >= 0.0).sum())  # NaN: no surface
                seen += int((part[0] > 0.0).sum())
    return RasterViewshed(seers.eyes, sensors, seen, raster.area * unit.square_metres)


def _observers(ground: HeightGround, rows: Sensors, options: ViewshedOptions) -> tuple[Observers, list[str]]:
    """The observers, each from the window around it; and notes about them."""
    each, notes = list[Observers](), list[str]()
    for k in range(len(rows)):
        scene = Scene.of_data(ground.window(rows.points[k, :2]))
        each.append(observers_of(scene, rows.take(np.array([k])), options))
        notes += notes_on_points(scene, each[-1].eyes, "observers")
        notes += notes_on_bare_points(scene, each[-1].eyes, "observers")
    names = tuple(str(k + 1) for k in range(len(each)))
    return Observers(np.concatenate([one.eyes for one in each]), names, [one.limits[0] for one in each]), notes


def _seen_by(
    ground: HeightGround, raster: Raster, eye: NDArray[np.float64], height: float, threads: int
) -> NDArray[np.uint8]:
    """Packed bits, row by row: the cells that an eye sees, without limits; exact."""
    at = Receivers.in_space(eye[None], ground.origin).origins[0, 0]
    classes = view_from(ground.ground, at, height, threads)
    if classes is None:
        where = place_text(eye)
        raise InputError(
            f"{ground.file.path.name}: the eye at {where} is not above the surface; raise it with --eye-height"
        )
    for first in range(0, raster.rows, _ROWS):
        part = classes[first : first + _ROWS]
        open_cells = np.flatnonzero((part == UNDECIDED) & ~np.isnan(ground.ground.z[first : first + _ROWS]))
        part[part == UNDECIDED] = 0
        heights = ground.heights(first, first + len(part)).reshape(-1) if len(open_cells) else np.empty(0)
        for some in np.split(open_cells, range(_UNDECIDED, len(open_cells), _UNDECIDED)):
            cells = some + first * raster.columns
            points = raster.places(cells, "z")
            points[:, 2] = heights[some] + height
            receivers = receivers_above(points, 2, ground.origin, ground.origin).origins[0]
            part.reshape(-1)[some] = decided(ground.ground, at, cells, receivers, threads)
    return np.packbits(classes == SEEN, axis=1)


def _parts(
    ground: HeightGround, raster: Raster, observers: Observers, bits: list[NDArray[np.uint8]], height: float
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Yield (first row, (bands, rows, columns) float32) for all rows; the array is used again."""
    part, is_unseen = np.empty((len(_BANDS), 0, raster.columns), np.float32), False
    for first in range(0, raster.rows, _ROWS):
        last = min(first + _ROWS, raster.rows)
        if part.shape[1] != last - first:
            part, is_unseen = np.empty((len(_BANDS), last - first, raster.columns), np.float32), False
        if not is_unseen:
            for band, value in zip(part, (0.0, -1.0, -1.0, np.nan)):
                band[:] = value
        is_unseen = True
        if any(each[first:last].any() for each in bits):
            is_unseen = False
            heights, distances = ground.heights(first, last).reshape(-1), np.full(part[0].size, np.inf)
            seen, lowest, nearest, shown = part.reshape(len(part), -1)
            for k, limits in enumerate(observers.limits):
                at = np.flatnonzero(np.unpackbits(bits[k][first:last], axis=1, count=raster.columns))
                points = raster.places(at + first * raster.columns, "z")
                points[:, 2] = heights[at] + height
                away = points - observers.eyes[k]
                distance = np.sqrt((away * away).sum(1))
                inside = limits.includes(away, distance, "z")
                at, distance = at[inside], distance[inside]
                seen[at] += 1.0
                lowest[at] = np.where(lowest[at] < 0.0, np.float32(k), lowest[at])
                nearer = distance < distances[at]
                distances[at[nearer]], nearest[at[nearer]], shown[at[nearer]] = distance[nearer], k, distance[nearer]
        if np.isnan(ground.ground.z[first:last].min()):
            is_unseen = False
            part[:, np.isnan(ground.ground.z[first:last])] = np.nan
        yield first, part
