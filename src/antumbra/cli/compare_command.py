"""``antumbra compare``: measures plans on one picture; reports text, JSON, heat maps and an HTML page."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from enum import Enum
from html import escape
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import typer

from ..errors import InputError
from ..picture.render_options import GBufferBy
from . import arguments
from . import console as report
from . import picture_report as page
from . import picture_report as summary
from .arguments import limit_memory, open_scene
from .console import UNFORESEEN, ProgressDisplay, say
from .installation_commands import about
from .options import (
    SCENE_HELP,
    AoOption,
    CameraOption,
    ExposureOption,
    Json,
    PictureLightOption,
    Preset,
    PresetOption,
    Quiet,
    SkyOption,
    SrdhRaysOption,
    UpOption,
    VplOption,
    arguments_of,
    fields_of,
    takes,
    writes,
)
from .picture_spec import PictureSpec, RenderArguments, Shot

# --- The command-line arguments of ``antumbra compare``, and their conversion to options ------------------------------


_Options: Any = arguments_of("compare", gbuffer=GBufferBy.raster)


@dataclass(frozen=True)
class CompareArguments(_Options):
    """The arguments of the command line: each field is an argument or an option.

    The base class has those of `RenderOptions` and `EngineOptions`.
    """

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help="A plan; given twice or more. See antumbra plans.",
            metavar="PLAN",
            show_default=False,
        ),
    ] = None
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="A .png file: picture and heat maps.", metavar="FILE", callback=writes(".png")
        ),
    ] = Path("compare.png")
    html: Annotated[
        Path | None,
        typer.Option(
            help="A page with everything, in one .html file.",
            metavar="FILE",
            show_default=False,
            callback=writes(".html", ".htm"),
        ),
    ] = None
    rounds: Annotated[int, typer.Option(help="Timed frames of each plan; the median counts.", min=1, max=1000)] = 5
    size: Annotated[str, typer.Option(help="Size of the picture in pixels.", metavar="WxH")] = "512x512"
    camera: CameraOption = None
    light: PictureLightOption = None
    sky: SkyOption = None
    ao: AoOption = None
    vpl: VplOption = None
    up: UpOption = None
    preset: PresetOption = Preset.standard
    srdh_rays: SrdhRaysOption = None
    exposure: ExposureOption = None
    json: Json = False
    quiet: Quiet = False

    def options(self) -> PictureSpec:
        """The options of the picture, checked against each other; they name no plan.

        Raises
        ------
        InputError
            If a text cannot be parsed, or options exclude each other.
        """
        if self.srdh_rays is not None and arguments.parse_srdh_rays(self.srdh_rays).last_frame:
            raise InputError("--srdh-rays last-frame belongs to animations; a comparison is of one picture")
        shared = {f.name for f in fields(self)} & {f.name for f in fields(RenderArguments)} - {"plan", "output"}
        of_picture = RenderArguments(**{name: getattr(self, name) for name in shared})
        of_picture.check()
        return of_picture.options()

    def command(self) -> str:
        """A command line with the same arguments, for a shell."""
        words = ["antumbra", "compare", self.scene]
        for field in fields_of(type(self)):
            value = getattr(self, field.name)
            if field.name != "scene" and value != field.default:
                words += _words("--" + field.name.replace("_", "-"), value)
        return shlex.join(words)


def _words(option: str, value: Any) -> list[str]:
    """An option with its value, or with each of its values, as words of a command line."""
    if value is True:
        return [option]
    if isinstance(value, list):
        return [word for one in value for word in _words(option, one)]
    text = str(value.value if isinstance(value, Enum) else value)
    return [f"{option}={text}"] if text.startswith("-") else [option, text]


# --- The results of ``antumbra compare``: as text, as JSON, and as panels of a picture --------------------------------


if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..picture.heat_maps import ColourBar
    from ..picture.plan_comparison import Comparison, PlanMeasurement
    from .picture_spec import PictureSpec, Shot

_WIDTH = 120  # width of the tables, in characters
_CAPTION = "tests of boxes and triangles per shadow ray, in windows of 16x16 pixels, logarithmic; black: no rays"
_NO_MAP = {True: "no map: it chooses a plan for each query", False: "no map: it works on all rays at once"}


class ComparisonReport(NamedTuple):
    """A comparison, and what was compared."""

    given: "CompareArguments"
    asked: "PictureSpec"
    scene: "AnyScene"
    load: float  # seconds that reading the scene took
    shot: "Shot"  # its frame is the reference's
    found: "Comparison"
    machine: dict[str, str | int]


class ComparisonPanels:
    """The rendered picture, and the heat map of each plan, with a common colour bar.

    panels : list of Panel
    bar : Bar
    """

    def __init__(self, told: ComparisonReport):
        from ..picture.heat_maps import Panel, blank, log_scale_of
        from ..picture.plan_comparison import windows_to_pixels

        found = told.found
        maps = [one.windows for one in found.plans]
        scale = log_scale_of(np.concatenate([np.empty(0), *(m[m > 0.0] for m in maps if m is not None)]))

        def drawn(one: "PlanMeasurement") -> np.ndarray:
            if one.windows is None:
                return blank(found.asks.shape, _NO_MAP[one.plan.tracer.chooses])
            return scale.colours(windows_to_pixels(one.windows, found.asks), found.asks)

        self.panels: list[Panel] = [Panel(_rendered(told), (told.scene.name, f"{found.frame.rays:,} shadow rays"))]
        self.panels += [Panel(drawn(one), (str(one.plan), _label(found, one))) for one in found.plans]
        self.bar: ColourBar = scale.bar(_CAPTION)

    def save(self, path: Path) -> None:
        """Write all panels as one picture."""
        from ..picture.heat_maps import sheet
        from ..picture.image_files import save_png

        save_png(sheet(self.panels, self.bar), path)


def _rendered(told: ComparisonReport) -> np.ndarray:
    from ..picture.image_files import frame_exposure, screen_picture

    frame, exposure = told.found.frame, told.asked.exposure
    return screen_picture(frame, frame_exposure(frame) if exposure is None else exposure)


def _label(found: "Comparison", one: "PlanMeasurement") -> str:
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


def speed(one: "PlanMeasurement") -> str:
    """Million shadow rays per second, as text."""
    return number(None if one.rays_per_second is None else one.rays_per_second / 1e6)


def extent(one: "PlanMeasurement") -> str:
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


def differs(found: "Comparison", one: "PlanMeasurement") -> str:
    """How a plan differs from the reference, as text."""
    n, pixels, first = one.difference
    assert first is not None
    return (
        f"{one.plan} differs from {found.reference}: {n:,} of the bits, {pixels:,} of the pixels, and first the pixel "
        f"({first[0]}, {first[1]})"
    )


def comparison_fields(told: ComparisonReport) -> Iterator[tuple[str, str]]:
    """The names and values that are printed above the tables."""
    yield "picture", str(told.given.output)
    if told.given.html is not None:
        yield "page", str(told.given.html)
    yield from picture_rows(told)
    for line in bits(told.found):
        yield "bits", line


def picture_rows(told: ComparisonReport) -> Iterator[tuple[str, str]]:
    """Names and values of the picture that was compared."""
    scene = told.scene
    moment = f", at {told.shot.time:g} of {scene.duration:g} s" if scene.animated else ""
    yield "scene", summary.scene_text(told.asked, scene) + moment
    yield from summary.view_fields(told.shot)


def print_tables(told: ComparisonReport) -> None:
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


def answer(told: ComparisonReport) -> dict:
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


def _plan_answer(found: "Comparison", one: "PlanMeasurement") -> dict:
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


# --- The page of ``antumbra compare``: pictures of plans, their times and counters ------------------------------------


if TYPE_CHECKING:
    from ..picture.heat_maps import Panel

_NARROWEST = 300  # least width of a panel, in pixels


def save_comparison_page(told: ComparisonReport, panels: ComparisonPanels, path: Path) -> None:
    """Write the page whole or not at all."""
    found = told.found
    verdict, plans = " class=bad" if found.wrong else "", [str(one.plan) for one in found.plans]
    parts = [
        *(f"<p{verdict}>Bits: {escape(line)}.</p>" for line in bits(found)),
        _pictures(panels),
        f"<h2>Milliseconds of a frame: median of {told.given.rounds}, and ratio to the fastest</h2>",
        page.html_table(["", *plans], _times(told)),
        "<h2>Counters of a frame</h2>",
        page.html_table(["", *plans], counters(found)),
        "<h2>Picture</h2>",
        page.html_pairs(picture_rows(told)),
        "<h2>Machine</h2>",
        page.html_pairs((name, str(value)) for name, value in told.machine.items()),
        "<h2>Command</h2>",
        f"<pre>{escape(told.given.command())}</pre>",
    ]
    page.save_page(f"{len(found.plans)} plans on {told.scene.name}", parts, path)


def _pictures(panels: ComparisonPanels) -> str:
    """All panels as figures, and the colour bar below them."""
    from ..picture.heat_maps import draw_bar

    bar = f'<img class=bar alt="{escape(panels.bar.caption)}" src="{page.data_url(draw_bar(panels.bar, 1400, 18))}">'
    return "\n".join(["<div class=panels>", *map(_figure, panels.panels), "</div>", bar])


def _figure(panel: "Panel") -> str:
    """A panel with its lines below it."""
    title, *more = map(escape, panel.lines)
    width = max(panel.picture.shape[1], _NARROWEST)
    image = f'<img alt="{title}" src="{page.data_url(panel.picture)}">'
    caption = f"{title}{''.join(f'<span>{line}</span>' for line in more)}"
    return f'<figure style="max-width: {width}px">{image}<figcaption>{caption}</figcaption></figure>'


def _times(told: ComparisonReport) -> Iterator[tuple[str, list[str]]]:
    """The rows of the phases, of the total, and of the rays per second: names, and cells in HTML."""
    plans = told.found.plans
    medians = [one.medians for one in plans]
    for name in phases(told.found):
        seconds = [each[name] for each in medians]
        least = min((s for s in seconds if s > 0.0), default=0.0)
        yield name, [f"{escape(milliseconds(s))} <small>{ratio(s, least) if s else ''}</small>" for s in seconds]
    yield "all totals", [f"{extent(one)} <small></small>" for one in plans]
    yield "million rays/s", [f"{speed(one)} <small></small>" for one in plans]


# --- ``antumbra compare``: measures plans on the same picture ---------------------------------------------------------


@takes(CompareArguments)
def compare(given: CompareArguments) -> int:
    """Measure plans on the same picture of SCENE, side by side.

    The plans take turns, and the medians of their frames are shown, phase by phase. Compilation is never timed. Each
    frame starts anew, as the picture of antumbra render: it keeps nothing from the frames before. Counters are those of
    a frame that is not timed.

    All plans must give the same bits. If an exact plan differs from the first one, the exit code is 1.

    The picture shows the rendered scene, and a heat map for each plan: the tests of boxes and triangles per shadow ray,
    in windows of 16x16 pixels. All maps have the same colours, on a logarithmic scale. A plan without a builder has no
    map, because its hierarchy is over the rays of all pixels. CAMERA and LIGHT are written as in antumbra render.

    \b
    Examples
      antumbra compare --plan bsah+single --plan bsah+multifrusta
      antumbra compare sponza.glb --plan bsah+wide --plan srdh+wide --plan cones --html sponza.html
      antumbra compare robot.glb --time 2 --plan lbvh+multifrusta --plan grid32+lbvh+multifrusta --rounds 9
      antumbra compare city.antumbra --plan bsah+chcrt --plan bsah+chcrt:20 --json
    """
    from ..engine.plan import with_sample
    from ..kernels.parallel import thread_count
    from ..picture.frame_request import TimeSample
    from ..picture.plan_comparison import compare as compared
    from ..picture.plan_comparison import compared_plans

    asked = given.options()
    path, page = given.output, given.html
    plans = compared_plans(given.plan or [])
    asked.check(*plans)
    plans = with_sample(plans, asked.srdh_rays)
    with ProgressDisplay(asked.quiet) as display:
        display.say("reading the scene")
        start = perf_counter()
        scene = open_scene(asked.spec, asked.up, asked.quiet)
        load = perf_counter() - start
        limit_memory(scene, asked.engine.max_memory)
        time = scene.clamped(given.time or 0.0)
        moment = TimeSample(time, asked.view(scene, time), asked.all_lights(scene, time))
        display.say("preparing")
        options = replace(asked.picture, time=time, antialias=False)  # a pixel that differs shows in no other pixel
        found = compared(scene, moment, plans, options, asked.engine, rounds=given.rounds, say=display.say)
        display.say("writing the picture")
        shot = Shot(moment.camera, moment.lights, options, found.frame)
        told = ComparisonReport(
            given, asked, scene, load, shot, found, {**about(), "threads": thread_count(asked.engine.threads)}
        )
        panels = ComparisonPanels(told)
        panels.save(path)
        if page is not None:
            save_comparison_page(told, panels, page)
    if asked.json:
        report.print_json(answer(told))
    elif not asked.quiet:
        report.print_fields(comparison_fields(told))
        print_tables(told)
    for one in found.wrong:
        say(f"{differs(found, one)}; this is a bug, please report it with the scene and the command")
    return UNFORESEEN if found.wrong else 0
