"""Pages of sheets, in millimetres from their lower left corner: heading, map, panel of keys and facts, title block.

The same content gives the same bytes.
"""

import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...base.extras import import_extra
from ...base.files import atomic_output, checked_output
from ...version import VERSION
from .page_text import FONT, MM_PER_POINT, fitted_lines, line_height, wrapped
from .sheet_options import PAPERS, Sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAP_SUFFIXES = (".pdf", ".png", ".svg")
"""Suffixes of map sheets."""

DPI = 200
"""Of .png, and of pictures in .pdf and .svg."""

INK, FAINT, RULE = "#202124", "#5f6368", "#b9bcc2"
"""Colours of text, of names and of lines."""

INCH = 25.4
"""Millimetres."""

_MARGIN = 10.0
_HEADER = 12.0  # height of the heading
_STRIP = 11.0  # height of the title block
_BELOW_MAP = 15.0  # for the coordinates and the scale bar
_BESIDE_MAP = 5.0  # for the coordinates
_GAP = 6.0
_OTHER_FONTS = "Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans", "Arial Unicode MS", "Microsoft YaHei", "PingFang SC"
_SEED = "antumbra"  # of the ids in .svg
_TITLES = ((16.0, 1), (14.0, 1), (12.0, 1), (10.0, 2), (8.0, 2), (6.5, 2))
_CELLS = ((9.0, 1), (8.0, 1), (7.0, 1), (7.0, 2), (6.0, 2), (5.0, 3))


def check_map(path: str | os.PathLike[str]) -> Path:
    """The path of a map sheet, checked before long work: its suffix, and that matplotlib is installed.

    Raises
    ------
    InputError
        If the suffix is unknown, the path cannot be written, or matplotlib is missing.
    """
    target = checked_output(path, MAP_SUFFIXES)
    import_extra("matplotlib", "a map sheet", "plot")
    return target


# --- Layout -----------------------------------------------------------------------------------------------------------


class Rect(NamedTuple):
    """A rectangle on a page, in millimetres."""

    left: float
    bottom: float
    width: float
    height: float

    @property
    def right(self) -> float:
        return self.left + self.width

    @property
    def top(self) -> float:
        return self.bottom + self.height


class Layout(NamedTuple):
    """The parts of a page, in millimetres."""

    paper: str  # such as "A4 landscape"
    width: float
    height: float
    map: Rect  # the frame of the map
    panel: tuple[Rect, ...]  # columns of keys and facts
    body: Rect  # of pages without a map
    strip: Rect  # the title block


def layout_of(paper: str, landscape: bool) -> Layout:
    """The layout of a paper of `PAPERS`."""
    width, height = sorted(PAPERS[paper], reverse=landscape)
    large = max(width, height) > 350.0
    strip = Rect(_MARGIN, _MARGIN, width - 2.0 * _MARGIN, _STRIP)
    body = Rect(_MARGIN, strip.top + 4.0, strip.width, height - _MARGIN - _HEADER - strip.top - 4.0)
    left, bottom = body.left + _BESIDE_MAP, body.bottom + _BELOW_MAP
    if landscape:
        panel = 86.0 if large else 68.0
        frame = Rect(left, bottom, body.right - panel - _GAP - left, body.top - bottom)
        columns: tuple[Rect, ...] = (Rect(body.right - panel, body.bottom, panel, body.height),)
    else:
        panel, count = (70.0, 3) if large else (58.0, 2)
        part = (body.width - (count - 1) * _GAP) / count
        columns = tuple(Rect(body.left + k * (part + _GAP), body.bottom, part, panel) for k in range(count))
        bottom += panel
        frame = Rect(left, bottom, body.right - left, body.top - bottom)
    return Layout(
        f"{paper.title()} {'landscape' if landscape else 'portrait'}", width, height, frame, columns, body, strip
    )


# --- Pages ------------------------------------------------------------------------------------------------------------


class Page:
    """A page: a figure of matplotlib whose places are in millimetres."""

    def __init__(self, layout: Layout):
        from matplotlib.figure import Figure

        self.layout = layout
        self.figure: Figure = Figure(figsize=(layout.width / INCH, layout.height / INCH), facecolor="white")

    def text(self, x: float, y: float, text: str, size: float, **style: Any) -> Any:
        """Write a line of text whose baseline begins at a place."""
        given = {"color": INK, "va": "baseline", "parse_math": False, **style}
        return self.figure.text(x / self.layout.width, y / self.layout.height, text, fontsize=size, **given)

    def axes(self, at: Rect, **more: Any) -> "Axes":
        """New axes in a rectangle."""
        width, height = self.layout.width, self.layout.height
        return self.figure.add_axes((at.left / width, at.bottom / height, at.width / width, at.height / height), **more)

    def line(
        self, x: Sequence[float], y: Sequence[float], colour: str = RULE, width: float = 0.5, dashes: Any = "-"
    ) -> None:
        """Draw a line; `width`: in points."""
        from matplotlib.lines import Line2D

        xs, ys = [each / self.layout.width for each in x], [each / self.layout.height for each in y]
        style: dict[str, Any] = {"color": colour, "linewidth": width, "linestyle": dashes, "solid_capstyle": "butt"}
        self.figure.add_artist(Line2D(xs, ys, transform=self.figure.transFigure, **style))

    def box(self, at: Rect, colour: Any, edge: str = FAINT, line: float = 0.4, hatch: str = "") -> None:
        """Draw a filled or hatched rectangle."""
        from matplotlib.patches import Rectangle

        width, height = self.layout.width, self.layout.height
        patch = Rectangle(
            (at.left / width, at.bottom / height), at.width / width, at.height / height, facecolor=colour,
            edgecolor=edge, linewidth=line, hatch=hatch or None, transform=self.figure.transFigure,
        )  # fmt: skip
        self.figure.add_artist(patch)

    def heading(self, title: str) -> None:
        """Write the heading."""
        body = self.layout.body
        size, lines = fitted_lines(title, "the title", body.width, _TITLES, bold=True)
        for k, line in enumerate(lines):
            y = body.top + 4.0 + (len(lines) - 1 - k) * line_height(size)
            self.text(body.left, y, line, size, weight="bold")

    def title_block(self, sheet: Sheet, scale: str, number: int, count: int) -> None:
        """Draw the title block: project, author, date, scale, paper and the number of the page."""
        strip = self.layout.strip
        fixed = [("date", str(sheet.date), 24.0)] if sheet.date else []
        fixed += [("scale", f"{scale}, {self.layout.paper.split()[0]}", 46.0)] if scale else []
        fixed += [("page", f"{number} of {count}", 17.0)] if count > 1 else []
        fixed.append(("made with", f"Antumbra {VERSION}", 34.0))
        free = [(name, text, share) for name, text, share in
                (("project", sheet.project, 2.0), ("author", sheet.author, 1.2)) if text]  # fmt: skip
        room, total = strip.width - sum(width for _, _, width in fixed), sum(share for _, _, share in free)
        cells = [(name, str(text), room * share / total) for name, text, share in free] + fixed
        left = strip.left
        self.line((left, strip.right), (strip.top, strip.top))
        for k, (name, text, width) in enumerate(cells):
            if k:
                self.line((left, left), (strip.bottom, strip.top))
            pad = 2.0 if k else 0.0
            self.text(left + pad, strip.top - 3.4, name, 6, color=FAINT)
            size, lines = fitted_lines(text, f"the {name}", width - pad - 1.0, _CELLS)
            for row, line in enumerate(lines):
                y = strip.top - (7.4 if len(lines) == 1 else 6.2) - row * line_height(size) * 0.9
                self.text(left + pad, y, line, size)
            left += width


def save_pages(path: Path, pages: Iterable[Page], title: str, author: str | None = None) -> None:
    """Write pages: all to a .pdf file, whose text can be selected; .svg and .png files hold the first."""
    from matplotlib.backends.backend_pdf import PdfPages

    suffix = path.suffix.lower()
    with atomic_output(path) as temporary, open(temporary, "wb") as file:
        if suffix == ".pdf":
            about: dict[str, Any] = {"Title": title, "Author": author, "CreationDate": None}
            with PdfPages(file, metadata={k: v for k, v in about.items() if v or k == "CreationDate"}) as book:
                for page in pages:
                    book.savefig(page.figure, dpi=DPI)
            return
        metadata: dict[str, Any] = {"Date": None} if suffix == ".svg" else {}
        next(iter(pages)).figure.savefig(file, format=suffix[1:], dpi=DPI, metadata=metadata)


@contextmanager
def fonts() -> Iterator[None]:
    """The context in which pages are made and written: fixed fonts and ids, and text that stays text."""
    from matplotlib import rc_context

    settings: Any = {
        "svg.hashsalt": _SEED, "svg.fonttype": "none", "pdf.fonttype": 42, "font.family": _families(),
        "axes.unicode_minus": True, "path.simplify": False, "text.usetex": False, "text.parse_math": False,
    }  # fmt: skip
    with rc_context(settings), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)  # `missing_letters` tells them together
        yield


def _families() -> list[str]:
    """The font, and those installed that have letters which it lacks."""
    from matplotlib import font_manager

    installed = {each.name for each in font_manager.fontManager.ttflist}
    return [FONT, *(name for name in _OTHER_FONTS if name in installed)]


def missing_letters(pages: Iterable[Page]) -> list[str]:
    """Letters of pages that no font has, and that are drawn as boxes, in order."""
    from matplotlib import font_manager

    known = set[int]()
    for family in _families():
        known |= font_manager.get_font(font_manager.findfont(family)).get_charmap().keys()
    from matplotlib.text import Text

    texts: list[Any] = [text for page in pages for text in page.figure.findobj(Text)]
    return sorted({letter for text in texts for letter in text.get_text() if ord(letter) not in known} - {"\n"})


# --- Columns of keys and facts ----------------------------------------------------------------------------------------


class TextColumn:
    """Rows written down one or several rectangles of a page, one after the other."""

    def __init__(self, page: Page, places: Sequence[Rect]):
        self.page = page
        self._places = list(places)
        self._at = self._places.pop(0)
        self._top = self._at.top

    @property
    def width(self) -> float:
        return self._at.width

    def take(self, height: float) -> Rect | None:
        """The next rows of a height, in the next rectangle if this one is full; None: no room is left."""
        while self._top - height < self._at.bottom:
            if not self._places:
                return None
            self._at = self._places.pop(0)
            self._top = self._at.top
        self._top -= height
        return Rect(self._at.left, self._top, self._at.width, height)

    def gap(self, height: float) -> None:
        """Leave some room, unless the rectangle is full."""
        self._top -= min(height, self._top - self._at.bottom)

    def next_part(self) -> None:
        """Go on in the next rectangle, or below a gap if this is the last one."""
        if self._places:
            self._at = self._places.pop(0)
            self._top = self._at.top
        else:
            self.gap(2.0)

    def lines(self, text: str, size: float, **style: Any) -> bool:
        """Write a wrapped text, and return whether it fitted."""
        rows = wrapped(text, size, self.width, style.get("weight") == "bold")
        at = self.take(len(rows) * line_height(size))
        if at is None:
            return False
        for k, row in enumerate(rows):
            self.page.text(at.left, at.top - k * line_height(size) - size * MM_PER_POINT, row, size, **style)
        return True

    def key(self, colour: Any, text: str, marker: str = "") -> None:
        """A colour and its meaning; `marker`: the shape of the marks that have it, or a hatch; else a rectangle."""
        rows = wrapped(text, 8.5, self.width - 9.0)
        at = self.take(max(len(rows) * line_height(8.5), 4.2) + 1.2)
        if at is None:
            return
        box = Rect(at.left, at.top - 4.0, 6.5, 3.6)
        if marker and not set(marker) <= set("/."):
            self._mark(box, colour, marker)
        else:
            self.page.box(box, colour, hatch=marker)
        for k, row in enumerate(rows):
            self.page.text(at.left + 9.0, at.top - 3.3 - k * line_height(8.5), row, 8.5)

    def _mark(self, at: Rect, colour: Any, marker: str) -> None:
        from matplotlib.lines import Line2D

        x, y = (
            (at.left + at.width / 2.0) / self.page.layout.width,
            (at.bottom + at.height / 2.0) / self.page.layout.height,
        )
        style: dict[str, Any] = {"markersize": 7.0, "markeredgecolor": INK, "markeredgewidth": 0.5, "linestyle": "none"}
        figure = self.page.figure
        figure.add_artist(Line2D([x], [y], marker=marker, color=colour, transform=figure.transFigure, **style))

    def line_key(self, colour: str, dashes: Any, text: str) -> None:
        """A line of a colour and with dashes, and its meaning."""
        at = self.take(5.2)
        if at is not None:
            y = at.top - 2.4
            self.page.line((at.left, at.left + 6.5), (y, y), colour, 1.4, dashes)
            self.page.text(at.left + 9.0, at.top - 3.3, text, 8.5)

    def fact(self, name: str, text: str) -> bool:
        """A name and a text below it; return whether they fitted."""
        rows = wrapped(text, 8.0, self.width)
        height = line_height(6.5) + len(rows) * line_height(8.0) + 1.2
        at = self.take(height)
        if at is None:
            return False
        y = at.top - 6.5 * MM_PER_POINT
        self.page.text(at.left, y, name, 6.5, color=FAINT)
        for k, row in enumerate(rows):
            self.page.text(at.left, y - (k + 1) * line_height(8.0), row, 8.0)
        return True

    def facts(self, facts: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
        """Facts, in order, as long as there is room; returns those that did not fit."""
        rest = list(facts)
        while rest and self.fact(*rest[0]):
            rest.pop(0)
        return rest
