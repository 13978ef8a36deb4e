"""Tables that are made, written and summed up a block of rows at a time, so that memory is that of a block."""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from ...base.files import temporary_folder
from ...scene.camera import Camera
from ..sensors.sensor_blocks import DescribedSensors
from ..sensors.sensors import Sensors
from .column_totals import ColumnTotals, add_totals
from .parquet_files import PARTITIONED
from .partitions import Partitions
from .result_table import BANDS, STREAMED, WRITERS, Column, Table, bands_of, tiff_bytes, writer_of

ROW_BYTES = 160
"""Memory of a row of a table of sensors, about; its finished part takes a third."""

WRITTEN_BY_BLOCK = tuple(suffix for suffix, writer in WRITERS.items() if writer in STREAMED)
"""Suffixes of files that need no table in memory."""


def file_bytes(sample: Table, rows: int, path: Path) -> float:
    """Bytes of a file that is written by block, with as many rows as given, judged by some of them.

    Parquet compresses more rows better, and rasters are counted without compression.
    """
    suffix = path.suffix.lower()
    if suffix in BANDS and sample.raster is not None:
        return tiff_bytes(path, sample.raster, len(bands_of(sample)))
    with temporary_folder() as folder:
        WRITERS[suffix](sample, folder / f"rows{suffix}", sample.shown(None))
        written = [file for name in (f"rows{suffix}", "part-*") for file in folder.rglob(name) if file.is_file()]
        return sum(file.stat().st_size for file in written) * rows / len(sample)


class TableBlocks:
    """A table of sensors that are described, with the methods of a `Table` by which commands write and sum it up.

    source : its sensors
    ranges : the first and the last sensor, exclusive, of each block
    make : makes the table of the sensors of block k
    make_whole : makes that of all sensors
    close : removes what the blocks are made from
    partitions : parts of the table, if it is stored as such
    """

    def __init__(
        self, source: DescribedSensors, ranges: Sequence[tuple[int, int]], make: Callable[[Sensors, int], Table],
        make_whole: Callable[[Sensors], Table], close: Callable[[], None], partitions: Partitions | None = None,
    ):  # fmt: skip
        self._source, self._ranges, self._make, self._make_whole, self.close = source, ranges, make, make_whole, close
        self._totals: dict[str, ColumnTotals] | None = None if partitions is None else partitions.totals()
        self._rows = 0 if partitions is None else partitions.count_rows()
        self._partitions = partitions
        self._whole: Table | None = None
        self.kind, first = source.kind, self._block(0)
        self.raster, self.about = first.sensors.raster, first.about
        self.camera: Camera | None = None  # for pictures

    @classmethod
    def of_partitions(
        cls, partitions: Partitions, table: Callable[[Sensors, dict[str, Column]], Table],
        close: Callable[[], None],
    ) -> "TableBlocks":  # fmt: skip
        """A table that is stored in parts; `table`: makes it of sensors and their columns."""
        return cls(
            partitions.source,
            partitions.ranges,
            lambda sensors, k: table(sensors, partitions.columns([k])),
            lambda sensors: table(sensors, partitions.columns(range(len(partitions)))),
            close,
            partitions,
        )

    def _block(self, k: int) -> Table:
        if not self._ranges:
            return self._make_whole(self._source.whole())
        return self._make(self._source.block(*self._ranges[k]), k)

    def blocks(self) -> Iterator[Table]:
        """The tables of all blocks. The first time to the end, they are also summed up."""
        totals, rows = dict[str, ColumnTotals](), 0
        in_memory = None if self._whole is None else [self._whole]
        for table in in_memory or map(self._block, range(max(len(self._ranges), 1))):
            table.about = self.about
            if self._totals is None:
                add_totals(totals, table)
            rows += len(table)
            yield table
        if self._totals is None:
            self._totals, self._rows = totals, rows

    def whole(self) -> Table:
        """The table in memory."""
        if self._whole is None:
            self._whole = self._make_whole(self._source.whole())
        self._whole.about, self._whole.camera = self.about, self.camera
        return self._whole

    @property
    def totals(self) -> dict[str, ColumnTotals]:
        """The totals of the columns of numbers."""
        if self._totals is None:
            for _ in self.blocks():
                pass
        assert self._totals is not None
        return self._totals

    def __len__(self) -> int:
        _ = self.totals
        return self._rows

    def save(self, path: str | os.PathLike[str], column: str | None = None) -> None:
        """As `Table.save`; tables and rasters are written by block, and partitions are those that are stored."""
        if self._partitions is not None and Path(path).suffix.lower() == PARTITIONED:
            return self._partitions.save(Path(path), self.about)
        writer = writer_of(path, self.kind)
        table: Any = self if writer in STREAMED else self.whole()
        writer(table, Path(path), next(self.blocks()).shown(column))

    def save_map(self, path: str | os.PathLike[str], column: str | None = None, **options: Any) -> None:
        """As `Table.save_map`."""
        self.whole().save_map(path, column, **options)

    def shown(self, column: str | None) -> str:
        """As `Table.shown`."""
        return next(self.blocks()).shown(column)
