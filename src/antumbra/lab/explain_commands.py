"""``antumbra explain`` and ``antumbra culling``: pictures of traversal steps and of culled triangles."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.wording import counted
from ..cli import arguments, console
from ..cli.options import (
    CameraOption,
    Json,
    LightOption,
    MaxMemoryOption,
    Quiet,
    SceneArgument,
    SppOption,
    SrdhRaysOption,
    Threads,
    TimeOption,
    UpOption,
    takes,
    writes,
)
from ..cli.scene_arguments import DEFAULT_SCENE, SceneArguments, limit_memory
from ..cli.study_run import StudyRun
from ..picture.picture_records import camera_fields, light_fields
from ..work.result_summary import Summary, duration

if TYPE_CHECKING:
    from ..picture.traversal_steps import Explanation, PlanSteps


# --- ``antumbra explain`` ---------------------------------------------------------------------------------------------


_PLANS = "bsah+single:random", "srdh+single"
_STORE_PLANS = ("bsah+chcrt",)
_WIDTH = 120  # width of the tables, in characters
_CAPTION = "box tests of the rays of a pixel; black: no rays"


@dataclass(frozen=True)
class ExplainArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .png file.  [default: SCENE's name-explain.png, here]",
            metavar="FILE",
            callback=writes(".png"),
        ),
    ] = None
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help=f"A plan; may be repeated, to compare with the first.  [default: {' and '.join(_PLANS)}; for a "
            "store bsah+chcrt]",
            metavar="PLAN",
            show_default=False,
        ),
    ] = None
    size: Annotated[str, typer.Option(help="Size of each picture in pixels.", metavar="WxH")] = "512x512"
    camera: CameraOption = None
    light: LightOption = None
    time: TimeOption = 0.0
    previous: Annotated[
        float | None,
        typer.Option(
            help="First build a frame this many seconds earlier, for plans that reuse state (refit, last-frame).",
            metavar="SECONDS",
            show_default=False,
        ),
    ] = None
    up: UpOption = None
    spp: SppOption = 16
    srdh_rays: SrdhRaysOption = None
    max_memory: MaxMemoryOption = None
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(ExplainArguments)
def explain(args: ExplainArguments) -> int:
    """Show where plans spend their traversal steps.

    The picture shows a panel per plan, side by side: the boxes tested per pixel, in one common colour scale. The tables
    split box tests into the classes of the SRDH paper: on the path to the hit, off that path, and of unblocked rays.
    They also give the depth, in each tree, of the triangles that block half of all blocked rays.

    Plans with the tracers single and single:... trace rays one by one. Others test boxes for bundles of rays: their
    panels show the tests in windows of 16x16 pixels, averaged over the pixels, and the classes are unknown. Plans
    without a builder have no tree and no steps. For a store, its own tree is used, with the plan bsah+chcrt.

    \b
    Examples
      antumbra explain
      antumbra explain zdm2.glb --plan bsah+single:rtsah --plan srdh+single --srdh-rays 32
      antumbra explain robot.glb --time 2 --previous 0.04 --plan bsah+single --plan bsah+refit+single
      antumbra explain city.glb --light sun:1,-0.5,-1 --plan bsah+single --plan bsah+multifrusta --json
    """
    spec, width_height = args.spec_of(args.scene), arguments.parse_size(args.size)
    camera_spec = None if args.camera is None else arguments.parse_camera(args.camera)
    light_specs = [arguments.parse_light(text) for text in args.light or []]
    if args.previous is not None and not 0.0 < args.previous <= 1e9:
        raise InputError(f"--previous is {args.previous:g}; it must be a positive number of seconds, such as 0.04")
    rays = None if args.srdh_rays is None else arguments.parse_srdh_rays(args.srdh_rays)
    if rays is not None and rays.last_frame and args.previous is None:
        raise InputError("--srdh-rays last-frame needs an earlier frame; add --previous SECONDS")

    from ..base.files import checked_output
    from ..engine.plan import with_sample
    from ..picture.frame_request import TimeSample
    from ..picture.image_files import save_png
    from ..picture.traversal_steps import explain as explained
    from ..picture.traversal_steps import explained_plans

    path = checked_output(Path(f"{spec.stem}-explain.png"), (".png",)) if args.output is None else args.output
    plans = explained_plans(args.plan or [])
    with_sample(plans or explained_plans(_PLANS), rays)
    memory = None if args.max_memory is None else arguments.parse_bytes(args.max_memory, "--max-memory")
    with StudyRun(args) as run:
        opened = run.open(spec).bare
        of_store = not opened.data.resident
        limit_memory(opened, memory)
        plans = with_sample(plans or explained_plans(_STORE_PLANS if of_store else _PLANS), rays)

        def moment(at: float) -> TimeSample:
            view = arguments.make_camera(camera_spec, opened, at, width_height)
            return TimeSample(opened.clamped(at), view, arguments.make_lights(light_specs, opened, at))

        moments = [
            moment(at) for at in ([args.time] if args.previous is None else [args.time - args.previous, args.time])
        ]
        say = lambda name, i: run.say(f"counting the steps of {name}", i, len(plans))
        explanation = explained(opened, moments, plans, spp=args.spp, threads=args.threads, say=say)
        run.save(lambda path: save_png(_picture(explanation), path), [path])
    if args.json:
        settings = {
            "output": str(path),
            "scene": args.record_of(args.scene),
            "triangles": opened.n_triangles,
            "time": moments[-1].time,
            "previous": args.previous,
            "camera": camera_fields(moments[-1].camera),
            "lights": [light_fields(each) for each in moments[-1].lights],
            "spp": args.spp,
            "srdh_rays": None if rays is None else console.srdh_rays_fields(rays),
            "threads": args.threads,
        }
        console.print_json({**settings, **_answer(explanation)})
    elif not args.quiet:
        console.print_fields(
            [
                ("picture", str(path)),
                ("scene", f"{args.record_of(args.scene)}, {counted(opened.n_triangles, 'triangle')}"),
                *_fields(explanation),
            ]
        )
        _print_tables(explanation)
    return 0


def _picture(explanation: "Explanation") -> NDArray[np.uint8]:
    """The panels of all plans, (H, W, 3)."""
    from ..picture.heat_maps import heat_map

    labels = [(str(one.plan), _label(explanation, one)) for one in explanation.plans]
    return heat_map([one.boxes for one in explanation.plans], explanation.asks, labels, _CAPTION)


def _label(explanation: "Explanation", one: "PlanSteps") -> str:
    each = f"{_each(one.box_tests, explanation.rays)} box tests per ray"
    return each if one is explanation.plans[0] else f"{each}, {_ratio(explanation, one)} times the first"


def _each(n: float, rays: int) -> str:
    """The mean per ray, as text."""
    return f"{n / rays:.4g}" if rays else "-"


def _ratio(explanation: "Explanation", one: "PlanSteps") -> str:
    first = explanation.plans[0].box_tests
    return f"{one.box_tests / first:.3f}" if first else "-"


def _answer(explanation: "Explanation") -> dict[str, Any]:
    """The steps for ``--json``. Values are null if there are no rays, or if the classes are unknown."""
    from ..trace.rays.single_rays import CLASSES

    first, rays = explanation.plans[0].box_tests, explanation.rays or float("nan")
    plans = [
        {
            "plan": str(one.plan),
            "one_by_one": one.classes is not None,
            "box_tests": one.box_tests,
            "box_tests_per_ray": one.box_tests / rays,
            "ratio": one.box_tests / first if first else None,
            "classes": None if one.classes is None else dict(zip(CLASSES, one.classes.tolist())),
            "triangle_tests": one.triangle_tests,
            "triangle_tests_per_ray": one.triangle_tests / rays,
            "depths": one.depths._asdict(),
        }
        for one in explanation.plans
    ]
    frequent = {"triangles": len(explanation.frequent), "rays": explanation.frequent_rays}
    answer = {"rays": explanation.rays, "blocked": explanation.blocked, "frequent": frequent}
    return {**answer, "plans": plans, "same_bits": True}


def _fields(explanation: "Explanation") -> Iterator[tuple[str, str]]:
    """The fields common to all plans."""
    rays, blocked = explanation.rays, explanation.blocked
    yield "rays", f"{rays:,}" + (f", {100 * blocked / rays:.3g} % of them blocked" if rays else "")
    if blocked:
        share = 100 * explanation.frequent_rays / blocked
        yield "frequent", f"{counted(len(explanation.frequent), 'triangle', 'block')} {share:.0f} % of the blocked rays"
    yield "bits", "identical for all plans"


def _print_tables(explanation: "Explanation") -> None:
    """Print the figures of each plan."""
    from ..trace.rays.single_rays import CLASSES

    steps = [
        (
            str(one.plan),
            _each(one.box_tests, explanation.rays),
            _ratio(explanation, one),
            *_classes(explanation, one),
            _each(one.triangle_tests, explanation.rays),
        )
        for one in explanation.plans
    ]
    print("Steps per ray")
    console.print_table(("plan", "box tests", "ratio", *CLASSES, "triangle tests"), steps, range(1, 7), _WIDTH)
    depths = [(str(one.plan), *(_depth(d) for d in one.depths[:4])) for one in explanation.plans]
    print("Boxes from the root to a leaf")
    head = "plan", "frequent blockers", "where rays end: mean", "median", "deepest leaf"
    console.print_table(head, depths, range(1, 5), _WIDTH)


def _classes(explanation: "Explanation", one: "PlanSteps") -> list[str]:
    """The box tests of each class per ray, and their shares, as text."""
    if one.classes is None or not one.box_tests:
        return ["-"] * 3
    return [f"{_each(n, explanation.rays)} ({100 * n / one.box_tests:.0f} %)" for n in one.classes.tolist()]


def _depth(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3g}"


# --- ``antumbra culling`` ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CullingArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .png file.  [default: SCENE's name-culling.png, here]",
            metavar="FILE",
            callback=writes(".png"),
        ),
    ] = None
    size: Annotated[str, typer.Option(help="Size of each picture in pixels.", metavar="WxH")] = "768x768"
    camera: CameraOption = None
    light: LightOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    spp: SppOption = 16
    culler: Annotated[str, typer.Option(help="Culling method; see antumbra plans.")] = "grid32"
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(CullingArguments)
def culling(args: CullingArguments) -> int:
    """Show which triangles survive pre-BVH culling.

    The picture has three panels: the camera's view, and the transparent scene from above and from the side. Orange
    triangles may intersect a shadow ray of the camera's pixels. All other triangles are blue, receivers white, and
    lights yellow.

    \b
    Examples
      antumbra culling
      antumbra culling "procedural:cellar?triangles=1M" -o cellar.png
      antumbra culling city.glb --light sun:1,-0.5,-1 --culler grid64 --json
    """
    spec, width_height = args.spec_of(args.scene), arguments.parse_size(args.size)
    camera_spec = None if args.camera is None else arguments.parse_camera(args.camera)
    light_specs = [arguments.parse_light(text) for text in args.light or []]

    from ..base.checks import spelling_hint
    from ..base.files import checked_output
    from ..engine.method_registry import CULLERS, find_method
    from ..picture.image_files import save_png, to_srgb8
    from .culling_picture import culling_picture

    path = checked_output(Path(f"{spec.stem}-culling.png"), (".png",)) if args.output is None else args.output
    if find_method("cull", args.culler) is None:
        hint = spelling_hint(args.culler, CULLERS)
        raise InputError(f"culler {args.culler!r} is unknown; {hint}choose one of {', '.join(CULLERS)}")
    with StudyRun(args) as run:
        opened = run.open(spec).bare
        opened.data.check_resident()
        view = arguments.make_camera(camera_spec, opened, args.time, width_height)
        lights = arguments.make_lights(light_specs, opened, args.time)
        picture = culling_picture(opened, view, lights, args.culler, spp=args.spp, time=args.time, threads=args.threads)
        run.save(lambda path: save_png(to_srgb8(picture.image, 1.0), path), [path])
    share = picture.kept / max(1, opened.n_triangles)
    answer = {
        "output": str(path),
        "culler": args.culler,
        "triangles": opened.n_triangles,
        "kept": picture.kept,
        "share": share,
        "cells": picture.cells,
        "marked": picture.marked,
        "sources": picture.sources,
        "targets": picture.targets,
        "seconds": picture.seconds,
    }
    cells = f"{picture.marked:,} of {picture.cells:,} marked, between {counted(picture.sources, 'box')} of receivers "
    fields = [
        ("picture", str(path)),
        ("scene", f"{args.record_of(args.scene)}, {counted(opened.n_triangles, 'triangle')}"),
        ("kept", f"{counted(picture.kept, 'triangle')}, {100 * share:.3g} %"),
        ("cells", f"{cells}and {picture.targets:,} of lights"),
        ("time", duration(picture.seconds)),
    ]
    return run.report(Summary(answer, fields), files=None)
