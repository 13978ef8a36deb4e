"""The stages of a build as parts in a folder, which threads, shards or a cluster run, and which resume."""

import json
import platform
import secrets
import shutil
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from ..base.errors import InputError
from ..base.files import atomic_output
from ..store.build_stages import Records, Work
from ..store.staging_files import Record
from .executors import StagedExecutor
from .work_parts import ABOUT, Arrays, Parts

_TOKEN = "shared.txt"
_SIZE = "size"  # array in a record: bytes of the file


class _StoredRecord(Record):
    """The record of a unit, from a file that this or another version has written."""

    def __init__(self, record: Record, folder: Path):
        super().__init__(record)
        self._folder = folder

    def __missing__(self, name: str) -> NoReturn:
        raise InputError(
            f"{self._folder}: is of a build by another version of antumbra (no {name}); delete it, and build again"
        )


class SharedFolder(NamedTuple):
    """A folder that the nodes of a cluster share. A file in it tells it from one of the same name on another disk."""

    path: Path
    token: str

    @classmethod
    def at(cls, path: Path) -> "SharedFolder":
        """A folder, which may be missing."""
        return cls(path.absolute(), secrets.token_hex(8))

    def make(self) -> None:
        """Create the folder, with its file."""
        self.path.mkdir(parents=True, exist_ok=True)
        (self.path / _TOKEN).write_text(self.token)

    def check(self) -> None:
        """Raise an InputError unless this machine has the folder."""
        with suppress(OSError):
            if (self.path / _TOKEN).read_text() == self.token:
                return
        raise InputError(
            f"{self.path}: is not on node {platform.node()}; write the store to a folder that all nodes share"
        )

    def leave(self) -> None:
        """Remove the file, and the folder if it is empty."""
        with suppress(OSError):
            (self.path / _TOKEN).unlink()
            self.path.rmdir()


class PartStages:
    """`store.build_stages.Stages` of an executor.

    Parameters
    ----------
    about : what the store depends on, by name
    shared : folder of the files, and of finished records, on a cluster; None: that of the executor
    is_alone : whether no other process runs stages, so that the files of a finished stage can be removed
    """

    def __init__(
        self, executor: StagedExecutor, about: dict[str, str], shared: SharedFolder | None = None, is_alone: bool = True
    ):
        assert executor.folder is not None
        self.folder = executor.folder if shared is None else shared.path
        self.executor, self.about, self.shared, self._is_alone = executor, about, shared, is_alone
        self._parts = dict[str, _StageParts]()

    def run(self, stage: str, count: int, work: Work, is_last: bool = False) -> Records | None:
        parts = self._parts[stage] = _StageParts(stage, count, work, self, is_last)
        if not is_last and all(parts.done(k) for k in range(count)):
            return parts.record
        run = self.executor.finish if is_last else self.executor.prepare
        if self.shared is None or not self._is_alone:
            is_done = run(list(self._parts.values()))
        else:
            self.shared.make()
            try:
                is_done = run(list(self._parts.values()))
            finally:
                self.shared.leave()
        return parts.record if is_done else None

    def file(self, stage: str, k: int) -> Path:
        return self._parts[stage].file(k, self.folder)

    def drop(self, stage: str) -> None:
        for k in range(len(self._parts[stage]) if self._is_alone else 0):
            self.file(stage, k).unlink(missing_ok=True)

    def end(self) -> None:
        """Remove all parts. Those of a build of another scene, or with other settings, will not be used either."""
        self.executor.end(list(self._parts.values()))
        if self._is_alone:
            kinds = {parts.about["what"] for parts in self._parts.values()}
            for about in self.folder.glob(f"*/{ABOUT}"):
                with suppress(OSError, ValueError):
                    if json.loads(about.read_text()).get("what") in kinds:
                        shutil.rmtree(about.parent)
            with suppress(OSError):
                self.folder.rmdir()


class _StageParts(Parts):
    """The units of a stage: parts of one item. Each has a file besides its record."""

    def __init__(self, stage: str, count: int, work: Work, stages: PartStages, is_last: bool):
        about = stages.about | {"what": f"{stage} of a store"}
        super().__init__(stage, count, 1, self._run, stages.executor.folder, about)
        self._write, self._target, self._is_last = work, stages.folder, is_last
        self._on_cluster = stages.shared is not None
        self.what = "parts of the store" if self._on_cluster else ""  # elsewhere, the build reports its progress

    def file(self, k: int, root: Path) -> Path:
        """The file of unit k below a root."""
        return root / self.name / f"{k:06d}.bin"

    def files(self, k: int) -> list[str]:
        """The record, and before it the file if a merge needs it. On a cluster, workers write files themselves."""
        file = [f"{self.name}/{k:06d}.bin"] if self._is_last and not self._on_cluster else []
        return [*file, *super().files(k)]

    def done(self, k: int, root: Path | None = None) -> bool:
        root = root or self._target
        if (record := self._load(k, root)) is None:
            return False
        file = self.file(k, root)
        if not file.exists():
            return not self._is_last  # it was needed for the next stage only
        return file.stat().st_size == int(record[_SIZE])

    def record(self, k: int) -> Record:
        """The record of unit k, which must be done."""
        if (record := self._load(k, self._target)) is None:
            raise InputError(f"{self._target}: part {k} is missing or damaged; run the command again")
        return _StoredRecord(record, self._target)

    def _run(self, first: int, last: int) -> Arrays:
        path = self.file(first, self._target)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with atomic_output(path) as temporary:
                record = self._write(first, temporary)
        except BaseException:
            with suppress(OSError):  # leave no empty folders
                path.parent.rmdir()
                path.parent.parent.rmdir()
            raise
        return record | {_SIZE: np.array(path.stat().st_size)}
