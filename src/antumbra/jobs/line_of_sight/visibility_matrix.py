"""`visibility_matrix`: mutual visibility of many points, one bit per pair, traced in tiles of large queries.

A strip of targets becomes lists of point lights for all points of the other strip. Both strips follow a space-filling
curve, so that their sightlines form thin bundles.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...checks import whole_number
from ...engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike, scene_of
from ...errors import InputError
from ...files import atomic_output, check_disk_space, checked_output
from ...kernels.parallel import thread_count
from ...progress import Progress, with_progress
from ...query.query_bounds import morton_codes
from ...query.receivers import Receivers
from ...query.shadow_query import below_horizon
from ...scene.light_lists import PointLights
from ...scene.lights import MAX_SPP
from ..bit_matrices import (
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
from ..executors import checked_keep, executor_of
from ..scene_records import scene_digest
from ..sensor_files import sensors_of
from ..sensors import Sensors, sensors_from, sightline_ends
from ..work_parts import Parts, about_parts, inexact_plan

# --- Tiles of a visibility matrix: all sightlines between two strips of points, by few large queries ------------------
#
# A strip of targets becomes lists of point lights, which all points of the other strip ask. Both strips are in the
# order of a space-filling curve, so that their sightlines form thin bundles.


STRIP = 4096
"""Points of a strip: a multiple of MAX_SPP. A tile has 2 MiB of bits."""


class TileTracer:
    """A scene at one time, ready for tiles.

    sightlines : int
        About so many in all.
    """

    def __init__(self, scene: AnyScene, plan, time: float, threads: int | None, sightlines: int):
        self._engine, self._time, self._sightlines = scene.engine.with_options(plan, threads, None), time, sightlines

    def visible(self, rows: Receivers, columns: Receivers) -> np.ndarray:
        """(n, words of m) uint64: bit j of row i is set where points i and j see each other."""
        blocked = np.empty((rows.n, words_of(columns.n)), np.uint64)
        for first, light in self._lists(columns):
            ((_, bits),) = self._engine.shadows(
                rows, [light], [_samples(light)], time=self._time, later=self._sightlines
            )
            blocked[:, first : first + bits.shape[2]] = bits[0]
        if columns.normals.size:
            blocked |= transpose_bits(self._below(columns, rows), rows.n)
        return ~blocked & full_row(columns.n)

    def _below(self, ends: Receivers, others: Receivers) -> np.ndarray:
        """(n, words of m) uint64: bit j of row i is set where the surface of end i hides point j."""
        blocks = []
        for _, light in self._lists(others):
            (query,) = self._engine.queries(ends, [light], [_samples(light)], time=self._time)
            blocks.append(below_horizon(query, self._engine.threads)[0])
        return np.hstack(blocks)

    def _lists(self, ends: Receivers):
        """Yield (first word, lights) of lists of at most MAX_SPP of the ends."""
        for first in range(0, ends.n, MAX_SPP):
            yield words_of(first), _Recentred(ends.origins[0, first : first + MAX_SPP])


class _Recentred(PointLights):
    """Point lights whose positions are in the recentred frame: they are float32, and stay what they are."""

    def patch(self, origin, reach):
        return super().patch(np.zeros(3), reach)


def _samples(light: PointLights) -> np.ndarray:
    """(16, k, 3) float64: each receiver asks all lights."""
    return np.ascontiguousarray(light.points[light.sets])


# --- Visibility matrices: which of many points see which others, one bit for each pair --------------------------------


_MOST = 1 << 31  # bytes of a matrix in memory
_ROWS = 256  # rows that are unpacked at a time


@dataclass(eq=False)
class VisibilityMatrix:
    """Which of n points see which of m targets.

    bits : (n, ceil(m / 64)) uint64
        Bit ``j % 64`` of word ``j // 64`` of row i is set if point i and target j see each other. Bits beyond the last
        target are 0. A file that was streamed is mapped into memory, read-only.
    columns : int
        m.
    counts : (n,) int64
        The number of targets that each point sees.
    """

    bits: np.ndarray
    columns: int
    counts: np.ndarray

    def __post_init__(self):
        self.columns = whole_number(self.columns, "columns", 0, 2**63 - 1)
        rows = getattr(self.bits, "shape", (0,))[:1]
        for name, shape in (("bits", (*rows, words_of(self.columns))), ("counts", rows)):
            if not isinstance(getattr(self, name), np.ndarray) or getattr(self, name).shape != shape:
                raise InputError(f"{name} of a matrix must be an array of shape {shape}")

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.bits), self.columns

    def __repr__(self) -> str:
        return f"VisibilityMatrix({self.shape[0]} x {self.columns}, {int(self.counts.sum())} visible pairs)"

    def rows(self, first: int = 0, last: int | None = None) -> np.ndarray:
        """(rows, m) bool: some rows, or all of them."""
        first = whole_number(first, "the first row", 0, len(self.bits))
        last = None if last is None else whole_number(last, "the last row", 0, len(self.bits))
        return unpack_bits(self.bits[first:last], self.columns)

    def sparse(self):
        """The visible pairs as a ``scipy.sparse.csr_array`` of bool."""
        return sparse_matrix(self.bits, self.columns, self.counts)

    def save(self, path) -> None:
        """Write the matrix: .npy holds `bits`, .npz the sparse matrix that ``scipy.sparse.load_npz`` reads.

        Raises
        ------
        InputError
            If the suffix is another one, or the path cannot be written.
        """
        target = checked_output(path, (".npy", ".npz"))
        with atomic_output(target) as temporary:
            if target.suffix.lower() == ".npy":
                write_rows(temporary, self.bits)
                return
            with open(temporary, "wb") as file:
                write_sparse(file, self.bits, self.columns, self.counts)


class _Grid(NamedTuple):
    """The tiles of a matrix; both sets of points in the order of a curve."""

    rows: Receivers
    columns: Receivers
    row_order: np.ndarray  # (n,) int64: number of each row before it was sorted
    column_order: np.ndarray
    tiles: list[tuple[int, int]]  # strip of rows, strip of columns
    square: bool  # of the points with themselves: tiles below the diagonal are mirrored


@with_progress
def visibility_matrix(
    scene: SceneLike, sensors: ArrayLike | Sensors | str, targets: ArrayLike | Sensors | str | None = None, *,
    normals: ArrayLike | None = None, target_normals: ArrayLike | None = None, output=None,
    plan: str | Plan | None = None, time: float = 0.0, threads: int | None = None, keep=None,
    progress: Progress = None,
) -> VisibilityMatrix:  # fmt: skip
    """Find which points see which targets. Every answer is exact.

    A point and a target see each other if no triangle meets the segment between them, strictly between its ends, and
    neither lies below the other's horizon, if it has a normal.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : (n, 3) float, Sensors, or str
        World coordinates. Sensors on surfaces bring their normals: ``at.face_sensors(scene)`` asks faces by faces.
        A text is what `antumbra.sensors_of` takes.
    targets : (m, 3) float, Sensors, or str, optional
        None: the sensors themselves. Each pair is then traced once, and no sensor sees itself.
    normals, target_normals : (3,) or (..., 3) float, optional
        For points on surfaces, towards the visible side: each is moved off its surface by a few units in the last
        place. Without normals, points lie in free space and are used unchanged.
    output : str or path-like, optional
        A .npy file to which the matrix is streamed, so that memory stays bounded. Finished tiles are kept in a folder
        beside it, and the same call goes on after an interruption. None: the matrix is made in memory.
    plan, time, threads
        As in `antumbra.visibility`.
    keep : str, path-like or engine, optional
        Folder of finished tiles, instead of the one beside `output`; or who does them, see `antumbra.jobs.executors`.
    progress : function of (text, done, total), or bool, optional
        Called while the job works. False: nothing is shown. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    VisibilityMatrix
        None if the engine leaves tiles to others.

    Raises
    ------
    InputError
        If an argument is wrong, or a matrix in memory would take more than 2 GiB.
    """
    scene, threads = scene_of(scene), thread_count(threads)
    time, keep = scene.clamped(time), checked_keep(keep)
    parse_plan(DEFAULT_PLAN if plan is None else plan)
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
    rows = sightline_ends(scene, sources)
    grid = _grid(rows, rows if others is None else sightline_ends(scene, others), others is None)
    if keep is None and path is not None:
        keep = path.with_name(path.name + ".parts")
    engine = executor_of(keep)
    tracing = cache(
        lambda: TileTracer(scene, plan, time, threads, len(grid.tiles) * STRIP * STRIP)
    )  # if there is a tile
    work = lambda first, last: {"bits": _tile(tracing(), grid, first)}
    about = None if engine.folder is None else _about(scene, grid, time, plan)
    parts = Parts(f"{n} x {m} lines of sight", len(grid.tiles), 1, work, engine.folder, about)
    if not engine.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    if path is None:
        bits = np.empty((n, words_of(m)), np.uint64)
        counts = _assemble(grid, parts, bits)
    else:
        with atomic_output(path) as temporary:
            counts = _stream(grid, parts, temporary, (n, words_of(m)))
        bits = np.load(path, mmap_mode="r")
    engine.end([parts])
    return VisibilityMatrix(bits, m, counts)


def _named(sensors, scene: AnyScene, threads: int):
    """The sensors that a text names; anything else as it is."""
    return sensors_of(sensors, scene, threads) if isinstance(sensors, str) else sensors


def _grid(rows: Receivers, columns: Receivers, square: bool) -> _Grid:
    row_order, column_order = (np.argsort(morton_codes(ends.origins[0]), kind="stable") for ends in (rows, columns))
    high, wide = (-(-ends.n // STRIP) for ends in (rows, columns))
    tiles = [(i, j) for i in range(high) for j in range(i if square else 0, wide)]
    return _Grid(rows.take(row_order), columns.take(column_order), row_order, column_order, tiles, square)


def _about(scene: AnyScene, grid: _Grid, time: float, plan) -> dict[str, str]:
    ends = [array for end in (grid.rows, grid.columns) for array in end]
    return about_parts(
        "lines of sight", scene_digest(scene, scene.clamped(time)), inexact_plan(plan), grid.square, *ends
    )


def _tile(tracing: TileTracer, grid: _Grid, k: int) -> np.ndarray:
    """The bits of tile k, without those of points with themselves."""
    i, j = grid.tiles[k]
    rows, columns = grid.rows.take(_strip(i)), grid.columns.take(_strip(j))
    bits = tracing.visible(rows, columns)
    if grid.square and i == j:
        diagonal = np.arange(rows.n)
        bits[diagonal, diagonal // 64] &= ~(np.uint64(1) << (diagonal % 64).astype(np.uint64))
    return bits


def _strip(i: int) -> slice:
    return slice(i * STRIP, (i + 1) * STRIP)


def _strips(grid: _Grid, parts: Parts):
    """Yield (numbers of rows, their bits), in pieces of a few hundred rows; columns in the order of the caller."""
    back = np.argsort(grid.column_order)
    at = {tile: k for k, tile in enumerate(grid.tiles)}
    n, m = grid.rows.n, grid.columns.n
    for i in range(-(-n // STRIP)):
        numbers = grid.row_order[_strip(i)]
        tiles = []
        for j in range(-(-m // STRIP)):
            found = parts[at[min(i, j), max(i, j)] if grid.square else at[i, j]]["bits"]
            tiles.append(transpose_bits(found, len(numbers)) if grid.square and j < i else found)
        bits = np.hstack([np.empty((len(numbers), 0), np.uint64), *tiles])
        for first in range(0, len(numbers), _ROWS):
            yield numbers[first : first + _ROWS], reorder_bits(bits[first : first + _ROWS], back)


def _assemble(grid: _Grid, parts: Parts, out: np.ndarray) -> np.ndarray:
    """Write the matrix to `out`; return the sums of rows."""
    counts = np.zeros(len(out), np.int64)
    for numbers, bits in _strips(grid, parts):
        out[numbers] = bits
        counts[numbers] = np.bitwise_count(bits).sum(1)
    return counts


def _stream(grid: _Grid, parts: Parts, path: Path, shape: tuple[int, int]) -> np.ndarray:
    """Write the matrix to a .npy file; return the sums of rows."""
    counts = np.zeros(shape[0], np.int64)
    with RowFile(path, shape) as file:
        for numbers, bits in _strips(grid, parts):
            counts[numbers] = np.bitwise_count(bits).sum(1)
            file.put(numbers, bits)
    return counts
