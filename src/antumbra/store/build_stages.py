"""The stages of a build: units that write files, described by records, which the units of the next stage read."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from .staging_files import Record

Work = Callable[[int, Path], Record]
"""work(k, path): write the file of unit k; return its record."""

Records = Callable[[int], Record]
"""The record of unit k, read from its file."""


class Stages(Protocol):
    """Runs the units of a build, stage by stage. A unit depends on its number and on earlier stages only."""

    @property
    def folder(self) -> Path:
        """The folder of the files, which may be missing before the first one is written."""
        ...

    def run(self, stage: str, count: int, work: Work, is_last: bool = False) -> Records | None:
        """Run the units 0 to `count` of a stage; None if some of them are left to others."""
        ...

    def file(self, stage: str, k: int) -> Path:
        """The file of a finished unit."""
        ...

    def drop(self, stage: str) -> None:
        """Remove the files of a stage, whose records stay, if no other process may need them."""
        ...

    def end(self) -> None:
        """Remove all files and records."""
        ...


class LocalStages:
    """Runs all units here.

    folder : an existing one, which the caller removes
    """

    def __init__(self, folder: Path):
        self.folder = folder

    def run(self, stage: str, count: int, work: Work, is_last: bool = False) -> Records:
        for k in range(count):
            with (self.folder / f"{stage}-{k}.npz").open("wb") as out:
                np.savez(out, allow_pickle=False, **work(k, self.file(stage, k)))
        return lambda k: _record_in(self.folder / f"{stage}-{k}.npz")

    def file(self, stage: str, k: int) -> Path:
        return self.folder / f"{stage}-{k}"

    def drop(self, stage: str) -> None:
        for path in self.folder.glob(f"{stage}-*"):
            if path.suffix != ".npz":
                path.unlink()

    def end(self) -> None:
        """No-op: the caller removes the folder."""


def _record_in(path: Path) -> Record:
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)
