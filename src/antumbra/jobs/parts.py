"""Long work in parts: finished parts are kept in a folder, and the same work goes on where it stopped.

A part is a range of items. Its results depend on the settings and the range only, so the order in which parts are done,
and by whom, does not matter. Parts are the units of an `engines.Engine`.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.plan import Plan, parse_plan
from ..errors import InputError
from ..files import atomic_output
from ..version import VERSION

Arrays = dict[str, np.ndarray]
Work = Callable[[int, int], Arrays]
"""work(first, last) -> arrays whose first axis are the items from `first` to `last`, excluded."""

ABOUT = "about.json"
"""The file beside the parts of a folder that says what they depend on."""

_OF = "part of"  # the array in each file that names its folder and its number


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


def about_parts(what: str, scene: str, *settings: Any) -> dict[str, str]:
    """What parts depend on, for `Parts`: the kind of work, the digest of a scene, settings, and this version."""
    return {"what": what, "version": VERSION, "scene": scene, "settings": digest(*settings)}


def inexact(plan: str | Plan | None) -> str | None:
    """A plan that changes bits, as text, for the settings of parts; None: an exact one, which changes none."""
    found = None if plan is None else parse_plan(plan)
    return None if found is None or found.tracer.exact else str(found)


class Parts:
    """Items 0 to `count` in parts of `size`: units of work, whose files are .npz.

    what : name of the work, for users
    work : makes the arrays of a range
    folder : where finished parts are kept, in a folder of their own; None: they are kept in memory
    about : names and texts of all that the results depend on; they name that folder
    """

    def __init__(
        self, what: str, count: int, size: int, work: Work, folder: Path | None = None,
        about: dict[str, str] | None = None,
    ):  # fmt: skip
        self.what, self.about, self._work = what, about or {}, work
        self.ranges = [(first, min(first + size, count)) for first in range(0, count, size)]
        self.name = digest(self.about)
        self.root = folder
        self.folder = None if folder is None else folder / self.name
        self._made: dict[int, Arrays] = {}

    def __len__(self) -> int:
        return len(self.ranges)

    def root_of(self, folder: Path) -> Path:
        return folder

    def files(self, k: int) -> list[str]:
        """The file of part k, below the root."""
        return [f"{self.name}/{k:06d}.npz"]

    def done(self, k: int, root: Path | None = None) -> bool:
        """Whether part k is kept and whole; `root`: another root to look at."""
        return self._kept(k, root) is not None

    def found(self, k: int) -> None:
        """Nobody needs to know."""

    def do(self, k: int) -> None:
        """Do part k, and keep it."""
        made = self._work(*self.ranges[k])
        if self.folder is None:
            self._made[k] = made
            return
        file = self._file(k, None)
        file.parent.mkdir(parents=True, exist_ok=True)
        if not (told := file.with_name(ABOUT)).exists():
            with atomic_output(told) as temporary:
                temporary.write_text(json.dumps(self.about))
        with atomic_output(file) as temporary, open(temporary, "wb") as out:
            np.savez(out, allow_pickle=False, **made, **{_OF: np.array(f"{self.name} {k}")})

    def joined(self, names: Sequence[str]) -> Arrays:
        """The arrays of these names of all parts, which are done, one after the other. There is at least one part."""
        done = [[part[name] for name in names] for part in map(self.__getitem__, range(len(self)))]
        return {name: np.concatenate(arrays) for name, arrays in zip(names, zip(*done))}

    def __getitem__(self, k: int) -> Arrays:
        """The arrays of part k, which is done."""
        found = self._kept(k, None)
        if found is None:
            raise InputError(f"{self.folder}: part {k} is missing or damaged; run the command again")
        return found

    def _file(self, k: int, root: Path | None) -> Path:
        assert self.root is not None
        return (root or self.root) / self.files(k)[0]

    def _kept(self, k: int, root: Path | None) -> Arrays | None:
        """The arrays of part k; None if it is not done, or its file is damaged or of other work."""
        if self.folder is None:
            return self._made.get(k)
        with (
            suppress(Exception),  # damage makes zipfile, zlib and numpy raise errors of many kinds
            np.load(self._file(k, root), allow_pickle=False) as kept,
        ):
            found = dict(kept)
            if str(found.pop(_OF)) == f"{self.name} {k}":
                return found
        return None

    def clear(self) -> None:
        """Remove the kept parts, and the folder around them if it is empty."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            with suppress(OSError):
                self.folder.parent.rmdir()
