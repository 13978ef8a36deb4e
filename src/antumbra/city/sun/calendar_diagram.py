"""The sheet of a calendar: the first and the last sun of each day, and a table of all days."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sheets.map_frame import MapFit
from ..sheets.method_facts import place_facts, unit_of
from ..sheets.page import FAINT, Page, TextColumn
from ..sheets.sheet import SheetContent
from ..sheets.sheet_options import Sheet
from ..sheets.sheet_tables import SheetTable

_SUN, _GRID = "#f2c14e", "#e1e3e7"
_OPEN: dict[str, Any] = {"color": FAINT, "linewidth": 1.0, "linestyle": (0, (4, 3))}
_BEHIND: dict[str, Any] = {"color": "#d1495b", "linewidth": 1.2, "linestyle": "-"}
_DAY = np.timedelta64(1, "D")
_STEPS = 1.5  # by which the hours, from suns a step apart, may differ from the time between the first and the last


def calendar_report(calendar: Any, point: int) -> SheetContent:
    """The content of the sheet of a point of a `SunCalendar`."""
    heading = f"First and last sun, point {calendar.names[point]}"
    draw = partial(_draw_diagram, calendar, point)
    facts = list(_facts(calendar, point))
    return SheetContent(heading, calendar.about, draw, tables=lambda: [_table(calendar, point)], counts=facts)


def clock_texts(times: NDArray[np.datetime64]) -> list[str]:
    """Times of day as texts; empty for NaT."""
    return ["" if text == "NaT" else text[11:] for text in np.datetime_as_string(times, unit="s").tolist()]


def _draw_diagram(calendar: Any, point: int, page: Page, fit: MapFit | None, sheet: Sheet) -> None:
    layout, about = page.layout, calendar.about
    axes = page.axes(layout.map._replace(left=layout.map.left + 8.0, width=layout.map.width - 8.0))
    times = [_hours(each[point], calendar.days) for each in _times(calendar)]
    for run in np.split(np.arange(len(calendar.days)), np.flatnonzero(np.diff(calendar.days) != _DAY) + 1):
        sunrise, first, last, sunset = (np.append(each[run], each[run[-1]]) for each in times)
        days = np.append(calendar.days[run], calendar.days[run[-1]] + _DAY)  # a day is as wide as it lasts
        axes.fill_between(days, first, last, color=_SUN, linewidth=0, step="post")
        for style, edges in ((_OPEN, (sunrise, sunset)), (_BEHIND, (first, last))):
            for hours in edges:
                axes.plot(days, hours, drawstyle="steps-post", **style)
    _draw_axes(axes, calendar.days)
    panel = TextColumn(page, layout.panel)
    panel.lines(f"local time, {about['timezone'] or 'zone of the longitude'}", 10, weight="bold")
    panel.gap(1.5)
    panel.key(_SUN, "from the first to the last sun")
    panel.line_key(_BEHIND["color"], _BEHIND["linestyle"], "first and last sun behind the scene")
    panel.line_key(_OPEN["color"], _OPEN["linestyle"], "sunrise and sunset over an open horizon")
    panel.next_part()
    panel.facts([("scene", about["scene"]), *place_facts(about), *_facts(calendar, point)])


def _draw_axes(axes: Any, days: NDArray[np.datetime64]) -> None:
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    hours = range(0, 25, 2)
    axes.set(xlim=(days[0], days[-1] + _DAY), ylim=(0, 24))
    axes.set_yticks(hours, [f"{hour:02d}:00" for hour in hours])
    places = AutoDateLocator(minticks=3, maxticks=13)
    axes.xaxis.set(major_locator=places, major_formatter=ConciseDateFormatter(places))
    axes.tick_params(labelsize=8)
    axes.grid(color=_GRID, linewidth=0.6)


def _times(calendar: Any) -> tuple[NDArray[np.datetime64], ...]:
    """Those of the sun of each point and day, in the order of a day."""
    return calendar.sunrise, calendar.first, calendar.last, calendar.sunset


def _hours(times: NDArray[np.datetime64], days: NDArray[np.datetime64]) -> NDArray[np.float64]:
    """Hours since midnight; NaN for NaT."""
    since = (times - days).astype("timedelta64[s]")
    return np.where(np.isnat(since), np.nan, since.astype(np.int64) / 3600.0)


def _facts(calendar: Any, point: int) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the position, and the days without sun or with sun that is interrupted."""
    unit = unit_of(calendar.about).name
    yield "point", f"{', '.join(f'{x:.2f}' for x in calendar.points[point])} {unit}"
    days = calendar.days
    yield "days", f"{len(days):,}, {days[0]}" + (f" to {days[-1]}" if len(days) > 1 else "")
    first, last = (_hours(each[point], calendar.days) for each in (calendar.first, calendar.last))
    dark, hours = np.isnan(first), calendar.hours[point]
    yield "days without sun", f"{int(dark.sum()):,} of {len(dark):,}"
    between = np.where(dark, 0.0, last - first)
    hidden = int((between - hours > _STEPS * calendar.about["step"] / 60.0).sum())
    yield "days with interrupted sun", f"{hidden:,}{' (its hours are in the table)' if hidden else ''}"
    yield "hours of sun", f"{hours.sum():,.1f} h"


def _table(calendar: Any, point: int) -> SheetTable:
    """The times of each day."""
    times = [clock_texts(each[point]) for each in _times(calendar)]
    hours = [f"{each:.2f}" for each in calendar.hours[point]]
    rows = list(zip(np.datetime_as_string(calendar.days).tolist(), *times, hours))
    columns = ("day", "sunrise", "first sun", "last sun", "sunset", "hours")
    return SheetTable("Sun of each day", columns, rows, frozenset((5,)), note="Local times; empty: no sun.")
