"""Partitions of a table: parts of Parquet files, which whoever computes a block of sensors writes in full."""

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...base.files import temporary_folder
from ...engine.scene import AnyScene
from ...version import VERSION
from ...work.work_parts import Arrays, Parts, settings_digest
from ..sensors.block_parts import NOTES, ROWS, BlockParts
from ..sensors.sensor_blocks import DescribedSensors
from ..sensors.sensors import Sensors
from .column_totals import ColumnTotals, joined_totals, totals_of
from .parquet_files import part_columns, part_record, save_files, write_parquet
from .result_table import Column, Table

_SAMPLE = -1  # number of a part that is not stored
_OF, _KINDS, _TOTALS = "of", "kinds", "totals"


class Partitions(Parts):
    """Parts that are files of Parquet. Of a result, nothing else is stored or sent, and a merge only checks them.

    blocks : the sums of each block, whose notes are kept; from now on, their parts are these
    more : further sums of the same blocks
    make : makes the table of the sensors of block k, when its sums are in memory
    source : the sensors
    scene : that of the table
    settings : what columns depend on besides the sums: arrays and JSON values
    """

    def __init__(
        self, blocks: BlockParts, more: Sequence[Parts], make: Callable[[Sensors, int], Table],
        source: DescribedSensors, scene: AnyScene, settings: Iterable[Any],
    ):  # fmt: skip
        self._job, self._make, self.source = [blocks.parts, *more], make, source
        of = [f"{parts.what} {parts.name}" for parts in self._job]
        digest = settings_digest(of, scene.crs, scene.up, scene.unit.name, *settings, *source.attributes_description)
        first = self._job[0]
        super().__init__(first.what, 0, 1, lambda first, last: {}, first.root, {
            "what": "table", "version": VERSION, "settings": digest,
        })  # fmt: skip
        self.ranges, self._records = first.ranges, dict[int, dict[str, Any]]()
        for parts in self._job:
            parts.folder = None  # its arrays are only needed until the part is written
        blocks.parts = self

    def files(self, k: int) -> list[str]:
        return [f"{self.name}/{k:06d}.parquet"]

    def do(self, k: int) -> None:
        for parts in self._job:
            parts.do(k)
        table, notes = self._make(self.source.block(*self.ranges[k]), k), str(self._job[0][k][NOTES])
        for parts in self._job:
            parts.drop(k)
        kinds = {name: column.values.dtype.str for name, column in table.columns.items()}
        totals = {name: each.record() for name, each in totals_of(table).items()}
        record = {_OF: f"{self.name} {k}", ROWS: len(table), NOTES: notes, _KINDS: kinds, _TOTALS: totals}
        with self.storing(k) as temporary:
            write_parquet(table, temporary, record)

    def _sample(self, first: int, last: int) -> int:
        for parts in self._job:
            parts.hold(_SAMPLE, first, last)
        table = self._make(self.source.block(first, last), _SAMPLE)
        for parts in self._job:
            parts.drop(_SAMPLE)
        with temporary_folder() as folder:
            write_parquet(table, path := folder / "part.parquet", {})
            return path.stat().st_size

    def _load(self, k: int, root: Path | None) -> Arrays | None:
        record = part_record(self._file(k, root))
        if record is None or record.get(_OF) != f"{self.name} {k}":
            return None
        return {name: np.array(record[name]) for name in (ROWS, NOTES)} | {
            name: np.array(json.dumps(record[name])) for name in (_KINDS, _TOTALS)
        }

    def __getitem__(self, k: int) -> Arrays:
        """The record of part k, which must be done."""
        if k not in self._records:  # it takes a look at the whole file
            self._records[k] = super().__getitem__(k)
        return self._records[k]

    def columns(self, some: Iterable[int]) -> dict[str, Column]:
        """The columns of results in some parts, at least one."""
        values, about = dict[str, list[np.ndarray]](), dict[str, tuple[str, str]]()
        for k in some:
            kinds = json.loads(str(self[k][_KINDS]))
            found, units = part_columns(self._file(k, None), kinds)
            for name, kind, each, unit in zip(kinds, kinds.values(), found, units):
                values.setdefault(name, []).append(each.astype(kind))
                about[name] = unit
        return {name: Column(np.concatenate(parts), *about[name]) for name, parts in values.items()}

    def totals(self) -> dict[str, ColumnTotals]:
        """The totals of the columns of numbers."""
        return joined_totals(json.loads(str(self[k][_TOTALS])) for k in range(len(self)))

    def count_rows(self) -> int:
        """The number of rows."""
        return sum(int(self[k][ROWS]) for k in range(len(self)))

    def save(self, path: Path, about: dict[str, Any]) -> None:
        """Write the folder; `about`: metadata of the study."""
        save_files([self._file(k, None) for k in range(len(self))], path, about)
