"""Daylight rules: BR 209, DIN 5034-1 and EN 17037, each with its clause, its criteria, and what the user must supply.

A rule is data. `rule_verdicts` scores the suns that it counts, and judges the columns of tables by it.
"""

from calendar import month_name
from collections.abc import Callable, Iterable, Sequence
from datetime import date, timedelta
from enum import Enum
from typing import Any, NamedTuple

from ...base.checks import items, quoted, spelling_hint
from ...base.errors import InputError

_MONTHS = 12

# --- What a rule is made of -------------------------------------------------------------------------------------------


class Kind(Enum):
    """What a criterion counts."""

    HOURS = "hours of possible sun"
    PROBABLE = "percent of annual probable sunlight hours"
    SKY = "percent of the light of an overcast sky"


class Criterion(NamedTuple):
    """One threshold of a rule."""

    column: str  # of tables; criteria with the same column are the same quantity
    kind: Kind
    least: float  # h or %
    about: str  # what the column holds
    period: tuple[int, int] = (101, 1231)  # first and last day, 100 * month + day; may span the new year

    @property
    def unit(self) -> str:
        """The unit of the column."""
        return "h" if self.kind is Kind.HOURS else "%"


class Rule(NamedTuple):
    """A daylight rule. A sensor passes if it meets all criteria, or if its loss is small enough."""

    name: str
    citation: str  # with the clause
    text: str  # the rule, in our words
    notes: str  # its approximations, and what is left to the user
    criteria: tuple[Criterion, ...]
    days: Callable[[int], list[date]] | None = None  # default days of a year; None: light of the sky, at no time
    period: tuple[int, int] | None = None  # the rule is about one day, between these two; None: a whole year or no time
    step: int = 5  # minutes
    lowest: float | None = 0.0  # degrees: suns count above this altitude; None: the user must look it up
    kept: float | None = None  # a share of all former values that also passes; None: the former state does not count
    small_loss: float | None = None  # a loss of the first quantity, in its unit, that also passes
    area: float | None = None  # fraction of each area that must pass; None: sensors are judged individually
    best: bool = False  # whether a dwelling passes with its best window; otherwise all of its windows must pass

    @property
    def prefix(self) -> str:
        """The beginning of the names of its verdicts in tables."""
        return self.name.replace("-", "_")

    @property
    def kind(self) -> Kind:
        """What its criteria count."""
        return self.criteria[0].kind


# --- Choosing rules ---------------------------------------------------------------------------------------------------


def rule_named(name: str) -> Rule:
    """A rule of `RULES`. Raises InputError with all names if there is none of this name."""
    if not isinstance(name, str) or name not in RULES:
        raise InputError(f"rule {quoted(name)} is unknown; {spelling_hint(name, RULES)}use one of {', '.join(RULES)}")
    return RULES[name]


def rules_named(names: Any) -> tuple[Rule, ...]:
    """The rules of a name, or of several names; each once. Raises InputError."""
    several = [names] if isinstance(names, str) else items(names, str, "rule")
    return tuple(dict.fromkeys(rule_named(name) for name in several))


def check_rules(rules: Iterable[Rule], days: Sequence[date] | None, areas: bool, sunshine: bool) -> None:
    """Raise an InputError, before work begins, if the days do not suit a rule, or if it lacks data that it needs.

    days : None: those of each rule
    areas, sunshine : whether there are areas, and data on how often the sun shines
    """
    for rule in rules:
        if rule.area is not None and not areas:
            raise InputError(
                f"rule {rule.name} judges gardens and other amenity areas; give their polygons as areas, such as "
                "--areas gardens.geojson"
            )
        if rule.kind is Kind.PROBABLE and not sunshine:
            raise InputError(
                f"rule {rule.name} counts hours in which the sun is expected to shine; give an EPW file, or the mean "
                "hours of sunshine of the twelve months, --sunshine JAN/FEB/.../DEC"
            )
        if days is not None and rule.days is not None:
            _check_days(rule, days)


def _check_days(rule: Rule, days: Sequence[date]) -> None:
    if rule.period is None:
        if len({day.month for day in days}) < _MONTHS:
            raise InputError(
                f"rule {rule.name} is about a whole year; leave the days out, or give days of all months such as "
                "year:2026"
            )
        return
    first, last = rule.period
    if len(set(days)) != 1 or not first <= 100 * days[0].month + days[0].day <= last:
        assert rule.days is not None
        when = _day_text(first) if first == last else f"one day from {_day_text(first)} to {_day_text(last)}"
        such = rule.days(2026)[0]
        raise InputError(f"rule {rule.name} is about {when}; leave the days out, or give one such day, such as {such}")


def _day_text(day: int) -> str:
    """The text of 100 * month + day, such as "21 March"."""
    return f"{day % 100} {month_name[day // 100]}"


# --- The rules --------------------------------------------------------------------------------------------------------


def _whole_year(year: int) -> list[date]:
    first = date(year, 1, 1)
    return [first + timedelta(days=k) for k in range((date(year + 1, 1, 1) - first).days)]


def _equinox(year: int) -> list[date]:
    return [date(year, 3, 21)]


def _january(year: int) -> list[date]:
    return [date(year, 1, 17)]


_BR_209 = "P. Littlefair et al., Site layout planning for daylight and sunlight, BR 209, BRE, third edition, 2022, "
_BR_209_ROOMS = (
    "Which rooms need daylight is for the assessor to say: give sensors at the centres of their main windows, on the "
    "outer face of the wall. A dwelling passes if all of its windows do."
)

_DIN_5034 = "DIN 5034-1:2011-07, Daylight in interiors, Part 1: General requirements, requirements on sunlight"
_DIN_NOTES = (
    "The sensor is the middle of a window in the plane of the facade, and the sky is clear. Suns count from an "
    "altitude of 6 degrees. A dwelling passes if one of its windows does, which must be that of a habitable room. The "
    "edition of 2021 differs: check which one applies."
)

_EN_17037 = "EN 17037:2018+A1:2021, Daylight in buildings, 5.3 Exposure to sunlight and Annex A"
_EN_NOTES = (
    "The standard allows any day from 1 February to 21 March; the default is 21 March. The sky is clear. The sensor "
    "is a point of an opening, at least 1.2 m above the floor. A dwelling passes if one of its windows does, which "
    "must be that of a habitable room. Suns count above a minimum altitude that the standard tabulates by country: "
    "give it as the lowest altitude."
)


def _en_17037(level: str, hours: float) -> Rule:
    return Rule(
        f"en17037-{level}",
        f"{_EN_17037}, level {level}",
        f"At least {hours:g} hours of possible sun on a day from 1 February to 21 March.",
        _EN_NOTES,
        (Criterion("en17037_hours", Kind.HOURS, hours, "possible sun on the day of EN 17037"),),
        _equinox,
        (201, 321),
        lowest=None,
        best=True,
    )


def _din_5034(season: str, hours: float, day: Callable[[int], list[date]], period: tuple[int, int], when: str) -> Rule:
    return Rule(
        f"din5034-{season}",
        _DIN_5034,
        f"At least {hours:g} hour{'s' * (hours != 1)} of possible sun {when}.",
        _DIN_NOTES,
        (Criterion(f"din5034_{season}_hours", Kind.HOURS, hours, f"possible sun {when}"),),
        day,
        period,
        lowest=6.0,
        best=True,
    )


RULES: dict[str, Rule] = {
    rule.name: rule
    for rule in (
        Rule(
            "br209-vsc",
            _BR_209 + "section 2.2",
            "The vertical sky component of a window is at least 27 %, or at least 0.8 times its former value.",
            "The vertical sky component is the light of an overcast sky of the CIE on a vertical plane, relative to "
            "that on unobstructed ground; reflected light and glass do not count. Without a former state, only the "
            "27 % are judged. " + _BR_209_ROOMS,
            (Criterion("br209_vsc", Kind.SKY, 27.0, "vertical sky component"),),
            kept=0.8,
        ),
        Rule(
            "br209-apsh",
            _BR_209 + "section 3.2",
            "A window gets at least 25 % of annual probable sunlight hours, and at least 5 % of them between "
            "21 September and 21 March; or it keeps 0.8 times its former hours in both periods; or it loses at most "
            "4 % of annual probable sunlight hours.",
            "Probable sunlight hours are the long-term average of hours of sunshine on unobstructed ground. Mean hours "
            "of sunshine per month are spread evenly over the hours with the sun above the horizon. With an EPW file, "
            "hours with direct normal irradiance above 120 W/m2 count instead: one typical year then stands for the "
            "long-term average. Without a former state, only the 25 % and the 5 % are judged. The rule is about main "
            "windows of living rooms that face within 90 degrees of due south, in the northern hemisphere: choose them "
            "with --facing 90:270. " + _BR_209_ROOMS,
            (
                Criterion("br209_apsh", Kind.PROBABLE, 25.0, "annual probable sunlight hours"),
                Criterion(
                    "br209_apsh_winter", Kind.PROBABLE, 5.0, "annual probable sunlight hours in winter", (921, 321)
                ),
            ),
            _whole_year,
            step=60,
            kept=0.8,
            small_loss=4.0,
        ),
        Rule(
            "br209-amenity",
            _BR_209 + "section 3.3",
            "At least half of a garden or amenity area gets at least two hours of sun on 21 March, or the part that "
            "does is at least 0.8 times the former one.",
            "Sun hours are those of a clear sky. Suns at any altitude count; assessments often leave out those below "
            "10 degrees, as the lowest altitude does. The ground is the lowest surface of the scene, or the top of a "
            "low slab there. Cells inside buildings do not belong to an area. Trees cast shade as modelled; "
            "assessments often leave them out. Without a former state, only the half is judged.",
            (Criterion("br209_amenity_hours", Kind.HOURS, 2.0, "sun on 21 March"),),
            _equinox,
            (321, 321),
            kept=0.8,
            area=0.5,
        ),
        _din_5034("winter", 1.0, _january, (117, 117), "on 17 January"),
        _din_5034("equinox", 4.0, _equinox, (320, 321), "at the equinox"),
        _en_17037("minimum", 1.5),
        _en_17037("medium", 3.0),
        _en_17037("high", 4.0),
    )
}
"""Name -> rule."""
