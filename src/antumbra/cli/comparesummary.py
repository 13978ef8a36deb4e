"""The results of ``antumbra compare``: as text, as JSON, and as panels of a picture."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from . import report, summary

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..picture.heat_maps import ColourBar
    from ..rendering.comparison import Comparison, Measured
    from .comparearguments import CompareArguments
    from .picturespec import PictureSpec, Shot

_WIDTH = 120  # width of the tables, in characters
_CAPTION = "tests of boxes and triangles per shadow ray, in windows of 16x16 pixels, logarithmic; black: no rays"
_NO_MAP = {True: "no map: it chooses a plan for each query", False: "no map: it works on all rays at once"}


class Told(NamedTuple):
    """A comparison, and what was compared."""

    given: "CompareArguments"
    asked: "PictureSpec"
    scene: "AnyScene"
    load: float  # seconds that reading the scene took
    shot: "Shot"  # its frame is the reference's
    found: "Comparison"
    machine: dict[str, str | int]


class Panels:
    """The rendered picture, and the heat map of each plan, with a common colour bar.

    panels : list of Panel
    bar : Bar
    """

    def __init__(self, told: Told):
        from ..picture.heat_maps import Panel, blank, log_scale_of
        from ..rendering.comparison import over_pixels

        found = told.found
        maps = [one.windows for one in found.plans]
        scale = log_scale_of(np.concatenate([np.empty(0), *(m[m > 0.0] for m in maps if m is not None)]))

        def drawn(one: "Measured") -> np.ndarray:
            if one.windows is None:
                return blank(found.asks.shape, _NO_MAP[one.plan.tracer.chooses])
            return scale.colours(over_pixels(one.windows, found.asks), found.asks)

        self.panels: list[Panel] = [Panel(_rendered(told), (told.scene.name, f"{found.frame.rays:,} shadow rays"))]
        self.panels += [Panel(drawn(one), (str(one.plan), _label(found, one))) for one in found.plans]
        self.bar: ColourBar = scale.bar(_CAPTION)

    def save(self, path: Path) -> None:
        """Write all panels as one picture."""
        from ..picture.heat_maps import sheet
        from ..picture.image_files import save_png

        save_png(sheet(self.panels, self.bar), path)


def _rendered(told: Told) -> np.ndarray:
    from ..picture.image_files import frame_exposure, screen_picture

    frame, exposure = told.found.frame, told.asked.exposure
    return screen_picture(frame, frame_exposure(frame) if exposure is None else exposure)


def _label(found: "Comparison", one: "Measured") -> str:
    total, least = one.medians["total"], found.fastest.medians["total"]
    return f"{report.duration(total)} ({ratio(total, least)}), {number(one.tests_per_ray)} tests a ray"


def ratio(value: float, least: float) -> str:
    """How many times the least value it is."""
    return f"{number(value / least)}x" if least > 0.0 else "-"


def number(value: float | None) -> str:
    """A number with three digits or more, as text."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.3g}"


def milliseconds(seconds: float) -> str:
    """Milliseconds, as text."""
    if seconds == 0.0:
        return "-"
    return f"{1000 * seconds:,.0f}" if seconds >= 0.1 else f"{1000 * seconds:.3g}" if seconds >= 1e-4 else "<0.1"


def speed(one: "Measured") -> str:
    """Million shadow rays per second, as text."""
    return number(None if one.rays_per_second is None else one.rays_per_second / 1e6)


def extent(one: "Measured") -> str:
    """The least and the greatest total, in milliseconds."""
    totals = [seconds["total"] for seconds in one.seconds]
    return f"{milliseconds(min(totals))}-{milliseconds(max(totals))}"


def phases(found: "Comparison") -> list[str]:
    """The phases that take time in any plan, and at last "total"."""
    return [name for name in found.plans[0].medians if any(one.medians[name] > 0.0 for one in found.plans)]


def counters(found: "Comparison") -> list[tuple[str, list[str]]]:
    """Names, and the counts of each plan; without counts that are 0 in all plans."""
    rows = [(name, [one.counters[name] for one in found.plans]) for name in found.plans[0].counters]
    for name in found.plans[0].paging or ():
        rows.append((f"chunks: {name}", [(one.paging or {})[name] for one in found.plans]))
    told = [(name.replace("_", " "), [f"{n:,}" for n in counts]) for name, counts in rows if any(counts)]
    return [*told, ("tests per ray", [number(one.tests_per_ray) for one in found.plans])]


def bits(found: "Comparison") -> list[str]:
    """Lines that say whether the bits are the same."""
    differing = [one for one in found.plans if one.difference.pixels]
    if not differing:
        return ["the same by all plans"]
    lines = [differs(found, one) + ("" if one.plan.tracer.exact else "; it is not exact") for one in differing]
    return lines if len(found.plans) - len(differing) < 2 else [*lines, "the same by all other plans"]


def differs(found: "Comparison", one: "Measured") -> str:
    """How a plan differs from the reference, as text."""
    n, pixels, first = one.difference
    assert first is not None
    return (
        f"{one.plan} differs from {found.reference}: {n:,} of the bits, {pixels:,} of the pixels, and first the pixel "
        f"({first[0]}, {first[1]})"
    )


def fields(told: Told) -> Iterator[tuple[str, str]]:
    """The names and values that are printed above the tables."""
    yield "picture", str(told.given.output)
    if told.given.html is not None:
        yield "page", str(told.given.html)
    yield from about(told)
    for line in bits(told.found):
        yield "bits", line


def about(told: Told) -> Iterator[tuple[str, str]]:
    """Names and values of the picture that was compared."""
    scene = told.scene
    moment = f", at {told.shot.time:g} of {scene.duration:g} s" if scene.animated else ""
    yield "scene", summary.scene_text(told.asked, scene) + moment
    yield from summary.view_fields(told.shot)


def print_tables(told: Told) -> None:
    """Print the medians of the phases, and the counters."""
    found, names = told.found, phases(told.found)
    least = found.fastest.medians["total"]
    rows = [
        (
            str(one.plan), *(milliseconds(one.medians[name]) for name in names), ratio(one.medians["total"], least),
            extent(one), speed(one),
        )
        for one in found.plans
    ]  # fmt: skip
    print(f"Milliseconds of a frame, median of {told.given.rounds}")
    report.print_table(("plan", *names, "ratio", "all totals", "Mrays/s"), rows, range(1, len(names) + 4), _WIDTH)
    print("Counters of a frame")
    head = "", *(str(one.plan) for one in found.plans)
    report.print_table(head, [(name, *row) for name, row in counters(found)], range(1, len(head)), _WIDTH)


def answer(told: Told) -> dict:
    """All fields of ``--json``."""
    found, asked = told.found, told.asked.record(told.shot.options)
    del asked["plan"]
    return {
        "output": str(told.given.output),
        "page": None if told.given.html is None else str(told.given.html),
        "command": told.given.command(),
        "machine": told.machine,
        "scene": summary.scene_answer(told.asked, told.scene),
        "load": told.load,
        "camera": report.camera_fields(told.shot.camera),
        "lights": [report.light_fields(light) for light in told.shot.lights],
        **asked,
        "rounds": told.given.rounds,
        "rays": found.frame.rays,
        "reference": str(found.reference),
        "same_bits": not any(one.difference.pixels for one in found.plans),
        "plans": [_plan_answer(found, one) for one in found.plans],
    }


def _plan_answer(found: "Comparison", one: "Measured") -> dict:
    rays = one.rays_per_second
    return {
        "plan": str(one.plan),
        "exact": one.plan.tracer.exact,
        "timings": one.medians,
        "ratio": one.medians["total"] / found.fastest.medians["total"],
        "rounds": one.seconds,
        "rays": one.rays,
        "mrays_per_second": None if rays is None else rays / 1e6,
        "counters": one.counters,
        "tests_per_ray": one.tests_per_ray,
        "windows": one.windows,
        "paging": one.paging,
        "difference": one.difference._asdict(),
    }
