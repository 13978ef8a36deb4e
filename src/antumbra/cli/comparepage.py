"""The page of ``antumbra compare``: one HTML file that holds its pictures, and needs nothing else."""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from .comparesummary import Panels, Told, about, bits, counters, extent, milliseconds, phases, ratio, speed

if TYPE_CHECKING:
    from ..image.panels import Panel

_STYLE = """
:root { background: #1e1e22; color: #ececec; color-scheme: dark; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 1400px; padding: 0 1.5em; }
h1 { font-size: 1.6em; } h2 { font-size: 1.15em; margin-top: 2em; }
.panels { display: flex; flex-wrap: wrap; gap: 1.2em; }
figure { flex: 1 1 300px; margin: 0; }
figcaption span { color: #a0a0a6; display: block; }
img { display: block; max-width: 100%; width: 100%; }
.bar { margin: 1.2em 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; }
th, td { border-bottom: 1px solid #8884; padding: 0.25em 1em 0.25em 0; text-align: left; vertical-align: top; }
table.numbers td, table.numbers th + th { font-variant-numeric: tabular-nums; text-align: right; white-space: nowrap; }
small { color: #a0a0a6; display: inline-block; min-width: 4em; }
tr.sum { font-weight: bold; }
.bad { color: #f66; font-weight: bold; }
pre { overflow-x: auto; padding: 0.8em 1em; background: #8882; }
"""
_NARROWEST = 300  # least width of a panel, in pixels


def save(told: Told, panels: Panels, path: Path) -> None:
    """Write the page whole or not at all."""
    from ..output import replacing

    with replacing(path) as temporary:
        temporary.write_text(_page(told, panels), encoding="utf-8", errors="backslashreplace")


def _page(told: Told, panels: Panels) -> str:
    found = told.found
    title = f"{len(found.plans)} plans on {told.scene.name}"
    verdict, plans = " class=bad" if found.wrong else "", [str(one.plan) for one in found.plans]
    parts = [
        f"<h1>{escape(title)}</h1>",
        *(f"<p{verdict}>Bits: {escape(line)}.</p>" for line in bits(found)),
        _pictures(panels),
        f"<h2>Milliseconds of a frame: median of {told.given.rounds}, and ratio to the fastest</h2>",
        _table(["", *plans], _times(told)),
        "<h2>Counters of a frame</h2>",
        _table(["", *plans], counters(found)),
        "<h2>Picture</h2>",
        _pairs(about(told)),
        "<h2>Machine</h2>",
        _pairs((name, str(value)) for name, value in told.machine.items()),
        "<h2>Command</h2>",
        f"<pre>{escape(told.given.command())}</pre>",
    ]
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head += f"<title>{escape(title)}</title><style>{_STYLE}</style>"
    return "\n".join(["<!doctype html>", f'<html lang="en"><head>{head}</head><body>', *parts, "</body></html>", ""])


def _pictures(panels: Panels) -> str:
    """All panels as figures, and the colour bar below them."""
    from ..image.panels import draw_bar

    bar = f'<img class=bar alt="{escape(panels.bar.caption)}" src="{_embedded(draw_bar(panels.bar, 1400, 18))}">'
    return "\n".join(["<div class=panels>", *map(_figure, panels.panels), "</div>", bar])


def _figure(panel: "Panel") -> str:
    """A panel with its lines below it."""
    title, *more = map(escape, panel.lines)
    width = max(panel.picture.shape[1], _NARROWEST)
    image = f'<img alt="{title}" src="{_embedded(panel.picture)}">'
    caption = f"{title}{''.join(f'<span>{line}</span>' for line in more)}"
    return f'<figure style="max-width: {width}px">{image}<figcaption>{caption}</figcaption></figure>'


def _embedded(rgb) -> str:
    """A picture as the address of an image."""
    from ..image.save import png_bytes

    return "data:image/png;base64," + b64encode(png_bytes(rgb)).decode("ascii")


def _times(told: Told) -> Iterator[tuple[str, list[str]]]:
    """The rows of the phases, of the total, and of the rays per second: names, and cells in HTML."""
    plans = told.found.plans
    medians = [one.medians for one in plans]
    for name in phases(told.found):
        seconds = [each[name] for each in medians]
        least = min((s for s in seconds if s > 0.0), default=0.0)
        yield name, [f"{escape(milliseconds(s))} <small>{ratio(s, least) if s else ''}</small>" for s in seconds]
    yield "all totals", [f"{extent(one)} <small></small>" for one in plans]
    yield "million rays/s", [f"{speed(one)} <small></small>" for one in plans]


def _table(headers: Sequence[str], rows: Iterable[tuple[str, Sequence[str]]]) -> str:
    """A table of numbers; the cells are HTML, the names of rows and columns are text."""
    head = "".join(f"<th>{escape(header)}" for header in headers)
    body = "\n".join(
        f"<tr{' class=sum' if name == 'total' else ''}><th>{escape(name)}{''.join(f'<td>{cell}' for cell in cells)}"
        for name, cells in rows
    )
    return f"<div class=scroll><table class=numbers><thead><tr>{head}</thead>\n<tbody>\n{body}\n</table></div>"


def _pairs(rows: Iterable[tuple[str, str]]) -> str:
    """A table of names and values."""
    body = "\n".join(f"<tr><th>{escape(name)}<td>{escape(value)}" for name, value in rows)
    return f"<table>\n{body}\n</table>"
