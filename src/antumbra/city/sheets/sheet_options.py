"""The options of a map sheet: its paper, scale and extent, its labels, and what its title block says."""

import datetime
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

from ...base.checks import checked_instance, choice, items, number, parts_of, path_of, quoted, spelling_hint
from ...base.errors import InputError
from ...base.wording import counted

PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4), "tabloid": (279.4, 431.8)}
"""Name -> width and height in millimetres, upright."""

ORIENTATIONS = "auto", "portrait", "landscape"

PAGES = "map", "table", "method", "sources"
"""The pages of a .pdf file; .svg and .png hold the map."""

_TEXTS = "title", "project", "author", "licence"  # one line each
_MOST_LETTERS = 300
_SCALE = re.compile(r"(?:1\s*:\s*)?([0-9][0-9,_]*(?:\.[0-9]+)?)")
_LARGEST = 1e9  # scale denominator


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """The options of a map sheet.

    Parameters
    ----------
    title : str, optional
        None: what the sheet shows.
    project, author : str, optional
        For the title block.
    date : str or datetime.date, optional
        For the title block, as it is written there; "today" is the date of today. None: no date, so that the same
        result gives the same file.
    licence : str, optional
        Of the data, for the page of sources.
    paper : str
        "a4", "a3", "letter" or "tabloid".
    orientation : str
        "portrait", "landscape", or "auto": whichever shows the map larger.
    scale : str or float, optional
        Such as "1:500", or 500. None: the largest round scale at which the map fits.
    extent : (4,) float, optional
        West, south, east and north of the map, in coordinates of the scene. None: all values, with the surroundings of
        single points.
    labels : str, optional
        The column of labels beside points; "none": no labels. None: the first of the columns id, name, label, window
        and site that the user's table has.
    pages : sequence of str, optional
        Of a .pdf file: "map", "table", "method" and "sources". None: all.
    sources : sequence of path-like
        Files that the result was made from, for the page of sources, which lists their sizes and SHA-256 digests.
        Commands add the files of their arguments.

    Raises
    ------
    InputError
        If a value is invalid.
    """

    title: str | None = None
    project: str | None = None
    author: str | None = None
    date: str | datetime.date | None = None
    licence: str | None = None
    paper: str = "a4"
    orientation: str = "auto"
    scale: str | float | None = None
    extent: Sequence[float] | None = None
    labels: str | None = None
    pages: Sequence[str] | None = None
    sources: Sequence[str | os.PathLike[str]] = ()

    def __post_init__(self) -> None:
        for name in _TEXTS:
            _check_line(getattr(self, name), name)
        when = self.date
        if isinstance(when, str) and when == "today":
            when = datetime.date.today()
        when = when.isoformat() if isinstance(when, datetime.date) else when
        _check_line(when, "date")
        self._set("date", when)
        for name, known in (("paper", tuple(PAPERS)), ("orientation", ORIENTATIONS)):
            value = getattr(self, name)
            self._set(name, choice(value.lower() if isinstance(value, str) else value, name, known))
        self._set("scale", None if self.scale is None else _checked_scale(self.scale))
        self._set("extent", None if self.extent is None else _checked_extent(self.extent))
        if self.labels is not None and not isinstance(self.labels, str):
            raise InputError(f"labels is {quoted(self.labels)}; it must be the name of a column, or none")
        self._set("pages", None if self.pages is None else _checked_pages(self.pages))
        sources = parts_of(self.sources)
        names = [self.sources] if sources is None else sources
        self._set("sources", tuple(path_of(each, "a source") for each in names))

    def _set(self, name: str, value: object) -> None:
        """Set a field during initialization, since the class is frozen."""
        object.__setattr__(self, name, value)

    @property
    def denominator(self) -> float | None:
        """N of the scale 1:N; None: to be chosen."""
        assert not isinstance(self.scale, str)
        return self.scale


def checked_sheet(sheet: Sheet | None, title: str | None = None) -> Sheet:
    """A `Sheet`, with another title if one is given; None: the default one. Raises InputError for anything else."""
    chosen = Sheet() if sheet is None else checked_instance(sheet, Sheet, "sheet")
    return chosen if title is None else replace(chosen, title=title)


def _check_line(value: object, name: str) -> None:
    if value is None:
        return
    if not isinstance(value, str) or "\n" in value or not value.strip():
        raise InputError(f"{name} is {quoted(value)}; give one line of text, or leave it out")
    if len(value) > _MOST_LETTERS:
        raise InputError(f"{name} has {counted(len(value), 'character')}; give at most {_MOST_LETTERS}")


def _checked_scale(scale: object) -> float:
    """N of 1:N."""
    if isinstance(scale, str):
        match = _SCALE.fullmatch(scale.strip())
        if match is None:
            raise InputError(f"scale is {quoted(scale)}; write 1:N, such as 1:500")
        scale = float(match[1].replace(",", "").replace("_", ""))
    return number(scale, "scale (N of 1:N)", 0.0, _LARGEST)


def _checked_extent(extent: object) -> tuple[float, float, float, float]:
    parts = parts_of(extent)
    if parts is None or len(parts) != 4:
        raise InputError(f"extent is {quoted(extent)}; it must be west, south, east and north")
    west, south, east, north = (number(each, "extent") for each in parts)
    if not (west < east and south < north):
        raise InputError(f"extent is {west:g},{south:g},{east:g},{north:g}; write west < east and south < north")
    return west, south, east, north


def _checked_pages(pages: object) -> tuple[str, ...]:
    names = [choice(each, "a page", PAGES) for each in items(pages, str, "pages")]
    if not names:
        raise InputError(f"pages is empty; name some of {', '.join(PAGES)}")
    return tuple(each for each in PAGES if each in names)


# --- The option --sheet -----------------------------------------------------------------------------------------------


_FIELDS = tuple(each.name for each in fields(Sheet))
_LISTS = "extent", "pages"  # separated by commas


def parse_sheet(texts: Sequence[str]) -> Sheet:
    """The sheet of options ``--sheet FIELD=VALUE``; ``sources`` may be repeated.

    Raises
    ------
    InputError
        If a field is unknown or repeated, or a value is invalid.
    """
    values: dict[str, object] = {}
    sources = list[str]()
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip()
        if not equals:
            raise InputError(f'--sheet {quoted(text)}: write FIELD=VALUE, such as project="River Street 5"')
        if name not in _FIELDS:
            hint = spelling_hint(name, _FIELDS)
            raise InputError(f"--sheet {name}: there is no such field; {hint}the fields are {', '.join(_FIELDS)}")
        if name == "sources":
            sources.append(value)
            continue
        if name in values:
            raise InputError(f"--sheet {name} is repeated; write it once")
        values[name] = _numbers_or_names(name, value) if name in _LISTS else value
    try:
        return Sheet(**values, sources=sources)  # type: ignore[arg-type]  # checked by the class
    except InputError as error:
        raise InputError(f"--sheet: {error}") from None


def _numbers_or_names(name: str, value: str) -> list[object]:
    parts: list[object] = [each.strip() for each in value.split(",")]
    if name != "extent":
        return parts
    try:
        return [float(str(each)) for each in parts]
    except ValueError:
        raise InputError(f"--sheet extent is {value!r}; write WEST,SOUTH,EAST,NORTH") from None
