"""The page of ``antumbra compare``: pictures of plans, their times and counters."""

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from . import page
from .comparesummary import Panels, Told, about, bits, counters, extent, milliseconds, phases, ratio, speed

if TYPE_CHECKING:
    from ..picture.heat_maps import Panel

_NARROWEST = 300  # least width of a panel, in pixels


def save(told: Told, panels: Panels, path: Path) -> None:
    """Write the page whole or not at all."""
    found = told.found
    verdict, plans = " class=bad" if found.wrong else "", [str(one.plan) for one in found.plans]
    parts = [
        *(f"<p{verdict}>Bits: {escape(line)}.</p>" for line in bits(found)),
        _pictures(panels),
        f"<h2>Milliseconds of a frame: median of {told.given.rounds}, and ratio to the fastest</h2>",
        page.table(["", *plans], _times(told)),
        "<h2>Counters of a frame</h2>",
        page.table(["", *plans], counters(found)),
        "<h2>Picture</h2>",
        page.pairs(about(told)),
        "<h2>Machine</h2>",
        page.pairs((name, str(value)) for name, value in told.machine.items()),
        "<h2>Command</h2>",
        f"<pre>{escape(told.given.command())}</pre>",
    ]
    page.save(f"{len(found.plans)} plans on {told.scene.name}", parts, path)


def _pictures(panels: Panels) -> str:
    """All panels as figures, and the colour bar below them."""
    from ..picture.heat_maps import draw_bar

    bar = f'<img class=bar alt="{escape(panels.bar.caption)}" src="{page.embedded(draw_bar(panels.bar, 1400, 18))}">'
    return "\n".join(["<div class=panels>", *map(_figure, panels.panels), "</div>", bar])


def _figure(panel: "Panel") -> str:
    """A panel with its lines below it."""
    title, *more = map(escape, panel.lines)
    width = max(panel.picture.shape[1], _NARROWEST)
    image = f'<img alt="{title}" src="{page.embedded(panel.picture)}">'
    caption = f"{title}{''.join(f'<span>{line}</span>' for line in more)}"
    return f'<figure style="max-width: {width}px">{image}<figcaption>{caption}</figcaption></figure>'


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
