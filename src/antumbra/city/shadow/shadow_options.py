"""The options of a shadow: the keywords of `antumbra.shadow`."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from itertools import pairwise
from typing import Any

import numpy as np

from ...base.checks import checked_instance, flag, items, number, parts_of, quoted
from ...base.errors import InputError
from ...base.option_fields import Choice, RealNumber, check_fields, option, optional, same_option
from ...engine.plan import Plan
from ...picture.render_options import EngineOptions
from ...sun.location import Place, checked_place
from ...sun.sun_positions import YEARS, checked_step, days_of

CLASSES = 0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0
"""Default lower limits of the classes, hours."""

_MOMENT = "2026-06-21T15:00, in the time zone of the place, or with an offset such as +02:00"


def _moment(value: Any, what: str) -> datetime:
    """A datetime, or one from an ISO text; without an offset, it is in the time zone of the place."""
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value.strip())
        except ValueError:
            raise InputError(f"{what} is {quoted(value)}; write {_MOMENT}") from None
    if not isinstance(value, datetime):
        raise InputError(f"{what} is {quoted(value)}; it must be a datetime, or a text such as 2026-06-21T15:00")
    if not YEARS[0] <= value.year <= YEARS[1]:
        raise InputError(f"{what} is {value}; choose a year from {YEARS[0]} to {YEARS[1]}")
    return value


def _classes(value: Any, what: str) -> tuple[float, ...]:
    parts = value.split(",") if isinstance(value, str) else parts_of(value)
    try:
        limits = tuple(number(float(part), f"{what} (hours)", 0.0, 8784.0, "[]") for part in parts or ())
    except (TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        limits = ()
    if not limits or any(b <= a for a, b in pairwise(limits)):
        raise InputError(f"{what} is {quoted(value)}; give hours in ascending order, such as 0,1,2,4,8")
    return limits


def _casters(value: Any, what: str) -> tuple[str, ...]:
    words = value.split(",") if isinstance(value, str) else items(value, str, what)
    return tuple(word.strip() for word in words)


def _place(value: Any, what: str) -> Place:
    return checked_place(checked_instance(value, Place, what))


@dataclass(frozen=True, kw_only=True)
class ShadowOptions:
    """The options of a shadow, checked and immutable. Raises InputError."""

    at: str | datetime | None = option(
        None,
        optional(_moment),
        "The moment, such as 2026-06-21T15:00, in the time zone of the place unless it has an offset.",
        kind=str | None,
        metavar="TIME",
        doc_type="str, datetime or None",
    )
    """The moment of the shadow, as a datetime or an ISO text such as 2026-06-21T15:00; in the time zone of the place
    unless it has its own offset."""
    days: str | Iterable[date] | None = option(
        None,
        optional(lambda value, _: days_of(value)),
        "Instead of a moment: 2026-06-21, 2026-03-21:2026-09-21, year:2026, or a comma-separated list.",
        kind=str | None,
        metavar="DAYS",
    )
    """Instead of a moment: dates, or a text as for `sun_hours`. The result has the hours of shadow on these days."""
    plane: float | None = option(
        None,
        RealNumber(-np.inf, np.inf, optional=True),
        "Height of the shadow's plane, in world units.",
        note="with cells, the highest surfaces; else the lowest point of the scene",
        metavar="HEIGHT",
    )
    """Coordinate on the up axis of a horizontal plane that the shadow falls on. None: with `cell`, the highest
    surfaces, else a plane through the lowest point of the scene."""
    cell: float | None = option(
        None,
        RealNumber(0.0, np.inf, optional=True),
        "Side of a raster cell, in world units: exact rays from each cell's centre.",
        note="1 m for days; else no raster, but exact outlines on a plane",
        metavar="SIZE",
    )
    """Side of a raster cell, world units: polygons follow the edges of cells, whose centres are traced exactly. None:
    1 m for `days`, else no raster, but the exact outline of the shadow on a plane."""
    per: str = option(
        "shadow", Choice(("shadow", "object")), "On a plane: one row per connected shadow, or per object."
    )
    """On a plane, "shadow": a row for each connected part of the shadow; "object": a row for each object, such as a
    building with all its parts, whose shadows may overlap."""
    casters: str | Sequence[str] | None = option(
        None,
        optional(_casters),
        "Objects that cast shadows, on a plane: names or types with * and ?, separated by commas.",
        kind=str | None,
        note="all but the ground of a city model",
        metavar="NAMES",
        doc_type="str, sequence of str or None",
    )
    """On a plane: names or types of the objects that cast shadows, with wildcards, such as "Building*". None: all,
    except terrain, roads, land use, plant cover and water of a city model."""
    footprints: bool = option(True, flag, "Include the ground below objects, on a plane.")
    """On a plane: whether the shadow includes the ground straight below the objects that cast it."""
    classes: str | Sequence[float] = option(
        CLASSES,
        _classes,
        "Lower limits of the classes of hours, for days, separated by commas.",
        kind=str,
        start=",".join(f"{limit:g}" for limit in CLASSES),
        metavar="HOURS",
        doc_type="str or sequence of float",
    )
    """For `days`: lower limits of the classes of hours of shadow, in ascending order. The last class has no upper
    limit."""
    step: float = option(
        15.0,
        lambda value, _: checked_step(value),
        "For days: interval that each sun position represents.",
        metavar="MINUTES",
    )
    """For `days`: minutes that each sun position represents."""
    place: Place | None = option(None, optional(_place))
    """None: that of the scene's CRS."""
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)

    def check_moment(self) -> None:
        """Raise an InputError unless there is either a moment or days."""
        if (self.at is None) == (self.days is None):
            raise InputError("a shadow needs either a moment (at, such as 2026-06-21T15:00) or days")

    @property
    def on_plane(self) -> bool:
        """Whether the outline of the shadow on a plane is computed, without a raster."""
        return self.cell is None and self.days is None
