"""The tables on the pages of a sheet: a row per window, site, facade or building, or a summary of each column."""

from typing import Any

import numpy as np

from ...base.wording import counted, percent
from ..sheets.method_facts import unit_of
from ..sheets.sheet_tables import SheetTable, cell_text
from ..sheets.units_text import unit_text
from .false_colours import column_values

MOST_ROWS = 1000
"""Rows that a sheet lists; a table with more is summarised."""

_SHARES = 5, 50, 95  # percentiles
_ID = "id", "name", "label", "window", "site", "dwelling", "building", "surface"  # first columns


def tables_of(table: Any) -> list[SheetTable]:
    """The tables of a `Table`: its rows if they stand for something with a name or are few, and a summary."""
    tables = [_areas(table)] if table.about.get("areas") else []
    if table.sensors.raster is None and len(table) <= MOST_ROWS and (_is_named(table) or len(table) <= 200):
        return [*tables, rows_table(table)]
    return [*tables, _summary(table)]


def _is_named(table: Any) -> bool:
    return table.row_of_face is not None or bool(table.sensors.attributes)


def rows_table(table: Any, most: int | None = None) -> SheetTable:
    """A row per sensor: its names, its position, and all results; of the first `most` sensors, if that is given."""
    length = unit_of(table.about).name
    left_out = {"nx", "ny", "nz", "face", "area"}
    columns = {name: values[:most] for name, values in table.rows().items() if name not in left_out}
    given = {*table.sensors.attributes, *(("building", "surface") if table.row_of_face is not None else ())}
    first = [name for name in columns if name in given and name.lower() in _ID]
    names = [*first, *(name for name in columns if name not in first)]
    if not first:
        columns, names = {"row": np.arange(1, len(table) + 1)[:most], **columns}, ["row", *names]
    headers, right = list[str](), set[int]()
    for k, name in enumerate(names):
        unit = unit_text(table.columns[name].unit) if name in table.columns else length if name in "xyz" else ""
        headers.append(f"{name.replace('_', ' ')} ({unit})" if unit else name.replace("_", " "))
        if columns[name].dtype.kind in "fiu":
            right.add(k)
    cells = [[_cell(name, value) for value in columns[name].tolist()] if columns[name].dtype.kind != "M"
             else [cell_text(value) for value in columns[name]] for name in names]  # fmt: skip
    return SheetTable("Results", headers, list(zip(*cells)), frozenset(right), max(len(first[:2]), 1))


def _cell(name: str, value: Any) -> str:
    """The text of a value; positions with centimetres, verdicts in words."""
    if isinstance(value, bool) and name.removesuffix("_before").endswith("passes"):
        return "passes" if value else "fails"
    if name in "xyz" and isinstance(value, float):
        return f"{value:.2f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return cell_text(value)


def _summary(table: Any) -> SheetTable:
    """Extremes, percentiles and mean of each column; of yes and no, the share of yes."""
    rows = []
    for name, column in table.columns.items():
        if column.values.dtype.kind not in "fiub":
            continue
        values, known = column_values(table, name)
        shown, unit = values[known], unit_text(column.unit)
        if column.values.dtype.kind == "b":
            share = f"{percent(shown.mean())} yes" if len(shown) else "-"
            rows.append((name, unit, "", "", "", share, "", "", f"{len(shown):,}"))
            continue
        numbers = ["-"] * 6
        if len(shown):
            low, middle, high = np.percentile(shown, _SHARES)
            numbers = [cell_text(float(x)) for x in (shown.min(), low, middle, shown.mean(), high, shown.max())]
        rows.append((name, unit, *numbers, f"{len(shown):,}"))
    headers = "column", "unit", "least", "5 %", "median", "mean", "95 %", "greatest", "values"
    note = f"{counted(len(table), 'row')}; all of them are in the files of the result."
    return SheetTable("Summary", headers, rows, frozenset(range(2, 9)), note=note)


def _areas(table: Any) -> SheetTable:
    """A row per area of a study of gardens."""
    areas = table.about["areas"]
    judged = any(area.get("share") is not None for area in areas)
    states = [end for end in ("_before", "") if any("sun_hours" + end in area for area in areas)]
    words = {"_before": " before", "": ""}
    headers = ["area", "cells", "left out", *(f"mean sun hours{words[end]} (h)" for end in states)]
    headers += [*(f"share of cells{words[end]}" for end in states), "verdict"] if judged else []
    rows = []
    for area in areas:
        row = [str(area["name"]), f"{area.get('cells', 0):,}", f"{area.get('left_out', 0):,}"]
        hours, shares = ([area.get(name + end) for end in states] for name in ("sun_hours", "share"))
        row += ["-" if each is None else f"{each:.2f}" for each in hours]
        if judged:
            row += ["-" if each is None else percent(each) for each in shares]
            row.append("no cells" if area.get("share") is None else "passes" if area["passes"] else "fails")
        rows.append(row)
    return SheetTable("Areas", headers, rows, frozenset(range(1, 3 + 2 * len(states))))
