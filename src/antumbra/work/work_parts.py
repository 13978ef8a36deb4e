"""Resumable parts of long work, merging the shards of some work, and pictures rendered in row bands.

A part is a range of items. Its results depend only on the settings and the range, so parts may be done in any order and
on any machine. Finished parts are stored in a folder, from which interrupted work resumes. A merge checks that each
unit is present exactly once and belongs to the work.
"""

import filecmp
import hashlib
import json
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ..base.errors import InputError, UnavailableError
from ..base.files import atomic_output
from ..base.wording import some_of
from ..engine.plan import Plan, parse_plan
from ..picture.frame import Frame
from ..picture.render_options import RenderOptions
from ..picture.renderer import Renderer
from ..picture.row_bands import BAND, band_array_names, bits_of_bands
from ..scene.camera import Camera
from ..scene.lights import Light
from ..store.system_resources import peak_resident_memory, resident_memory
from ..version import VERSION
from .estimates import Estimate
from .executors import Executor, UnitCount, Units, numbered, read_shard_record

# --- Resumable parts --------------------------------------------------------------------------------------------------


Arrays = dict[str, np.ndarray]
Work = Callable[[int, int], Arrays]
"""work(first, last) -> arrays whose first axis runs over the items from `first` to `last`, exclusive."""

ABOUT = "about.json"
"""File beside the parts in a folder that records what they depend on."""

_PIECE, _PLACES = 32, 4  # of a part: the piece that is a sample, and their number
_MANY = 16  # parts, of which samples are a hundredth of the work
_LEAST = 16  # items of a piece, of which a part takes proportionally more
# What work takes beyond the memory that samples leave, as measured on sun, viewshed, los and skyline:
_HELD = 1.25  # of that memory
_ITEM, _SCRATCH = 600.0, 4.0  # bytes an item, or in the bytes of the results if these are more

_OF = "part of"  # array in each file that records its folder and number


def settings_digest(*settings: Any) -> str:
    """A short digest of settings: arrays and JSON values."""
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
    """The dependencies of `Parts`: the kind of work, the digest of a scene, the settings, and this version."""
    return {"what": what, "version": VERSION, "scene": scene, "settings": settings_digest(*settings)}


def inexact_plan(plan: str | Plan | None) -> str | None:
    """An inexact plan as text, for the settings of parts; None for exact plans, which do not affect results."""
    parsed = None if plan is None else parse_plan(plan)
    return None if parsed is None or parsed.tracer.exact else str(parsed)


class Parts:
    """Items 0 to `count` in parts of `size`: the `Units` of an executor, stored as .npz files.

    what : name of the work, for users
    work : computes the arrays of a range
    folder : finished parts are stored in a subfolder of it; None: in memory
    about : everything that the results depend on, by name; its digest names the subfolder
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
        self._in_memory: dict[int, Arrays] = {}

    def __len__(self) -> int:
        return len(self.ranges)

    def root_of(self, folder: Path) -> Path:
        return folder

    def files(self, k: int) -> list[str]:
        """The file of part k, relative to the root."""
        return [f"{self.name}/{k:06d}.npz"]

    def done(self, k: int, root: Path | None = None) -> bool:
        """Whether part k is stored and complete; `root`: look in another root."""
        return self._load(k, root) is not None

    def found(self, k: int) -> None:
        """No-op."""

    def do(self, k: int) -> None:
        """Compute part k and store it."""
        if self.folder is None:
            return self.hold(k, *self.ranges[k])
        arrays = self._work(*self.ranges[k])
        with self.storing(k) as temporary, open(temporary, "wb") as out:
            _save(out, arrays, f"{self.name} {k}")

    def estimate(self, left: int) -> Estimate | None:
        """Judged by `_PLACES` pieces of parts, evenly spread, and by single items, which tell what any part takes."""
        first, last = self.ranges[0] if self.ranges else (0, 0)
        items, end = last - first, self.ranges[-1][1] if self.ranges else 0
        piece = items // _PIECE
        if self.folder is None or left < _MANY or piece < _LEAST:
            return None
        places = [(2 * k + 1) * end // (2 * _PLACES) for k in range(_PLACES)]
        self._sample(places[0], places[0] + piece)  # loads kernels and builds trees
        (short, small), (long, large) = (
            self._samples([(place, min(place + n, end)) for place in places]) for n in (1, piece)
        )
        share = (items - 1) / (piece - 1)
        seconds, size = (low + share * max(high - low, 0.0) for low, high in ((short, long), (small, large)))
        resident = resident_memory()
        more = (_HELD - 1.0) * resident + max(_ITEM * items, _SCRATCH * size / _PLACES)
        memory = max(resident + more, peak_resident_memory() or 0)
        source = f"a sample of {piece * _PLACES:,}"
        return Estimate(seconds / _PLACES, size / _PLACES, memory, more, source)

    def _samples(self, ranges: Sequence[tuple[int, int]]) -> tuple[float, int]:
        """The seconds and the bytes of some ranges."""
        start = perf_counter()
        size = sum(self._sample(*each) for each in ranges)
        return perf_counter() - start, size

    def _sample(self, first: int, last: int) -> int:
        """Compute a range; return the bytes of its file."""
        file = BytesIO()
        _save(file, self._work(first, last), self.name)
        return file.tell()

    @contextmanager
    def storing(self, k: int) -> Iterator[Path]:
        """Yield the temporary name of the file of part k, beside the record of what the parts depend on."""
        file = self._file(k, None)
        file.parent.mkdir(parents=True, exist_ok=True)
        if not (about_file := file.with_name(ABOUT)).exists():
            with atomic_output(about_file) as temporary:
                temporary.write_text(json.dumps(self.about))
        with atomic_output(file) as temporary:
            yield temporary

    def hold(self, k: int, first: int, last: int) -> None:
        """Compute a range, and keep it in memory as part k."""
        self._in_memory[k] = self._work(first, last)

    def drop(self, k: int) -> None:
        """Remove the arrays of a part in memory."""
        del self._in_memory[k]

    def joined(self, names: Sequence[str]) -> Arrays:
        """The named arrays of all parts, concatenated. All parts must be done, and there must be at least one."""
        done = [[part[name] for name in names] for part in map(self.__getitem__, range(len(self)))]
        return {name: np.concatenate(arrays) for name, arrays in zip(names, zip(*done))}

    def taken(self, names: Sequence[str]) -> Arrays:
        """`joined`, after which parts in memory no longer have these arrays: at most one array is there twice."""
        if self.folder is not None:
            return self.joined(names)
        parts = [self[k] for k in range(len(self))]
        return {name: np.concatenate([part.pop(name) for part in parts]) for name in names}

    def __getitem__(self, k: int) -> Arrays:
        """The arrays of part k, which must be done."""
        arrays = self._load(k, None)
        if arrays is None:
            raise InputError(f"{self.folder}: part {k} is missing or damaged; run the command again")
        return arrays

    def _file(self, k: int, root: Path | None) -> Path:
        assert self.root is not None
        return (root or self.root) / self.files(k)[-1]

    def _load(self, k: int, root: Path | None) -> Arrays | None:
        """The arrays of part k; None if it is not done, or its file is damaged or belongs to other work."""
        if self.folder is None:
            return self._in_memory.get(k)
        with (
            suppress(Exception),  # zipfile, zlib and numpy raise many kinds of errors for damaged files
            np.load(self._file(k, root), allow_pickle=False) as archive,
        ):
            arrays = dict(archive)
            if str(arrays.pop(_OF)) == f"{self.name} {k}":
                return arrays
        return None

    def clear(self) -> None:
        """Remove the stored parts, and the folder around them if it is empty."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            with suppress(OSError):
                self.folder.parent.rmdir()


def _save(file: BinaryIO, arrays: Arrays, of: str) -> None:
    np.savez(file, allow_pickle=False, **arrays, **{_OF: np.array(of)})


# --- Merging shards ---------------------------------------------------------------------------------------------------


_MAX_NAMES = 3  # names listed in an error


class FinishedUnit(NamedTuple):
    """A unit and the root that contains its files."""

    units: Units
    k: int
    root: Path


class ShardMerge(UnitCount):
    """An executor that runs no unit: it collects finished ones from folders of shards.

    folder : receives the units, from which the work writes its results
    sources : folders of shards; `folder` may be one of them
    """

    def __init__(self, folder: Path, sources: Sequence[Path]):
        self.folder = folder
        self._sources = {path.resolve(): path for path in sources}
        self._recorded = [read_shard_record(path) for path in sources]

    def finish(self, work: Sequence[Units]) -> bool:
        for source in self._sources.values():
            _check_folder(source, work)
        return self.prepare(work)

    def prepare(self, work: Sequence[Units]) -> bool:
        self._check_commands()
        self.add(sum(map(len, work)), 0)
        for unit in self._places(work):
            target = unit.units.root
            if target is not None and unit.root.resolve() != target.resolve():
                _copy(unit, target)
            unit.units.found(unit.k)
        return True

    def end(self, work: Sequence[Units]) -> None:
        """Remove the copied units, unless `folder` is itself a source."""
        if self.folder.resolve() not in self._sources:
            for units in work:
                units.clear()

    def _check_commands(self) -> None:
        for path, recorded in zip(self._sources.values(), self._recorded):
            if recorded.command != self._recorded[0].command:
                first_source = next(iter(self._sources.values()))
                raise InputError(
                    f"{path}: has shards of another command than {first_source}: {shlex.join(recorded.command)}"
                )

    def _places(self, work: Sequence[Units]) -> list[FinishedUnit]:
        """Locate each unit.

        Raises
        ------
        InputError
            If a unit is damaged, or there twice with other contents.
        UnavailableError
            If shards have not done all units yet.
        """
        finished, missing_units = list[FinishedUnit](), list[tuple[int, str]]()
        for number, units, k in numbered(work):
            roots = [root for root in self._roots(units) if units.done(k, root)]
            for other in roots[1:]:
                _check_equal(units.files(k), roots[0], other)
            if roots:
                finished.append(FinishedUnit(units, k, roots[0]))
            else:
                missing_units.append((number, self._fault(units, k)))
        if missing_units:
            is_damaged = any(fault for _, fault in missing_units)
            error = InputError if is_damaged else UnavailableError
            raise error(self._missing_message(missing_units, len(finished) + len(missing_units)))
        return finished

    def _roots(self, units: Units) -> Iterator[Path]:
        """Yield the distinct roots of all sources."""
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

    def _missing_message(self, missing: list[tuple[int, str]], total: int) -> str:
        """The error message for missing units, with the names of their shards."""
        of = self._recorded[0].of
        shards = sorted({number % of for number, _ in missing})
        names = ", ".join(f"{i}/{of}" for i in shards[:_MAX_NAMES]) + (", ..." if len(shards) > _MAX_NAMES else "")
        faults = [fault for _, fault in missing if fault]
        why = f" ({'; '.join(faults[:_MAX_NAMES])})" if faults else ""
        what = f"shard{'s' * (len(shards) > 1)} {names} {'are' if len(shards) > 1 else 'is'} not complete"
        again = shlex.join(["antumbra", *self._recorded[0].command, "--shard", f"{shards[0]}/{of}"])
        return f"{what}, {some_of(len(missing), total, 'part', 'lack')}{why}; run {again}"


def _check_equal(files: list[str], first: Path, second: Path) -> None:
    """Raise an InputError if a unit's files differ in two roots, of which either could then be wrong."""
    for file in files:
        if not filecmp.cmp(first / file, second / file, shallow=False):
            raise InputError(f"{file} is there twice, and differs in {first} and {second}; leave one of them out")


def _check_folder(folder: Path, work: Sequence[Units]) -> None:
    """Raise an InputError if a folder has parts that are stale or belong to other work."""
    about_by_name = {units.name: units.about for units in work if isinstance(units, Parts)}
    for path in sorted(folder.iterdir()):
        if path.is_dir() and path.name not in about_by_name:
            raise InputError(f"{path}: {_difference(path, list(about_by_name.values()))}; remove it, and merge again")


def _difference(path: Path, expected: list[dict[str, str]]) -> str:
    """Describe how the parts in a folder differ from those of this work."""
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
    """Copy the files of a unit to another root; the file that marks it as done comes last."""
    for file in unit.units.files(unit.k):
        target = root / file
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_output(target) as temporary:
            shutil.copyfile(unit.root / file, temporary)


# --- Pictures in row bands --------------------------------------------------------------------------------------------


def render_bands(
    renderer: Renderer, camera: Camera, lights: Sequence[Light], options: RenderOptions, executor: Executor, scene: str,
    settings: dict[str, Any],
) -> Frame | None:  # fmt: skip
    """The frame of `Renderer.render`, whose row bands an executor traces; None if it leaves bands to other shards.

    scene, settings : the digest of the scene, and everything else that the bits depend on, in JSON types
    """
    request = renderer.request(camera, lights, options)
    rows = None

    def band(first: int, last: int) -> Arrays:
        nonlocal rows
        rows = rows or renderer.rows(request)
        return rows.band(first, last)

    about = about_parts("picture", scene, settings)
    parts = Parts("bands of the picture", camera.height, BAND, band, executor.folder, about)
    if not executor.finish([parts]):
        return None
    frame = renderer.from_rows(request, bits_of_bands(parts.joined(band_array_names(request))))
    executor.end([parts])  # the bits are in memory
    return frame
