"""Pages of sheets: their texts, and the boxes of these in millimetres."""

import antumbra as at
from antumbra.city.sheets.page import INCH, fonts
from antumbra.city.sheets.sheet import report_pages
from antumbra.city.tables.map_sheet import table_report


def pages_of(report, **fields):
    """All pages of a report, as figures."""
    with fonts():
        return [page.figure for page in report_pages(report, at.Sheet(**fields))]


def map_of(report, **fields):
    """The first page of a report, as a figure; its first axes are those of the map."""
    with fonts():
        return report_pages(report, at.Sheet(**fields), whole=False)[0].figure


def table_pages_of(table, column, **fields):
    """All pages of the sheet of a table, as figures."""
    return pages_of(table_report(table, column, at.Sheet(**fields)), **fields)


def table_map(table, column, **fields):
    """The map of a table, as a figure."""
    return map_of(table_report(table, column, at.Sheet(**fields)), **fields)


def texts(figure):
    """All texts of a page, with those of ticks."""
    there = [each.get_text() for each in figure.texts]
    for axes in figure.axes:
        there += [each.get_text() for each in (*axes.texts, *axes.get_xticklabels())]
    return there


def words(figure):
    """All texts of a page in one, with single spaces: lines that were divided are joined."""
    return " ".join(" ".join(texts(figure)).split())


def boxes(figure, axes=True):
    """The box of each text of a page that is not empty, in millimetres: (text, left, bottom, right, top)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()
    found = list(figure.texts)
    if axes:
        for each in figure.axes:
            found += [*each.texts, *each.get_xticklabels()]
    out = []
    for text in found:
        if text.get_text().strip():
            box = text.get_window_extent(renderer)
            out.append((text.get_text(), *(value / figure.dpi * INCH for value in (box.x0, box.y0, box.x1, box.y1))))
    return out
