"""The summary of a study of sun hours: its suns, its sensors, and the hours that they get."""

from typing import Any

import numpy as np

from ...work.result_summary import Summary, SummaryTable
from ..tables.result_table import Table
from ..tables.surface_columns import NAMES

_MOST_AREAS = 50  # most areas in the table


def sun_summary(table: Table, per: str, seconds: float) -> Summary:
    """The summary of the table of `antumbra.sun_hours`.

    per : what a row stands for, as in `SunOptions`
    seconds : of the study
    """
    about, covered = table.about, table.sensors.covered
    sensors = len(table) if per == "sensor" else int(table["sensors"].sum())
    rays = sensors * about["suns"] * about["samples"]
    numbers = {"sensors": sensors, "rows": len(table), "suns": about["suns"], "rays": rays, "seconds": seconds}
    means = {name: float(table[name][covered].mean()) for name in numeric_results(table)} if covered.any() else {}
    hours = table["sun_hours"][covered]
    least, middle, most = np.percentile(hours, (0, 50, 100)) if len(hours) else (0.0, 0.0, 0.0)
    lines = [
        ("place", f"{about['latitude']:.4f}, {about['longitude']:.4f}; true north at {about['north']:.2f} degrees"),
        ("suns", f"{about['suns']:,} from {about['first']} to {about['last']}, {about['hours']:,.1f} h"),
        ("sensors", f"{sensors:,} ({about.get('sensors', table.sensors.kind)})"),
        *([(f"{per}s", f"{len(table):,}")] if per != "sensor" else []),
        ("hours of sun", f"{least:,.1f} to {most:,.1f}, median {middle:,.1f}"),
    ]
    if "sun_hours_loss" in table.columns and len(hours):
        loss = table["sun_hours_loss"][covered]
        lines.append(
            ("loss of sun", f"up to {max(loss.max(), 0.0):,.1f} h, in {(loss > 0.0).sum():,} of {len(loss):,} rows")
        )
    if "passes" in table.columns and "areas" not in about and per == "sensor":
        lines.append((about["rule"], f"{table['passes'][covered].mean():.1%} of the sensors on surfaces pass"))
    areas = _area_table(about["areas"]) if "areas" in about else None
    return Summary({**about, **numbers, "means": means}, lines, table=areas, rays=rays)


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
    return *row, "" if share is None else f"{share:.1%}", passes
