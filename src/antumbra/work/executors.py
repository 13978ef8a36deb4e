"""Executors, which run the units of some work: all of them locally, one shard, or none when they are only collected.

A unit produces one or a few files. It depends only on the work and its own number, so it may run twice, and on any
machine. docs/design/shards.md explains the design.
"""

import json
import os
import shlex
import warnings
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, Protocol, TypeAlias, cast

from ..base.checks import listed, path_of, quoted, whole_number
from ..base.errors import InputError, UnavailableError
from ..base.files import atomic_output, checked_folder
from ..base.progress import report_progress
from ..base.wording import some_of
from ..store.system_resources import resident_memory
from .estimates import JUDGED, Estimate, tell_estimate

JOB = "job.json"
"""File in a folder of shards that records the command that made them."""

SHARDS = ".shards"
"""Suffix of folders of shards."""

JOB_FORMAT = 1
"""Version of the schema of `JOB`."""


class Units(Protocol):
    """Work divided into units, numbered from 0. Their files lie below `root`; the work is done once all exist."""

    what: str  # name shown to users; empty: the work reports its own progress

    @property
    def root(self) -> Path | None: ...  # None: units are kept in memory

    def root_of(self, folder: Path) -> Path:
        """The root of a run that keeps its shards in `folder`."""
        ...

    def __len__(self) -> int: ...

    def files(self, k: int) -> list[str]:
        """The files of unit k, relative to the root."""
        ...

    def done(self, k: int, root: Path | None = None) -> bool:
        """Whether the files of unit k exist, are complete and belong to this work; `root`: look in another root."""
        ...

    def do(self, k: int) -> None:
        """Do unit k and write its files."""
        ...

    def found(self, k: int) -> None:
        """Called when unit k is already done."""

    def estimate(self, left: int) -> Estimate | None:
        """What a unit takes, judged by a sample that is dropped; None if it would not be small beside `left` units."""
        ...

    def clear(self) -> None:
        """Remove intermediate files after the results have been written."""


class Executor(Protocol):
    """Runs the units of some work."""

    @property
    def folder(self) -> Path | None:
        """Folder of intermediate units; None: in memory, if there is room."""

    def finish(self, work: Sequence[Units]) -> bool:
        """Run this executor's share; return whether all units are done, so that the work can end."""
        ...

    def end(self, work: Sequence[Units]) -> None:
        """Called after the work's results have been written."""


class UnitCount:
    """What an executor counts: the units of its work, and those that it has not found done already."""

    units = did = 0

    def add(self, units: int, did: int) -> None:
        """Count more units."""
        self.units, self.did = self.units + units, self.did + did


def traced_share(executor: Executor | None) -> float:
    """The share of the units of some work that were done now: 1 without an executor that counts them."""
    return executor.did / executor.units if isinstance(executor, UnitCount) and executor.units else 1.0


class StagedExecutor(Executor, Protocol):
    """An executor of work in stages: the units of a stage depend on those of earlier ones."""

    def prepare(self, work: Sequence[Units]) -> bool:
        """Run all units of earlier stages; return whether all are done, so that the next stage can begin."""
        ...


Keep: TypeAlias = str | os.PathLike[str] | Executor | None
"""Argument `keep` of studies and bakes: a folder of finished parts, or the executor that runs the units."""


def executor_of(keep: Keep) -> Executor:
    """The executor for an argument `keep`: the executor itself, or a local one that keeps its parts in that folder."""
    keep = checked_keep(keep)
    if keep is None:
        return LocalExecutor(None)
    return LocalExecutor(checked_folder(keep, parents=True)) if isinstance(keep, Path) else keep


def checked_keep(keep: Keep) -> Path | Executor | None:
    """`keep` as an executor, None, or the path of a folder, which is not created yet; otherwise an InputError."""
    if keep is None or all(hasattr(keep, part) for part in ("folder", "finish", "end")):
        return cast(Executor | None, keep)
    return path_of(keep, "keep")


class LocalExecutor(UnitCount):
    """Runs all units that are not done yet."""

    def __init__(self, folder: Path | None = None):
        self.folder = folder

    def finish(self, work: Sequence[Units]) -> bool:
        self.add(sum(map(len, work)), do_missing([(units, range(len(units))) for units in work]))
        return True

    def prepare(self, work: Sequence[Units]) -> bool:
        return self.finish(work)

    def end(self, work: Sequence[Units]) -> None:
        for units in work:
            units.clear()


def do_missing(share: Sequence[tuple[Units, Sequence[int]]]) -> int:
    """Do the numbered units that are not done yet, with an estimate for the rest; return their number.

    An interruption notes how many are kept.
    """
    did = passed = 0
    try:
        for units, numbers in share:
            done_now, sampled = 0, False
            if not len(numbers):
                continue
            with report_progress(units.what) if units.what else nullcontext(lambda done, total: None) as progress:
                for i, k in enumerate(numbers):
                    if units.done(k):
                        units.found(k)
                    else:
                        if not done_now and (estimate := units.estimate(len(numbers) - i)) is not None:
                            sampled = True
                            tell_estimate(units.what, units.root, estimate, len(numbers) - i)
                        start = perf_counter()
                        units.do(k)
                        done_now += 1
                        if done_now == JUDGED and not sampled:
                            estimate = _estimate_of(units, k, perf_counter() - start)
                            tell_estimate(units.what, units.root, estimate, len(numbers) - i - 1)
                    passed += units.root is not None and units.what != ""  # other work tells it itself
                    progress(i + 1, len(numbers))
            did += done_now
    except KeyboardInterrupt:
        if passed:
            total = sum(len(numbers) for _, numbers in share)
            with suppress(UserWarning):  # where Python makes warnings errors
                warnings.warn(
                    f"{some_of(passed, total, 'part', 'are')} done; run it again to resume from there", stacklevel=2
                )
        raise
    return did


def _estimate_of(units: Units, k: int, seconds: float) -> Estimate:
    """What other units take, judged by unit k, which is done."""
    files = [] if units.root is None else [units.root / file for file in units.files(k)]
    size = sum(file.stat().st_size for file in files if file.is_file())  # a frame that failed has none
    return Estimate(seconds, size, resident_memory(), 0.0, "one part")


class ShardIndex(NamedTuple):
    """Shard `number` of `of`: the units number, number + of, number + 2 of, ... of some work."""

    number: int  # from 0
    of: int

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


def checked_shard(shard: tuple[int, int]) -> ShardIndex:
    """`shard` as (i, n) with 0 <= i < n; otherwise an InputError."""
    with suppress(InputError):
        index, of = (whole_number(i, "shard", 0, 2**31) for i in listed(shard, "shard", 2))
        if index < of:
            return ShardIndex(index, of)
    raise InputError(f"shard is {quoted(shard)}; it must be (i, n) with 0 <= i < n, such as (0, 4)")


class ShardExecutor(UnitCount):
    """Runs one shard of some work.

    folder : stores the shard's units
    command : the words of the command, which identify the work and which a merge repeats
    """

    def __init__(self, folder: Path, share: ShardIndex, command: Sequence[str]):
        self.folder, self.share, self._command = folder, share, list(command)

    def prepare(self, work: Sequence[Units]) -> bool:
        """Run this shard's units, then those that no other shard has done so far: the next stage needs them all."""
        write_shard_record(self.folder, self._command, self.share.of)
        for units in work:
            own = range(self.share.number, len(units), self.share.of)
            self.add(0, do_missing([(units, own)]))
            do_missing(
                [(units, [k for k in reversed(range(len(units))) if k not in own])]
            )  # others begin with the first
        return True

    def finish(self, work: Sequence[Units]) -> bool:
        write_shard_record(self.folder, self._command, self.share.of)
        start, share = 0, list[tuple[Units, Sequence[int]]]()
        for units in work:
            first = (self.share.number - start) % self.share.of
            share.append((units, range(first, len(units), self.share.of)))
            start += len(units)
        self.add(sum(len(numbers) for _, numbers in share), do_missing(share))
        return False

    def end(self, work: Sequence[Units]) -> None:
        raise AssertionError("a shard writes no results")


class UnitCollector:
    """Collects the units of some work without running them, so that a caller can run them one by one."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.work: list[Units] = []

    def finish(self, work: Sequence[Units]) -> bool:
        self.work = list(work)
        return False

    def prepare(self, work: Sequence[Units]) -> bool:
        return self.finish(work)

    def end(self, work: Sequence[Units]) -> None:
        raise AssertionError("a collector writes no results")


class ShardRecord(NamedTuple):
    """Record of a folder of shards."""

    command: list[str]
    of: int  # number of shards, as the latest run had it


def write_shard_record(folder: Path, command: Sequence[str], of: int) -> None:
    """Record the command that a folder belongs to.

    Raises
    ------
    InputError
        If the folder belongs to another command, or cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be created ({error.strerror}); choose another output") from None
    if (folder / JOB).exists():
        record = read_shard_record(folder)
        if record.command != list(command):
            raise InputError(f"{folder}: has shards of another command ({shlex.join(record.command)}); remove it")
        if record.of == of:
            return
    with atomic_output(folder / JOB) as temporary:
        temporary.write_text(json.dumps({"format": JOB_FORMAT, "command": list(command), "of": of}) + "\n")


def read_shard_record(folder: Path) -> ShardRecord:
    """Read the record of `write_shard_record`.

    Raises
    ------
    InputError
        If the folder has shards of another format, or neither shards nor the name of a folder of shards.
    UnavailableError
        If it has that name, and no shard has begun yet.
    """
    if folder.suffix == SHARDS and not (folder / JOB).exists():
        raise UnavailableError(f"{folder}: no shard has begun; run the shards, or name the folder that they write")
    try:
        data: dict[str, Any] = json.loads((folder / JOB).read_text())
        number = int(data["format"])
        if number == JOB_FORMAT:
            return ShardRecord([str(word) for word in data["command"]], int(data["of"]))
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{folder}: holds no shards; name the folder NAME.shards that --shard made") from None
    known = f"holds shards of format {number}, and this antumbra reads format {JOB_FORMAT}"
    raise InputError(f"{folder}: {known}; use the version that wrote them, or remove the folder")


def numbered(work: Sequence[Units]) -> Iterator[tuple[int, Units, int]]:
    """Yield (number in the work, units, number among these units) of each unit of some work."""
    total = 0
    for units in work:
        for k in range(len(units)):
            yield total, units, k
            total += 1
