"""The summary of a study of sun hours: its suns, its sensors, and the hours that they get."""

from typing import Any

from ...base.wording import percent, some_of
from ...work.result_summary import Summary, SummaryTable
from ..sheets.method_facts import minutes_text, position_text
from ..tables.column_totals import ColumnTotals
from ..tables.result_table import Table
from ..tables.surface_columns import NAMES
from ..tables.table_blocks import TableBlocks
from .daylight_rules import rule_named
from .rule_verdicts import PASSES

_MOST_AREAS = 50  # most areas in the table


def sun_summary(table: Table | TableBlocks, per: str, seconds: float) -> Summary:
    """The summary of the table of `antumbra.sun_hours`.

    per : what a row stands for, as in `SunOptions`
    seconds : of the study
    """
    about, totals, rows = table.about, table.totals, len(table)
    sensors = rows if per == "sensor" else int(totals["sensors"].total)
    rays = sensors * (about["suns"] * about["samples"] + about.get("directions", 0))
    numbers = {"sensors": sensors, "rows": rows, "suns": about["suns"], "rays": rays, "seconds": seconds}
    means = {name: each.mean for name, each in totals.items() if name not in NAMES and each.rows}
    lines = list[tuple[str, str]]()
    if "latitude" in about:
        lines.append(("place", position_text(about)))
    if "first" in about:
        first, last = minutes_text(about["first"]), minutes_text(about["last"])
        lines.append(("suns", f"{about['suns']:,} from {first} to {last}, {about['hours']:,.1f} h"))
    lines.append(("sensors", f"{sensors:,} ({about.get('sensors', table.kind)})"))
    lines += [(f"{per}s", f"{rows:,}")] if per != "sensor" else []
    if (hours := totals.get("sun_hours")) is not None:
        least, most = (f"{hours.least:,.1f}", f"{hours.most:,.1f}") if hours.rows else ("0.0", "0.0")
        lines.append(("hours of sun", least if least == most else f"{least} to {most}, median {hours.median:,.1f}"))
    loss = totals.get("sun_hours_loss")
    if loss is not None and loss.rows:
        lines.append(
            ("loss of sun", f"up to {max(loss.most, 0.0):,.1f} h, in {some_of(loss.positive, loss.rows, 'row')}")
        )
    for rule in [] if "areas" in about else about.get("rules", []):
        lines.append((rule["name"], _passing(totals[rule_named(rule["name"]).prefix + PASSES], per)))
    areas = _area_table(about["areas"]) if "areas" in about else None
    return Summary({**about, **numbers, "means": means}, lines, table=areas, rays=rays)


def _passing(passes: ColumnTotals, per: str) -> str:
    """How many rows pass."""
    rows = "sensors on surfaces" if per == "sensor" else "rows"
    share = f" ({percent(passes.mean)})" if passes.rows else ""
    return f"{passes.positive:,} of {passes.rows:,} {rows} pass{share}"


def numeric_results(table: Table) -> list[str]:
    """The names of the numeric columns, besides those that describe the surfaces."""
    return [name for name, column in table.columns.items() if column.values.dtype.kind in "fiub" and name not in NAMES]


def _area_table(records: list[dict[str, Any]]) -> SummaryTable:
    judged = "share" in records[0]
    names = "area", "cells", "inside buildings", "mean hours", *(("at least 2 h", "passes") if judged else ())
    return SummaryTable(names, [_area(each)[: len(names)] for each in records[:_MOST_AREAS]], right=(1, 2, 3, 4))


def _area(record: dict[str, Any]) -> tuple[str, ...]:
    """The row of an area."""
    hours, share = record["sun_hours"], record.get("share")
    row = record["name"], f"{record['cells']:,}", f"{record['left_out']:,}", "" if hours is None else f"{hours:.1f}"
    passes = {None: "no cells", True: "yes", False: "no"}[record.get("passes")]
    return *row, "" if share is None else percent(share), passes
