"""The paths of the sun in a polar diagram: azimuths clockwise from true north at the top, the zenith in the centre.

Equal steps of elevation are equally far apart, and the horizontal is the rim.
"""

from collections.abc import Sequence
from datetime import UTC, date, datetime, time, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...sun.location import Place
from ...sun.sun_positions import solar_angles, zone_of
from .page import FAINT, INK, Page, Rect

_MINUTES = 2  # between points of a path


class SunPath(NamedTuple):
    """A day whose path is drawn."""

    day: date
    name: str
    colour: str
    dashes: Any = "-"  # of matplotlib, so that paths differ in print without colours


SEASONS = (
    SunPath(date(2026, 6, 21), "sun on 21 June", "#d1495b"),
    SunPath(date(2026, 3, 20), "sun on 20 March", "#b87400", (0, (5, 1.5))),
    SunPath(date(2026, 12, 21), "sun on 21 December", "#2f6690", (0, (1.5, 1.2))),
)
"""The solstices and the equinox of March."""


def polar_axes(page: Page, at: Rect) -> Any:
    """Axes of a diagram in a rectangle, with the directions of the compass and circles of elevation."""
    side = min(at.width, at.height)
    square = Rect(at.left + (at.width - side) / 2.0, at.bottom + (at.height - side) / 2.0, side, side)
    inner = Rect(square.left + 7.0, square.bottom + 7.0, side - 14.0, side - 14.0)
    axes: Any = page.axes(inner, projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_rlim(0.0, 90.0)
    axes.set_thetagrids(range(0, 360, 45), ["N", "NE", "E", "SE", "S", "SW", "W", "NW"], color=INK, fontsize=8)
    axes.set_rgrids([30, 60, 90], ["60°", "30°", "0°"], angle=22.5, fontsize=6, color=FAINT)
    axes.tick_params(pad=1)
    axes.grid(color="#d5d7db", linewidth=0.5)
    return axes


def sun_path(place: Place, day: date) -> NDArray[np.float64]:
    """(n, 2) float64, degrees: azimuths and elevations of the sun above the horizon, from solar midnight of a day."""
    midnight = datetime.combine(day, time(), UTC) - timedelta(hours=place.longitude / 15.0)
    start = np.datetime64(midnight.replace(tzinfo=None), "s")
    elevation, azimuth = solar_angles(place, start + np.arange(0, 24 * 60 + 1, _MINUTES) * np.timedelta64(60, "s"))
    above = elevation >= 0.0
    return np.stack([azimuth[above], elevation[above]], 1)


def draw_paths(axes: Any, place: Place, paths: Sequence[SunPath]) -> None:
    """Draw the paths of days, with the full hours of the place's time zone."""
    for each in paths:
        path = sun_path(place, each.day)
        style = {"color": each.colour, "linewidth": 1.4, "linestyle": each.dashes}
        axes.plot(np.radians(path[:, 0]), 90.0 - path[:, 1], **style)
        _draw_hours(axes, place, each)


def _draw_hours(axes: Any, place: Place, path: SunPath) -> None:
    zone = zone_of(place)
    hours = [datetime.combine(path.day, time(hour), zone).astimezone(UTC) for hour in range(24)]
    instants = np.array([hour.replace(tzinfo=None) for hour in hours], "datetime64[s]")
    elevation, azimuth = solar_angles(place, instants)
    for hour in np.flatnonzero(elevation > 0.0).tolist():
        at = np.radians(azimuth[hour]), 90.0 - elevation[hour]
        axes.plot(*at, marker="o", markersize=2.2, color=path.colour)
        axes.annotate(str(hour), at, (0, 2.5), textcoords="offset points", fontsize=6, ha="center", color=path.colour)
