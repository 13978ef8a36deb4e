"""``antumbra culling``: shows the triangles that pre-BVH culling leaves."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .options import SCENE_HELP, CameraOption, Json, LightOption, Quiet, SppOption, Threads, TimeOption, UpOption
from .outputs import writes
from .progress import ProgressDisplay
from .sceneinput import in_memory, open_scene


def culling(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .png file.  [default: SCENE's name-culling.png, here]",
            metavar="FILE",
            callback=writes(".png"),
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of each of the pictures.", metavar="WxH")] = "768x768",
    camera: CameraOption = None,
    light: LightOption = None,
    time: TimeOption = 0.0,
    up: UpOption = None,
    spp: SppOption = 16,
    culler: Annotated[str, typer.Option(help="Which one; see antumbra plans.")] = "grid32",
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show which triangles of SCENE pre-BVH culling leaves.

    The picture has three panels: the camera's view, then the scene from above and from the side, drawn transparent.
    Orange triangles may meet a shadow ray of the camera's pixels. All other triangles are blue, receivers are white,
    and lights are yellow.

    \b
    Examples
      antumbra culling
      antumbra culling "procedural:cellar?triangles=1M" -o cellar.png
      antumbra culling city.glb --light sun:1,-0.5,-1 --culler grid64 --json
    """
    spec, width_height = arguments.parse_scene(scene), arguments.parse_size(size)
    asked_camera = None if camera is None else arguments.parse_camera(camera)
    asked_lights = [arguments.parse_light(text) for text in light or []]

    from ..checks import near
    from ..methods import CULLERS, find_method
    from ..output import checked_output
    from ..picture.image_files import save_png, to_srgb8
    from ..rendering.culling_picture import culling_picture

    path = checked_output(Path(f"{spec.stem}-culling.png"), (".png",)) if output is None else output
    if find_method("cull", culler) is None:
        raise InputError(f"culler {culler!r} is unknown; {near(culler, CULLERS)}choose one of {', '.join(CULLERS)}")
    with ProgressDisplay(quiet) as display:
        display.say("reading the scene")
        opened = in_memory(open_scene(spec, None if up is None else up.value, quiet))
        view = arguments.make_camera(asked_camera, opened, time, width_height)
        lights = arguments.make_lights(asked_lights, opened, time)
        display.say("preparing")
        shown = culling_picture(opened, view, lights, culler, spp=spp, time=time, threads=threads)
        display.say("writing the picture")
        save_png(to_srgb8(shown.image, 1.0), path)
    share = shown.kept / max(1, opened.n_triangles)
    answer = {
        "output": str(path),
        "culler": culler,
        "triangles": opened.n_triangles,
        "kept": shown.kept,
        "share": share,
        "cells": shown.cells,
        "marked": shown.marked,
        "sources": shown.sources,
        "targets": shown.targets,
        "seconds": shown.seconds,
    }
    if json:
        report.print_json(answer)
    elif not quiet:
        report.print_fields(
            [
                ("picture", str(path)),
                ("scene", f"{scene}, {opened.n_triangles:,} triangles"),
                ("left", f"{shown.kept:,} triangles, {100 * share:.3g} %"),
                ("cells", f"{shown.marked:,} of {shown.cells:,} marked, between {shown.sources:,} boxes of receivers "
                          f"and {shown.targets:,} of lights"),
                ("time", report.duration(shown.seconds)),
            ]
        )  # fmt: skip
