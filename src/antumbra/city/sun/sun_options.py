"""The options of a study of sun hours: the keywords of `antumbra.sun_hours` that define it."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from pathlib import Path
from typing import Any, cast

from ...base.checks import checked_instance, choice, flag, items, listed, number, parts_of, quoted
from ...base.errors import InputError
from ...base.option_fields import RealNumber, WholeNumber, check_fields, option, optional, same_option, unchecked
from ...engine.plan import Plan
from ...picture.render_options import EngineOptions
from ...scene.materials import MONTHS
from ...sun.location import Place, checked_place
from ...sun.sun_positions import checked_step, days_of
from ..sensors.curvature_options import CurvatureOptions
from ..tables.surface_columns import Between, Facing
from .daylight_rules import Rule, check_rules, rules_named

MOST_DIRECTIONS = 1 << 14
"""Maximum number of directions for the sky-view factor."""

MOST_SAMPLES = 64
"""Maximum number of points on the sun's disk."""


class HoursInterval(StrEnum):
    """An item of `SunKeywords.by` on the command line."""

    month = "month"
    hour = "hour"


def place_option(value: Any, what: str) -> Place:
    """Check of an option that is a place."""
    return checked_place(checked_instance(value, Place, what))


def _by(value: Any, what: str) -> tuple[str, ...]:
    return tuple(choice(each, what, [name.value for name in HoursInterval]) for each in items(value, str, what))


def _surfaces(value: Any, what: str) -> tuple[str, ...]:
    """Types of semantic surfaces, from a text with commas or several texts."""
    names = [name.strip() for name in value.split(",")] if isinstance(value, str) else items(value, str, what)
    if not names or not all(names):
        raise InputError(f"{what} is {quoted(value)}; write types such as WallSurface,RoofSurface")
    return tuple(names)


def _facing(value: Any, what: str) -> Facing:
    """Two azimuths, from a text FROM:TO or a pair."""
    return Facing(*_two_angles(value, what, -360.0, 360.0, "150:210"))


def _tilt(value: Any, what: str) -> Between:
    """Two tilts, from a text FROM:TO or a pair."""
    first, last = _two_angles(value, what, 0.0, 180.0, "80:100")
    if first > last:
        raise InputError(f"{what} is {quoted(value)}; write the smaller angle first, such as 80:100")
    return Between(first, last)


def _two_angles(value: Any, what: str, low: float, high: float, such: str) -> tuple[float, float]:
    ends = value.split(":") if isinstance(value, str) else value
    if len(parts_of(ends) or ()) != 2:
        raise InputError(f"{what} is {quoted(value)}; write FROM:TO in degrees, such as {such}")
    try:
        first, last = (float(end) if isinstance(end, str) else end for end in listed(ends, what, 2))
        return number(first, what, low, high, "[]"), number(last, what, low, high, "[]")
    except ValueError:
        raise InputError(
            f"{what} is {quoted(value)}; write two numbers from {low:g} to {high:g}, such as {such}"
        ) from None


def _rules(value: Any, what: str) -> tuple[str, ...]:
    """Names of rules, each once."""
    return tuple(rule.name for rule in rules_named(value))


def _sunshine(value: Any, what: str) -> tuple[float, ...]:
    """Hours of twelve months, from a text JAN/FEB/.../DEC or a sequence."""
    hours = value.split("/") if isinstance(value, str) else value
    if len(parts_of(hours) or ()) != len(MONTHS):
        raise InputError(f"{what} is {quoted(value)}; write twelve mean hours of sunshine, JAN/FEB/.../DEC")
    try:
        given = [float(each) if isinstance(each, str) else each for each in parts_of(hours) or ()]
        return tuple(number(each, what, 0.0, 24.0 * 31.0, "[]") for each in given)
    except ValueError:
        raise InputError(f"{what} is {quoted(value)}; its hours must be numbers from 0 to 744, one a month") from None


def _per(value: Any, what: str) -> str:
    """What a row stands for; whether it is a column of the sensors is checked with them."""
    if not isinstance(value, str) or not value:
        raise InputError(f'{what} is {quoted(value)}; it must be "sensor", "surface", "facade", "building" or a column')
    return value


@dataclass(frozen=True, kw_only=True)
class SunDays:
    """The days of a study."""

    days: str | Iterable[date] | None = option(
        None,
        optional(lambda value, _: days_of(value)),
        "2026-06-21, 2026-03-21:2026-09-21, year:2026, or a comma-separated list.",
        kind=str | None,
        note="those of the rule or the EPW file",
        metavar="DAYS",
    )
    """Dates, or a text that `parse_days` reads."""


@dataclass(frozen=True, kw_only=True)
class SunKeywords:
    """The keywords of `antumbra.sun_hours`, besides those for its input and output."""

    place: Place | None = option(None, optional(place_option))
    """None: that of the scene's CRS."""
    step: float | None = option(
        None,
        optional(lambda value, _: checked_step(value)),
        "Interval that each sun position represents.",
        note="60, or as the rule requires",
        metavar="MINUTES",
    )
    """Length of an interval in minutes. None: 60, or that of the rule. EPW files have hourly intervals."""
    rule: str | Sequence[str] | None = option(
        None,
        optional(_rules),
        "A daylight rule: br209-vsc, br209-apsh, br209-amenity, din5034-winter, din5034-equinox, en17037-minimum, "
        "en17037-medium or en17037-high; may be repeated.",
        kind=list[str] | None,
        metavar="NAME",
        doc_type="str, sequence of str, or None",
    )
    """Daylight rules, such as "br209-vsc" or ["en17037-medium", "din5034-winter"]. Their verdicts become the first
    columns, before the quantities that they judge. Without `days`, each has its own; days to which a rule does not
    apply are rejected."""
    sunshine: str | Sequence[float] | None = option(
        None,
        optional(_sunshine),
        "Mean sunshine hours per month, twelve numbers, for br209-apsh.",
        kind=str | None,
        metavar="JAN/.../DEC",
        doc_type="str, sequence of 12 floats, or None",
    )
    """Mean hours of sunshine in each month, for the rule br209-apsh, as weather services publish them: 12 numbers, or a
    text such as "62/78/.../52". None: it follows from the EPW file."""
    lowest: float | None = option(
        None,
        RealNumber(0.0, 90.0, "[)", "degrees", optional=True),
        "Lowest altitude of suns that count.",
        note="0, or as the rule requires",
        metavar="DEGREES",
    )
    """Altitude of the sun above which it counts, degrees. None: 0, or that of each rule."""
    epw: str | os.PathLike[str] | None = option(
        None,
        unchecked,
        "EPW weather file: location, days, direct and diffuse radiation.",
        kind=Path | None,
        metavar="FILE",
        doc_type="str, path-like or None",
    )
    """Weather file with direct and diffuse radiation; also sets the place if there is no other."""
    energy: bool = option(False, flag, "Add the direct energy under a clear sky.")
    """Add the energy of direct light, under a clear sky if there is no EPW file."""
    sky_view: int = option(
        0, WholeNumber(0, MOST_DIRECTIONS), "Add the sky-view factor, from N directions.", metavar="N"
    )
    """Number of sky directions for the sky-view factor, 0 to 16384; 0: no such column. `sky_view` needs no place and no
    days."""
    by: Sequence[str] = option(
        (),
        _by,
        "Also list hours per month or hour of the day; may be repeated.",
        kind=list[HoursInterval] | None,
        start=None,
        doc_type='sequence of "month" and "hour"',
    )
    """Add a column of hours for each month, or for each hour of the day."""
    curvature: bool = same_option(CurvatureOptions, "curvature")
    refraction: float | None = same_option(CurvatureOptions, "refraction")
    earth_radius: float | None = same_option(CurvatureOptions, "earth_radius")
    surfaces: Sequence[str] | None = option(
        None,
        optional(_surfaces),
        "Only these CityJSON surface types, such as WallSurface,RoofSurface.",
        kind=str | None,
        note="all",
        metavar="TYPES",
        doc_type="str, sequence of str, or None",
    )
    """Use only the sensors on semantic surfaces of these types, such as "WallSurface,RoofSurface". None: all."""
    facing: tuple[float, float] | None = option(
        None,
        optional(_facing),
        "Only surfaces that face these azimuths, degrees clockwise from true north.",
        kind=str | None,
        note="all",
        metavar="FROM:TO",
        doc_type="str, (float, float) or None",
    )
    """Use only the sensors on surfaces whose azimuth lies in this range, clockwise, both ends included: "150:210" or
    (150, 210) faces south, (315, 45) north. Degrees clockwise from true north. Horizontal surfaces face nowhere. None:
    all."""
    tilt: tuple[float, float] | None = option(
        None,
        optional(_tilt),
        "Only surfaces with these tilts: 0 faces up, 90 is upright, 180 faces down.",
        kind=str | None,
        note="all",
        metavar="FROM:TO",
        doc_type="str, (float, float) or None",
    )
    """Use only the sensors on surfaces whose tilt lies in this range, degrees, both ends included: "80:100" are walls.
    0 faces up, 90 is upright, 180 faces down. None: all."""
    per: str = option(
        "sensor",
        _per,
        "What a row stands for: sensor, surface, facade, building, or a column of the sensors' file such as dwelling.",
        metavar="NAME",
        doc_type='"sensor", "surface", "facade", "building", or the name of a column',
    )
    """One row per sensor, surface, facade, building, or value of a column of the sensors' file, such as "dwelling".
    Rows of several sensors have their means, over the area if sensors have areas, the earliest "first" and the latest
    "last", for each column per m2 another one with its sum, and of rules the verdict on all of them: the best window
    decides for DIN 5034-1 and EN 17037, the worst one for BR 209."""
    samples: int = option(1, WholeNumber(1, MOST_SAMPLES), "Sample points on the sun's disk; 1: its centre.")
    """Points on the sun's disk, 1 to 64; 1: its centre."""
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    threads: int | None = same_option(EngineOptions, "threads")


@dataclass(frozen=True, kw_only=True)
class SunOptions(SunKeywords, SunDays):
    """The options of a study, checked and immutable. Raises InputError."""

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def dates(self) -> list[date] | None:
        """The days; None: those of the rule or of the EPW file."""
        return cast(list[date] | None, self.days)

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules."""
        return () if self.rule is None else rules_named(self.rule)

    def check_rules(self, areas: bool) -> None:
        """Raise an InputError if the days do not suit a rule, or it lacks areas or sunshine that it needs."""
        check_rules(self.rules, self.dates, areas, self.sunshine is not None or self.epw is not None)
