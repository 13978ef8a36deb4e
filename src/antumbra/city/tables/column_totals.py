"""Totals of the columns of a table, added up block by block: means, medians, and the extremes that pictures show."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .false_colours import column_values

_COUNTED = "sun_hours", "visible"  # columns whose values are counted
_DIGITS = 3  # of these values


@dataclass
class ColumnTotals:
    """Sums over the rows of a column of numbers."""

    dtype: np.dtype[Any]
    unit: str
    rows: int = 0  # whose sensors are `Sensors.covered`
    total: float = 0.0
    positive: int = 0
    area: float = 0.0  # that the sensors of the rows represent
    area_positive: float = 0.0
    least: float = np.inf
    most: float = -np.inf
    low: float = np.inf  # of the values that pictures show
    high: float = -np.inf
    counts: Counter[float] | None = None  # rows by value, rounded; None: not counted

    def add(self, table: Any, name: str) -> None:
        """Add the rows of a block."""
        values, known = column_values(table, name)
        covered, shown = values[table.sensors.covered], values[known]
        self.rows, self.total = self.rows + len(covered), self.total + float(covered.sum())
        self.positive += int((covered > 0.0).sum())
        if (areas := table.sensors.areas) is not None:
            areas = areas[table.sensors.covered]
            self.area, self.area_positive = (
                self.area + float(areas.sum()),
                self.area_positive + float(areas[covered > 0.0].sum()),
            )
        self.least, self.most = covered.min(initial=self.least), covered.max(initial=self.most)
        if len(shown):
            self.low, self.high = min(self.low, float(shown.min())), max(self.high, float(shown.max()))
        if self.counts is not None:
            rounded, numbers = np.unique(np.round(covered, _DIGITS), return_counts=True)
            self.counts.update(dict(zip(rounded.tolist(), numbers.tolist())))

    def join(self, other: "ColumnTotals") -> None:
        """Add those of further rows."""
        for name in ("rows", "total", "positive", "area", "area_positive"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name, choose in (("least", min), ("low", min), ("most", max), ("high", max)):
            setattr(self, name, choose(getattr(self, name), getattr(other, name)))
        if self.counts is not None and other.counts is not None:
            self.counts.update(other.counts)

    def record(self) -> dict[str, Any]:
        """The totals in JSON types; extremes of no rows are left out."""
        values = {each.name: getattr(self, each.name) for each in fields(self) if each.name not in ("dtype", "counts")}
        numbers = {name: each if isinstance(each, (str, int)) else float(each) for name, each in values.items()}
        counts = None if self.counts is None else list(self.counts.items())
        finite = {name: each for name, each in numbers.items() if isinstance(each, str) or np.isfinite(each)}
        return {**finite, "dtype": self.dtype.str, "counts": counts}

    @classmethod
    def of_record(cls, record: dict[str, Any]) -> "ColumnTotals":
        """The totals that `record` returned."""
        counts = None if record["counts"] is None else Counter(dict(record["counts"]))
        return cls(**{**record, "dtype": np.dtype(record["dtype"]), "counts": counts})

    @property
    def mean(self) -> float:
        return self.total / max(self.rows, 1)

    @property
    def median(self) -> float:
        """Of `counts`, to three decimals."""
        if not self.counts:
            return 0.0
        values = sorted(self.counts)
        ends = np.cumsum([self.counts[value] for value in values])
        low, high = (values[int(np.searchsorted(ends, k, "right"))] for k in ((self.rows - 1) // 2, self.rows // 2))
        return (low + high) / 2.0


def totals_of(table: Any) -> dict[str, ColumnTotals]:
    """The totals of the columns of numbers of a `Table`."""
    totals = dict[str, ColumnTotals]()
    add_totals(totals, table)
    return totals


def joined_totals(records: Iterable[dict[str, Any]]) -> dict[str, ColumnTotals]:
    """The totals of all blocks; `records`: of each block, name of a column -> `ColumnTotals.record`."""
    totals = dict[str, ColumnTotals]()
    for block in records:
        for name, record in block.items():
            found = ColumnTotals.of_record(record)
            if name in totals:
                totals[name].join(found)
            else:
                totals[name] = found
    return totals


def add_totals(totals: dict[str, ColumnTotals], table: Any) -> None:
    """Add those of a block."""
    for name, column in table.columns.items():
        if column.values.dtype.kind in "fiub":
            if name not in totals:
                counts = Counter[float]() if name in _COUNTED else None
                totals[name] = ColumnTotals(column.values.dtype, column.unit, counts=counts)
            totals[name].add(table, name)
