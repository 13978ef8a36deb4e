"""Build a store from scenes of any size within a given amount of memory."""

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import NamedTuple, TypedDict

import numpy as np

from ..base.errors import InputError
from ..base.files import atomic_output
from ..base.progress import ProgressListener
from ..generate.generated_scene import StreamedCity
from ..scene.camera import Camera
from ..scene.lights import Light
from ..scene.mesh import Source
from ..scene.raster import Raster
from ..scene.scene_bounds import Survey
from ..scene.scene_data import SceneData
from ..scene.terrain import StreamedTerrain
from ..scene.units import METRE, LengthUnit
from .chunk_sorting import SortSettings, chunks_of, grid_over, sorted_groups
from .staging_files import MAX_FACES, StagingFile, gather_triangles
from .store_checks import MAX_TRIANGLES
from .store_file import StoreWriter, top_tree
from .store_format import StoreMeta
from .system_resources import check_disk_space

MIN_MEMORY = 384 << 20
CHUNK = 65536

StreamedScene = StreamedCity | StreamedTerrain
"""Scenes whose pieces are never in memory all at once."""

_GROUP = 8  # chunks sorted in memory at a time
_TRIANGLE_MEMORY = 640  # budget per triangle distributed at a time: four times the memory it takes
_THREAD_BYTES = 64 << 20  # memory for building and writing a chunk

"""Called with the name of the step, the number of items done, and their total (0: unknown)."""


class BuildReport(NamedTuple):
    """The result of a build."""

    path: Path  # path of the store
    triangles: int  # number of triangles of all scenes, including zero-area ones
    chunks: int  # number of chunks
    bytes: int  # size of the file
    seconds: dict[str, float]  # time of the phases "read", "sort", "build" and "finish", and "total"


class PieceSizes(NamedTuple):
    """The triangles that a build handles at a time, which change no byte of the store."""

    staged: int = MAX_FACES  # faces of a staged piece, at most
    sorted: int | None = None  # triangles distributed among chunks at a time; None: as many as memory allows

    def batch(self, max_memory: int) -> int:
        """Triangles distributed at a time."""
        return self.sorted or max(self.staged, min(max_memory // _TRIANGLE_MEMORY, 1 << 22))


USUAL_SIZES = PieceSizes()


class _Description(TypedDict):
    """The fields of `StoreMeta` that the scenes supply."""

    name: str
    up: str
    crs: str | None
    unit: LengthUnit | None
    raster: Raster | None
    cameras: list[Camera]
    lights: list[Light]
    notes: tuple[str, ...]


def write_store(
    scenes: Iterable[SceneData | StreamedScene],
    path: Path,
    max_memory: int = MIN_MEMORY,
    threads: int = 1,
    chunk: int = CHUNK,
    progress: ProgressListener | None = None,
    sizes: PieceSizes = USUAL_SIZES,
) -> BuildReport:
    """`engine.store_building.build_store`, once arguments are checked and kernels compiled."""
    with atomic_output(path, durable=True) as temporary:
        return _Build(temporary.parent, max_memory, threads, chunk, progress, sizes).run(scenes, path, temporary)


class _Build:
    """A build: the settings and clocks that its phases share."""

    def __init__(
        self,
        folder: Path,
        max_memory: int,
        threads: int,
        chunk: int,
        progress: ProgressListener | None,
        sizes: PieceSizes,
    ) -> None:
        self.folder, self.chunk, self.progress, self.sizes = folder, chunk, progress, sizes
        self.threads, self.workers = threads, max(1, min(threads, max_memory // 2 // _THREAD_BYTES))
        self.batch = sizes.batch(max_memory)
        self._excluded_box = np.array([[np.inf] * 3, [-np.inf] * 3], np.float32)  # bounds of triangles in no chunk
        self.seconds: dict[str, float] = {}
        self._start = self._lap = perf_counter()

    def run(self, scenes: Iterable[SceneData | StreamedScene], path: Path, temporary: Path) -> BuildReport:
        staging = StagingFile(self.folder, path.name, self.sizes.staged)
        try:
            description = self._stage_scenes(scenes, staging)
            bounds = staging.survey.bounds()
            self._end_phase("read")
            with temporary.open("wb") as stream:
                writer = StoreWriter(stream)
                self._write_chunks(staging, bounds, writer)
                return self._finish(writer, staging.survey, description, path)
        finally:
            staging.close()

    def _stage_scenes(self, scenes: Iterable[SceneData | StreamedScene], staging: StagingFile) -> _Description:
        """Stage the pieces of all scenes and merge their descriptions."""
        names, ups, systems, rasters = list[str](), set[str](), set[str](), set[Raster]()
        units, given = set[LengthUnit](), set[LengthUnit]()
        cameras, lights, notes = list[Camera](), list[Light](), list[str]()
        for scene in scenes:
            source: Source | None = getattr(scene, "source", None)  # InputError if it is in a store
            if source is None:
                raise InputError(f"a scene is {type(scene).__name__}; it must be a Scene, as returned by antumbra.load")
            check_disk_space(
                self.folder, staging.survey.file, staging.survey.n_triangles + scene.n_triangles, staging.size
            )
            self._stage(source, staging)
            names.append(scene.name)
            ups.add(scene.up)
            if (crs := getattr(scene, "crs", None)) is not None:  # a streamed city has none
                systems.add(crs)
            units.add(getattr(scene, "unit", METRE))
            if (unit := getattr(scene, "given_unit", None)) is not None:
                given.add(unit)
            if (raster := getattr(scene, "raster", None)) is not None:
                rasters.add(raster)
            cameras += source.cameras(0.0)
            lights += source.lights(0.0)
            notes += scene.notes
            if scene.appearance is not None:
                notes.append(f"{scene.name}: a store keeps the mean colour of each face, without textures and normals")
            if scene.animated:
                notes.append(f"{scene.name}: is animated; the store shows its first moment")
            del scene  # free it before the next one is opened
        if not names:
            raise InputError("no scenes; give at least one")
        if len(ups) > 1:
            raise InputError(f"{', '.join(names)}: some have +Y up and some +Z; give them the same up axis")
        if len(systems) > 1:
            raise InputError(f"{', '.join(names)}: have the CRS {', '.join(sorted(systems))}; reproject them to one")
        if len(units) > 1:
            symbols = ", ".join(sorted(unit.name for unit in units))
            raise InputError(f"{', '.join(names)}: have coordinates in {symbols}; scale them to one unit")
        if staging.survey.n_triangles > MAX_TRIANGLES:
            raise InputError(f"{staging.survey.n_triangles} triangles; a store holds at most {MAX_TRIANGLES}")
        crs, known = systems.pop() if systems else None, given.pop() if given else None
        raster = rasters.pop() if len(rasters) == 1 else None
        return _Description(
            name=" + ".join(names), up=ups.pop(), crs=crs, unit=known, raster=raster, cameras=cameras,
            lights=lights, notes=tuple(notes),
        )  # fmt: skip

    def _stage(self, source: Source, staging: StagingFile) -> None:
        with closing(source.pieces(0.0)) as pieces:  # other processes may be generating them
            for piece in pieces:
                staging.add(piece)
                self._report("reading", staging.survey.n_triangles, 0)

    def _write_chunks(self, staging: StagingFile, bounds: np.ndarray, writer: StoreWriter) -> None:
        n, origin, n_sorted = staging.survey.n_triangles, staging.survey.origin(), 0

        def distributed(count: int) -> None:
            nonlocal n_sorted
            n_sorted += count
            self._report("sorting", n_sorted, 2 * n)

        grid = grid_over((bounds - origin).astype(np.float32))
        sorting = SortSettings(grid, self.folder, _GROUP * self.chunk, self.batch, self.threads, distributed)
        batches = lambda: gather_triangles(staging.pieces(), origin, self.batch, self.threads, self._excluded_box)
        done = 0
        with closing(chunks_of(sorted_groups(sorting, batches, n, staging.close), self.chunk, self.workers)) as chunks:
            for chunk in chunks:
                if not done:
                    self._end_phase("sort")
                writer.add(chunk)
                done += int(chunk.row["triangles"])
                self._report("building", done, n)
        self._end_phase("build")

    def _finish(self, writer: StoreWriter, survey: Survey, description: _Description, path: Path) -> BuildReport:
        table = writer.table
        top = top_tree(table["box"], self.threads)
        n, bounds, origin = survey.n_triangles, survey.bounds(), survey.origin()
        lower, upper = self._excluded_box
        lower, upper = (
            np.minimum(lower, table["box"][:, :3].min(axis=0)),
            np.maximum(upper, table["box"][:, 3:].max(axis=0)),
        )
        box = np.stack([lower, upper])
        built = {"chunk": self.chunk, "builder": "bsah", "top": "bsah, reinsert"}
        meta = StoreMeta(n_triangles=n, bounds=bounds, origin=origin, box=box, built=built, **description)
        size = writer.finish(top, meta)
        self._end_phase("finish")
        self.seconds["total"] = perf_counter() - self._start
        return BuildReport(path, n, len(table), size, self.seconds)

    def _report(self, text: str, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress(text, done, total)

    def _end_phase(self, phase: str) -> None:
        """Record the time of the phase that ends now."""
        now = perf_counter()
        self.seconds[phase], self._lap = now - self._lap, now
