"""The options of a study of sun hours: the keywords of `antumbra.sun_hours` that define it."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from pathlib import Path
from typing import Any, cast

from ...base.checks import checked_instance, choice, flag, items, listed, number, parts_of, quoted, text
from ...base.errors import InputError
from ...base.option_fields import WholeNumber, check_fields, option, optional, same_option, unchecked
from ...engine.plan import Plan
from ...picture.render_options import EngineOptions
from ...sun.location import Place, checked_place
from ...sun.sun_positions import checked_step, days_of
from ..sensors.curvature_options import CurvatureOptions
from ..tables.surface_columns import Facing
from .daylight_rules import check_rule, rule_named

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
    ends = value.split(":") if isinstance(value, str) else value
    if len(parts_of(ends) or ()) != 2:
        raise InputError(f"{what} is {quoted(value)}; write FROM:TO in degrees, such as 150:210")
    first, last = (_degrees(end, value, what) for end in listed(ends, what, 2))
    return Facing(first, last)


def _degrees(end: Any, value: Any, what: str) -> float:
    try:
        return number(float(end) if isinstance(end, str) else end, what, -360.0, 360.0, "[]")
    except ValueError:
        raise InputError(f"{what} is {quoted(value)}; write two numbers from -360 to 360, such as 150:210") from None


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
        "Minutes represented by each sun position.",
        note="60, or as the rule requires",
        metavar="MINUTES",
    )
    """Length of an interval in minutes. None: 60, or that of the rule. EPW files have hourly intervals."""
    rule: str | None = option(
        None, optional(lambda value, _: rule_named(value).name), "A daylight rule: br209-windows, en17037-medium, ..."
    )
    """A daylight rule, see `antumbra plans`: its criteria become columns. Days to which it does not apply are
    rejected."""
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
    sky: int = option(0, WholeNumber(0, MOST_DIRECTIONS), "Add the sky-view factor, from N directions.", metavar="N")
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
        "Only surfaces of these types of CityJSON, such as WallSurface,RoofSurface.",
        kind=str | None,
        note="all",
        metavar="TYPES",
        doc_type="str, sequence of str, or None",
    )
    """Use only the sensors on semantic surfaces of these types, such as "WallSurface,RoofSurface". None: all."""
    facing: tuple[float, float] | None = option(
        None,
        optional(_facing),
        "Only surfaces that face azimuths in this range, degrees clockwise from true north.",
        kind=str | None,
        note="all",
        metavar="FROM:TO",
        doc_type="str, (float, float) or None",
    )
    """Use only the sensors on surfaces whose azimuth lies in this range, clockwise, both ends included: "150:210" or
    (150, 210) faces south, (315, 45) north. Degrees clockwise from true north. Horizontal surfaces face nowhere. None:
    all."""
    per: str = option("sensor", text, "What a row stands for: sensor, surface, building, or a column of their file.")
    """One row per sensor, surface or building, or for each value of a column of the file of the sensors, such as
    "dwelling". Rows of several sensors have their means over the area, the earliest "first" and the latest "last", and
    for each column per m2 another one with its sum. Points without areas count alike."""
    samples: int = option(1, WholeNumber(1, MOST_SAMPLES), "Sample points on the sun's disk; 1: its centre.")
    """Points on the sun's disk, 1 to 64; 1: its centre."""
    plan: str | Plan | None = same_option(EngineOptions, "plan", help="Plan; see antumbra plans.", note="auto")
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

    def check_rule(self, areas: bool) -> None:
        """Raise an InputError if the days do not suit the rule, or it needs areas and has none."""
        if self.rule is not None:
            check_rule(self.rule, self.dates, areas)
