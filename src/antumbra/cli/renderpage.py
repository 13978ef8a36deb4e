"""The page of ``antumbra render --html``: the picture, its settings, times and counters."""

import shlex
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from . import page, report, summary

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from .picturespec import PictureSpec, Shot


def save(asked: "PictureSpec", scene: "AnyScene", load: float, shot: "Shot", saved: summary.Saved, path: Path) -> None:
    """Write the page whole or not at all."""
    from ..picture.image_files import frame_exposure, screen_picture
    from .about import about

    frame = shot.frame
    exposure = asked.exposure if asked.exposure is not None else frame_exposure(frame)
    width = frame.image.shape[1]
    picture = page.embedded(screen_picture(frame, exposure, asked.behind))
    parts = [
        f'<img style="max-width: {width}px" alt="{escape(scene.name)}" src="{picture}">',
        "<h2>Picture</h2>",
        page.pairs(_facts(asked, scene, shot, saved, exposure)),
        "<h2>Lights</h2>",
        page.table(["", "kind", "share lit", "intensity"], _lights(shot)),
        "<h2>Milliseconds</h2>",
        page.table(["", ""], _times(load, shot, saved)),
    ]
    if frame.counters is not None:
        rows = [(name.replace("_", " "), [f"{value:,}"]) for name, value in frame.counters.items()]
        parts += ["<h2>Counters of shadow rays</h2>", page.table(["", ""], rows)]
    parts += [
        "<h2>Settings</h2>",
        page.pairs((name, str(v)) for name, v in report.plain(asked.record(shot.options)).items()),
    ]
    parts += ["<h2>Machine</h2>", page.pairs((name, str(value)) for name, value in about().items())]
    parts += ["<h2>Command</h2>", f"<pre>{escape(shlex.join(['antumbra', *sys.argv[1:]]))}</pre>"]
    page.save(f"{scene.name}: {width}x{frame.image.shape[0]}", parts, path)


def _facts(asked, scene, shot: "Shot", saved: summary.Saved, exposure: float) -> Iterator[tuple[str, str]]:
    yield "scene", summary.scene_text(asked, scene)
    yield "file", str(saved.path)
    yield "exposure", f"{exposure:.4g}"
    if scene.animated:
        yield "time", f"{shot.time:g} of {scene.duration:g} s"
    yield from summary.shot_fields(asked, shot)
    for note in scene.notes:
        yield "left out", note


def _lights(shot: "Shot") -> Iterator[tuple[str, list[str]]]:
    """One row for each light: the share of it that the surfaces of the picture see."""
    frame = shot.frame
    for name, light, seen in zip(frame.names, shot.lights, frame.visibility):
        lit = f"{100.0 * float(seen[frame.mask].mean()):.1f} %" if frame.mask.any() else ""
        yield name, [type(light).__name__, lit, f"{light.intensity:.4g}"]


def _times(load: float, shot: "Shot", saved: summary.Saved) -> Iterator[tuple[str, list[str]]]:
    phases = dict(shot.frame.timings)
    total = phases.pop("total")
    for name, each in phases.items():
        if each > 0.0:
            yield name, [f"{1000.0 * each:.1f}"]
    yield "total", [f"{1000.0 * total:.1f}"]
    yield "load the scene", [f"{1000.0 * load:.1f}"]
    yield "save the picture", [f"{1000.0 * saved.seconds:.1f}"]
