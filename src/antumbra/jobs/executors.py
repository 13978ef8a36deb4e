"""Executors run the units of a job: all of them here, one shard of them, or none, to collect the units.

A unit is one file or a few. It depends on the job and its number alone, so it may run twice, and anywhere.
docs/design/shards.md gives the reasons.
"""

import json
import shlex
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from ..checks import listed, path_of, quoted, whole_number
from ..errors import InputError
from ..files import atomic_output, checked_folder
from ..progress import report_progress

JOB = "job.json"
"""The file in a folder of shards that says which command made them."""


class Units(Protocol):
    """Work in units, numbered from 0. Their files lie below `root`; the work is done when all of them are there."""

    what: str  # name of the work, for users; empty: it shows its own progress

    @property
    def root(self) -> Path | None: ...  # None: units are kept in memory

    def root_of(self, folder: Path) -> Path:
        """The root in which another run has its files, if it keeps its shards in `folder`."""
        ...

    def __len__(self) -> int: ...

    def files(self, k: int) -> list[str]:
        """The files of unit k, below the root."""
        ...

    def done(self, k: int, root: Path | None = None) -> bool:
        """Whether the files of unit k are there, whole, and of this work; `root`: another root to look at."""
        ...

    def do(self, k: int) -> None:
        """Do unit k, and write its files."""
        ...

    def found(self, k: int) -> None:
        """Hear that unit k was done before."""

    def clear(self) -> None:
        """Remove files that are no results, when the results have been written."""


class Executor(Protocol):
    """Does the units of a job."""

    @property
    def folder(self) -> Path | None:
        """Where units are kept that are no results; None: in memory, if there is room."""

    def finish(self, job: Sequence[Units]) -> bool:
        """Do what this engine has to do; return whether all units are done, so that the job can end."""
        ...

    def end(self, job: Sequence[Units]) -> None:
        """The job's results have been written."""


def executor_of(keep) -> Executor:
    """The engine that an argument `keep` means: an engine, or the folder of one that does everything itself."""
    keep = checked_keep(keep)
    if keep is None:
        return LocalExecutor(None)
    return LocalExecutor(checked_folder(keep, parents=True)) if isinstance(keep, Path) else keep


def checked_keep(keep) -> Any:
    """An argument `keep` as an engine, None, or the path of a folder, which is not made yet; else an InputError."""
    if keep is None or all(hasattr(keep, part) for part in ("folder", "finish", "end")):
        return keep
    return path_of(keep, "keep")


class LocalExecutor:
    """Does all units that are not done yet."""

    def __init__(self, folder: Path | None = None):
        self.folder = folder

    def finish(self, job: Sequence[Units]) -> bool:
        for units in job:
            do_missing(units, range(len(units)))
        return True

    def end(self, job: Sequence[Units]) -> None:
        for units in job:
            units.clear()


def do_missing(units: Units, numbers: Sequence[int]) -> int:
    """Do those of the numbered units that are not done yet; return how many they were."""
    did = 0
    if not len(numbers):
        return did
    with report_progress(units.what) if units.what else nullcontext(lambda done, total: None) as progress:
        for i, k in enumerate(numbers):
            if units.done(k):
                units.found(k)
            else:
                units.do(k)
                did += 1
            progress(i + 1, len(numbers))
    return did


class ShardIndex(NamedTuple):
    """Shard `number` of `of`: the units number, number + of, number + 2 of, ... of a job."""

    number: int  # from 0
    of: int

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def checked_shard(shard) -> ShardIndex:
    """`shard`, (i, n) with 0 <= i < n; otherwise an InputError."""
    with suppress(InputError):
        index, of = (whole_number(i, "shard", 0, 2**31) for i in listed(shard, "shard", 2))
        if index < of:
            return ShardIndex(index, of)
    raise InputError(f"shard is {quoted(shard)}; it must be (i, n) with 0 <= i < n, such as (0, 4)")


class ShardExecutor:
    """Does one shard of a job, and leaves the rest to others.

    folder : where its units are kept
    command : the words of the command, which `merge` repeats; they identify the job
    """

    def __init__(self, folder: Path, share: ShardIndex, command: Sequence[str]):
        self.folder, self.share, self._command = folder, share, list(command)
        self.units = self.did = 0  # of this shard; and how many of them were not done before

    def finish(self, job: Sequence[Units]) -> bool:
        write_job(self.folder, self._command, self.share.of)
        start = 0
        for units in job:
            first = (self.share.number - start) % self.share.of
            numbers = range(first, len(units), self.share.of)
            self.did += do_missing(units, numbers)
            self.units += len(numbers)
            start += len(units)
        return False

    def end(self, job: Sequence[Units]) -> None:
        raise AssertionError("a shard writes no results")


class UnitCollector:
    """An engine that does nothing: it learns the units of a job, which others ask for one by one."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.job: list[Units] = []

    def finish(self, job: Sequence[Units]) -> bool:
        self.job = list(job)
        return False

    def end(self, job: Sequence[Units]) -> None:
        raise AssertionError("it writes no results")


class ShardRecord(NamedTuple):
    """What a folder of shards says of itself."""

    command: list[str]
    of: int  # shards of the last one that began


def write_job(folder: Path, command: Sequence[str], of: int) -> None:
    """Say which command a folder belongs to.

    Raises
    ------
    InputError
        If it belongs to another command, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another output") from None
    if (folder / JOB).exists():
        found = read_job(folder)
        if found.command != list(command):
            raise InputError(f"{folder}: has shards of another command ({shlex.join(found.command)}); remove it")
        if found.of == of:
            return
    with atomic_output(folder / JOB) as temporary:
        temporary.write_text(json.dumps({"format": 1, "command": list(command), "of": of}) + "\n")


def read_job(folder: Path) -> ShardRecord:
    """What `write_job` wrote. Raises InputError if the folder has no shards."""
    try:
        found: dict[str, Any] = json.loads((folder / JOB).read_text())
        return ShardRecord([str(word) for word in found["command"]], int(found["of"]))
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{folder}: holds no shards; name the folder NAME.shards that --shard made") from None


def numbered(job: Sequence[Units]) -> Iterator[tuple[int, Units, int]]:
    """Yield (number in the job, units, number in them) of each unit of a job."""
    total = 0
    for units in job:
        for k in range(len(units)):
            yield total, units, k
            total += 1
