"""Parts of a benchmark, stored as soon as they are measured, so that it resumes and its tables can be measured alone.

A part is what is measured at once, such as one view by one tracer, and belongs to a table. With a folder, each part has
a file there, with its conditions: settings, machine, versions, date, load, rounds and kernels. A stored part replaces a
measurement only if it was measured with the same settings, by the same version and kernels, on the same machine.
Otherwise it is measured anew, or left out if its table was not requested.
"""

import base64
import json
import os
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np

from ..base.files import atomic_output
from ..cli.console import say
from ..cli.installation_commands import about
from ..kernels.jit import recorded_calls
from ..store.system_resources import peak_resident_memory
from ..work.work_parts import settings_digest
from .bench_conditions import KernelDigests, changed_kernels, collected_laps, kernel_digests

# --- Values as JSON ---------------------------------------------------------------------------------------------------


def packed(value: Any) -> Any:
    """A value of a part as JSON types. It may have NamedTuples, tuples, lists, dicts, bytes and arrays."""
    if isinstance(value, tuple):
        return {"tuple": [packed(each) for each in value], "of": type(value).__name__}
    if isinstance(value, list):
        return [packed(each) for each in value]
    if isinstance(value, dict):
        return {"dict": [[packed(key), packed(each)] for key, each in value.items()]}
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if isinstance(value, np.ndarray):
        text = base64.b64encode(zlib.compress(value.tobytes())).decode()
        return {"array": text, "dtype": value.dtype.str, "shape": value.shape}
    return value.item() if isinstance(value, np.generic) else value


def unpacked(value: Any, rows: Mapping[str, type]) -> Any:
    """The value that `packed` was given; `rows`: the NamedTuples by name.

    Raises
    ------
    LookupError, TypeError or ValueError
        If the JSON is not that of such a value.
    """
    if isinstance(value, list):
        return [unpacked(each, rows) for each in value]
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        fields = [unpacked(each, rows) for each in value["tuple"]]
        return tuple(fields) if value["of"] == "tuple" else rows[value["of"]](*fields)
    if "dict" in value:
        return {unpacked(key, rows): unpacked(each, rows) for key, each in value["dict"]}
    if "bytes" in value:
        return bytes.fromhex(value["bytes"])
    data = zlib.decompress(base64.b64decode(value["array"]))
    return np.frombuffer(data, np.dtype(value["dtype"])).reshape(value["shape"]).copy()


# --- Conditions -------------------------------------------------------------------------------------------------------


class PartConditions(NamedTuple):
    """How a part was measured."""

    command: str
    commit: str  # empty outside a checkout
    date: str  # when it ended, UTC
    seconds: float  # how long it took
    load: list[float]  # processes that ran or waited, before and after: means over a minute; empty if unknown
    rounds: list[int]  # least and most rounds of its repeated timings; empty without any
    spreads: list[float]  # see `bench_conditions.record_laps`
    kernels: KernelDigests
    peak_resident: int | None  # bytes of memory, of the process so far


class TableConditions(NamedTuple):
    """How the parts of a table were measured."""

    parts: int
    commands: list[str]
    commits: list[str]
    dates: list[str]  # first and last
    seconds: float  # in all
    load: list[float]  # least and most; empty if unknown
    rounds: list[int]  # least and most; empty if nothing was timed repeatedly


def _span(values: Iterable[Any]) -> list[Any]:
    """The least and the greatest value; empty if there is none."""
    ordered = sorted(values)
    return [ordered[0], ordered[-1]] if ordered else []


def table_conditions(conditions: Collection[PartConditions]) -> TableConditions:
    """The conditions of a table from those of its parts."""
    distinct = lambda field: sorted({value for each in conditions if (value := getattr(each, field))})
    spans = (_span(value for each in conditions for value in getattr(each, field)) for field in ("load", "rounds"))
    dates, seconds = _span(each.date for each in conditions), sum(each.seconds for each in conditions)
    return TableConditions(len(conditions), distinct("command"), distinct("commit"), dates, seconds, *spans)


def _load() -> list[float]:
    """The load average of the last minute; empty if the system has none."""
    return [round(os.getloadavg()[0], 2)] if hasattr(os, "getloadavg") else []


# --- Parts ------------------------------------------------------------------------------------------------------------


class _Part(NamedTuple):
    value: Any
    conditions: PartConditions
    order: int  # its place in the table
    settings: dict[str, Any]  # beside those of the table


class BenchParts:
    """The parts of a benchmark.

    settings : table -> what its timings and counts depend on, as JSON values
    rows : the NamedTuples in the values of parts
    tables : the tables to measure; None: all
    folder : where parts are stored; None: nowhere
    fresh : whether to measure again what is stored there
    """

    def __init__(
        self,
        settings: Mapping[str, Mapping[str, Any]],
        rows: Iterable[type] = (),
        tables: Collection[str] | None = None,
        *,
        folder: Path | None = None,
        fresh: bool = False,
        command: str = "",
    ):
        self._settings = {str(table): json.loads(json.dumps(each)) for table, each in settings.items()}
        self._rows = {each.__name__: each for each in rows}
        self._wanted = set(settings) if tables is None else {str(table) for table in tables}
        self._folder, self._command = folder, command
        self._machine = about()
        self._commit = str(self._machine.pop("commit", ""))
        self._parts: dict[str, dict[str, _Part]] = {table: {} for table in self._settings}
        self._places: dict[str, list[str]] = {table: [] for table in self._settings}
        self.measured = self.resumed = 0  # parts that `add` measured, and that it found stored
        if folder is not None:
            self._read(folder, fresh)

    def __contains__(self, table: str) -> bool:
        """Whether a table has parts."""
        return bool(self._parts.get(table))

    def wants(self, *tables: str) -> bool:
        """Whether any of these tables is to be measured."""
        return not self._wanted.isdisjoint(tables)

    def add(self, table: str, name: str, measure: Callable[[], Any], **settings: Any) -> None:
        """Measure a part of a table, unless it is stored or its table is not to be measured.

        settings : what it depends on beside the settings of the table
        """
        place = len(self._places[table])
        self._places[table].append(name)
        stored = self._parts[table].get(name)
        if stored is not None and stored.settings != settings:
            del self._parts[table][name]
            stored = None
        if stored is not None or table not in self._wanted:
            self.resumed += table in self._wanted
            return
        load, start = _load(), monotonic()
        with collected_laps() as laps, recorded_calls() as calls:
            value = measure()
        date, seconds = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC", monotonic() - start
        conditions = PartConditions(
            self._command, self._commit, date, seconds, load + _load(), _span(laps.rounds), laps.spreads,
            kernel_digests(calls), peak_resident_memory(),
        )  # fmt: skip
        part = self._parts[table][name] = _Part(value, conditions, place, settings)
        self.measured += 1
        if self._folder is not None:
            self._write(self._folder, table, name, part)

    def values(self, table: str) -> list[Any]:
        """The values of a table's parts: first those that this run has added, in their order."""
        return [part.value for part in self._ordered(table)]

    def rows(self, table: str) -> list[Any]:
        """The rows of a table whose parts are lists of rows."""
        return [row for value in self.values(table) for row in value]

    def conditions(self) -> list[PartConditions]:
        """The conditions of all parts."""
        return [part.conditions for parts in self._parts.values() for part in parts.values()]

    def of_tables(self) -> dict[str, dict[str, Any]]:
        """The conditions of each table, as JSON."""
        return {
            table: table_conditions([part.conditions for part in self._ordered(table)])._asdict()
            for table in self._parts
            if table in self
        }

    def _ordered(self, table: str) -> list[_Part]:
        parts, here = self._parts[table], self._places[table]
        place = lambda name: (0, here.index(name)) if name in here else (1, parts[name].order)
        return [parts[name] for name in sorted(parts, key=place)]

    # --- Files ---

    def _write(self, folder: Path, table: str, name: str, part: _Part) -> None:
        folder.mkdir(exist_ok=True)
        record = {"table": table, "part": name, "order": part.order, "settings": self._settings[table]}
        record |= {"more": part.settings, "machine": self._machine}
        record |= {"conditions": part.conditions._asdict(), "value": packed(part.value)}
        with atomic_output(folder / f"{table}-{settings_digest(table, name)[:12]}.json", durable=True) as temporary:
            temporary.write_text(json.dumps(record), encoding="utf-8")

    def _read(self, folder: Path, fresh: bool) -> None:
        """Read the stored parts that are as good as measured now; say which others are left out."""
        left_out: dict[str, str] = {}
        for path in sorted(folder.glob("*.json")):
            try:
                record = json.loads(path.read_text(encoding="utf-8"))
                table, name = record["table"], record["part"]
                if table in self._wanted and fresh:
                    continue
                conditions, value = PartConditions(**record["conditions"]), unpacked(record["value"], self._rows)
                reason = self._objection(table, record, conditions)
                order, more = int(record["order"]), dict(record["more"])
            except (OSError, LookupError, TypeError, ValueError, zlib.error):
                continue  # damaged: measured anew
            if reason is None:
                self._parts[table][name] = _Part(value, conditions, order, more)
            elif table not in self._wanted:
                left_out[table] = reason
        for table, reason in left_out.items():
            say(f"table {table} in {folder} is left out, because it was measured {reason}")

    def _objection(self, table: str, record: dict[str, Any], conditions: PartConditions) -> str | None:
        """How a stored part differs from one measured now; None if it does not."""
        for what, then, now in (
            ("on another machine, or with other versions", record["machine"], self._machine),
            ("with other options", record["settings"], self._settings[table]),
        ):
            if names := [name for name in {**then, **now} if then.get(name) != now.get(name)]:
                return f"{what} ({', '.join(name.replace('_', ' ') for name in names)})"
        changed = changed_kernels(conditions.kernels)
        return f"with an older kernel ({changed[0]})" if changed else None
