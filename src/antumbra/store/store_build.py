"""Build a store from scenes of any size within a given amount of memory."""

from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..files import atomic_output
from ..generate.generated_scene import StreamedCity
from ..scene.mesh import Source
from ..scene.scene_bounds import frame_origin
from ..scene.scene_data import MemoryData
from .chunk_sorting import Sorting, chunks_of, grid_over, groups
from .staging_files import MOST, StagingFile, gather_triangles
from .store_file import StoreData, Writer, top_tree
from .store_format import Meta
from .system_resources import check_space

LEAST_MEMORY = 384 << 20
MOST_TRIANGLES = 2**31 - 1  # so that an int32 holds their indices
CHUNK = 65536
_GROUP = 8  # chunks that are sorted in memory at a time
_BATCH_BYTES = 640  # budget for each triangle that is distributed at a time: four times the memory it takes
_THREAD_BYTES = 64 << 20  # memory that building and writing a chunk takes

Progress = Callable[[str, int, int], None]
"""Called with the name of the step, the number of items done, and their total (0: unknown)."""


class BuildReport(NamedTuple):
    """The result of a build."""

    path: Path  # path of the store
    triangles: int  # number of triangles of all scenes, with those without area
    chunks: int  # number of chunks
    bytes: int  # size of the file
    seconds: dict[str, float]  # time of the phases "read", "sort", "build" and "finish", and "total"


def build_compiled(scenes, path: Path, max_memory=LEAST_MEMORY, threads=1, chunk=CHUNK, progress=None) -> BuildReport:
    """`rendering.building.build_store`, after the arguments are checked and the kernels are compiled."""
    with atomic_output(path, durable=True) as temporary:
        return _Build(temporary.parent, max_memory, threads, chunk, progress).run(scenes, path, temporary)


class _Build:
    """One build: the settings and clocks that all its phases share."""

    def __init__(self, folder: Path, max_memory: int, threads: int, chunk: int, progress: Progress | None):
        self.folder, self.chunk, self.progress = folder, chunk, progress
        self.threads, self.workers = threads, max(1, min(threads, max_memory // 2 // _THREAD_BYTES))
        self.batch = max(MOST, min(max_memory // _BATCH_BYTES, 1 << 22))
        self._left_out = np.array([[np.inf] * 3, [-np.inf] * 3], np.float32)  # box of triangles that are in no chunk
        self.seconds: dict[str, float] = {}
        self._start = self._lap = perf_counter()

    def run(self, scenes: Iterable, path: Path, temporary: Path) -> BuildReport:
        spool = StagingFile(self.folder, path.name)
        try:
            about = self._spooled(scenes, spool)
            bounds = spool.survey.bounds()
            self._note("read")
            with temporary.open("wb") as stream:
                writer = Writer(stream)
                self._write_chunks(spool, bounds, writer)
                return self._finish(writer, spool.survey.n_triangles, about, bounds, path)
        finally:
            spool.close()

    def _spooled(self, scenes: Iterable, spool: StagingFile) -> dict:
        """Spool all pieces; return the name, up axis, CRS, cameras, lights and notes of all scenes."""
        names, ups, systems, cameras, lights, notes = [], set(), set(), [], [], []
        for scene in scenes:
            if isinstance(scene, StoreData):
                raise scene.refusal()
            if not isinstance(scene, MemoryData | StreamedCity):
                raise InputError(f"a scene is {type(scene).__name__}; it must be a Scene, as antumbra.load gives")
            check_space(self.folder, spool.survey.file, spool.survey.n_triangles + scene.n_triangles, spool.size)
            self._spool(scene.source, spool)
            names.append(scene.name)
            ups.add(scene.up)
            systems.add(getattr(scene, "crs", None))  # a streamed city has none
            cameras += scene.source.cameras(0.0)
            lights += scene.source.lights(0.0)
            notes += scene.notes
            if scene.appearance is not None:
                notes.append(f"{scene.name}: a store keeps the mean colour of each face, without textures and normals")
            if scene.animated:
                notes.append(f"{scene.name}: moves; the store shows its first moment")
            del scene  # before the next one is opened
        if not names:
            raise InputError("no scenes; give at least one")
        if len(ups) > 1:
            raise InputError(f"{', '.join(names)}: some have +Y up and some +Z; give them the same up axis")
        if len(known := sorted(systems - {None})) > 1:
            raise InputError(f"{', '.join(names)}: have the CRS {', '.join(known)}; reproject them to one")
        if spool.survey.n_triangles > MOST_TRIANGLES:
            raise InputError(f"{spool.survey.n_triangles} triangles; a store holds at most {MOST_TRIANGLES}")
        about = {"name": " + ".join(names), "up": ups.pop(), "crs": known[0] if known else None}
        return {**about, "cameras": cameras, "lights": lights, "notes": tuple(notes)}

    def _spool(self, source: Source, spool: StagingFile) -> None:
        with closing(source.pieces(0.0)) as pieces:  # other processes may be making the pieces
            for piece in pieces:
                spool.add(piece)
                self._say("reading", spool.survey.n_triangles, 0)

    def _write_chunks(self, spool: StagingFile, bounds: np.ndarray, writer: Writer) -> None:
        n, origin, heard = spool.survey.n_triangles, frame_origin(*bounds), 0

        def distributed(count: int) -> None:
            nonlocal heard
            heard += count
            self._say("sorting", heard, 2 * n)

        grid = grid_over((bounds - origin).astype(np.float32))
        sorting = Sorting(grid, self.folder, _GROUP * self.chunk, self.batch, self.threads, distributed)
        batches = lambda: gather_triangles(spool.pieces(), origin, self.batch, self.threads, self._left_out)
        done = 0
        with closing(chunks_of(groups(sorting, batches, n, spool.close), self.chunk, self.workers)) as chunks:
            for made in chunks:
                if not done:
                    self._note("sort")
                writer.add(made)
                done += int(made.row["triangles"])
                self._say("building", done, n)
        self._note("build")

    def _finish(self, writer: Writer, n: int, about: dict, bounds: np.ndarray, path: Path) -> BuildReport:
        table = writer.table
        top = top_tree(table["box"], self.threads)
        origin = frame_origin(*bounds)
        lower, upper = self._left_out
        box = np.stack([
            np.minimum(lower, table["box"][:, :3].min(axis=0)), np.maximum(upper, table["box"][:, 3:].max(axis=0))
        ])  # fmt: skip
        how = {"chunk": self.chunk, "builder": "bsah", "top": "bsah, reinsert"}
        meta = Meta(n_triangles=n, bounds=bounds, origin=origin, box=box, built=how, **about)
        size = writer.finish(top, meta)
        self._note("finish")
        self.seconds["total"] = perf_counter() - self._start
        return BuildReport(path, n, len(table), size, self.seconds)

    def _say(self, text: str, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress(text, done, total)

    def _note(self, phase: str) -> None:
        """Record the time of a phase that ends now."""
        now = perf_counter()
        self.seconds[phase], self._lap = now - self._lap, now
