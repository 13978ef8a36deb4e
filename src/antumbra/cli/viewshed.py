"""``antumbra viewshed``: how many observers see each sensor of a scene."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .joboptions import ColumnOption, CrsOption, OutputsOption, PlanOption, SensorsOption, points_or_file
from .options import SCENE_HELP, CameraOption, Json, Quiet, Threads, TimeOption, UpOption, takes
from .outputs import writes
from .progress import ProgressDisplay
from .sceneinput import open_scene

_SIZE = 1024, 768  # of pictures


@dataclass(frozen=True)
class ViewshedArguments:
    """The parameters of ``antumbra viewshed``."""

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE
    sensors: SensorsOption = "face"
    observer: Annotated[
        list[str] | None, typer.Option(help="An observer; may be repeated.", metavar="X,Y,Z", show_default=False)
    ] = None
    observers: Annotated[
        Path | None, typer.Option(help="A file of observers: .csv, .parquet, .npy or .npz.", show_default=False)
    ] = None
    eye_height: Annotated[float, typer.Option(help="World units that eyes are above the observers.")] = 0.0
    on_surface: Annotated[
        bool, typer.Option("--on-surface", help="Put each observer on the highest surface at its place first.")
    ] = False
    min_distance: Annotated[float, typer.Option(help="World units from the eye; nearer sensors are not seen.")] = 0.0
    max_distance: Annotated[
        float | None,
        typer.Option(help="World units; farther ones are not seen.  [default: no limit]", show_default=False),
    ] = None
    azimuth: Annotated[
        str, typer.Option(help="Compass directions, degrees clockwise from north.", metavar="FROM:TO")
    ] = "0:360"
    elevation: Annotated[str, typer.Option(help="Degrees above the horizontal.", metavar="LOWEST:HIGHEST")] = "-90:90"
    curvature: Annotated[bool, typer.Option("--curvature", help="Let the earth curve away from each observer.")] = False
    refraction: Annotated[float, typer.Option(help="Share of the curvature that bent light takes back.")] = 0.13
    earth_radius: Annotated[float, typer.Option(help="World units.")] = 6_371_000.0
    output: OutputsOption = None
    column: ColumnOption = None
    camera: CameraOption = None
    bits: Annotated[
        Path | None,
        typer.Option(
            help="A .npy file: which observer sees which sensor, 64 observers in a word.",
            show_default=False,
            callback=writes(".npy"),
        ),
    ] = None
    plan: PlanOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(ViewshedArguments)
def viewshed(given: ViewshedArguments) -> int:
    """Count the observers that see each sensor of SCENE.

    The columns of the result are seen (the number of observers), first and nearest (their numbers from 0, -1: none) and
    distance. A raster becomes a map or a GeoTIFF, other sensors a view of the scene. raster:2+1.6 asks for targets 1.6
    above the highest surfaces. Distances are straight, from the eye.

    \b
    Examples
      antumbra viewshed --observer 0,1.7,8 -o seen.png
      antumbra viewshed city.glb --up z --sensors raster:1 --observer 10,20,0 --on-surface --eye-height 1.6 -o map.tif
      antumbra viewshed city.glb --up z --sensors grid:2 --observers people.csv --max-distance 300 -o seen.png
      antumbra viewshed hills.ply --up z --observer 0,0,900 --curvature --azimuth 350:10 -o seen.parquet
    """
    spec = arguments.parse_scene(given.scene)
    angles = (
        arguments.parse_interval(given.azimuth, "--azimuth"),
        arguments.parse_interval(given.elevation, "--elevation"),
    )
    asked_camera = None if given.camera is None else arguments.parse_camera(given.camera)

    from ..jobs.formats import writer_of
    from ..jobs.readsensors import check_file_crs, check_sensors, kind_of, sensors_of
    from ..jobs.rowfile import write_rows
    from ..jobs.sight.viewshed import viewshed as seen_from
    from ..output import replacing

    check_sensors(given.sensors)
    outputs = given.output or []
    for path in outputs:
        writer_of(path, kind_of(given.sensors))
    bits = given.bits
    eyes = points_or_file(given.observer, given.observers, "--observer", "--observers")
    if eyes is None:
        raise InputError("there is no observer: give --observer X,Y,Z or --observers FILE")
    with ProgressDisplay(given.quiet) as display:
        display.say("reading the scene")
        opened = open_scene(spec, None if given.up is None else given.up.value, given.quiet, given.crs)
        check_file_crs(opened, given.observers)
        display.say("preparing")
        sensors = sensors_of(given.sensors, opened, given.threads)
        camera = None if asked_camera is None else arguments.make_camera(asked_camera, opened, given.time, _SIZE)
        start = perf_counter()
        found = seen_from(
            opened, sensors, eyes.points, eye_height=given.eye_height, on_surface=given.on_surface,
            min_distance=given.min_distance, max_distance=given.max_distance, azimuth=angles[0], elevation=angles[1],
            curvature=given.curvature, refraction=given.refraction, earth_radius=given.earth_radius,
            bits=bits is not None, plan=given.plan, time=given.time, threads=given.threads,
        )  # fmt: skip
        seconds = perf_counter() - start
        display.say("writing the results")
        table = found.table
        table.camera = camera
        for path in outputs:
            table.save(path, given.column)
        if bits is not None and found.bits is not None:
            with replacing(bits) as temporary:
                write_rows(temporary, found.bits)
    answer = _answer(table, len(eyes), seconds)
    written = [str(path) for path in [*outputs, *([bits] if bits else [])]]
    if given.json:
        report.print_json({"scene": opened.name, **answer, "outputs": written})
    elif not given.quiet:
        report.print_fields([*_fields(answer), *(("written", path) for path in written)])
    return 0


def _answer(table, observers: int, seconds: float) -> dict:
    """The fields of ``--json``."""
    counted = table.sensors.covered
    seen, sensors = table["seen"][counted] > 0, int(counted.sum())
    answer = {"sensors": sensors, "observers": observers, "seen": int(seen.sum()), "seconds": seconds}
    if table.sensors.areas is not None:
        areas = table.sensors.areas[counted]
        answer |= {"area": float(areas.sum()), "area_seen": float(areas[seen].sum())}
    return answer


def _fields(answer: dict) -> list[tuple[str, str]]:
    n, seen = answer["sensors"], answer["seen"]
    fields = [("sensors", f"{n:,}"), ("observers", f"{answer['observers']:,}")]
    fields.append(("seen by any", f"{seen:,} ({100.0 * seen / max(n, 1):.1f} %)"))
    if "area" in answer:
        fields.append(("area seen", f"{answer['area_seen']:,.6g} of {answer['area']:,.6g}"))
    return [*fields, ("time", report.duration(answer["seconds"]))]
