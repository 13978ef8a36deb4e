"""The options of a study of sun hours: the keywords of `antumbra.sun_hours` that define it."""

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from ...checks import checked_instance, choice, flag, items
from ...engine.plan import DEFAULT_PLAN
from ...picture.option_fields import (
    CommandOption,
    WholeNumber,
    check_fields,
    known_plan,
    option,
    same_option,
    unchecked,
)
from ...picture.render_options import EngineOptions
from .daylight_rules import check_rule, rule_named
from .location import Place, checked_place
from .sun_positions import checked_step, days_of

if TYPE_CHECKING:
    from ...engine.plan import Plan

MOST_DIRECTIONS = 1 << 14
"""Maximum number of directions for the sky-view factor."""

MOST_SAMPLES = 64
"""Maximum number of points on the sun's disk."""


class HoursInterval(StrEnum):
    """An item of `SunKeywords.by` on the command line."""

    month = "month"
    hour = "hour"


def _days(value: Any, what: str) -> list[date] | None:
    return None if value is None else days_of(value)


def _place(value: Any, what: str) -> Place | None:
    return None if value is None else checked_place(checked_instance(value, Place, what))


def _step(value: Any, what: str) -> float | None:
    return None if value is None else checked_step(value)


def _rule(value: Any, what: str) -> str | None:
    return None if value is None else rule_named(value).name


def _by(value: Any, what: str) -> tuple[str, ...]:
    return tuple(choice(each, what, [name.value for name in HoursInterval]) for each in items(value, str, what))


@dataclass(frozen=True, kw_only=True)
class SunDays:
    """The days of a study."""

    days: str | Iterable[date] | None = option(
        None,
        _days,
        CommandOption(
            "2026-06-21, 2026-03-21:2026-09-21, year:2026, or a comma-separated list.",
            kind=str | None,
            note="those of the rule or the EPW file",
            metavar="DAYS",
        ),
    )
    """Dates, or a text that `parse_days` reads."""


@dataclass(frozen=True, kw_only=True)
class SunKeywords:
    """The keywords of `antumbra.sun_hours`, besides those for its input and output."""

    place: Place | None = option(None, _place)
    """None: that of the scene's CRS."""
    step: float | None = option(
        None,
        _step,
        CommandOption(
            "Minutes represented by each sun position.", note="60, or as the rule requires", metavar="MINUTES"
        ),
    )
    """Length of an interval in minutes. None: 60, or that of the rule. EPW files have hourly intervals."""
    rule: str | None = option(None, _rule, CommandOption("A daylight rule: br209-windows, en17037-medium, ..."))
    """A daylight rule, see `antumbra plans`: its criteria become columns. Days to which it does not apply are
    rejected."""
    epw: str | os.PathLike[str] | None = option(
        None,
        unchecked,
        CommandOption(
            "EPW weather file: location, days, direct and diffuse radiation.", kind=Path | None, metavar="FILE"
        ),
        kind="str or path-like or None",
    )
    """Weather file with direct and diffuse radiation; also sets the place if there is no other."""
    energy: bool = option(False, flag, CommandOption("Add the direct energy under a clear sky."))
    """Add the energy of direct light, under a clear sky if there is no EPW file."""
    sky: int = option(
        0, WholeNumber(0, MOST_DIRECTIONS), CommandOption("Add the sky-view factor, from N directions.", metavar="N")
    )
    """Number of sky directions for the sky-view factor, 0 to 16384; 0: no such column. `sky_view` needs no place and no
    days."""
    by: Sequence[str] = option(
        (),
        _by,
        CommandOption(
            "Also list hours per month or hour of the day; may be repeated.",
            kind=list[HoursInterval] | None,
            start=None,
        ),
        kind='sequence of "month" and "hour"',
    )
    """Add a column of hours for each month, or for each hour of the day."""
    samples: int = option(
        1, WholeNumber(1, MOST_SAMPLES), CommandOption("Sample points on the sun's disk; 1: its centre.")
    )
    """Points on the sun's disk, 1 to 64; 1: its centre."""
    plan: "str | Plan | None" = option(
        None, known_plan, CommandOption("Plan; see antumbra plans.", kind=str, start=DEFAULT_PLAN)
    )
    """As in `antumbra.render`."""
    threads: int | None = same_option(EngineOptions, "threads")
    """As in `antumbra.render`."""


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
