"""The summary of a study of sun hours: its suns, its sensors, and the hours that they get."""

from typing import Any

import numpy as np

from ...work.result_summary import Summary, SummaryTable
from ..tables.result_table import Table
from ..tables.surface_columns import NAMES
from .daylight_rules import rule_named
from .rule_verdicts import PASSES

_MOST_AREAS = 50  # most areas in the table


def sun_summary(table: Table, per: str, seconds: float) -> Summary:
    """The summary of the table of `antumbra.sun_hours`.

    per : what a row stands for, as in `SunOptions`
    seconds : of the study
    """
    about, covered = table.about, table.sensors.covered
    sensors = len(table) if per == "sensor" else int(table["sensors"].sum())
    rays = sensors * (about["suns"] * about["samples"] + about.get("directions", 0))
    numbers = {"sensors": sensors, "rows": len(table), "suns": about["suns"], "rays": rays, "seconds": seconds}
    means = {name: float(table[name][covered].mean()) for name in numeric_results(table)} if covered.any() else {}
    lines = list[tuple[str, str]]()
    if "latitude" in about:
        place = f"{about['latitude']:.4f}, {about['longitude']:.4f}; true north at {about['north']:.2f} degrees"
        lines.append(("place", place))
    if "first" in about:
        when = f"{about['suns']:,} from {about['first']} to {about['last']}, {about['hours']:,.1f} h"
        lines.append(("suns", when))
    lines.append(("sensors", f"{sensors:,} ({about.get('sensors', table.sensors.kind)})"))
    lines += [(f"{per}s", f"{len(table):,}")] if per != "sensor" else []
    if "sun_hours" in table.columns:
        hours = table["sun_hours"][covered]
        least, middle, most = np.percentile(hours, (0, 50, 100)) if len(hours) else (0.0, 0.0, 0.0)
        lines.append(("hours of sun", f"{least:,.1f} to {most:,.1f}, median {middle:,.1f}"))
    if "sun_hours_loss" in table.columns and covered.any():
        loss = table["sun_hours_loss"][covered]
        lines.append(
            ("loss of sun", f"up to {max(loss.max(), 0.0):,.1f} h, in {(loss > 0.0).sum():,} of {len(loss):,} rows")
        )
    for rule in [] if "areas" in about else about.get("rules", []):
        lines.append((rule["name"], _passing(table[rule_named(rule["name"]).prefix + PASSES][covered], per)))
    areas = _area_table(about["areas"]) if "areas" in about else None
    return Summary({**about, **numbers, "means": means}, lines, table=areas, rays=rays)


def _passing(passes: np.ndarray, per: str) -> str:
    """How many rows pass."""
    rows = "sensors on surfaces" if per == "sensor" else "rows"
    share = f" ({passes.mean():.1%})" if len(passes) else ""
    return f"{int(passes.sum()):,} of {len(passes):,} {rows} pass{share}"


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
