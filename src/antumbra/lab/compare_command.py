"""``antumbra compare``: measure plans on one picture, and report text, JSON, heat maps and an HTML page."""

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
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.wording import counted
from ..cli import arguments, console, picture_report
from ..cli.console import UNFORESEEN, ProgressDisplay, say
from ..cli.installation_commands import about
from ..cli.options import (
    AoOption,
    CameraOption,
    ExposureOption,
    Json,
    PictureLightOption,
    Preset,
    PresetOption,
    Quiet,
    SceneArgument,
    SkyOption,
    SrdhRaysOption,
    UpOption,
    VplOption,
    arguments_of,
    parameters_of,
    takes,
    writes,
)
from ..cli.picture_spec import PictureSpec, RenderArguments, Shot
from ..cli.scene_arguments import DEFAULT_SCENE, limit_memory
from ..picture.picture_records import camera_fields, light_fields
from ..picture.render_options import GBufferBy
from ..work.result_summary import duration

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..picture.heat_maps import ColourBar, Panel
    from .plan_comparison import Comparison, PlanMeasurement


# --- Arguments and their conversion to options ------------------------------------------------------------------------


_Options: Any = arguments_of("compare", gbuffer=GBufferBy.raster)


@dataclass(frozen=True)
class CompareArguments(_Options):  # type: ignore[misc] # made from the options of a picture
    """The command-line arguments and options, one per field.

    The base class adds the options derived from `RenderOptions` and `EngineOptions`.
    """

    scene: SceneArgument = DEFAULT_SCENE
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help="A plan; repeat for at least two. See antumbra plans.",
            metavar="PLAN",
            show_default=False,
        ),
    ] = None
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Write the picture and heat maps to a .png file.",
            metavar="FILE",
            callback=writes(".png"),
        ),
    ] = Path("compare.png")
    html: Annotated[
        Path | None,
        typer.Option(
            help="Write all results to a self-contained .html file.",
            metavar="FILE",
            show_default=False,
            callback=writes(".html", ".htm"),
        ),
    ] = None
    rounds: Annotated[int, typer.Option(help="Timed frames per plan, for the median.", min=1, max=1000)] = 5
    size: Annotated[str, typer.Option(help="Picture size in pixels.", metavar="WxH")] = "512x512"
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
        """The options of the picture, without a plan, checked against each other.

        Raises
        ------
        InputError
            If a text cannot be parsed, or options exclude each other.
        """
        if self.srdh_rays is not None and arguments.parse_srdh_rays(self.srdh_rays).last_frame:
            raise InputError("--srdh-rays last-frame is for animations; compare renders a single picture")
        shared = {f.name for f in fields(self)} & {f.name for f in fields(RenderArguments)} - {"plan", "output"}
        of_picture = RenderArguments(**{name: getattr(self, name) for name in shared})
        of_picture.check()
        return of_picture.options()

    def command(self) -> str:
        """The equivalent command line, quoted for a shell."""
        words = ["antumbra", "compare", self.scene]
        for each in parameters_of(type(self)):
            value = getattr(self, each.name)
            if each.name != "scene" and value != each.default:
                words += _words("--" + each.name.replace("_", "-"), value)
        return shlex.join(words)


def _words(option: str, value: Any) -> list[str]:
    """An option and its value, or each of its values, as words of a command line."""
    if value is True:
        return [option]
    if isinstance(value, list):
        return [word for one in value for word in _words(option, one)]
    text = str(value.value if isinstance(value, Enum) else value)
    return [f"{option}={text}"] if text.startswith("-") else [option, text]


# --- Results as text, JSON and panels of a picture --------------------------------------------------------------------


_WIDTH = 120  # width of the tables, in characters
_CAPTION = "box and triangle tests per shadow ray, in windows of 16x16 pixels, logarithmic; black: no rays"
_NO_MAP = {True: "no map: it chooses a plan per query", False: "no map: it traces all rays at once"}


class ComparisonReport(NamedTuple):
    """A comparison and its inputs."""

    arguments: CompareArguments
    spec: PictureSpec
    scene: "AnyScene"
    load: float  # seconds to read the scene
    shot: Shot  # with the frame of the reference
    comparison: "Comparison"
    machine: dict[str, str | int]


class ComparisonPanels:
    """The rendered picture and the heat map of each plan, with a common colour bar.

    panels : list of Panel
    bar : Bar
    """

    def __init__(self, report: ComparisonReport):
        from ..picture.heat_maps import Panel, blank_panel, log_scale
        from .plan_comparison import windows_to_pixels

        comparison = report.comparison
        maps = [one.windows for one in comparison.plans]
        scale = log_scale(np.concatenate([np.empty(0), *(m[m > 0.0] for m in maps if m is not None)]))

        def heat_map(one: "PlanMeasurement") -> NDArray[np.uint8]:
            if one.windows is None:
                return blank_panel(comparison.asks.shape, _NO_MAP[one.plan.tracer.chooses])
            return scale.colours(windows_to_pixels(one.windows, comparison.asks), comparison.asks)

        self.panels: list[Panel] = [
            Panel(_rendered(report), (report.scene.name, f"{counted(comparison.frame.rays, 'shadow ray')}"))
        ]
        self.panels += [Panel(heat_map(one), (str(one.plan), _label(comparison, one))) for one in comparison.plans]
        self.bar: ColourBar = scale.bar(_CAPTION)

    def save(self, path: Path) -> None:
        """Save all panels as one picture."""
        from ..picture.heat_maps import panel_sheet
        from ..picture.image_files import save_png

        save_png(panel_sheet(self.panels, self.bar), path)


def _rendered(report: ComparisonReport) -> NDArray[np.uint8]:
    from ..picture.image_files import frame_exposure, screen_picture

    frame, exposure = report.comparison.frame, report.spec.exposure
    return screen_picture(frame, frame_exposure(frame) if exposure is None else exposure)


def _label(comparison: "Comparison", one: "PlanMeasurement") -> str:
    total, least = one.medians["total"], comparison.fastest.medians["total"]
    return f"{duration(total)} ({ratio(total, least)}), {number(one.tests_per_ray)} tests per ray"


def ratio(value: float, least: float) -> str:
    """The ratio to the least value, as text."""
    return f"{number(value / least)}x" if least > 0.0 else "-"


def number(value: float | None) -> str:
    """A number with at least three significant digits, as text."""
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
    """The range of the totals in milliseconds, as text."""
    totals = [seconds["total"] for seconds in one.seconds]
    return f"{milliseconds(min(totals))}-{milliseconds(max(totals))}"


def phases(comparison: "Comparison") -> list[str]:
    """The phases that take time in any plan, ending with "total"."""
    return [name for name in comparison.plans[0].medians if any(one.medians[name] > 0.0 for one in comparison.plans)]


def counters(comparison: "Comparison") -> list[tuple[str, list[str]]]:
    """Names and the counts of each plan, without counters that are 0 in all plans."""
    rows = [(name, [one.counters[name] for one in comparison.plans]) for name in comparison.plans[0].counters]
    for name in comparison.plans[0].paging or ():
        rows.append((f"chunks: {name}", [(one.paging or {}).get(name, 0) for one in comparison.plans]))
    changing = [(name.replace("_", " "), [f"{n:,}" for n in counts]) for name, counts in rows if any(counts)]
    return [*changing, ("tests per ray", [number(one.tests_per_ray) for one in comparison.plans])]


def bits(comparison: "Comparison") -> list[str]:
    """Lines that state whether the plans give the same bits."""
    differing = [one for one in comparison.plans if one.difference.pixels]
    if not differing:
        return ["identical for all plans"]
    lines = [
        differs(comparison, one) + ("" if one.plan.tracer.exact else "; this plan is not exact") for one in differing
    ]
    return lines if len(comparison.plans) - len(differing) < 2 else [*lines, "identical for all other plans"]


def differs(comparison: "Comparison", one: "PlanMeasurement") -> str:
    """How a plan differs from the reference, as text."""
    n, pixels, first = one.difference
    assert first is not None
    return (
        f"{one.plan} differs from {comparison.reference}: {n:,} of the bits, {pixels:,} of the pixels, first at "
        f"({first[0]}, {first[1]})"
    )


def comparison_fields(report: ComparisonReport) -> Iterator[tuple[str, str]]:
    """The names and values printed above the tables."""
    yield "picture", str(report.arguments.output)
    if report.arguments.html is not None:
        yield "page", str(report.arguments.html)
    yield from picture_rows(report)
    for line in bits(report.comparison):
        yield "bits", line


def picture_rows(report: ComparisonReport) -> Iterator[tuple[str, str]]:
    """Names and values that describe the rendered picture."""
    scene = report.scene
    moment = f", at {report.shot.time:g} of {scene.duration:g} s" if scene.animated else ""
    yield "scene", picture_report.scene_text(report.spec, scene) + moment
    yield from picture_report.view_fields(scene, report.shot)


def print_tables(report: ComparisonReport) -> None:
    """Print the median times of the phases and the counters."""
    comparison, names = report.comparison, phases(report.comparison)
    least = comparison.fastest.medians["total"]
    rows = [
        (
            str(one.plan),
            *(milliseconds(one.medians[name]) for name in names),
            ratio(one.medians["total"], least),
            extent(one),
            speed(one),
        )
        for one in comparison.plans
    ]
    print(f"Milliseconds per frame, median of {report.arguments.rounds}")
    console.print_table(("plan", *names, "ratio", "all totals", "Mrays/s"), rows, range(1, len(names) + 4), _WIDTH)
    print("Counters per frame")
    head = "", *(str(one.plan) for one in comparison.plans)
    console.print_table(head, [(name, *row) for name, row in counters(comparison)], range(1, len(head)), _WIDTH)


def answer(report: ComparisonReport) -> dict[str, Any]:
    """All fields of ``--json``."""
    comparison, settings = report.comparison, report.spec.record(report.shot.options)
    del settings["plan"]
    return {
        "output": str(report.arguments.output),
        "page": None if report.arguments.html is None else str(report.arguments.html),
        "command": report.arguments.command(),
        "machine": report.machine,
        "scene": picture_report.scene_answer(report.spec, report.scene),
        "load": report.load,
        "camera": camera_fields(report.shot.camera),
        "lights": [light_fields(light) for light in report.shot.lights],
        **settings,
        "rounds": report.arguments.rounds,
        "rays": comparison.frame.rays,
        "reference": str(comparison.reference),
        "same_bits": not any(one.difference.pixels for one in comparison.plans),
        "plans": [_plan_answer(comparison, one) for one in comparison.plans],
    }


def _plan_answer(comparison: "Comparison", one: "PlanMeasurement") -> dict[str, Any]:
    rays = one.rays_per_second
    return {
        "plan": str(one.plan),
        "exact": one.plan.tracer.exact,
        "timings": one.medians,
        "ratio": one.medians["total"] / comparison.fastest.medians["total"],
        "rounds": one.seconds,
        "rays": one.rays,
        "mrays_per_second": None if rays is None else rays / 1e6,
        "counters": one.counters,
        "tests_per_ray": one.tests_per_ray,
        "windows": one.windows,
        "paging": one.paging,
        "difference": one.difference._asdict(),
    }


# --- HTML page --------------------------------------------------------------------------------------------------------


_NARROWEST = 300  # minimum width of a panel, in pixels


def save_comparison_page(report: ComparisonReport, panels: ComparisonPanels, path: Path) -> None:
    """Write the page atomically."""
    comparison = report.comparison
    verdict, plans = " class=bad" if comparison.wrong else "", [str(one.plan) for one in comparison.plans]
    parts = [
        *(f"<p{verdict}>Bits: {escape(line)}.</p>" for line in bits(comparison)),
        _pictures(panels),
        f"<h2>Milliseconds per frame: median of {report.arguments.rounds}, and ratio to the fastest</h2>",
        picture_report.html_table(["", *plans], _times(report)),
        "<h2>Counters per frame</h2>",
        picture_report.html_table(["", *plans], counters(comparison)),
        "<h2>Picture</h2>",
        picture_report.html_pairs(picture_rows(report)),
        "<h2>Machine</h2>",
        picture_report.html_pairs((name, str(value)) for name, value in report.machine.items()),
        "<h2>Command</h2>",
        f"<pre>{escape(report.arguments.command())}</pre>",
    ]
    picture_report.save_page(f"{counted(len(comparison.plans), 'plan')} on {report.scene.name}", parts, path)


def _pictures(panels: ComparisonPanels) -> str:
    """All panels as figures, with the colour bar below."""
    from ..picture.heat_maps import draw_bar

    url = picture_report.data_url(draw_bar(panels.bar, 1400, 18))
    bar = f'<img class=bar alt="{escape(panels.bar.caption)}" src="{url}">'
    return "\n".join(["<div class=panels>", *map(_figure, panels.panels), "</div>", bar])


def _figure(panel: "Panel") -> str:
    """A panel with its caption."""
    title, *more = map(escape, panel.lines)
    width = max(panel.picture.shape[1], _NARROWEST)
    image = f'<img alt="{title}" src="{picture_report.data_url(panel.picture)}">'
    caption = f"{title}{''.join(f'<span>{line}</span>' for line in more)}"
    return f'<figure style="max-width: {width}px">{image}<figcaption>{caption}</figcaption></figure>'


def _times(report: ComparisonReport) -> Iterator[tuple[str, list[str]]]:
    """The rows of the phases, the total and the rays per second: names, and cells in HTML."""
    plans = report.comparison.plans
    medians = [one.medians for one in plans]
    for name in phases(report.comparison):
        seconds = [each[name] for each in medians]
        least = min((s for s in seconds if s > 0.0), default=0.0)
        yield name, [f"{escape(milliseconds(s))} <small>{ratio(s, least) if s else ''}</small>" for s in seconds]
    yield "all totals", [f"{extent(one)} <small></small>" for one in plans]
    yield "million rays/s", [f"{speed(one)} <small></small>" for one in plans]


# --- The command ------------------------------------------------------------------------------------------------------


@takes(CompareArguments)
def compare(args: CompareArguments) -> int:
    """Measure plans side by side on one picture.

    The plans take turns, and the medians of their frames are shown, phase by phase. Compilation is never timed. Each
    frame starts from scratch and reuses nothing from earlier frames. The counters come from a separate, untimed frame.

    All exact plans must give the same bits. If one differs from the first exact plan, the exit code is 1.

    The picture shows the rendered scene and a heat map per plan: box and triangle tests per shadow ray, in windows of
    16x16 pixels. All maps share one logarithmic colour scale. A plan without a builder has no map, because its
    hierarchy spans the rays of all pixels. antumbra render --help explains CAMERA and LIGHT.

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
    from .plan_comparison import compare as compare_plans
    from .plan_comparison import compared_plans

    spec = args.options()
    path, page = args.output, args.html
    plans = compared_plans(args.plan or [])
    spec.check(*plans)
    plans = with_sample(plans, spec.srdh_rays)
    with ProgressDisplay(spec.quiet) as display:
        display.say("reading the scene")
        start = perf_counter()
        scene = spec.open()
        load = perf_counter() - start
        engine = replace(spec.engine, max_memory=limit_memory(scene, spec.engine.max_memory))
        time = scene.clamped(args.time or 0.0)
        moment = TimeSample(time, spec.view(scene, time), spec.all_lights(scene, time))
        display.say("preparing")
        options = replace(spec.picture, time=time, antialias=False)  # smoothing would spread differing pixels
        comparison = compare_plans(scene, moment, plans, options, engine, rounds=args.rounds, say=display.say)
        display.say("writing the picture")
        shot = Shot(moment.camera, moment.lights, options, comparison.frame)
        report = ComparisonReport(
            args, spec, scene, load, shot, comparison, {**about(), "threads": thread_count(spec.engine.threads)}
        )
        panels = ComparisonPanels(report)
        panels.save(path)
        if page is not None:
            save_comparison_page(report, panels, page)
    if spec.json:
        console.print_json(answer(report))
    elif not spec.quiet:
        console.print_fields(comparison_fields(report))
        print_tables(report)
    for one in comparison.wrong:
        say(f"{differs(comparison, one)}; this is a bug, please report it with the scene and the command")
    return UNFORESEEN if comparison.wrong else 0
