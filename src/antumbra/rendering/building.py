"""Building a store, as users ask for it."""

from pathlib import Path
from tempfile import TemporaryDirectory

from ..checks import whole_number
from ..kernels.parallel import thread_count
from ..output import checked_output
from ..scene.any_scene import AnyScene
from ..store.build import CHUNK, LEAST_MEMORY, BuildReport, Progress, build_compiled
from ..store.layout import STORE_SUFFIX
from .ready import Job, fixed_job, make_ready, small_scene


def build_store(
    scenes,
    path,
    *,
    max_memory: int = 4 << 30,
    threads: int | None = None,
    chunk: int = CHUNK,
    progress: Progress | None = None,
) -> BuildReport:
    """Write scenes, as one, to a store, which `load` opens.

    Parameters
    ----------
    scenes : Scene or iterable of Scene
        Merged in this order, as they are at time 0; cameras and lights of all are kept. They are looked at one after
        the other, so a generator need not keep them.
    path : str or path-like
        A file ``*.antumbra``. It is written whole or not at all. While it is built, temporary files without a name
        take about 55 bytes a triangle beside it.
    max_memory : int
        Bytes that the process may have in memory at any time, from 384 MiB on, beside the scenes themselves.
    threads : int, optional
        None: all cores. Neither they nor `max_memory` change a bit of the file.
    chunk : int
        Triangles in a chunk, at most.
    progress : function of (text, done, total), optional
        Hears what is being done, how much of it is done, and of how much; 0: nobody knows.

    Returns
    -------
    BuildReport

    Raises
    ------
    InputError
        On scenes without triangles, too far apart or with other up axes; a path that cannot be written, or a full
        disk, and then nothing is left behind.
    """
    scenes = [scenes] if isinstance(scenes, AnyScene) else scenes
    path, threads = checked_output(path, (STORE_SUFFIX,)), thread_count(threads)
    max_memory = whole_number(max_memory, "max_memory", LEAST_MEMORY, 1 << 60)
    chunk = whole_number(chunk, "chunk", 16, 1 << 22)
    make_ready(store_job)
    return build_compiled(scenes, path, max_memory, threads, chunk, progress)


def store_job() -> Job:
    """Building a store."""

    def work():
        with TemporaryDirectory() as folder:
            build_compiled([small_scene()], Path(folder) / "small.antumbra", threads=2, chunk=64)

    return fixed_job("building stores", work)
