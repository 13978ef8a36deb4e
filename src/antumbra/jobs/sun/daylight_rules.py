"""Daylight rules on sun hours, such as BR 209 and EN 17037; only rules whose text is certain.

Each rule is linear: a sun counts towards a criterion with a weight, and a sensor's score is the sum over the suns that
it sees. `weights_of` gives a matrix, and ``seen @ weights.T`` the scores.
"""

from calendar import month_name
from collections.abc import Callable
from datetime import date, timedelta
from typing import NamedTuple

import numpy as np

from ...checks import quoted, spelling_hint
from ...errors import InputError
from .sun_positions import Suns, month_days

BRIGHT = 120.0
"""W/m2: sunshine is bright if direct normal irradiance is above this (World Meteorological Organization)."""

_MONTHS = 12
_ROUNDING = 1e-9  # so that a sum of twelfths of an hour reaches a whole number


class Criterion(NamedTuple):
    """One threshold of a rule."""

    name: str
    least: float  # hours; or, if `share`, the part of the hours of all suns of the rule
    share: bool = False
    period: tuple[int, int] = (101, 1231)  # first and last day, 100 * month + day; it may cross the new year


class Rule(NamedTuple):
    """A daylight rule."""

    name: str
    citation: str
    text: str  # the rule, in our words
    notes: str  # its approximations, and what it leaves to the user
    days: Callable[[int], list[date]]  # of a year
    step: int  # minutes
    criteria: tuple[Criterion, ...]  # a sensor passes if it meets all
    area: float | None = None  # part of each area that has to pass; None: each sensor by itself
    period: tuple[int, int] | None = None  # first and last of the days of which one is asked; None: a whole year


def weights_of(rule: Rule, suns: Suns) -> np.ndarray:
    """What each sun adds to each criterion if a sensor sees it: (criteria, k) float64.

    If the suns have direct radiation, probable hours count only while it is above `BRIGHT`.

    Raises
    ------
    InputError
        If no sun is there to count.
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


def meets_rule(rule: Rule, scores: np.ndarray) -> np.ndarray:
    """Whether each sensor meets all criteria: (n,) bool, for scores (n, criteria)."""
    least = np.array([criterion.least for criterion in rule.criteria])
    return np.all(scores >= least - _ROUNDING, axis=1)


def check_rule(name: str, days: list[date] | None, areas: bool) -> None:
    """Raise an InputError, before work begins, if a rule does not fit the days, or lacks its areas.

    days : those that were given; None: those of the rule
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
    """100 * month + day in words, such as "21 March"."""
    return f"{day % 100} {month_name[day // 100]}"


def rule_named(name: str) -> Rule:
    """A rule of `RULES`. Raises InputError with all names if there is none."""
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
    "The standard lets the day be any from 1 February to 21 March; 21 March is the preset. The sky is clear. The "
    "sensor is a point of an opening of one habitable room, at least 1.2 m above the floor. Suns count above a lowest "
    "altitude that depends on the country: give sensors and lowest altitude to match."
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
            "the long-term average. Without one, every hour of sun above the horizon counts alike: cloudy winters then "
            "weigh too much.",
            _whole_year,
            60,
            (Criterion("annual", 0.25, True), Criterion("winter", 0.05, True, (921, 321))),
        ),
        Rule(
            "br209-amenity",
            _BR_209,
            "At least half of a garden or amenity area gets at least two hours of sun on 21 March.",
            "Sun hours are those of a clear sky, with the sun at any height above the horizon. The ground is the "
            "lowest surface of the scene, or the upper side of a low slab there. Cells inside buildings do not belong "
            "to an area. Trees shade as they are modelled; assessments often leave them out.",
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
