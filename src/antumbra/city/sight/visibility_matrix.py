"""`visibility_matrix`: mutual visibility of many points, one bit per pair, traced in tiles by a few large queries.

A tile covers all sightlines between two strips of points. One strip becomes lists of point lights, which are tested
from all points of the other strip. Both strips follow a space-filling curve, so their sightlines form thin bundles.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import whole_number
from ...base.errors import InputError
from ...base.files import atomic_output, check_disk_space, checked_output
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted
from ...engine.measured_scenes import measured_scene
from ...engine.plan import Plan
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...engine.small_scenes import UP
from ...kernels.parallel import thread_count
from ...query.query_bounds import morton_codes
from ...query.receivers import Receivers
from ...scene.light_lists import PointLights
from ...scene.lights import MAX_SPP, LightPatch
from ...trace.terrain.terrain_views import UNDECIDED, Over
from ...work.executors import Keep, checked_keep, executor_of
from ...work.result_summary import Summary
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts, inexact_plan
from ..sensors.point_checks import notes_on_sensors, tell
from ..sensors.sensor_files import sensors_of
from ..sensors.sensors import Sensors, sensors_from, sightline_ends
from ..tables.bit_matrices import (
    RowFile,
    full_row,
    reorder_bits,
    row_file_size,
    sparse_matrix,
    transpose_bits,
    unpack_bits,
    words_of,
    write_rows,
    write_sparse,
)
from .mutual_horizons import hidden_by_horizons
from .sight_options import MatrixOptions

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_P = ParamSpec("_P")

# --- Tiles ------------------------------------------------------------------------------------------------------------


_VIEWS = 1 << 30  # bytes of views that are kept
STRIP = 4096
"""Points per strip: a multiple of MAX_SPP. A tile has 2 MiB of bits."""


class TileTracer:
    """Traces tiles in a scene at one time.

    sightlines : int
        Approximate number of sightlines in all tiles.
    """

    def __init__(self, scene: AnyScene, plan: str | Plan | None, time: float, threads: int | None, sightlines: int):
        self._engine, self._time, self._sightlines = scene.engine.with_options(plan, threads, None), time, sightlines
        self._views: dict[tuple[bytes, float], NDArray[np.uint8]] = {}  # (eye, far) -> what it sees of all cells
        self._height: float | None = None  # of the sensors of views

    @property
    def prefers_rows(self) -> bool:
        """Whether points in rows of a raster are traced faster than in any other order."""
        return self._engine.prefers_rows

    def over(self, rows: Receivers, cells: NDArray[np.int64] | None) -> Over | None:
        """How sensors lie above cells of a raster of heights, for `view`; None for other points and scenes.

        cells : (n,) row * columns + column; None: all
        """
        terrain = self._engine.terrain
        over = None if terrain is None else terrain.over(rows, cells, self._height)
        self._height = self._height if over is None else over.height
        return over

    def view(
        self, over: Over, cells: NDArray[np.int64] | None, eye: NDArray[np.float32], far: float
    ) -> NDArray[np.uint8] | None:
        """(n,) uint8: what an eye surely sees of the sensors of `over`, of `terrain_views`.

        The view of an eye is kept for other cells. None: it has none, or more views of some cells than can be kept.
        """
        terrain = self._engine.terrain
        assert terrain is not None  # as it has sensors
        grid = terrain.pyramid.surface.grid
        kept = (len(self._views) + 1) * grid.rows * grid.columns <= _VIEWS
        classes = self._views.get((eye.tobytes(), far))
        if classes is None and (kept or cells is None):
            classes = terrain.view(eye, over.height, far)
            if classes is not None and cells is not None:
                self._views[eye.tobytes(), far] = classes
        return (
            None if classes is None else np.where(over.there, classes if cells is None else classes[cells], UNDECIDED)
        )

    def visible(self, rows: Receivers, columns: Receivers) -> NDArray[np.uint64]:
        """(n, words of m) uint64: bit j of row i is set where points i and j see each other."""
        hidden = hidden_by_horizons(rows, columns, self._engine.threads)
        for first in range(0, columns.n, MAX_SPP):
            light = _Recentred(columns.origins[0, first : first + MAX_SPP])
            blocked = hidden[None, :, words_of(first) : words_of(first + MAX_SPP)]
            options: dict[str, Any] = {"time": self._time, "later": self._sightlines, "whole": True, "known": [blocked]}
            (traced,) = self._engine.shadows(rows, [light], [_samples(light)], **options)
            blocked |= traced.bits
        return ~hidden & full_row(columns.n)


class _Recentred(PointLights):
    """Point lights whose positions are already in the recentred float32 frame, so they are not moved again."""

    def patch(self, origin: np.ndarray, reach: float) -> LightPatch:
        return super().patch(np.zeros(3), reach)


def _samples(light: PointLights) -> NDArray[np.float64]:
    """(16, k, 3) float64: sample sets with which each receiver tests all lights."""
    return np.ascontiguousarray(light.points[light.sets])


# --- Visibility matrices ----------------------------------------------------------------------------------------------


_MOST = 1 << 31  # maximum bytes of a matrix in memory
_ROWS = 256  # rows reordered at a time


@dataclass(eq=False)
class VisibilityMatrix:
    """Which of n points see which of m targets.

    bits : (n, ceil(m / 64)) uint64
        Bit ``j % 64`` of word ``j // 64`` of row i is set if point i and target j see each other. Bits beyond the last
        target are 0. A streamed file is memory-mapped, read-only.
    columns : int
        m.
    counts : (n,) int64
        The number of targets that each point sees.
    """

    bits: np.ndarray
    columns: int
    counts: np.ndarray

    def __post_init__(self) -> None:
        self.columns = whole_number(self.columns, "columns", 0, 2**63 - 1)
        rows = getattr(self.bits, "shape", (0,))[:1]
        for name, shape in (("bits", (*rows, words_of(self.columns))), ("counts", rows)):
            if not isinstance(getattr(self, name), np.ndarray) or getattr(self, name).shape != shape:
                raise InputError(f"{name} of a matrix must be an array of shape {shape}")

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.bits), self.columns

    def __repr__(self) -> str:
        return f"VisibilityMatrix({self.shape[0]} x {self.columns}, {counted(int(self.counts.sum()), 'visible pair')})"

    def rows(self, first: int = 0, last: int | None = None) -> NDArray[np.bool_]:
        """(rows, m) bool: the rows from `first` to `last`, exclusive; None: to the end."""
        first = whole_number(first, "the first row", 0, len(self.bits))
        last = None if last is None else whole_number(last, "the last row", 0, len(self.bits))
        return unpack_bits(self.bits[first:last], self.columns)

    def sparse(self) -> "csr_array":
        """The visible pairs as a ``scipy.sparse.csr_array`` of bool. It needs the extra ``sparse``."""
        return sparse_matrix(self.bits, self.columns, self.counts)

    def summary(self, scene: str, seconds: float) -> Summary:
        """The size of the matrix, and the pairs that see each other; `seconds`: of the study."""
        (rows, columns), visible = self.shape, int(self.counts.sum())
        values = {"scene": scene, "rows": rows, "columns": columns, "visible": visible, "seconds": seconds}
        share = 100.0 * visible / max(rows * columns, 1)
        return Summary(
            values, [("matrix", f"{rows:,} x {columns:,}"), ("visible", f"{counted(visible, 'pair')} ({share:.2f} %)")]
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write the matrix: .npy stores `bits`, .npz the sparse matrix, for ``scipy.sparse.load_npz``.

        Raises
        ------
        InputError
            If the suffix is neither, or the path cannot be written.
        """
        target = checked_output(path, (".npy", ".npz"))
        with atomic_output(target) as temporary:
            if target.suffix.lower() == ".npy":
                write_rows(temporary, self.bits)
                return
            with open(temporary, "wb") as file:
                write_sparse(file, self.bits, self.columns, self.counts)


class _Grid(NamedTuple):
    """The tiles of a matrix; both sets of points are in curve order."""

    rows: Receivers
    columns: Receivers
    row_order: np.ndarray  # (n,) int64: original index of each row
    column_order: np.ndarray
    tiles: list[tuple[int, int]]  # strip of rows, strip of columns
    square: bool  # points with themselves: tiles below the diagonal are mirrored


@with_keywords(MatrixOptions, 3)
@with_progress
def visibility_matrix(
    given: Given[_P], scene: SceneLike, sensors: ArrayLike | Sensors | str,
    targets: ArrayLike | Sensors | str | None = None, normals: ArrayLike | None = None,
    target_normals: ArrayLike | None = None, output: str | PathLike[str] | None = None, keep: Keep = None,
    progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> VisibilityMatrix:  # fmt: skip
    """Find which points see which targets. Every result is exact.

    A point and a target see each other if no triangle meets the segment between them, strictly between its ends, and
    neither lies below the horizon of the other, where that has a normal.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : (n, 3) float, Sensors, or str
        World coordinates. Sensors on surfaces have normals: ``at.face_sensors(scene)`` gives a matrix of faces.
        A text is as in `antumbra.sensors_of`.
    targets : (m, 3) float, Sensors, or str, optional
        None: the sensors themselves. Each pair is then traced once, and no sensor sees itself.
    normals, target_normals : (3,) or (..., 3) float, optional
        For points on surfaces, towards the visible side: each is moved off its surface by a few units in the last
        place. Without normals, points lie in free space and are used unchanged.
    output : str or path-like, optional
        A .npy file to which the matrix is streamed, so that memory stays bounded. Finished tiles are stored in a folder
        beside it, from which the same call resumes after an interruption. None: the matrix is computed in memory.
    keep : str, path-like or executor, optional
        Folder for finished tiles, instead of the one beside `output`, or an executor for the tiles; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    VisibilityMatrix
        None if the executor leaves tiles to other shards.

    Raises
    ------
    InputError
        If an argument is invalid, points are in degrees, or a matrix in memory would take more than 2 GiB.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[-9, 5, 0], [9, 5, 0], [9, 5, 3], [-9, 5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> pairs = at.visibility_matrix(wall, [[0, 2, 1], [0, 9, 1]], [[2, 0, 1], [2, 9, 1], [2, 5, 4]])
    >>> pairs.rows()
    array([[ True, False,  True],
           [False,  True,  True]])
    """
    options, scene = MatrixOptions(**given(*args, **keywords)), measured_scene(scene)
    plan, threads, time = options.plan, thread_count(options.threads), scene.clamped(options.time)
    keep = checked_keep(keep)
    path = None if output is None else checked_output(output, (".npy",))
    sources = sensors_from(scene, _named(sensors, scene, threads), normals, "sensors")
    others = None
    if targets is not None:
        others = sensors_from(scene, _named(targets, scene, threads), target_normals, "targets")
    if others is None and target_normals is not None:
        raise InputError("target_normals need targets; give the points' own normals as normals")
    n, m = len(sources), len(sources if others is None else others)
    if path is None and 8 * n * words_of(m) > _MOST:
        raise InputError(f"a matrix of {n} x {m} bits takes {n * m / 8e9:.1f} GB; give an output to stream it to")
    if path is not None:
        check_disk_space(path, row_file_size((n, words_of(m))))
    for each, what in ((sources, "sensors"), *([] if others is None else [(others, "targets")])):
        tell(notes_on_sensors(scene, each, what, time, threads))
    rows = sightline_ends(scene, sources)
    grid = _grid(rows, rows if others is None else sightline_ends(scene, others), others is None)
    if keep is None and path is not None:
        keep = path.with_name(path.name + ".parts")
    executor = executor_of(keep)
    sightlines = len(grid.tiles) * STRIP * STRIP
    tracing = cache(lambda: TileTracer(scene, plan, time, threads, sightlines))  # created for the first tile
    work = lambda first, last: {"bits": _tile(tracing(), grid, first)}
    about = None if executor.folder is None else _about(scene, grid, time, plan)
    parts = Parts(f"lines of sight: {n} x {m}", len(grid.tiles), 1, work, executor.folder, about)
    if not executor.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    if path is None:
        bits = np.empty((n, words_of(m)), np.uint64)
        counts = _assemble(grid, parts, bits)
    else:
        with atomic_output(path) as temporary:
            counts = _stream(grid, parts, temporary, (n, words_of(m)))
        bits = np.load(path, mmap_mode="r")
    executor.end([parts])
    return VisibilityMatrix(bits, m, counts)


def _named(sensors: ArrayLike | Sensors | str, scene: AnyScene, threads: int) -> ArrayLike | Sensors:
    """The sensors that a text names; any other value unchanged."""
    return sensors_of(sensors, scene, threads) if isinstance(sensors, str) else sensors


def _grid(rows: Receivers, columns: Receivers, square: bool) -> _Grid:
    row_order, column_order = (np.argsort(morton_codes(ends.origins[0]), kind="stable") for ends in (rows, columns))
    high, wide = (-(-ends.n // STRIP) for ends in (rows, columns))
    tiles = [(i, j) for i in range(high) for j in range(i if square else 0, wide)]
    return _Grid(rows.take(row_order), columns.take(column_order), row_order, column_order, tiles, square)


def _about(scene: AnyScene, grid: _Grid, time: float, plan: str | Plan | None) -> dict[str, str]:
    ends = [array for end in (grid.rows, grid.columns) for array in end]
    return about_parts(
        "lines of sight", scene_digest(scene, scene.clamped(time)), inexact_plan(plan), grid.square, *ends
    )


def _tile(tracing: TileTracer, grid: _Grid, k: int) -> np.ndarray:
    """The bits of tile k, except those of points with themselves."""
    i, j = grid.tiles[k]
    rows, columns = grid.rows.take(_strip(i)), grid.columns.take(_strip(j))
    bits = tracing.visible(rows, columns)
    if grid.square and i == j:
        diagonal = np.arange(rows.n)
        bits[diagonal, diagonal // 64] &= ~(np.uint64(1) << (diagonal % 64).astype(np.uint64))
    return bits


def _strip(i: int) -> slice:
    return slice(i * STRIP, (i + 1) * STRIP)


def _strips(grid: _Grid, parts: Parts) -> Iterator[tuple[NDArray[np.int64], NDArray[np.uint64]]]:
    """Yield (row indices, their bits), a few hundred rows at a time, with columns in their original order."""
    back = np.argsort(grid.column_order)
    at = {tile: k for k, tile in enumerate(grid.tiles)}
    n, m = grid.rows.n, grid.columns.n
    for i in range(-(-n // STRIP)):
        numbers = grid.row_order[_strip(i)]
        tiles = []
        for j in range(-(-m // STRIP)):
            tile_bits = parts[at[min(i, j), max(i, j)] if grid.square else at[i, j]]["bits"]
            tiles.append(transpose_bits(tile_bits, len(numbers)) if grid.square and j < i else tile_bits)
        bits = np.hstack([np.empty((len(numbers), 0), np.uint64), *tiles])
        for first in range(0, len(numbers), _ROWS):
            yield numbers[first : first + _ROWS], reorder_bits(bits[first : first + _ROWS], back)


def _assemble(grid: _Grid, parts: Parts, out: np.ndarray) -> np.ndarray:
    """Write the matrix to `out`; return the number of set bits per row."""
    counts = np.zeros(len(out), np.int64)
    for numbers, bits in _strips(grid, parts):
        out[numbers] = bits
        counts[numbers] = np.bitwise_count(bits).sum(1)
    return counts


def _stream(grid: _Grid, parts: Parts, path: Path, shape: tuple[int, int]) -> np.ndarray:
    """Write the matrix to a .npy file; return the number of set bits per row."""
    counts = np.zeros(shape[0], np.int64)
    with RowFile(path, shape) as file:
        for numbers, bits in _strips(grid, parts):
            counts[numbers] = np.bitwise_count(bits).sum(1)
            file.put(numbers, bits)
    return counts


def _example() -> None:
    """The bits of matrices, without their rays."""
    ends = Receivers.on_surface(np.zeros((1, 3)), UP, np.zeros(3))
    hidden_by_horizons(ends, ends, 1)
    reorder_bits(np.zeros((1, 1), np.uint64), np.zeros(1, np.int64), 1)


EXAMPLES = {"visibility matrices": _example}
"""The example calls of this study."""
