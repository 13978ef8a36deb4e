"""`Page`, which the methods named ``page`` of scenes and results return: a file, and a frame in notebooks."""

import os
from dataclasses import dataclass, field
from datetime import date, datetime, time
from html import escape
from pathlib import Path

from ..base.checks import checked_instance, choice, quoted, text
from ..base.errors import InputError
from ..base.files import atomic_output, checked_output
from ..engine.scene import AnyScene
from ..engine.scene_loading import SceneLike, scene_of
from ..scene.camera import Camera
from ..sun.location import Place, place_of
from .page_export import LANGUAGES, PageOptions, page_html
from .value_layer import ValueLayer

NOON = time(14)
"""The time of the first picture, if only a day is given."""

_MOST_EMBEDDED = 20e6  # bytes of a page in a notebook


@dataclass(frozen=True)
class Page:
    """A page with exact shadows, which notebooks show in a frame without access to the notebook."""

    html: str = field(repr=False)
    triangles: int
    path: Path | None = None  # the file; None: only in memory

    def _repr_html_(self) -> str:
        if len(self.html) > _MOST_EMBEDDED:
            where = "give page() a path, and open the file" if self.path is None else f"open {self.path}"
            return f"<p>The page has {len(self.html) / 1e6:.0f} MB, too much for a notebook; {escape(where)}.</p>"
        return (
            f'<iframe sandbox="allow-scripts allow-downloads" srcdoc="{escape(self.html)}" width="100%" height="620" '
            'style="border: 0"></iframe>'
        )


def make_page(
    scene: SceneLike,
    path: str | os.PathLike[str] | None = None,
    *,
    title: str | None = None,
    when: str | date | datetime | None = None,
    place: Place | None = None,
    credits: str = "",
    language: str = "en",
    camera: Camera | None = None,
    time: float = 0.0,
    layer: ValueLayer | None = None,
) -> Page:
    """Make a page of a scene, as `antumbra.Scene.page` documents it.

    layer : numbers that the surfaces show as colours
    """
    text(credits, "credits")
    choice(language, "language", LANGUAGES)
    for value, kind, name in (title, str, "title"), (place, Place, "place"), (camera, Camera, "camera"):
        if value is not None:
            checked_instance(value, kind, name)
    shown: AnyScene = scene_of(scene)
    target = None if path is None else checked_output(path, (".html",))
    place = place_of(shown) if place is None else place
    moment = datetime.combine(date.today(), NOON) if when is None else local_time(when, "when")
    options = PageOptions(title or shown.name, moment, place, credits, language)
    data, report = page_html(shown, options, camera, shown.clamped(time), layer)
    if target is not None:
        with atomic_output(target) as temporary:
            temporary.write_bytes(data)
    return Page(data.decode(), report.triangles, target)


def local_time(when: str | date | datetime, name: str) -> datetime:
    """A day, at 14:00, or a local time. Raises an InputError with the name of the option."""
    moment: date | datetime | None = None
    if isinstance(when, date):  # so are times
        moment = when
    elif isinstance(when, str):
        try:
            moment = datetime.fromisoformat(when)
        except ValueError:
            moment = None
        else:
            moment = moment.date() if len(when) <= len("2026-06-21") else moment
    offset = isinstance(moment, datetime) and moment.tzinfo is not None
    if moment is None or offset or not 1900 <= moment.year <= 2199:
        raise InputError(f"{name} {quoted(when)} is not a day; write 2026-06-21, or 2026-06-21T15:30 in local time")
    return moment if isinstance(moment, datetime) else datetime.combine(moment, NOON)
