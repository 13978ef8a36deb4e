"""Verdicts of daylight rules: what suns score, and which rows of a table pass, now and compared with a former state.

Verdicts depend on the names of columns alone: a criterion judges its column, and compares it with the column of the
same name that ends in ``_before`` if the table has one.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...scene.materials import MONTHS
from ...sun.sun_positions import Suns, month_days, months_of
from ..changes.before_and_after import BEFORE, LOSS
from ..tables.result_table import Column, Table
from .daylight_rules import Criterion, Kind, Rule

BRIGHT = 120.0
"""W/m2: sunshine is bright if direct normal irradiance is above this (World Meteorological Organization)."""

PASSES, RATIO, SHARE = "_passes", "_ratio", "_share"
"""Ends of the names of columns: the former state, the loss since, and the verdicts of a rule."""

_ROUNDING = 1e-9  # tolerance, so that a sum of twelfths of an hour reaches a whole number

# --- What suns score --------------------------------------------------------------------------------------------------


def rates_of(
    criteria: Sequence[Criterion], suns: Suns, sunshine: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """(criteria, k) float64: what an hour of each visible sun adds to the score of each criterion, in its unit.

    sunshine : (12,) float64, mean hours of sunshine per month, for probable hours; None: an hour is probable if the
        direct radiation of its sun is above `BRIGHT`

    Raises
    ------
    InputError
        If no sun counts, or a month has more sunshine than hours with the sun above the horizon.
    """
    days, rates = month_days(suns.local), list[NDArray[np.float64]]()
    for criterion in criteria:
        first, last = criterion.period
        inside = (days >= first) & (days <= last) if first <= last else (days >= first) | (days <= last)
        rate = np.ones(len(days)) if criterion.kind is Kind.HOURS else _percent_per_hour(suns, sunshine)
        rates.append(np.where(inside, rate, 0.0))
    return np.array(rates).reshape(len(criteria), len(days))


def _percent_per_hour(suns: Suns, sunshine: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(k,) float64: percent of all probable hours in an hour of each sun."""
    if sunshine is None:
        assert suns.dni is not None
        probable = (suns.dni > BRIGHT).astype(np.float64)
    else:
        months = months_of(suns.local)
        possible = np.bincount(months, suns.hours, len(MONTHS))
        whole = possible * _shares_of_days(suns)
        for month in np.flatnonzero(sunshine > whole * (1.0 + _ROUNDING)):
            raise InputError(
                f"sunshine is {sunshine[month]:g} h in {MONTHS[month]}, and the sun is above the horizon for "
                f"{whole[month]:.0f} h; give mean hours of a month"
            )
        probable = np.divide(sunshine, possible, out=np.zeros(len(MONTHS)), where=possible > 0.0)[months]
    total = float((suns.hours * probable).sum())
    if not total > 0.0:
        raise InputError("no sun of these days is probable; check the weather, the place and the days")
    return np.asarray(100.0 * probable / total)


def _shares_of_days(suns: Suns) -> NDArray[np.float64]:
    """(12,) float64: days of each month, divided by those that have suns; 0 if none has."""
    days = np.unique(suns.local.astype("datetime64[D]"))
    months = days.astype("datetime64[M]")
    lengths = ((months + 1).astype("datetime64[D]") - months.astype("datetime64[D]")).astype(np.float64)
    counts = np.bincount(months_of(days), minlength=len(MONTHS))
    total = np.bincount(months_of(days), lengths, len(MONTHS))
    return np.divide(total, counts**2, out=np.zeros(len(MONTHS)), where=counts > 0)


# --- Verdicts ---------------------------------------------------------------------------------------------------------


class RuleVerdict(NamedTuple):
    """What a rule says of n values."""

    passes: NDArray[np.bool_]  # (n,) bool
    ratio: NDArray[np.float64] | None  # (n,) float64: the least share of a former value; NaN: it was 0; None: no former


def verdict_of(rule: Rule, after: Sequence[np.ndarray], before: Sequence[np.ndarray] | None = None) -> RuleVerdict:
    """Judge values by a rule.

    after, before : (n,) float of each criterion, in its unit; before: None if there is no former state, so that only
        the thresholds count
    """
    passes = np.all([now >= each.least - _ROUNDING for now, each in zip(after, rule.criteria)], axis=0)
    if before is None:
        return RuleVerdict(passes, None)
    if rule.kept is not None and rule.area is None:
        passes |= np.all([now >= rule.kept * former - _ROUNDING for now, former in zip(after, before)], axis=0)
    if rule.small_loss is not None:
        passes |= before[0] - after[0] <= rule.small_loss + _ROUNDING
    ratios = [np.divide(now, old, out=np.full(len(old), np.nan), where=old > 0.0) for now, old in zip(after, before)]
    return RuleVerdict(passes, np.fmin.reduce(ratios))


def verdict_columns(rule: Rule, columns: Mapping[str, Column]) -> dict[str, Column]:
    """The verdicts of a rule on columns of a table: ``RULE_passes``, and ``RULE_ratio`` if there is a former state.

    Raises
    ------
    InputError
        If a column that the rule judges is missing.
    """
    names = [each.column for each in rule.criteria]
    missing = [name for name in names if name not in columns]
    if missing:
        raise InputError(f"rule {rule.name} judges the column {missing[0]}, which the table lacks; compute it first")
    compared = all(name + BEFORE in columns for name in names)
    before = [columns[name + BEFORE].values for name in names] if compared else None
    return _named(rule, verdict_of(rule, [columns[name].values for name in names], before))


def _named(rule: Rule, verdict: RuleVerdict) -> dict[str, Column]:
    """The columns of a verdict."""
    about = f"verdict by {rule.name}" if rule.area is None else f"places with the hours of {rule.name}"
    if verdict.ratio is not None and rule.kept is not None and rule.area is None:
        about += ", compared with the former state"
    columns = {rule.prefix + PASSES: Column(verdict.passes, "", about)}
    if verdict.ratio is not None:
        about = f"share of the former value that remains, {rule.name}"
        columns[rule.prefix + RATIO] = Column(verdict.ratio, "", about)
    return columns


def with_verdicts(table: Table, rules: Sequence[Rule]) -> Table:
    """The table with the verdicts of rules, which come first, so that pictures and maps show them.

    Columns that end in ``_before`` are the former state. ``about["areas"]`` gets the verdict on each area, too.

    Raises
    ------
    InputError
        If a column that a rule judges is missing.
    """
    verdicts = dict[str, Column]()
    for rule in rules:
        verdicts |= verdict_columns(rule, table.columns)
    columns = verdicts | {name: column for name, column in table.columns.items() if name not in verdicts}
    about = table.about
    if table.sensors.zone is not None:
        about = {**about, "areas": _area_records(table, rules)}
    return Table(table.sensors, columns, about, table.scene, table.camera, table.marks, table.row_of_face)


def _area_records(table: Table, rules: Sequence[Rule]) -> list[dict[str, Any]]:
    """The results of each area, in JSON types. All cells have the same size, so shares of cells are shares of area."""
    sensors, records = table.sensors, list[dict[str, Any]]()
    assert sensors.zone is not None
    hours = next((table[name] for name in ("sun_hours", *_quantities(rules)) if name in table.columns), None)
    for k, zone in enumerate(sensors.zones):
        inside = sensors.zone == k
        record: dict[str, Any] = {"name": zone.name, "cells": int(inside.sum()), "left_out": zone.left_out}
        record["sun_hours"] = float(hours[inside].mean()) if hours is not None and inside.any() else None
        for end in (BEFORE, LOSS) if "sun_hours" + BEFORE in table.columns and inside.any() else ():
            record["sun_hours" + end] = float(table["sun_hours" + end][inside].mean())
        for rule in rules:
            if rule.area is not None:
                record |= _area_verdict(rule, table, inside)
        records.append(record)
    return records


def _quantities(rules: Sequence[Rule]) -> list[str]:
    return [each.column for rule in rules for each in rule.criteria]


def _area_verdict(rule: Rule, table: Table, inside: NDArray[np.bool_]) -> dict[str, Any]:
    """Whether enough of an area passes, now or compared with its former part."""
    assert rule.area is not None
    if not inside.any():
        return {"share": None, "passes": None}
    quantity = rule.criteria[0]
    share = float((table[quantity.column][inside] >= quantity.least - _ROUNDING).mean())
    verdict: dict[str, Any] = {"share": share, "passes": share >= rule.area}
    if quantity.column + BEFORE in table.columns:
        former = float((table[quantity.column + BEFORE][inside] >= quantity.least - _ROUNDING).mean())
        verdict |= {"share_before": former, "share_loss": former - share, "passes_before": former >= rule.area}
        verdict["passes"] |= rule.kept is not None and share >= rule.kept * former - _ROUNDING
    return verdict


# --- One verdict for several rows -------------------------------------------------------------------------------------

Grouped = Callable[[Mapping[str, Column], NDArray[np.integer], NDArray[np.float64]], dict[str, Column]]
"""(columns, row of each sensor, weight of each sensor) -> columns with a value for each row."""


def grouped_verdicts(rules: Sequence[Rule]) -> Grouped:
    """The function that joins the verdicts of sensors, such as the windows of a dwelling, as their rules say.

    The best window decides for rules that want one room to be sunlit: quantities are the greatest. For other rules
    every window must pass: quantities and ratios are the least. ``RULE_share`` is the share that passes.
    """

    def joined(columns: Mapping[str, Column], row: NDArray[np.integer], weights: NDArray[np.float64]) -> dict[str, Any]:
        verdicts, quantities = dict[str, Column](), dict[str, Column]()
        for rule in rules:
            extremes = _extremes(rule, columns, row)
            verdicts |= _joined_verdict(rule, columns, extremes, row, weights)
            quantities |= extremes
        return verdicts | quantities

    return joined


def _extremes(rule: Rule, columns: Mapping[str, Column], row: NDArray[np.integer]) -> dict[str, Column]:
    """The quantities of a rule, of the best or the worst sensor of each row."""
    extremes, word = dict[str, Column](), "greatest" if rule.best else "least"
    for criterion in rule.criteria:
        states = dict[str, Column]()
        for name in criterion.column + BEFORE, criterion.column:
            if name in columns:
                values, unit, about = columns[name]
                states[name] = Column(_extreme(values, row, rule.best), unit, f"{about}; {word} of its sensors")
        if criterion.column + LOSS in columns:
            lost = states[criterion.column + BEFORE].values - states[criterion.column].values
            extremes[criterion.column + LOSS] = columns[criterion.column + LOSS]._replace(values=lost)
        extremes |= states
    return extremes


def _extreme(values: np.ndarray, row: NDArray[np.integer], greatest: bool) -> NDArray[np.float64]:
    """(rows,) float64: the greatest or the least value of each row, ignoring NaN; NaN only if every value is."""
    extremes = np.full(int(row.max(initial=-1)) + 1, np.nan)
    (np.fmax if greatest else np.fmin).at(extremes, row, values)
    return extremes


def _joined_verdict(
    rule: Rule, columns: Mapping[str, Column], extremes: Mapping[str, Column], row: NDArray[np.integer],
    weights: NDArray[np.float64],
) -> dict[str, Column]:  # fmt: skip
    """The verdict on each row, and the share of its sensors that pass."""
    passing = columns[rule.prefix + PASSES].values
    joined = verdict_columns(rule, extremes)
    if not rule.best:  # a sensor may pass by a threshold and another by its ratio
        name = rule.prefix + PASSES
        joined[name] = joined[name]._replace(values=_extreme(passing, row, False) > 0.0)
        if (ratio := rule.prefix + RATIO) in columns:
            joined[ratio] = joined[ratio]._replace(values=_extreme(columns[ratio].values, row, False))
    total = np.bincount(row, weights)
    share = np.divide(np.bincount(row, weights * passing), total, out=np.zeros(len(total)), where=total > 0.0)
    joined[rule.prefix + SHARE] = Column(share, "", f"share of its sensors that meet {rule.name}")
    return joined
