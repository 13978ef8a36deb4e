"""Tables on the pages of a sheet: rows and columns are divided among pages, and each page has the headings again."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .page import FAINT, RULE, Layout, Page
from .page_text import MM_PER_POINT, text_width

_SIZES = 8.0, 7.0, 6.0
_LEADING = 1.55  # height of a row, in font sizes
_BETWEEN = 3.5  # millimetres between columns
_APART = 10.0  # millimetres between blocks of rows
_WIDEST = 75.0  # millimetres: wider cells are cut
_LEAST_ROWS = 4
_HEADING = 7.0  # height of a table's title


class SheetTable(NamedTuple):
    """A table of texts."""

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    right: frozenset[int] = frozenset()  # columns of numbers
    keys: int = 1  # first columns, repeated beside others that need a page of their own
    note: str = ""  # below the title


def cell_text(value: Any) -> str:
    """A value in a table: whole numbers and times in full, other numbers with four digits, - for none."""
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if value is None or value != value:
        return "-"
    if isinstance(value, (float, np.floating)):
        value = float(value)
        return f"{value:,.4g}" if abs(value) < 1000.0 else f"{value:,.1f}"
    if isinstance(value, np.datetime64):
        return str(value).replace("T", " ")[:16]
    return f"{value:,}" if isinstance(value, (int, np.integer)) else " ".join(str(value).split())


def table_pages(layout: Layout, tables: Sequence[SheetTable]) -> list[Page]:
    """The pages of tables, one below the other where they fit; narrow ones run down several columns of a page."""
    pages, top = list[Page](), 0.0
    for table in tables:
        size, groups = _groups(table, layout.body.width)
        row = _LEADING * size * MM_PER_POINT
        for k, columns in enumerate(groups):
            first = 0
            while first < max(len(table.rows), 1):
                above = _HEADING + row + (row if table.note and first == 0 else 0.0)
                least = min(_LEAST_ROWS, len(table.rows) - first)  # or a page of its own
                if not pages or top - above - least * row < layout.body.bottom:
                    pages.append(Page(layout))
                    top = layout.body.top
                room = max(int((top - above - layout.body.bottom) / row), 1)
                part = _Part(table, columns, size, _widths(table, size))
                across = min(part.across(layout.body.width), -(-(len(table.rows) - first) // room) or 1)
                ends = [min(first + k * room, len(table.rows)) for k in range(max(across, 1) + 1)]
                top = part.draw(pages[-1], list(pairwise(ends)), top, k > 0 or first > 0)
                first += room * max(across, 1)
            top -= 5.0
    return pages


def _groups(table: SheetTable, room: float) -> tuple[float, list[list[int]]]:
    """The font size, and the columns that stand beside each other: all, or the keys with some of the others."""
    for size in _SIZES:
        widths = _widths(table, size)
        if sum(widths) + _BETWEEN * (len(widths) - 1) <= room:
            return size, [list(range(len(widths)))]
    size, keys = _SIZES[0], list(range(table.keys))
    widths = _widths(table, size)
    fixed = sum(widths[: table.keys]) + _BETWEEN * table.keys
    groups, used = [keys.copy()], fixed
    for k in range(table.keys, len(widths)):
        if used + widths[k] > room and len(groups[-1]) > table.keys:
            groups.append(keys.copy())
            used = fixed
        groups[-1].append(k)
        used += widths[k] + _BETWEEN
    return size, groups


def _widths(table: SheetTable, size: float) -> list[float]:
    cells = [[header, *column] for header, column in zip(table.headers, zip(*table.rows) if table.rows else
                                                         ([] for _ in table.headers))]  # fmt: skip
    return [min(max(text_width(text, size, k == 0) for k, text in enumerate(column)), _WIDEST) for column in cells]


class _Part(NamedTuple):
    """Columns of a table that stand beside each other."""

    table: SheetTable
    columns: Sequence[int]
    size: float  # points
    widths: Sequence[float]  # millimetres, of all columns

    @property
    def width(self) -> float:
        """Millimetres."""
        return sum(self.widths[k] + _BETWEEN for k in self.columns) - _BETWEEN

    def across(self, room: float) -> int:
        """How often the columns fit beside each other."""
        return max(int((room + _APART) / (self.width + _APART)), 1)

    def draw(self, page: Page, blocks: Sequence[tuple[int, int]], top: float, continued: bool) -> float:
        """Draw blocks of rows (first and last, exclusive) beside each other; return the height of their lower edge."""
        row, left = _LEADING * self.size * MM_PER_POINT, page.layout.body.left
        page.text(left, top - 4.5, self.table.title + (" (continued)" if continued else ""), 10, weight="bold")
        y = top - _HEADING
        if self.table.note and not continued:
            page.text(left, y - 0.7 * row, self.table.note, self.size, color=FAINT)
            y -= row
        lowest = y
        for k, rows in enumerate(blocks):
            lowest = min(lowest, self._draw_block(page, rows, left + k * (self.width + _APART), y))
        return lowest

    def _draw_block(self, page: Page, rows: tuple[int, int], left: float, y: float) -> float:
        table, row = self.table, _LEADING * self.size * MM_PER_POINT
        places, at = dict[int, float](), left
        for k in self.columns:
            places[k] = at + (self.widths[k] if k in table.right else 0.0)
            at += self.widths[k] + _BETWEEN
        for k in self.columns:
            page.text(places[k], y - 0.72 * row, table.headers[k], self.size, weight="bold", ha=_side(table, k))
        y -= row
        page.line((left, left + self.width), (y, y), RULE)
        for cells in table.rows[rows[0] : rows[1]]:
            for k in self.columns:
                page.text(places[k], y - 0.75 * row, _cut(cells[k], self.size), self.size, ha=_side(table, k))
            y -= row
        return y


def _side(table: SheetTable, column: int) -> str:
    return "right" if column in table.right else "left"


def _cut(text: str, size: float) -> str:
    """A text that is at most as wide as the widest column."""
    while text_width(text, size) > _WIDEST:
        text = text[: max(int(len(text) * _WIDEST / text_width(text, size)) - 1, 1)].rstrip("…") + "…"
    return text
