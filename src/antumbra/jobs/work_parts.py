"""Resumable parts of long work, merging the shards of a job, and pictures whose row bands are parts.

A part is a range of items. Its results depend only on the settings and the range, so parts may be done in any order and
on any machine. Finished parts are stored in a folder, and an interrupted job resumes there. A merge checks that each
unit is there exactly once and belongs to the job.
"""

import hashlib
import json
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..engine.plan import Plan, parse_plan
from ..errors import InputError
from ..files import atomic_output
from ..picture.frame import Frame
from ..picture.render_options import RenderOptions
from ..picture.renderer import Renderer
from ..picture.row_bands import BAND, band_array_names, joined_bits
from ..scene.camera import Camera
from ..scene.lights import Light
from ..version import VERSION
from .executors import Executor, Units, numbered, read_job

# --- Long work in parts: finished parts are kept in a folder, and the same work goes on where it stopped --------------
#
# A part is a range of items. Its results depend on the settings and the range only, so the order in which parts are
# done, and by whom, does not matter. Parts are the units of an `engines.Engine`.


Arrays = dict[str, np.ndarray]
Work = Callable[[int, int], Arrays]
"""work(first, last) -> arrays whose first axis are the items from `first` to `last`, excluded."""

ABOUT = "about.json"
"""The file beside the parts of a folder that says what they depend on."""

_OF = "part of"  # the array in each file that names its folder and its number


def settings_digest(*settings: Any) -> str:
    """A short name of settings: arrays, and all that JSON holds."""
    digest = hashlib.sha256()
    for each in settings:
        if isinstance(each, np.ndarray):
            digest.update(f"{each.dtype.str}{each.shape}".encode())
            digest.update(np.ascontiguousarray(each).data)
        else:
            digest.update(json.dumps(each, sort_keys=True, default=str).encode())
        digest.update(b";")
    return digest.hexdigest()[:24]


def about_parts(what: str, scene: str, *settings: Any) -> dict[str, str]:
    """What parts depend on, for `Parts`: the kind of work, the digest of a scene, settings, and this version."""
    return {"what": what, "version": VERSION, "scene": scene, "settings": settings_digest(*settings)}


def inexact_plan(plan: str | Plan | None) -> str | None:
    """A plan that changes bits, as text, for the settings of parts; None: an exact one, which changes none."""
    parsed = None if plan is None else parse_plan(plan)
    return None if parsed is None or parsed.tracer.exact else str(parsed)


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
        self.name = settings_digest(self.about)
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
        arrays = self._work(*self.ranges[k])
        if self.folder is None:
            self._made[k] = arrays
            return
        file = self._file(k, None)
        file.parent.mkdir(parents=True, exist_ok=True)
        if not (about_file := file.with_name(ABOUT)).exists():
            with atomic_output(about_file) as temporary:
                temporary.write_text(json.dumps(self.about))
        with atomic_output(file) as temporary, open(temporary, "wb") as out:
            np.savez(out, allow_pickle=False, **arrays, **{_OF: np.array(f"{self.name} {k}")})

    def joined(self, names: Sequence[str]) -> Arrays:
        """The arrays of these names of all parts, which are done, one after the other. There is at least one part."""
        done = [[part[name] for name in names] for part in map(self.__getitem__, range(len(self)))]
        return {name: np.concatenate(arrays) for name, arrays in zip(names, zip(*done))}

    def __getitem__(self, k: int) -> Arrays:
        """The arrays of part k, which is done."""
        arrays = self._kept(k, None)
        if arrays is None:
            raise InputError(f"{self.folder}: part {k} is missing or damaged; run the command again")
        return arrays

    def _file(self, k: int, root: Path | None) -> Path:
        assert self.root is not None
        return (root or self.root) / self.files(k)[0]

    def _kept(self, k: int, root: Path | None) -> Arrays | None:
        """The arrays of part k; None if it is not done, or its file is damaged or of other work."""
        if self.folder is None:
            return self._made.get(k)
        with (
            suppress(Exception),  # damage makes zipfile, zlib and numpy raise errors of many kinds
            np.load(self._file(k, root), allow_pickle=False) as archive,
        ):
            arrays = dict(archive)
            if str(arrays.pop(_OF)) == f"{self.name} {k}":
                return arrays
        return None

    def clear(self) -> None:
        """Remove the kept parts, and the folder around them if it is empty."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            with suppress(OSError):
                self.folder.parent.rmdir()


# --- Brings the shards of a job together: each unit must be there once, of this job and no other ----------------------


_MAX_NAMES = 3  # names in an error


class FinishedUnit(NamedTuple):
    """A unit, and the root in which it is done."""

    units: Units
    k: int
    root: Path


class ShardMerge:
    """An engine that does no unit: all of them are in folders of shards.

    folder : where the job keeps its units, for the results
    sources : folders of shards; `folder` may be one of them
    """

    def __init__(self, folder: Path, sources: Sequence[Path]):
        self.folder = folder
        self._sources = {path.resolve(): path for path in sources}
        self._recorded = [read_job(path) for path in sources]

    def finish(self, job: Sequence[Units]) -> bool:
        self._check_commands()
        for source in self._sources.values():
            _check_folder(source, job)
        for unit in self._places(job):
            target = unit.units.root
            if target is not None and unit.root.resolve() != target.resolve():
                _copy(unit, target)
            unit.units.found(unit.k)
        return True

    def end(self, job: Sequence[Units]) -> None:
        """Remove what was brought here. Shards that were here stay."""
        if self.folder.resolve() not in self._sources:
            for units in job:
                units.clear()

    def _check_commands(self) -> None:
        for path, recorded in zip(self._sources.values(), self._recorded):
            if recorded.command != self._recorded[0].command:
                first_source = next(iter(self._sources.values()))
                raise InputError(
                    f"{path}: has shards of another command than {first_source}: {shlex.join(recorded.command)}"
                )

    def _places(self, job: Sequence[Units]) -> list[FinishedUnit]:
        """Where each unit is done. Raises InputError if one is missing, or there twice."""
        finished, missing = list[FinishedUnit](), list[tuple[int, str]]()
        for number, units, k in numbered(job):
            places = [root for root in self._roots(units) if units.done(k, root)]
            if len(places) > 1:
                name = units.files(k)[0]
                raise InputError(f"{name} is there twice, in {places[0]} and {places[1]}; leave one of them out")
            if places:
                finished.append(FinishedUnit(units, k, places[0]))
            else:
                missing.append((number, self._fault(units, k)))
        if missing:
            raise InputError(self._told(missing, len(finished) + len(missing)))
        return finished

    def _roots(self, units: Units) -> Iterator[Path]:
        """The roots of all sources, each once."""
        yield from {
            units.root_of(source).resolve(): units.root_of(source) for source in self._sources.values()
        }.values()

    def _fault(self, units: Units, k: int) -> str:
        """Why unit k is not done."""
        for root in self._roots(units):
            for file in units.files(k):
                if (root / file).exists():
                    return f"{root / file} is damaged, or of another job"
        return ""

    def _told(self, missing: list[tuple[int, str]], total: int) -> str:
        """The units that are missing, by the names of their shards."""
        of = self._recorded[0].of
        shards = sorted({number % of for number, _ in missing})
        names = ", ".join(f"{i}/{of}" for i in shards[:_MAX_NAMES]) + (", ..." if len(shards) > _MAX_NAMES else "")
        faults = [fault for _, fault in missing if fault]
        why = f" ({'; '.join(faults[:_MAX_NAMES])})" if faults else ""
        what = f"shard{'s' * (len(shards) > 1)} {names} {'are' if len(shards) > 1 else 'is'} not complete"
        again = shlex.join(["antumbra", *self._recorded[0].command, "--shard", f"{shards[0]}/{of}"])
        return f"{what}, {len(missing)} of {total} parts lack{why}; run {again}"


def _check_folder(folder: Path, job: Sequence[Units]) -> None:
    """Refuse parts of other work: they are stale, or of another job."""
    about_by_name = {units.name: units.about for units in job if isinstance(units, Parts)}
    for path in sorted(folder.iterdir()):
        if path.is_dir() and path.name not in about_by_name:
            raise InputError(f"{path}: {_difference(path, list(about_by_name.values()))}; remove it, and merge again")


def _difference(path: Path, expected: list[dict[str, str]]) -> str:
    """In words, how the parts in a folder differ from those of this job."""
    try:
        about = json.loads((path / ABOUT).read_text())
        same = next(each for each in expected if each["what"] == about["what"])
    except (OSError, ValueError, KeyError, TypeError, StopIteration):
        return "has parts of another job"
    if about["version"] != same["version"]:
        return f"has stale parts, made by antumbra {about['version']}"
    if about["scene"] != same["scene"]:
        return "has stale parts, of the scene as it was before"
    return "has parts of other settings, or of other input files"


def _copy(unit: FinishedUnit, root: Path) -> None:
    """Copy the files of a unit to another root; the file that says it is done is the last one."""
    for file in unit.units.files(unit.k):
        target = root / file
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output(target) as temporary:
            shutil.copyfile(unit.root / file, temporary)


# --- A picture whose rays are traced in bands of rows, by any engine --------------------------------------------------


def render_bands(
    renderer: Renderer, camera: Camera, lights: Sequence[Light], options: RenderOptions, engine: Executor, scene: str,
    settings: dict,
) -> Frame | None:  # fmt: skip
    """The frame of `Renderer.render`, whose rays an engine traces; None if it leaves bands to others.

    scene, settings : the digest of the scene, and all that the bits depend on besides it, as JSON can hold them
    """
    request = renderer.request(camera, lights, options)
    rows = None

    def band(first: int, last: int):
        nonlocal rows
        rows = rows or renderer.rows(request)
        return rows.band(first, last)

    about = about_parts("picture", scene, settings)
    parts = Parts("bands of the picture", camera.height, BAND, band, engine.folder, about)
    if not engine.finish([parts]):
        return None
    frame = renderer.from_rows(request, joined_bits(parts.joined(band_array_names(request))))
    engine.end([parts])  # the bits are in memory
    return frame
