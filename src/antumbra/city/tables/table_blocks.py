"""Tables that are made, written and summed up a block of rows at a time, so that memory is that of a block."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...scene.raster import Raster
from .column_totals import ColumnTotals, add_totals
from .result_table import STREAMED, Table, writer_of


@dataclass(eq=False)
class TableBlocks:
    """A table of sensors that are described, with the methods of a `Table` by which commands write and sum it up.

    count : number of blocks, at least 1
    make : makes the table of a block
    make_whole : makes that of all sensors
    about : metadata, in JSON types
    kind, raster : of the sensors
    close : removes what the blocks are made from
    """

    count: int
    make: Callable[[int], Table]
    make_whole: Callable[[], Table]
    about: dict[str, Any]
    kind: str
    raster: Raster | None
    close: Callable[[], None]
    _totals: dict[str, ColumnTotals] | None = field(default=None, init=False)
    _rows: int = field(default=0, init=False)
    _whole: Table | None = field(default=None, init=False)

    def blocks(self) -> Iterator[Table]:
        """The tables of all blocks. The first time to the end, they are also summed up."""
        totals, rows = dict[str, ColumnTotals](), 0
        for k in range(self.count):
            table = self.make(k)
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
            self._whole = self.make_whole()
            self._whole.about = self.about
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
        """As `Table.save`; tables and GeoTIFFs are written by block."""
        writer = writer_of(path, self.kind)
        table: Any = self if writer in STREAMED else self.whole()
        writer(table, Path(path), self.make(0).shown(column))

    def save_map(self, path: str | os.PathLike[str], column: str | None = None, **options: Any) -> None:
        """As `Table.save_map`."""
        self.whole().save_map(path, column, **options)

    def shown(self, column: str | None) -> str:
        """As `Table.shown`."""
        return self.make(0).shown(column)
