"""Daylight rules on sun hours, such as BR 209 and EN 17037; only rules whose text could be verified.

Each rule is linear: a sun counts towards a criterion with a weight, and a sensor's score is the sum over its visible
suns. `weights_of` returns the weight matrix; the scores are ``visible @ weights.T``.
"""

from calendar import month_name
from collections.abc import Callable
from datetime import date, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import quoted, spelling_hint
from ...base.errors import InputError
from ...sun.sun_positions import Suns, month_days

BRIGHT = 120.0
"""W/m2: sunshine is bright if direct normal irradiance is above this (World Meteorological Organization)."""

_MONTHS = 12
_ROUNDING = 1e-9  # tolerance, so that a sum of twelfths of an hour reaches a whole number


class Criterion(NamedTuple):
    """One threshold of a rule."""

    name: str
    least: float  # hours; or, if `share`, the fraction of the hours of all suns of the rule
    share: bool = False
    period: tuple[int, int] = (101, 1231)  # first and last day, 100 * month + day; may span the new year


class Rule(NamedTuple):
    """A daylight rule."""

    name: str
    citation: str
    text: str  # the rule, in our words
    notes: str  # its approximations, and the choices left to the user
    days: Callable[[int], list[date]]  # default days of a year
    step: int  # minutes
    criteria: tuple[Criterion, ...]  # a sensor passes if it meets all
    area: float | None = None  # fraction of each area that must pass; None: sensors are judged individually
    period: tuple[int, int] | None = None  # the rule applies to one day, between these two; None: to a whole year


def weights_of(rule: Rule, suns: Suns) -> NDArray[np.float64]:
    """(criteria, k) float64: what each visible sun adds to the score of each criterion.

    If the suns have direct radiation, probable hours count only while it is above `BRIGHT`.

    Raises
    ------
    InputError
        If no sun counts.
    """
    hours = suns.hours if suns.dni is None else suns.hours * (suns.dni > BRIGHT)
    days, rows = month_days(suns.local), []
    for criterion in rule.criteria:
        counted = hours if criterion.share else suns.hours
        first, last = criterion.period
        inside = (days >= first) & (days <= last)
        if first > last:
            inside = (days >= first) | (days <= last)
        total = counted.sum() if criterion.share else 1.0
        if not total > 0.0:
            raise InputError(f"rule {rule.name}: no sun is above the horizon on its days; check the place and the days")
        rows.append(counted * inside / total)
    return np.array(rows, np.float64)


def meets_rule(rule: Rule, scores: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) bool: whether each sensor meets all criteria, for scores (n, criteria)."""
    least = np.array([criterion.least for criterion in rule.criteria])
    return np.asarray(np.all(scores >= least - _ROUNDING, axis=1))


def check_rule(name: str, days: list[date] | None, areas: bool) -> None:
    """Raise an InputError, before work begins, if the days do not suit a rule, or it needs areas and has none.

    days : None: those of the rule
    """
    rule = rule_named(name)
    if rule.area is not None and not areas:
        raise InputError(
            f"rule {name} judges gardens and other amenity areas; give their polygons as areas, such as --areas "
            "gardens.geojson"
        )
    if days is None:
        return
    cure = "leave the days out"
    if rule.period is None:
        if len({day.month for day in days}) < _MONTHS:
            raise InputError(f"rule {name} is about a whole year; {cure}, or give days of all months such as year:2026")
        return
    first, last = rule.period
    if len(set(days)) != 1 or not first <= 100 * days[0].month + days[0].day <= last:
        when = _day_text(first) if first == last else f"one day from {_day_text(first)} to {_day_text(last)}"
        raise InputError(f"rule {name} is about {when}; {cure}, or give one such day, such as 2026-03-21")


def _day_text(day: int) -> str:
    """The text of 100 * month + day, such as "21 March"."""
    return f"{day % 100} {month_name[day // 100]}"


def rule_named(name: str) -> Rule:
    """A rule of `RULES`. Raises InputError with all names if there is none of this name."""
    if not isinstance(name, str) or name not in RULES:
        raise InputError(f"rule {quoted(name)} is unknown; {spelling_hint(name, RULES)}use one of {', '.join(RULES)}")
    return RULES[name]


def _whole_year(year: int) -> list[date]:
    first = date(year, 1, 1)
    return [first + timedelta(days=k) for k in range((date(year + 1, 1, 1) - first).days)]


def _equinox(year: int) -> list[date]:
    return [date(year, 3, 21)]


_BR_209 = "P. Littlefair, Site layout planning for daylight and sunlight, BR 209, BRE, editions of 2011 and 2022"
_EN_17037 = "EN 17037:2018+A1:2021, Daylight in buildings, exposure to sunlight"
_EN_NOTES = (
    "The standard allows any day from 1 February to 21 March; the default is 21 March. The sky is clear. The sensor is "
    "a point of an opening of one habitable room, at least 1.2 m above the floor. Suns count above a minimum altitude "
    "that depends on the country: choose sensors and minimum altitude accordingly."
)


def _en_17037(level: str, hours: float) -> Rule:
    text = f"At least {hours:g} hours of possible sun on a day from 1 February to 21 March."
    days, criteria = _equinox, (Criterion("hours", hours),)
    cited = f"{_EN_17037}, level {level}"
    return Rule(f"en17037-{level}", cited, text, _EN_NOTES, days, 5, criteria, period=(201, 321))


RULES: dict[str, Rule] = {
    rule.name: rule
    for rule in (
        Rule(
            "br209-windows",
            _BR_209,
            "A window gets at least 25 % of annual probable sunlight hours, and at least 5 % of them between "
            "21 September and 21 March.",
            "Probable sunlight hours are the long-term average of hours of bright sun on unobstructed ground. With an "
            f"EPW file, hours with direct normal irradiance above {BRIGHT:g} W/m2 count: one typical year stands for "
            "the long-term average. Without one, every hour of sun above the horizon counts alike, which gives "
            "cloudy winters too much weight.",
            _whole_year,
            60,
            (Criterion("annual", 0.25, True), Criterion("winter", 0.05, True, (921, 321))),
        ),
        Rule(
            "br209-amenity",
            _BR_209,
            "At least half of a garden or amenity area gets at least two hours of sun on 21 March.",
            "Sun hours are those of a clear sky, with the sun at any height above the horizon. The ground is the "
            "lowest surface of the scene, or the top of a low slab there. Cells inside buildings do not belong to an "
            "area. Trees cast shade as modelled; assessments often leave them out.",
            _equinox,
            5,
            (Criterion("hours", 2.0),),
            0.5,
            (321, 321),
        ),
        _en_17037("minimum", 1.5),
        _en_17037("medium", 3.0),
        _en_17037("high", 4.0),
    )
}
"""Name -> rule."""
