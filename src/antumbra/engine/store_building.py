"""`build_store`: merge scenes into one store file."""

import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from ..base.checks import byte_count, quoted, whole_number
from ..base.errors import InputError
from ..base.files import checked_output
from ..base.progress import Progress, show_progress, with_progress
from ..formats.example_files import scene_path
from ..formats.format_registry import format_of, format_taking
from ..formats.library_meshes import is_mesh
from ..formats.scene_format import ReadOptions, Stream
from ..kernels.parallel import thread_count
from ..scene.scene_data import SceneData
from ..store.build_stages import Stages
from ..store.read_units import ReadUnit, StreamedScene
from ..store.store_build import CHUNK, MIN_MEMORY, BuildReport, write_store
from ..store.store_format import STORE_SUFFIX, TILES_SUFFIX
from .precompilation import precompile
from .scene import AnyScene
from .scene_loading import SceneLike, scene_of
from .scene_reading import read_scene_data


@with_progress
def build_store(
    scenes: "SceneLike | StreamedScene | Iterable[SceneLike | StreamedScene]",
    path: "str | os.PathLike[str]",
    *,
    max_memory: int = 4 << 30,
    threads: int | None = None,
    chunk: int = CHUNK,
    tile: int | None = None,
    progress: Progress = None,
) -> BuildReport:
    """Merge scenes and write them to a store, one file or several tiles, which `load` opens.

    Parameters
    ----------
    scenes : Scene, or anything that `antumbra.load` accepts, or an iterable of them
        The scenes at time 0, merged in this order. Cameras and lights of all scenes are kept. Scenes are read one
        after the other, so a generator may release each scene after yielding it. glTF, OBJ and CityJSONSeq files,
        binary PLY and STL files of triangles, raster files and DataArrays of heights are read piece by piece, lazy
        arrays by chunk; rasters that follow one another are tiles of one surface.
    path : str or path-like
        A file ``*.antumbra``, for at most 2^31 - 1 triangles; or ``*.tiles``, a list of the stores ``*-0000.antumbra``
        and so on beside it, for any number. Each is written atomically, the list last. During the build, a hidden
        temporary folder beside them takes at most 100 bytes per triangle, and 376 of looks.
    max_memory : int
        Limit in bytes on the memory of the process at any time, at least 384 MiB, not counting the scenes themselves.
    threads : int, optional
        None: all cores. The file has the same bits for every value of `threads` and `max_memory`.
    chunk : int
        Maximum number of triangles in a chunk, 16 to 4,194,304.
    tile : int, optional
        Triangles, 1 to 2^30, at which a tile ends; only for ``*.tiles``. None: 134,217,728, which take 6 GB.
    progress : function of (text, done, total), or bool, optional
        Called with the current phase, the work done and the total work (0: unknown). False: nothing is shown. None:
        terminals and notebooks show a bar after a second.

    Returns
    -------
    BuildReport

    Raises
    ------
    InputError
        If the scenes have no triangles, lie too far apart, or have different up axes; if tiles do not share a grid; or
        if the path cannot be written or the disk is full. No partial file is left behind.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     report = at.build_store([at.procedural("city", triangles=5_000)], f"{folder}/city.antumbra")
    ...     report.triangles == at.load(report.path).n_triangles
    True
    """
    data = _scene_data_of_all(scenes)
    report = build_units([ReadUnit(lambda: data)], path, max_memory, threads, chunk, progress, tile=tile)
    assert report is not None  # all units run here
    return report


def build_units(
    units: Sequence[ReadUnit],
    path: "str | os.PathLike[str]",
    max_memory: int,
    threads: int | None,
    chunk: int = CHUNK,
    progress: Progress = None,
    stages: Stages | None = None,
    tile: int | None = None,
) -> BuildReport | None:
    """`build_store`, of units that `stages` runs; None if it leaves some to others."""
    path, threads = checked_output(path, (STORE_SUFFIX, TILES_SUFFIX)), thread_count(threads)
    max_memory = byte_count(max_memory, "max_memory", MIN_MEMORY)
    chunk = whole_number(chunk, "chunk", 16, 1 << 22)
    if tile is not None:
        tile = whole_number(tile, "tile", 1, 1 << 30)
        if path.suffix.lower() != TILES_SUFFIX:
            raise InputError(f"tile is {tile}, and {path.name} a single store; write *{TILES_SUFFIX}")
    precompile("building stores")
    with show_progress(f"building {path.name}") as callback:
        bar = None if callback is None else lambda text, done, total: callback(done, total)
        listener = progress if callable(progress) else bar
        return write_store(units, path, max_memory, threads, chunk, listener, stages=stages, tile=tile)


def _scene_data_of_all(scenes: Any) -> Iterator[SceneData | StreamedScene]:
    """Yield the data of one scene after the other."""
    if isinstance(scenes, (AnyScene, StreamedScene, str, os.PathLike)) or is_mesh(scenes) or format_taking(scenes):
        scenes = [scenes]
    try:
        iter(scenes)
    except TypeError:
        raise InputError(f"scenes are {quoted(scenes)}; give a scene, or several in a list") from None
    return map(_scene_data, _with_tiles(scenes))  # unlike a generator, `map` holds no reference to the last scene


class _Tiles(NamedTuple):
    """Files or objects of libraries that are tiles of one surface, as rasters of heights."""

    stream: Stream
    tiles: list[Any]


def _with_tiles(scenes: "Iterable[SceneLike | StreamedScene]") -> "Iterator[SceneLike | StreamedScene | _Tiles]":
    """The scenes, with `_Tiles` of the files of one format with a stream that follow one another."""
    tiles, others = list[_Tiles](), list[Any]()
    for scene in scenes:
        path = scene_path(scene) if isinstance(scene, (str, os.PathLike)) else None
        file_format = format_taking(scene) if path is None else format_of(path)
        if file_format is not None and file_format.stream is not None:
            if tiles and tiles[0].stream is not file_format.stream:
                yield tiles.pop()
            tiles = tiles or [_Tiles(file_format.stream, [])]
            tiles[0].tiles.append(scene if path is None else path)
            continue
        if tiles:
            yield tiles.pop()
        others.append(scene)
        del scene
        yield others.pop()  # so that no reference is left
    if tiles:
        yield tiles.pop()


def _scene_data(scene: "SceneLike | StreamedScene | _Tiles") -> SceneData | StreamedScene:
    """The data of a scene; tiles are streamed."""
    if isinstance(scene, _Tiles):
        return scene.stream([(tile, {}) for tile in scene.tiles])
    if isinstance(scene, (str, os.PathLike)):
        data = read_scene_data(scene, ReadOptions(streamed=True))
        for note in data.notes:
            warnings.warn(note, UserWarning, stacklevel=3)
        return data
    return scene if isinstance(scene, StreamedScene) else scene_of(scene).data
