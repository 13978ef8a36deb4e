"""The sheet of a skyline: a polar diagram of the horizon, with the paths of the sun at the solstices and equinox.

Azimuths run clockwise from true north at the top. The zenith is the centre, the horizontal the rim, and equal steps of
elevation are equally far apart.
"""

from collections.abc import Iterator
from datetime import UTC, date, datetime, time, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...sun.location import Place
from ...sun.sun_positions import solar_angles, zone_of
from ..tables.map_page import FAINT, INK, PICTURE, TOP, draw_caption, draw_facts, draw_key, new_page, place_facts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SOLID, _HIGHEST = "#bcc0c7", "#e1e3e7"
_MINUTES = 2  # between points of a path
_PATHS = (
    (date(2026, 6, 21), "sun on 21 June", "#d1495b"),
    (date(2026, 3, 20), "sun on 20 March", "#e09f3e"),
    (date(2026, 12, 21), "sun on 21 December", "#2f6690"),
)
"""The solstices and the equinox of March."""


def horizon_figure(skyline: Any, point: int, place: Place | None, title: str | None = None) -> "Figure":
    """The sheet of a point of a `Skyline`, as a figure of matplotlib. Without a place, it has no paths of the sun."""
    figure = new_page(title or "Skyline")
    axes: Any = figure.add_axes(PICTURE, projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_rlim(0.0, 90.0)
    axes.set_thetagrids(range(0, 360, 45), ["N", "NE", "E", "SE", "S", "SW", "W", "NW"], color=INK)
    axes.set_rgrids([30, 60, 90], ["60°", "30°", "0°"], angle=22.5, fontsize=8, color=FAINT)
    _fill(axes, skyline.azimuth, skyline.highest[point], _HIGHEST)
    _fill(axes, skyline.azimuth, skyline.elevation[point], _SOLID)
    draw_caption(figure, "elevation of the horizon")
    top = draw_key(figure, _SOLID, "along the azimuth", TOP)
    top = draw_key(figure, _HIGHEST, "highest within half a step", top)
    for day, name, colour in _PATHS if place is not None else ():
        assert place is not None
        _draw_path(axes, sun_path(place, day), colour)
        _draw_hours(axes, place, day, colour)
        top = draw_key(figure, colour, name, top)
    draw_facts(figure, horizon_facts(skyline, point, place), top)
    return figure


def _fill(axes: Any, azimuth: NDArray[np.float64], elevation: NDArray[np.float64], colour: str) -> None:
    """Fill what lies below a horizon, as steps around the azimuths."""
    width = 2.0 * np.pi / len(azimuth)
    height = np.clip(elevation, 0.0, 90.0)
    axes.bar(np.radians(azimuth), height, width, bottom=90.0 - height, color=colour, linewidth=0.4)  # no seams


def sun_path(place: Place, day: date) -> NDArray[np.float64]:
    """(n, 2) float64, degrees: azimuths and elevations of the sun above the horizon, from solar midnight of a day."""
    midnight = datetime.combine(day, time(), UTC) - timedelta(hours=place.longitude / 15.0)
    start = np.datetime64(midnight.replace(tzinfo=None), "s")
    elevation, azimuth = solar_angles(place, start + np.arange(0, 24 * 60 + 1, _MINUTES) * np.timedelta64(60, "s"))
    above = elevation >= 0.0
    return np.stack([azimuth[above], elevation[above]], 1)


def _draw_path(axes: Any, path: NDArray[np.float64], colour: str) -> None:
    axes.plot(np.radians(path[:, 0]), 90.0 - path[:, 1], color=colour, linewidth=1.4)


def _draw_hours(axes: Any, place: Place, day: date, colour: str) -> None:
    """Draw the full hours of the place's time zone on a path."""
    zone = zone_of(place)
    hours = [datetime.combine(day, time(hour), zone).astimezone(UTC) for hour in range(24)]
    instants = np.array([hour.replace(tzinfo=None) for hour in hours], "datetime64[s]")
    elevation, azimuth = solar_angles(place, instants)
    for hour in np.flatnonzero(elevation > 0.0).tolist():
        at = np.radians(azimuth[hour]), 90.0 - elevation[hour]
        axes.plot(*at, marker="o", markersize=2.5, color=colour)
        axes.annotate(str(hour), at, (0, 3), textcoords="offset points", fontsize=7, ha="center", color=colour)


def horizon_facts(skyline: Any, point: int, place: Place | None) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the point, the horizon, the view of the sky, north, and the place."""
    about, azimuth, highest = skyline.about, skyline.azimuth, skyline.highest[point]
    yield "scene", about["scene"]
    yield "point", ", ".join(f"{x:.9g}" for x in skyline.points[point])
    yield "azimuths", f"every {about['step']:g} degrees; true north at {about['north']:.2f}"
    yield "lowest", f"{skyline.elevation[point].min():.2f} degrees"
    yield "highest", f"{highest.max():.2f} degrees, towards {azimuth[highest.argmax()]:g}"
    yield "sky view factor", f"{skyline.sky_view_factor()[point]:.4f} of a level plane"
    fields = {} if place is None else place._asdict()
    yield from place_facts({**fields, **{name: about[name] for name in ("crs", "trees") if name in about}})
