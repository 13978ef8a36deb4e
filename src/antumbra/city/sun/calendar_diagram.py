"""The sheet of a calendar: the first and the last sun of each day, and a table of all days."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sheets.map_frame import MapFit
from ..sheets.page import FAINT, Column, Page
from ..sheets.sheet import Report
from ..sheets.sheet_options import Sheet
from ..sheets.sheet_tables import SheetTable

_SUN, _EDGE, _GRID = "#f2c14e", "#d1495b", "#e1e3e7"
_DASHES = (0, (4, 3))


def calendar_report(calendar: Any, point: int) -> Report:
    """The content of the sheet of a point of a `SunCalendar`."""
    heading = f"First and last sun, point {calendar.names[point]}"
    facts = [("point", ", ".join(f"{x:.9g}" for x in calendar.points[point])), ("days", f"{len(calendar.days):,}")]
    draw = partial(_draw_diagram, calendar, point)
    return Report(heading, calendar.about, draw, tables=lambda: [_table(calendar, point)], counts=facts)


def clock_texts(times: NDArray[np.datetime64]) -> list[str]:
    """Times of day as texts; empty for NaT."""
    return ["" if text == "NaT" else text[11:] for text in np.datetime_as_string(times, unit="s").tolist()]


def _draw_diagram(calendar: Any, point: int, page: Page, fit: MapFit | None, sheet: Sheet) -> None:
    layout, days = page.layout, calendar.days
    axes = page.axes(layout.map._replace(left=layout.map.left + 6.0, width=layout.map.width - 6.0))
    first, last = (_hours(each[point], days) for each in (calendar.first, calendar.last))
    axes.fill_between(days, first, last, color=_SUN, linewidth=0)
    for times in calendar.sunrise, calendar.sunset:
        axes.plot(days, _hours(times[point], days), color=FAINT, linewidth=1.0, linestyle=_DASHES)
    for hours in first, last:
        axes.plot(days, hours, color=_EDGE, linewidth=1.2)
    axes.set(xlim=(days[0], days[-1] + np.timedelta64(1, "D")), ylim=(0, 24), yticks=range(0, 25, 2))
    axes.tick_params(labelsize=8)
    axes.grid(color=_GRID, linewidth=0.6)
    panel = Column(page, layout.panel)
    panel.lines(f"local time, {calendar.about['timezone'] or 'zone of the longitude'}", 10, weight="bold")
    panel.gap(1.5)
    panel.key(_SUN, "sun at the point, if no cloud hides it")
    panel.line_key(_EDGE, "-", "first and last sun")
    panel.line_key(FAINT, _DASHES, "over an open horizon")
    panel.next_part()
    panel.facts(_facts(calendar, point))


def _hours(times: NDArray[np.datetime64], days: NDArray[np.datetime64]) -> NDArray[np.float64]:
    """Hours since midnight; NaN for NaT."""
    since = (times - days).astype("timedelta64[s]")
    return np.where(np.isnat(since), np.nan, since.astype(np.int64) / 3600.0)


def _facts(calendar: Any, point: int) -> list[tuple[str, str]]:
    hours, dark = calendar.hours[point], np.isnat(calendar.first[point])
    facts = [("scene", calendar.about["scene"]), ("days without sun", f"{int(dark.sum()):,} of {len(dark):,}")]
    return [*facts, ("sun on all days", f"{hours.sum():,.1f} h")]


def _table(calendar: Any, point: int) -> SheetTable:
    """The times of each day."""
    times = [clock_texts(each[point]) for each in (calendar.sunrise, calendar.first, calendar.last, calendar.sunset)]
    hours = [f"{each:.2f}" for each in calendar.hours[point]]
    rows = list(zip(np.datetime_as_string(calendar.days).tolist(), *times, hours))
    columns = ("day", "sunrise", "first sun", "last sun", "sunset", "hours")
    return SheetTable("Sun of each day", columns, rows, frozenset((5,)), note="Local times; empty: no sun.")
