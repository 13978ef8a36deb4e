"""Sheets for a report: a map or a diagram, tables, the method, and the sources of the data, with one title block."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...scene.units import METRE, LengthUnit
from ...sun.location import Place
from ...sun.sun_positions import suns_of, times_of, zone_of
from ..sensors.point_checks import tell
from .map_frame import Extent, MapFit, fit_map
from .method_facts import SUNLIT, day_of, method_facts, minutes_text, place_in_about, source_facts
from .page import FAINT, Layout, Page, Rect, TextColumn, fonts, layout_of, missing_letters, save_pages
from .sheet_options import Sheet
from .sheet_tables import SheetTable, cell_text, table_pages
from .sun_paths import SEASONS, SunPath, draw_paths, polar_axes

_DIAGRAM = 100.0  # millimetres: largest diagram of the sun on the page of the method
_SAME_PATH = 4  # days
_MOST_SUNS = 400  # listed
_MOST_LETTERS = 8  # without a font, named


@dataclass(frozen=True)
class SheetContent:
    """The content of a sheet.

    heading : the title, unless the sheet has one
    about : metadata of the study
    draw : draws the map or diagram and its keys on the first page; of a diagram, the fit is None
    extent : of the map, with surroundings; None: a diagram without a scale
    core : what the map must show at a given scale; None: the whole extent
    margin : millimetres around the map
    tables : makes the tables
    counts : facts such as the number of sensors
    """

    heading: str
    about: dict[str, Any]
    draw: Callable[[Page, MapFit | None, Sheet], None]
    extent: Extent | None = None
    core: Extent | None = None
    unit: LengthUnit = METRE
    margin: float = 2.0
    tables: Callable[[], Sequence[SheetTable]] = tuple
    counts: Sequence[tuple[str, str]] = ()
    scene: AnyScene | None = None
    place: Place | None = field(default=None)

    def fit(self, sheet: Sheet) -> MapFit | None:
        """The paper and the scale of the map. Raises InputError if the sheet's scale is impossible."""
        if self.extent is not None:
            extent = self.extent if self.core is None or sheet.scale is None else self.core
            return fit_map(extent, self.unit, sheet, self.margin)
        check_diagram(sheet)
        return None


def check_diagram(sheet: Sheet) -> None:
    """Raise an InputError if a sheet has what only maps have."""
    if sheet.scale is not None or sheet.extent is not None:
        raise InputError("the sheet is a diagram without a scale; leave scale and extent out")


def save_report(path: Path, report: SheetContent, sheet: Sheet) -> None:
    """Write the sheet of a report; .svg and .png hold the map alone."""
    with fonts():
        pages = report_pages(report, sheet, path.suffix.lower() == ".pdf")
        if missing := missing_letters(pages):
            letters = f"{' '.join(missing[:_MOST_LETTERS])}{' ...' if len(missing) > _MOST_LETTERS else ''}"
            tell([f"{path.name}: no font has the letters {letters}, which are boxes; install Noto Sans CJK, say"])
        save_pages(path, pages, sheet.title or report.heading, sheet.author)


def report_pages(report: SheetContent, sheet: Sheet, whole: bool = True) -> list[Page]:
    """The pages of a sheet; `whole`: all, not only the map."""
    fit = report.fit(sheet)
    layout = layout_of(sheet.paper, sheet.orientation != "portrait") if fit is None else fit.layout
    chosen = (sheet.pages or ("map", "table", "method", "sources")) if whole else ("map",)
    made = {"map": _map_pages, "table": _table_pages, "method": _method_pages, "sources": _source_pages}
    pages = [page for name in chosen for page in made[name](report, sheet, layout, fit)]
    scale = "" if fit is None else fit.text(report.unit)
    for number, page in enumerate(pages, 1):
        page.heading(sheet.title or report.heading)
        page.title_block(sheet, scale, number, len(pages))
    return pages


def _map_pages(report: SheetContent, sheet: Sheet, layout: Layout, fit: MapFit | None) -> Iterator[Page]:
    page = Page(layout)
    report.draw(page, fit, sheet)
    yield page


def _table_pages(report: SheetContent, sheet: Sheet, layout: Layout, fit: MapFit | None) -> list[Page]:
    return table_pages(layout, list(report.tables()))


def _halves(layout: Layout) -> tuple[Rect, Rect]:
    """Two columns of a page, below the name of the page."""
    body = layout.body
    part = (body.width - 10.0) / 2.0
    height = body.height - 9.0
    return Rect(body.left, body.bottom, part, height), Rect(body.left + part + 10.0, body.bottom, part, height)


def _named_page(layout: Layout, name: str) -> Page:
    page = Page(layout)
    page.text(layout.body.left, layout.body.top - 4.5, name, 12, weight="bold")
    return page


def _fact_pages(layout: Layout, name: str, facts: Sequence[tuple[str, str]], first: tuple[Page, Rect]) -> list[Page]:
    """Pages with facts in two columns. `first`: the first page, and its second column."""
    page, right = first
    rest, pages = TextColumn(page, (_halves(layout)[0], right)).facts(facts), [page]
    while rest:
        page = _named_page(layout, f"{name} (continued)")
        left = TextColumn(page, _halves(layout)).facts(rest)
        if len(left) == len(rest):
            raise InputError(f"{rest[0][0]} is too long for a page of the sheet; choose a larger paper")
        rest = left
        pages.append(page)
    return pages


def _method_pages(report: SheetContent, sheet: Sheet, layout: Layout, fit: MapFit | None) -> list[Page]:
    """The method, the paths of the sun, and the positions of the sun on a single day."""
    page = _named_page(layout, "Method")
    right = _halves(layout)[1]
    place = report.place or place_in_about(report.about)
    if place is not None and report.about.get("job") in SUNLIT:
        right = _draw_diagram(page, right, place, day_of(report.about), report.about)
    facts = list(method_facts(report.about, report.counts))
    if fit is not None:
        facts.insert(-1, ("scale of the map", f"{fit.text(report.unit)}, of the coordinates"))
    pages = _fact_pages(layout, "Method", facts, (page, right))
    suns = None if place is None else sun_table(report.about, place)
    return pages if suns is None else [*pages, *table_pages(layout, [suns])]


def _draw_diagram(page: Page, at: Rect, place: Place, day: date | None, about: dict[str, Any]) -> Rect:
    """Draw the paths of the sun at the top of a column, and return what is left of it."""
    side = min(at.width, at.height * 0.6, _DIAGRAM)
    axes = polar_axes(page, Rect(at.left, at.top - side, side, side))
    shown = list(SEASONS)
    if day is not None:  # instead of a season's path that would hide it
        shown = [each for each in SEASONS if abs((each.day.replace(year=day.year) - day).days) > _SAME_PATH]
        shown.append(SunPath(day, f"sun on {day.day} {day:%B %Y}", "#202124", (0, (6, 1.2, 1.2, 1.2))))
    draw_paths(axes, place, shown)
    y = at.top - side - 3.0
    if "sun_azimuth" in about:
        axes.plot(
            np.radians(about["sun_azimuth"]), 90.0 - about["sun_elevation"], marker="*", markersize=12,
            color="#ffd23f", markeredgecolor="black", markeredgewidth=0.6,
        )  # fmt: skip
        page.text(at.left + 9.0, y - 1.0, f"star: the sun at {minutes_text(about['time'])}", 7)
        y -= 4.5
    for each in shown:
        page.line((at.left, at.left + 7.0), (y, y), each.colour, 1.4, each.dashes)
        page.text(at.left + 9.0, y - 1.0, f"{each.name}, hours of the time zone", 7, color=FAINT)
        y -= 4.5
    return Rect(at.left, at.bottom, at.width, y - 2.0 - at.bottom)


def sun_table(about: dict[str, Any], place: Place) -> SheetTable | None:
    """The positions of the sun in a study of sun hours on a single day; None: it has other days, or very many."""
    day, step = day_of(about), about.get("step")
    if about.get("job") != "sun" or day is None or not isinstance(step, (int, float)) or "first" not in about:
        return None
    suns = suns_of(place, times_of([day], zone_of(place), float(step)), str(about.get("up", "z")))
    if len(suns.hours) != about.get("suns") or len(suns.hours) > _MOST_SUNS:
        return None  # weather left some out, or they fill pages
    rows = [
        (cell_text(when), f"{azimuth:.2f}", f"{altitude:.2f}", f"{60.0 * hours:.4g}")
        for when, azimuth, altitude, hours in zip(suns.local, suns.azimuth, suns.altitude, suns.hours)
    ]
    headers = "local time", "azimuth (degrees)", "elevation (degrees)", "minutes"
    note = "In the middle of each interval; azimuths clockwise from true north; without refraction."
    return SheetTable("Positions of the sun", headers, rows, frozenset((1, 2, 3)), note=note)


def _source_pages(report: SheetContent, sheet: Sheet, layout: Layout, fit: MapFit | None) -> list[Page]:
    page = _named_page(layout, "Data sources")
    facts = list(source_facts(report.about, report.scene, [Path(each) for each in sheet.sources], sheet.licence))
    return _fact_pages(layout, "Data sources", facts, (page, _halves(layout)[1]))
