"""A node of a cluster: one process that owns its cores, opens the scene once, and does units of a job."""

import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from ..engine.plan import DEFAULT_PLAN, parse_plan
from ..engine.precompilation import compile_missing, missing_of
from ..files import file_lock, temporary_folder
from ..jobs.executors import UnitCollector, Units, numbered
from ..jobs.job_kernels import all_jobs
from ..progress import ignore_progress, progress_listener
from .inputs import Input, local_path, own_temporary

Prepare = Callable[[dict[str, str], int, UnitCollector], Any]
"""prepare(paths of inputs by name, threads, engine): begin a job, and give its units to the engine."""


class NodeJob(NamedTuple):
    """A job as nodes get it."""

    prepare: Prepare
    inputs: dict[str, Input]
    plan: str | None
    folder: str  # name of the folder of units


class Done(NamedTuple):
    """A unit that a node has done."""

    files: dict[str, bytes]  # by their names below the root; none if it cannot be done
    seconds: float


def signature(job: Sequence[Units]) -> list[tuple[int, list[str]]]:
    """What tells a job from others: numbers of units, and names of files, which have digests."""
    return [(len(units), units.files(0) if len(units) else []) for units in job]


class Node:
    """The worker of a node. Files are written in a folder of its own, and sent from there."""

    def __init__(self, threads: int):
        self._threads, self._open = threads, ExitStack()
        self._own = self._open.enter_context(temporary_folder())  # of a killed node, the next one removes it
        self._units: list[tuple[Units, int]] = []

    def begin(self, job: NodeJob, read: Callable[[str, int], bytes] | None) -> list[tuple[int, list[str]]]:
        """Open the inputs, compile what is missing, and prepare the job; return its `signature`.

        read : reads a piece of a file of the driver, see `inputs.local_path`
        """
        with progress_listener(ignore_progress):
            paths = {name: local_path(each, read, None) for name, each in job.inputs.items()}
            os.chdir(self._own)  # results of a job have relative names here
            warm(job.plan)
            asked = UnitCollector(Path(job.folder))
            job.prepare(paths, self._threads, asked)
        self._units = [(units, k) for _, units, k in numbered(asked.job)]
        return signature(asked.job)

    def do(self, number: int) -> Done:
        """Do a unit."""
        units, k = self._units[number]
        start = perf_counter()
        with progress_listener(ignore_progress):
            units.do(k)
        assert units.root is not None
        files = {name: units.root / name for name in units.files(k)}
        if not all(path.exists() for path in files.values()):
            return Done({}, perf_counter() - start)
        found = {name: path.read_bytes() for name, path in files.items()}
        for path in files.values():
            path.unlink()
        return Done(found, perf_counter() - start)

    def leave(self) -> None:
        """Remove the node's own files."""
        os.chdir(tempfile.gettempdir())
        self._open.close()


def warm(plan: str | None) -> None:
    """Compile the kernels of a plan that are missing on this machine. Its other workers wait, and find them."""
    wanted = {each for job in all_jobs([parse_plan(plan or DEFAULT_PLAN)]) for each in job.kernels() or ()}
    if missing_of(wanted):
        with file_lock(own_temporary() / "warm.lock"):
            if missing := missing_of(wanted):
                compile_missing(missing)
