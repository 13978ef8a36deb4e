"""The legend of a map and the facts beside it: keys with their shares, a bar that ends at the extremes, the study."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...base.wording import counted, percent, some_of
from ..sheets.method_facts import above_text, minutes_text, place_facts, unit_of
from ..sheets.page import FAINT, Rect, TextColumn
from ..sheets.units_text import area_text, unit_text
from .map_scale import MapScale, map_scale

HATCH = "////"
"""Of what has no value: no colour of a scale looks like it."""

GAIN_HATCH, GAIN_MARKER = "....", "D"
"""Of gains, in maps of losses, for print without colours."""

CLASS_MARKERS = "s", "o"
"""Shapes of points of no and yes, for print without colours."""

END_MARKERS = "^", "o"
"""Shapes of the observers and the targets of lines of sight."""

LINES: dict[bool, tuple[str, Any]] = {True: ("#2b8a5a", "-"), False: ("#b03a1a", (0, (2.5, 1.5)))}
"""Whether a line of sight is free -> its colour and dashes."""

MOST_MARKS = 30
"""Marks that have labels."""

_MARKS = {"viewshed": "observer", "visible share": "target"}
_MOST_COUNTS = 8  # greatest whole number of a legend with a key for each
_MOST_AREAS = 12
_MOST_CHANGES = 4


class SightLine(NamedTuple):
    """A line of sight in plan."""

    begin: tuple[float, float]
    end: tuple[float, float]
    visible: bool
    begin_name: str = ""
    end_name: str = ""


# --- Scales -----------------------------------------------------------------------------------------------------------


def scale_of(table: Any, column: str) -> MapScale:
    """The scale of a column of a `Table` or of `TableBlocks`; of values before and after a change, the same one."""
    name = column.removesuffix("_before")
    twin, totals = name if name != column else f"{name}_before", table.totals
    chosen, extremes = totals[column], [totals[column]]
    if twin in totals and chosen.dtype.kind in "iuf":
        extremes.append(totals[twin])
    ends = np.array([x for each in extremes for x in (each.low, each.high)])
    known = np.isfinite(ends)
    values = np.where(known, ends, 0.0).astype(chosen.dtype)
    return map_scale(values, known, chosen.unit, column, yes_or_no=len(extremes) == 1 and is_seen(table, column))


def is_seen(table: Any, column: str) -> bool:
    """Whether a column says whether a single observer sees each sensor, 0 or 1."""
    return column == "seen" and table.about.get("observers") == 1


# --- The legend -------------------------------------------------------------------------------------------------------


def shows_points(table: Any) -> bool:
    """Whether a map shows the sensors of a `Table` as single points."""
    return table.sensors.kind == "points" and table.row_of_face is None


def draw_legend(panel: TextColumn, table: Any, scale: MapScale, values: np.ndarray, lines: list[SightLine]) -> None:
    """Draw the legend: classes with their shares, or a bar that ends at the extremes, and the median."""
    known = np.isfinite(values)
    if lines:
        _draw_line_keys(panel, lines)
    elif scale.classes:
        markers = CLASS_MARKERS if shows_points(table) else ("",) * len(scale.classes)
        _draw_keys(panel, table, [(each.value, each.name) for each in scale.classes], markers, scale, values)
    elif scale.whole and scale.low == 0.0 < scale.high <= _MOST_COUNTS:
        counts = [(float(k), str(k)) for k in range(int(scale.high) + 1)]
        _draw_keys(panel, table, counts, ("",) * len(counts), scale, values)
    else:
        _draw_bar(panel, scale)
        if known.any():
            unit = unit_text(scale.unit)
            least, middle, most = (_number(scale, float(x)) for x in np.percentile(values[known], (0, 50, 100)))
            panel.lines(f"{least} to {most}{f' {unit}' if unit else ''}, median {middle}", 8, color=FAINT)
    if scale.diverging:
        panel.lines("positive: lost; negative: gained", 8, color=FAINT)
        if (values[known] < 0.0).any():
            panel.gap(1.0)
            colour = tuple((scale.colours(np.array([scale.low]))[0] / 255.0).tolist())
            panel.key(colour, "gained", GAIN_MARKER if shows_points(table) else GAIN_HATCH)
    if not known.all() and not lines:
        panel.gap(1.0)
        panel.key("white", "no value", "x" if shows_points(table) else HATCH)
    if table.marks is not None and len(table.marks):
        name = _kind_of_marks(table)
        numbered = 1 < len(table.marks) <= MOST_MARKS and "targets" not in table.about
        panel.key("white", name + "s" * (len(table.marks) > 1) + ", by number" * numbered, "^")


def _kind_of_marks(table: Any) -> str:
    return "turbine" if "targets" in table.about else _MARKS.get(str(table.about.get("job")), "mark")


def mark_labels(table: Any) -> list[str]:
    """The labels of a table's marks: names of turbines, which their columns have; or the numbers in its columns."""
    return list(table.about.get("targets", map(str, range(len(table.marks)))))


def _number(scale: MapScale, value: float) -> str:
    return scale._replace(unit="").text(value)


def _draw_bar(panel: TextColumn, scale: MapScale) -> None:
    """Draw the colours of a scale above its numbers."""
    at = panel.take(11.0)
    if at is None:
        return
    axes: Any = panel.page.axes(Rect(at.left + 3.0, at.top - 5.0, at.width - 8.0, 5.0))
    low, high = scale.low, scale.high if scale.span else scale.low + 1.0
    colours = scale.colours(np.linspace(low, scale.high, 512))[None]
    axes.imshow(colours, aspect="auto", extent=(low, high, 0.0, 1.0), interpolation="nearest")
    ticks = scale.ticks()
    axes.set_xticks(ticks, [_number(scale, x) for x in ticks], fontsize=7)
    axes.tick_params(length=2, width=0.4, pad=1.5)
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(color=FAINT, linewidth=0.4)


def _draw_keys(
    panel: TextColumn,
    table: Any,
    named: list[tuple[float, str]],
    markers: Sequence[str],
    scale: MapScale,
    values: np.ndarray,
) -> None:
    """Draw a key per value, with its share of the sensors, and its area where sensors have one."""
    areas, unit, known = table.sensors.areas, unit_of(table.about), np.isfinite(values)
    what = _rows_name(table) if table.sensors.raster is None else "cells"
    for marker, (value, name) in zip(markers, named):
        rows = values == value
        text = f"{name}: {percent(rows[known].mean())} of the {what}" if known.any() else name
        if known.any() and areas is not None:
            text += f", {area_text(float(areas[rows].sum()) * unit.square_metres, unit)}"
        panel.key(tuple((scale.colours(np.array([value]))[0] / 255.0).tolist()), text, marker)


def _draw_line_keys(panel: TextColumn, lines: list[SightLine]) -> None:
    for visible, name in ((True, "visible"), (False, "not visible")):
        colour, dashes = LINES[visible]
        count = sum(line.visible == visible for line in lines)
        panel.line_key(colour, dashes, f"{name}: {some_of(count, len(lines), 'line')}")
    for marker, name in zip(END_MARKERS, ("observer", "target")):
        panel.key("white", name, marker)


# --- Facts ------------------------------------------------------------------------------------------------------------


def facts_of(table: Any) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the rule and its areas, the dates, the place, the CRS and the sensors."""
    about = table.about
    if table.scene is not None:
        yield "scene", table.scene.name
    for rule in about.get("rules", []):
        yield f"rule {rule['name']}", rule["citation"]
    for text in about.get("change", [])[:_MOST_CHANGES]:
        yield "change", text
    for area in about.get("areas", [])[:_MOST_AREAS]:
        yield f"area {area['name']}", _area_text(area)
    if "first" in about and "last" in about:
        yield "dates", f"{minutes_text(about['first'])} to {minutes_text(about['last'])}"
        yield "sun", f"{counted(about['suns'], 'position')}, {about['hours']:,.4g} h {above_text(about)}"
    if about.get("observers"):
        yield "observers", f"{about['observers']:,}"
    yield from place_facts(about)
    yield sensor_fact(table)


def sensor_fact(table: Any) -> tuple[str, str]:
    """The number and the kind of the sensors, or of the rows that stand for groups of them."""
    sensors = table.sensors
    if table.about.get("per"):
        return _rows_name(table), f"{len(table):,}"
    cell = "" if sensors.raster is None else f", cells of {sensors.raster.spacing:g} {unit_of(table.about).name}"
    return "sensors", f"{len(sensors):,} ({sensors.kind}{cell})"


def _rows_name(table: Any) -> str:
    """What the rows of a `Table` stand for, in the plural."""
    return f"{table.about.get('per') or 'sensor'}s"


def mark_facts(table: Any) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the positions of the table's marks, if they are few."""
    marks = [] if table.marks is None or len(table.marks) > MOST_MARKS else table.marks.tolist()
    name, unit = _kind_of_marks(table), unit_of(table.about).name
    for label, mark in zip(mark_labels(table) if marks else [], marks):
        yield name if len(marks) == 1 else f"{name} {label}", f"{', '.join(f'{x:.10g}' for x in mark)} {unit}"


def _area_text(area: dict[str, Any]) -> str:
    if area.get("sun_hours") is None:
        return "no cells"
    text = f"mean {area['sun_hours']:.1f} h{_former(area, 'sun_hours_before', 1.0, ' h')}"
    if area.get("share") is not None:
        share = f"{percent(area['share'])} of the cells{_former(area, 'share_before', 100.0, ' %')}"
        text += f"; {share}: {'passes' if area['passes'] else 'fails'}"
    return text


def _former(area: dict[str, Any], name: str, factor: float, unit: str) -> str:
    """The former value of an area, in parentheses."""
    return "" if area.get(name) is None else f" (before: {factor * area[name]:.1f}{unit})"
