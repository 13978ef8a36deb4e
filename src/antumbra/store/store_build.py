"""Build a store, or the tiles of a scene, from scenes of any size within a given amount of memory.

A build has three stages of units, which may run in any process, and resume: scenes are read into files of pieces, their
triangles are sorted by cells of the Morton order, and buckets of cells are made into chunks. Then the store is joined.
Tiles are consecutive pieces, in the frame of them all; each is sorted and made into chunks by units of its own.
"""

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from functools import cached_property
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..base.files import atomic_output, temporary_name, writing
from ..base.progress import ProgressListener
from ..scene.default_picture import framed_points
from ..scene.mesh import Piece
from ..scene.open_faces import OpenFaces
from ..scene.scene_bounds import Detail, FaceSample, detail_box, flush_to_zero
from .build_stages import LocalStages, Records, Stages
from .chunk_sorting import (
    LEVEL_BITS,
    Group,
    SortSettings,
    bucket_cells,
    chunks_of,
    grid_over,
    sorted_by_cell,
    sorted_groups,
)
from .read_units import ReadUnit, StagedScenes, check_count, read_unit
from .staging_files import MAX_FACES, CutoutColumns, Excluded, Record, RunWriter, SortedRuns, gather_triangles
from .store_checks import check_one_range
from .store_directory import top_tree
from .store_file import Store, open_store
from .store_format import STORE_SUFFIX, TILES_SUFFIX, HeightSection, LookSection, StoreMeta
from .store_writer import StoreWriter
from .stored_cutouts import ordered_masks
from .stored_looks import LookWriter
from .tiled_store import Tile, manifest_to_json

MIN_MEMORY = 384 << 20
CHUNK = 65536
TILE = 1 << 27
"""Triangles of a tile, unless a caller sets another number: 6 GB."""

_GROUP = 8  # chunks sorted in memory at a time
_THREAD_BYTES = 64 << 20  # memory for building and writing a chunk


class BuildReport(NamedTuple):
    """The result of a build."""

    path: Path  # path of the store, or of the manifest of tiles
    triangles: int  # number of triangles of all scenes, including zero-area ones
    chunks: int  # number of chunks
    bytes: int  # size of the file, or of all tiles
    seconds: dict[str, float]  # time of the phases "read", "sort", "build" and "finish", and "total"


class PieceSizes(NamedTuple):
    """The triangles that a build handles at a time, which change no byte of the store."""

    staged: int = MAX_FACES  # faces of a staged piece, at most
    run: int = 1 << 19  # triangles sorted by cell at a time, at most
    unit: int = 1 << 21  # triangles of a unit that sorts, or makes chunks


USUAL_SIZES = PieceSizes()


def write_store(
    units: Sequence[ReadUnit],
    path: Path,
    max_memory: int = MIN_MEMORY,
    threads: int = 1,
    chunk: int = CHUNK,
    progress: ProgressListener | None = None,
    sizes: PieceSizes | None = None,
    stages: Stages | None = None,
    tile: int | None = None,
) -> BuildReport | None:
    """`engine.store_building.build_store`, once arguments are checked and kernels compiled.

    sizes : None: `USUAL_SIZES`
    stages : runs the units; None: here, with files in a temporary folder beside the store
    tile : triangles at which a tile ends, for a path with TILES_SUFFIX; None: `TILE`

    Returns None if `stages` leaves units to others.
    """
    with writing(path):
        if stages is not None:
            sizes = sizes or USUAL_SIZES
            tile = (tile or TILE) if path.suffix.lower() == TILES_SUFFIX else None
            if tile is not None:
                sizes = sizes._replace(staged=min(sizes.staged, tile))
            return _Build(stages, path, max_memory, threads, chunk, progress, sizes).run(units, tile)
        with temporary_name(path.resolve().parent) as folder:
            folder.mkdir()
            return write_store(units, path, max_memory, threads, chunk, progress, sizes, LocalStages(folder), tile)


class _Tile(NamedTuple):
    """Consecutive pieces that are written to one store."""

    path: Path
    begin: int  # its first piece
    sizes: np.ndarray  # triangles of its pieces
    first: int  # number of its first triangle in the scene

    @property
    def triangles(self) -> int:
        return int(self.sizes.sum())


class _Range(NamedTuple):
    """What a unit handles: some pieces, or some buckets, of a tile."""

    tile: int
    first: int
    last: int  # exclusive


class _Build:
    """A build: the settings and clocks that its stages share."""

    def __init__(
        self,
        stages: Stages,
        path: Path,
        max_memory: int,
        threads: int,
        chunk: int,
        progress: ProgressListener | None,
        sizes: PieceSizes,
    ) -> None:
        self.stages, self.path, self.chunk, self.progress, self.sizes = stages, path, chunk, progress, sizes
        self.threads, self.workers = threads, max(1, min(threads, max_memory // 2 // _THREAD_BYTES))
        self.seconds: dict[str, float] = {}
        self._start = self._lap = perf_counter()
        self._counts = dict[str, int]()  # what is done of each step

    def run(self, units: Sequence[ReadUnit], tile: int | None) -> BuildReport | None:
        """The report; None if some units are left to others. `tile`: triangles at which one ends; None: one store."""
        read = self.stages.run("read", len(units), lambda k, file: self._read(units[k], file))
        if read is None:
            return None
        self._scenes = StagedScenes(self.path.name, len(units), lambda k: self.stages.file("read", k), read)
        self._tiles = self._tiles_of(tile)
        if self._scenes.masks:
            check_one_range(self.path.name, self._scenes.survey.n_triangles)
        self._description = self._scenes.description
        if tile is not None:
            self._description["heights"] = None  # tiles are traced as triangles
        self._end_phase("read")

        ranges = self._units([each.sizes for each in self._tiles])
        sort = self.stages.run("sort", len(ranges), lambda k, file: self._sort(ranges[k], file))
        if sort is None:
            return None
        heights = self._description["heights"]
        if heights is not None and self.stages.run("heights", 1, lambda k, file: self._keep(heights, file)) is None:
            return None
        looks: Records | None = None
        if self._scenes.materials.texts:
            looks = self.stages.run("looks", len(self._tiles), self._write_looks)
            if looks is None:
                return None
        self.stages.drop("read")
        of_tiles = [_of_tile(ranges, t) for t in range(len(self._tiles))]
        buckets = [_Buckets(self.stages, sort, of_tile, self._sorting) for of_tile in of_tiles]
        self._end_phase("sort")

        parts = self._units([each.sizes for each in buckets])
        run = lambda k, file: self._build(buckets[parts[k].tile], parts[k], file)
        build = self.stages.run("build", len(parts), run, True)
        if build is None:
            return None
        self.stages.drop("sort")
        self._end_phase("build")

        sample = np.concatenate([sort(k)["sample"] for k in range(len(ranges))])
        self._framed, self._detail = framed_points(sample, self._description["up"]), self._detail_of(sample)
        with ExitStack() as written:
            stores = list[Store]()
            for t, each in enumerate(self._tiles):
                left = _Left(sort, of_tiles[t], self._looks_of(t, looks))
                self._finish(each, build, _of_tile(parts, t), left, tile is not None)
                stores.append(written.enter_context(open_store(each.path)))
            report = self._report_of(stores)
            if tile is not None:
                self._write_manifest(stores)
        self.stages.end()
        return report

    def _detail_of(self, sample: np.ndarray) -> Detail | None:
        """The detail of a sample of faces, (m, 3, 3) world; None for copies, which are shown from outside."""
        if self._scenes.has_copies:
            return None
        origin = self._scenes.survey.origin()
        return Detail.of(detail_box(sample), flush_to_zero((sample[:, 0] - origin).astype(np.float32)), origin)

    def _tiles_of(self, limit: int | None) -> list[_Tile]:
        """The tiles, each of which ends once it has `limit` triangles; None: one store."""
        sizes, firsts = self._scenes.sizes, np.append(0, np.cumsum(self._scenes.sizes))
        if limit is None:
            check_count(self.path, int(firsts[-1]))
            return [_Tile(self.path, 0, sizes, 0)]
        places = _ranges(sizes, limit)
        name = lambda t: self.path.with_name(f"{self.path.stem}-{t:04d}{STORE_SUFFIX}")
        return [_Tile(name(t), a, sizes[a:b], int(firsts[a])) for t, (a, b) in enumerate(places)]

    def _units(self, sizes: list[np.ndarray]) -> list[_Range]:
        """Units of about `PieceSizes.unit` triangles; `sizes`: those of the items of each tile."""
        return [_Range(t, *each) for t, items in enumerate(sizes) for each in _ranges(items, self.sizes.unit)]

    @cached_property
    def _sorting(self) -> SortSettings:
        grid = grid_over((self._scenes.bounds - self._scenes.survey.origin()).astype(np.float32))
        return SortSettings(grid, self.stages.folder, _GROUP * self.chunk, self.threads)

    def _read(self, unit: ReadUnit, file: Path) -> Record:
        report = lambda n: self._report("reading", n, 0)
        return read_unit(unit, self.path, self.stages.folder.parent, file, self.sizes.staged, report)

    def _sort(self, unit: _Range, file: Path) -> Record:
        """Sort the triangles of a range of pieces by cell, in runs."""
        tile = self._tiles[unit.tile]
        excluded = Excluded()
        start, origin = int(tile.sizes[: unit.first].sum()), self._scenes.survey.origin()
        sample = FaceSample(self._scenes.survey.n_triangles, tile.first + start)
        pieces = self._scenes.pieces(tile.begin + unit.first, tile.begin + unit.last)
        size = max(self.sizes.staged, self.sizes.run)
        with file.open("wb") as stream:
            runs = RunWriter(stream)
            for batch in gather_triangles(_sampled(pieces, sample), origin, size, self.threads, excluded, start):
                runs.add(*sorted_by_cell(self._sorting, batch))
                self._report("sorting", len(batch.ids), self._scenes.survey.n_triangles)
        cutouts = {f"cutouts_{name}": column for name, column in excluded.cutouts._asdict().items()}
        return runs.record() | {"excluded": excluded.box, "sample": sample.corners} | cutouts

    def _keep(self, heights: HeightSection, file: Path) -> Record:
        """Copy the heights of terrain from the file of the unit that has read it, which is removed."""
        assert self._scenes.begin is not None
        with self.stages.file("read", self._scenes.begin).open("rb") as source, file.open("wb") as stream:
            source.seek(heights.offset)
            shutil.copyfileobj(source, stream)
        return {}

    def _write_looks(self, tile: int, file: Path) -> Record:
        """Write the looks of the faces of a tile, in their order."""
        begin, sizes = self._tiles[tile].begin, self._tiles[tile].sizes
        with file.open("wb") as stream:
            writer = LookWriter(stream, self._scenes.materials.texts)
            for looks in self._scenes.looks(begin, begin + len(sizes)):
                writer.add(looks)
            return writer.finish(self._scenes.materials.image)

    def _looks_of(self, tile: int, records: Records | None) -> "_StagedLooks | None":
        """The looks of a tile; None if all its faces have plain colours."""
        if records is None:
            return None
        fields = json.loads(records(tile)["looks"].tobytes())
        return _StagedLooks(self.stages.file("looks", tile), LookSection(0, **fields)) if fields["materials"] else None

    def _build(self, buckets: "_Buckets", unit: _Range, file: Path) -> Record:
        """Make chunks of a range of buckets."""
        groups = chain.from_iterable(map(buckets.groups, range(unit.first, unit.last)))
        rows, end = list[np.ndarray](), 0
        with file.open("wb") as stream, closing(chunks_of(groups, self.chunk, self.workers)) as chunks:
            for chunk in chunks:
                chunk.row["offset"] = end
                rows.append(chunk.row)
                end += stream.write(chunk.data.data)
                self._report("building", int(chunk.row["triangles"]), self._scenes.survey.n_triangles)
        return {"table": np.stack(rows)}

    def _finish(self, tile: _Tile, build: Records, parts: range, left: "_Left", is_part: bool) -> None:
        """Write the store of a tile; `is_part`: of several, in the frame of them all."""
        with atomic_output(tile.path, durable=True) as temporary, temporary.open("wb") as stream:
            writer = StoreWriter(stream)
            for k in parts:
                writer.add(self.stages.file("build", k), build(k)["table"])
            table = writer.table
            meta = self._meta(tile.triangles, np.concatenate([left.boxes(), table["box"].reshape(-1, 2, 3)]))
            if is_part:
                meta = meta._replace(raster=None, objects=None, framed=None, detail=None)  # they are of the whole
            elif meta.heights is not None:
                meta = meta._replace(heights=writer.add_heights(self.stages.file("heights", 0), meta.heights))
            if self._scenes.masks:
                used = (part.mask[part.mask >= 0] for part in left.cutouts())
                masks, numbers = ordered_masks(self._scenes.masks, used)
                meta = meta._replace(cutouts=writer.add_cutouts(lambda: left.cutouts(numbers), masks))
            if left.looks is not None:
                meta = meta._replace(looks=writer.add_looks(*left.looks))
            writer.finish(top_tree(table["box"], self.threads), meta)

    def _meta(self, n_triangles: int, boxes: np.ndarray) -> StoreMeta:
        """The metadata of triangles of the scene, within (k, 2, 3) boxes."""
        return StoreMeta(
            n_triangles=n_triangles, bounds=self._scenes.bounds, origin=self._scenes.survey.origin(),
            box=np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)]),
            built={"chunk": self.chunk, "builder": "bsah", "top": "bsah, reinsert"},
            framed=self._framed, detail=self._detail, **self._description,
        )  # fmt: skip

    def _write_manifest(self, stores: list[Store]) -> None:
        meta = self._meta(self._scenes.survey.n_triangles, np.stack([store.meta.box for store in stores]))
        tiles = [Tile.of(store, tile.first) for store, tile in zip(stores, self._tiles)]
        with atomic_output(self.path, durable=True) as temporary:
            temporary.write_bytes(manifest_to_json(meta, tiles))

    def _report_of(self, stores: list[Store]) -> BuildReport:
        self._end_phase("finish")
        self.seconds["total"] = perf_counter() - self._start
        chunks, size = sum(map(len, stores)), sum(store.size for store in stores)
        return BuildReport(self.path, self._scenes.survey.n_triangles, chunks, size, self.seconds)

    def _report(self, text: str, n: int, total: int) -> None:
        """Report that n more triangles have passed a step."""
        self._counts[text] = self._counts.get(text, 0) + n
        if self.progress is not None:
            self.progress(text, self._counts[text], total)

    def _end_phase(self, phase: str) -> None:
        """Record the time of the phase that ends now."""
        now = perf_counter()
        self.seconds[phase], self._lap = now - self._lap, now


def _sampled(pieces: Iterator[tuple[Piece, OpenFaces]], sample: FaceSample) -> Iterator[tuple[Piece, OpenFaces]]:
    """The pieces, which are added to a sample of faces on their way."""
    for piece, open_faces in pieces:
        sample.add(piece)
        yield piece, open_faces


class _StagedLooks(NamedTuple):
    """The looks of a tile in a file."""

    path: Path
    section: LookSection  # without its offset


class _Left:
    """What the units of a tile have left out of chunks; `units`: those that sorted its triangles."""

    def __init__(self, records: Records, units: range, looks: _StagedLooks | None):
        self._records, self._units, self.looks = records, units, looks

    def boxes(self) -> np.ndarray:
        """(k, 2, 3) float32: the bounds of it, for each unit."""
        return np.stack([self._records(k)["excluded"] for k in self._units])

    def cutouts(self, numbers: np.ndarray | None = None) -> Iterator[CutoutColumns]:
        """Yield the cut-outs of each unit; `numbers`: in place of each mask."""
        for k in self._units:
            record = self._records(k)
            columns = CutoutColumns(*(record[f"cutouts_{name}"] for name in CutoutColumns._fields))
            mask = columns.mask
            yield columns if numbers is None else columns._replace(mask=np.where(mask >= 0, numbers[mask], mask))


class _Buckets:
    """The triangles of all runs of a tile, in buckets of cells; `units`: those that sorted them."""

    def __init__(self, stages: Stages, records: Records, units: range, sorting: SortSettings):
        counts = np.zeros(1 << LEVEL_BITS, np.int64)
        for k in units:
            record = records(k)
            np.add.at(counts, record["cells"], record["counts"])
        self._cells = bucket_cells(counts, sorting.max_triangles)
        self.sizes = np.array([counts[first:last].sum() for first, last in self._cells])
        self._files = lambda: ((stages.file("sort", k), records(k)) for k in units)
        self._sorting = sorting

    @cached_property
    def _runs(self) -> SortedRuns:
        return SortedRuns(self._files(), self._cells)

    def groups(self, k: int) -> Iterator[Group]:
        """Yield the triangles of bucket k, sorted by all bits of their codes."""
        n = int(self.sizes[k])
        batches = lambda: self._runs.batches(k, n, self._sorting.max_triangles)
        return sorted_groups(self._sorting, batches, n)


def _of_tile(units: list[_Range], tile: int) -> range:
    """The numbers of the units of a tile."""
    numbers = [k for k, unit in enumerate(units) if unit.tile == tile]
    return range(numbers[0], numbers[-1] + 1)


def _ranges(sizes: np.ndarray, limit: int) -> list[tuple[int, int]]:
    """Ranges of items, each of which ends once its size reaches `limit`; half-open."""
    ranges, first, total = list[tuple[int, int]](), 0, 0
    for k, size in enumerate(sizes.tolist()):
        total += size
        if total >= limit or k == len(sizes) - 1:
            ranges.append((first, k + 1))
            first, total = k + 1, 0
    return ranges
