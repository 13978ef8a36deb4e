"""The sheet of a skyline: a polar diagram of the horizon, with the paths of the sun at the solstices and equinox."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.wording import place_text
from ...sun.location import Place
from ..sheets.map_frame import MapFit
from ..sheets.method_facts import place_facts
from ..sheets.page import Page, TextColumn
from ..sheets.sheet import SheetContent
from ..sheets.sheet_options import Sheet
from ..sheets.sheet_tables import SheetTable
from ..sheets.sun_paths import SEASONS, draw_paths, polar_axes

_SOLID, _HIGHEST = "#a9aeb6", "#dcdee2"


def horizon_report(skyline: Any, point: int, place: Place | None) -> SheetContent:
    """The content of the sheet of a point of a `Skyline`. Without a place, it has no paths of the sun."""
    facts = [("point", _point_text(skyline, point)), ("azimuths", f"{len(skyline.azimuth):,}")]
    draw = partial(_draw_diagram, skyline, point, place)
    return SheetContent(
        "Skyline", skyline.about, draw, tables=lambda: [_table(skyline, point)], counts=facts, place=place
    )


def _draw_diagram(skyline: Any, point: int, place: Place | None, page: Page, fit: MapFit | None, sheet: Sheet) -> None:
    layout = page.layout
    diagram = layout.map._replace(bottom=layout.map.bottom - 12.0, height=layout.map.height + 12.0)
    axes = polar_axes(page, diagram)
    _fill(axes, skyline.azimuth, skyline.highest[point], _HIGHEST)
    _fill(axes, skyline.azimuth, skyline.elevation[point], _SOLID)
    panel = TextColumn(page, layout.panel)
    panel.lines("elevation of the horizon", 10, weight="bold")
    panel.gap(1.5)
    panel.key(_SOLID, "along the azimuth")
    panel.key(_HIGHEST, "highest within half a step")
    if place is not None:
        draw_paths(axes, place, SEASONS)
        for each in SEASONS:
            panel.line_key(each.colour, each.dashes, each.name)
    panel.next_part()
    panel.facts(horizon_facts(skyline, point, place))


def _fill(axes: Any, azimuth: NDArray[np.float64], elevation: NDArray[np.float64], colour: str) -> None:
    """Fill what lies below a horizon, as steps around the azimuths."""
    width = 2.0 * np.pi / len(azimuth)
    height = np.clip(elevation, 0.0, 90.0)
    axes.bar(np.radians(azimuth), height, width, bottom=90.0 - height, color=colour, linewidth=0.4)  # no seams


def _table(skyline: Any, point: int) -> SheetTable:
    """The elevations by azimuth."""
    columns = skyline.azimuth, skyline.elevation[point], skyline.highest[point]
    rows = [(f"{azimuth:g}", f"{low:.2f}", f"{high:.2f}") for azimuth, low, high in zip(*columns)]
    note = "In degrees: along each azimuth, and the highest within half a step; azimuths clockwise from true north."
    return SheetTable(
        "Elevation of the horizon", ("azimuth", "elevation", "highest"), rows, frozenset((0, 1, 2)), note=note
    )


def _point_text(skyline: Any, point: int) -> str:
    return place_text(skyline.points[point]).replace(",", ", ")


def horizon_facts(skyline: Any, point: int, place: Place | None) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, the point, the horizon, the view of the sky, north, and the place."""
    about, azimuth, highest = skyline.about, skyline.azimuth, skyline.highest[point]
    yield "scene", about["scene"]
    yield "point", _point_text(skyline, point)
    yield "azimuths", f"every {about['azimuth_step']:g} degrees; true north at {about['north']:.2f}"
    yield "lowest", f"{skyline.elevation[point].min():.2f} degrees"
    yield "highest", f"{highest.max():.2f} degrees, towards {azimuth[highest.argmax()]:g}"
    yield "sky view factor", f"{skyline.sky_view_factor()[point]:.4f} of a level plane"
    fields = {} if place is None else place._asdict()
    yield from place_facts({**fields, **{name: about[name] for name in ("crs", "trees") if name in about}})
