"""Long work in parts: it shows progress, keeps finished parts in a folder, and goes on where it stopped.

A part is a range of items. Its results depend on the settings and the range only, so the order in which parts are done,
and by whom, does not matter.
"""

import hashlib
import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..errors import InputError
from ..kernels.progress import reported
from ..output import replacing

Arrays = dict[str, np.ndarray]
Work = Callable[[int, int], Arrays]
"""work(first, last) -> arrays whose first axis are the items from `first` to `last`, excluded."""


def digest(*settings: Any) -> str:
    """A short name of settings: arrays, and all that JSON holds."""
    made = hashlib.sha256()
    for each in settings:
        if isinstance(each, np.ndarray):
            made.update(f"{each.dtype.str}{each.shape}".encode())
            made.update(np.ascontiguousarray(each).data)
        else:
            made.update(json.dumps(each, sort_keys=True, default=str).encode())
        made.update(b";")
    return made.hexdigest()[:24]


class Parts:
    """Items 0 to `count` in parts of `size`.

    folder : where finished parts are kept, in a folder named by `name`; None: they are not kept
    name : from `digest`, of all that the results depend on
    """

    def __init__(self, count: int, size: int, folder: Path | None = None, name: str = ""):
        self.ranges = [(first, min(first + size, count)) for first in range(0, count, size)]
        self.folder = None if folder is None else folder / name
        self._made: dict[int, Arrays] = {}

    def run(self, work: Work, what: str) -> Arrays:
        """Do all parts that are not kept yet; return their arrays, joined.

        what : name of the work, for progress
        """
        self.finish(work, what)
        done = [self[k] for k in range(len(self.ranges))]
        return {name: np.concatenate([part[name] for part in done]) for name in (done[0] if done else ())}

    def finish(self, work: Work, what: str) -> None:
        """Do all parts that are not kept yet. Parts without a folder are kept in memory."""
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
        with reported(what) as progress:
            for k, (first, last) in enumerate(self.ranges):
                if self._kept(k) is None:
                    self._keep(k, work(first, last))
                progress(last, self.ranges[-1][1])

    def __getitem__(self, k: int) -> Arrays:
        """The arrays of part k, which is finished."""
        found = self._kept(k)
        if found is None:
            raise InputError(f"{self.folder}: part {k} is missing or damaged; run the command again")
        return found

    def _file(self, k: int) -> Path | None:
        return None if self.folder is None else self.folder / f"{k:06d}.npz"

    def _kept(self, k: int) -> Arrays | None:
        """The arrays of part k; None if it is not finished, or its file is damaged."""
        file = self._file(k)
        if file is None:
            return self._made.get(k)
        with suppress(OSError, ValueError, EOFError, BadZipFile), np.load(file, allow_pickle=False) as kept:
            return dict(kept)
        return None

    def _keep(self, k: int, made: Arrays) -> None:
        file = self._file(k)
        if file is None:
            self._made[k] = made
            return
        with replacing(file) as temporary, open(temporary, "wb") as out:
            np.savez(out, allow_pickle=False, **made)

    def clear(self) -> None:
        """Remove the kept parts, and the folder around them if it is empty."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            with suppress(OSError):
                self.folder.parent.rmdir()
