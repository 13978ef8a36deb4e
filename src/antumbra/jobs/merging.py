"""Brings the shards of a job together: each unit must be there once, of this job and no other."""

import json
import shlex
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import InputError
from ..files import atomic_output
from .engines import Units, numbered, read_job
from .parts import ABOUT, Parts

_SHOWN = 3  # names in an error


class Found(NamedTuple):
    """A unit, and the root in which it is done."""

    units: Units
    k: int
    root: Path


class Merge:
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
        for found in self._places(job):
            own = found.units.root
            if own is not None and found.root.resolve() != own.resolve():
                _copy(found, own)
            found.units.found(found.k)
        return True

    def end(self, job: Sequence[Units]) -> None:
        """Remove what was brought here. Shards that were here stay."""
        if self.folder.resolve() not in self._sources:
            for units in job:
                units.clear()

    def _check_commands(self) -> None:
        for path, recorded in zip(self._sources.values(), self._recorded):
            if recorded.command != self._recorded[0].command:
                own = next(iter(self._sources.values()))
                raise InputError(f"{path}: has shards of another command than {own}: {shlex.join(recorded.command)}")

    def _places(self, job: Sequence[Units]) -> list[Found]:
        """Where each unit is done. Raises InputError if one is missing, or there twice."""
        found, missing = list[Found](), list[tuple[int, str]]()
        for number, units, k in numbered(job):
            places = [root for root in self._roots(units) if units.done(k, root)]
            if len(places) > 1:
                name = units.files(k)[0]
                raise InputError(f"{name} is there twice, in {places[0]} and {places[1]}; leave one of them out")
            if places:
                found.append(Found(units, k, places[0]))
            else:
                missing.append((number, self._fault(units, k)))
        if missing:
            raise InputError(self._told(missing, len(found) + len(missing)))
        return found

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
        names = ", ".join(f"{i}/{of}" for i in shards[:_SHOWN]) + (", ..." if len(shards) > _SHOWN else "")
        faults = [fault for _, fault in missing if fault]
        why = f" ({'; '.join(faults[:_SHOWN])})" if faults else ""
        what = f"shard{'s' * (len(shards) > 1)} {names} {'are' if len(shards) > 1 else 'is'} not complete"
        again = shlex.join(["antumbra", *self._recorded[0].command, "--shard", f"{shards[0]}/{of}"])
        return f"{what}, {len(missing)} of {total} parts lack{why}; run {again}"


def _check_folder(folder: Path, job: Sequence[Units]) -> None:
    """Refuse parts of other work: they are stale, or of another job."""
    own = {units.name: units.about for units in job if isinstance(units, Parts)}
    for path in sorted(folder.iterdir()):
        if path.is_dir() and path.name not in own:
            raise InputError(f"{path}: {_difference(path, list(own.values()))}; remove it, and merge again")


def _difference(path: Path, own: list[dict[str, str]]) -> str:
    """In words, how the parts in a folder differ from those of this job."""
    try:
        about = json.loads((path / ABOUT).read_text())
        same = next(each for each in own if each["what"] == about["what"])
    except (OSError, ValueError, KeyError, TypeError, StopIteration):
        return "has parts of another job"
    if about["version"] != same["version"]:
        return f"has stale parts, made by antumbra {about['version']}"
    if about["scene"] != same["scene"]:
        return "has stale parts, of the scene as it was before"
    return "has parts of other settings, or of other input files"


def _copy(found: Found, root: Path) -> None:
    """Copy the files of a unit to another root; the file that says it is done is the last one."""
    for file in found.units.files(found.k):
        target = root / file
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output(target) as temporary:
            shutil.copyfile(found.root / file, temporary)
