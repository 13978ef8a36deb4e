"""``antumbra render``: from a scene to a picture with exact shadows."""

from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ..errors import InputError
from . import arguments, lean, report
from .activity import Activity
from .opening import open_scene
from .options import SCENE_HELP, GBufferBy, Json, Quiet, UpOption

if TYPE_CHECKING:
    from ..renderer import Frame
    from ..scene.camera import Camera
    from ..scene.lights import Light
    from ..scene.scene import Scene


def render(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="A .png or .exr file.  [default: SCENE's name.png, here]", metavar="FILE"),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the picture in pixels.", metavar="WxH")] = "1024x1024",
    camera: Annotated[
        str | None, typer.Option(help="An index, or POSITION:TARGET[:VFOV].", metavar="CAMERA", show_default=False)
    ] = None,
    light: Annotated[
        list[str] | None,
        typer.Option(help="An index, or KIND:...[@INTENSITY]; may be repeated.", metavar="LIGHT", show_default=False),
    ] = None,
    ao: Annotated[
        str | None,
        typer.Option(
            help="Ambient occlusion by what is nearer than RADIUS (inf: by everything), besides the lights.",
            metavar="RADIUS[@INTENSITY]",
            show_default=False,
        ),
    ] = None,
    vpl: Annotated[
        int | None,
        typer.Option(
            help="Instead of ambient light, light that bounces once: photons of the first light become point lights.",
            min=1,
            max=16384,
            metavar="PHOTONS",
            show_default=False,
        ),
    ] = None,
    time: Annotated[float, typer.Option(help="Seconds into the animation.")] = 0.0,
    up: UpOption = None,
    spp: Annotated[int, typer.Option(help="Shadow rays for each pixel and light.", min=1, max=1024)] = 16,
    sampler: Annotated[
        str, typer.Option(help="Points on the light: larcher-pillichshammer, hammersley or sobol.", metavar="NAME")
    ] = "larcher-pillichshammer",
    filter: Annotated[bool, typer.Option("--filter", help="Smooth noise in penumbrae over 4x4 pixels.")] = False,
    adaptive: Annotated[
        bool, typer.Option("--adaptive", help="Refine penumbrae with more rays, and edges by sub-pixels.")
    ] = False,
    adaptive_spp: Annotated[
        int | None,
        typer.Option(
            help="Shadow rays for each refined pixel and light; implies --adaptive.  [default: 4 times --spp]",
            min=1,
            max=1024,
            show_default=False,
        ),
    ] = None,
    plan: Annotated[str, typer.Option(help="Which methods answer; see antumbra plans.")] = "bsah+multifrusta",
    gbuffer: Annotated[GBufferBy, typer.Option(help="How it is found what pixels see.")] = GBufferBy.raster,
    threads: Annotated[
        int | None, typer.Option(help="Threads to use.  [default: all cores]", min=1, show_default=False)
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(help="Factor on the light of a .png.  [default: automatic]", show_default=False),
    ] = None,
    counters: Annotated[bool, typer.Option("--counters", help="Count rays, nodes and tests exactly.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Render SCENE with exact shadows.

    Without arguments, the embedded atrium is rendered to antumbra.png. Cameras and lights come from the file at the
    time given; a scene without a camera is shown whole, one without lights gets a square light above it.

    \b
    CAMERA
      1                         the second camera of the file
      0,1.7,8:0,1,0             from 0,1.7,8 towards 0,1,0
      0,1.7,8:0,1,0:45          ... with a vertical field of view of 45 degrees instead of 60

    \b
    LIGHT
      0                                    the first light of the file
      point:X,Y,Z
      quad:CX,CY,CZ:UX,UY,UZ:VX,VY,VZ      a parallelogram around C with the edges U and V
      disk:CX,CY,CZ:NX,NY,NZ:RADIUS        a disk around C that faces N
      sphere:CX,CY,CZ:RADIUS
      sun:DX,DY,DZ[:ANGULAR_DIAMETER]      shines along D; 0.53 degrees wide, as the sun
      ...@INTENSITY                        candela (sun: lux), 1 by default

    \b
    Examples
      antumbra render
      antumbra render sponza.glb --size 1920x1080 --spp 64 -o sponza.exr
      antumbra render city.ply --up z --light sun:1,0.5,-1 --camera=-90,-60,40:0,0,5
      antumbra render hall.glb --light point:0,3,0@50 --light sphere:2,1,2:0.2@10 --counters
      antumbra render hall.glb --ao 2 --spp 64
      antumbra render hall.glb --vpl 1000
      antumbra render robot.glb --time 1.5 --filter --adaptive
      antumbra render robot.glb --time 1.5 --json
      antumbra render "procedural:city?triangles=500k&seed=3"
    """
    spec, width_height = arguments.parse_scene(scene), arguments.parse_size(size)
    asked_camera = None if camera is None else arguments.parse_camera(camera)
    asked_lights = [arguments.parse_light(text) for text in light or []]
    ambient = [] if ao is None else [arguments.parse_ambient(ao)]
    if ao is not None and vpl is not None:
        raise InputError("--ao dims the ambient light that --vpl replaces; leave one of them out")
    if adaptive and adaptive_spp is None:
        adaptive_spp = min(4 * spp, 1024)
    lean.import_numba()
    path = _checked(output, spec, plan, sampler, spp, exposure)

    from .. import render as render_frame
    from .. import virtual_point_lights

    with Activity(quiet) as activity:
        activity.say("reading the scene")
        clock = [perf_counter()]
        opened = open_scene(spec, None if up is None else up.value, quiet)
        clock.append(perf_counter())
        view = arguments.make_camera(asked_camera, opened, time, width_height)
        lights = arguments.make_lights(asked_lights, opened, time)
        bounced = [] if vpl is None else [virtual_point_lights(opened, lights[0], vpl, time=time, threads=threads)]
        lights = lights + ambient + bounced
        activity.say("preparing")
        runs = len(lights) * (1 if adaptive_spp is None else 3)
        frame = render_frame(
            opened, view, lights, spp=spp, plan=plan, time=time, threads=threads, counters=counters,
            gbuffer=gbuffer.value, sampler=sampler, filter=filter, adaptive=adaptive_spp,
            progress=activity.parts("tracing shadow rays", runs),
        )  # fmt: skip
        activity.say("writing the picture")
        clock.append(perf_counter())
        exposure = _save(frame, path, exposure)
        clock.append(perf_counter())
    moment = min(max(time, 0.0), opened.duration)
    done = Done(scene, opened, moment, view, lights, frame, path, exposure, clock[1] - clock[0], clock[3] - clock[2])
    if json:
        asked = {"spp": spp, "sampler": sampler, "filter": filter, "adaptive": adaptive_spp, "plan": plan}
        asked |= {"gbuffer": gbuffer.value, "threads": threads}
        report.print_json(_answer(done, asked))
    elif not quiet:
        report.print_fields(_fields(done, spp, adaptive_spp, plan))


class Done(NamedTuple):
    """A rendering and what went into it."""

    source: str  # as it was written on the command line
    scene: "Scene"
    time: float  # seconds, clamped to the animation
    camera: "Camera"
    lights: "list[Light]"
    frame: "Frame"
    path: Path
    exposure: float | None  # None: the file holds linear light
    load: float  # seconds
    save: float  # seconds


def _checked(output, spec, plan, sampler, spp, exposure) -> Path:
    """The path of the picture; everything that can be found wrong before a scene is read, is."""
    from ..image.save import check_output, checked_exposure
    from ..plan import parse_plan
    from ..query.sampling import sample_sets

    path = check_output(Path(spec.stem + ".png") if output is None else output)
    if exposure is not None:
        checked_exposure(exposure)
    parse_plan(plan)
    sample_sets(spp, sampler)
    return path


def _save(frame, path: Path, exposure: float | None) -> float | None:
    """Write the picture; the exposure that was used (None: it has none)."""
    from ..image.save import frame_exposure

    if path.suffix.lower() == ".exr":
        exposure = None
    elif exposure is None:
        exposure = frame_exposure(frame)
    frame.save(path, exposure)
    return exposure


def _answer(done: Done, asked: dict) -> dict:
    """What ``--json`` says."""
    scene, camera, frame = done.scene, done.camera, done.frame
    seen = frame.gbuffer.face >= 0
    return {
        "output": str(done.path),
        "scene": {
            "source": done.source,
            "name": scene.name,
            "triangles": scene.n_triangles,
            "duration": scene.duration,
            "up": scene.up,
            "notes": list(scene.notes),
        },
        "time": done.time,
        "camera": report.camera_fields(camera),
        "lights": [report.light_fields(light) for light in done.lights],
        **asked,
        "exposure": done.exposure,
        "seen": int(seen.sum()),
        "lit": [float(v[seen].mean()) if seen.any() else None for v in frame.visibility],
        "refined": None if frame.refined is None else _refined(frame),
        "rays": frame.rays,
        "mrays_per_second": _speed(frame),
        "load": done.load,
        "timings": frame.timings,
        "save": done.save,
        "counters": frame.counters,
        "uncertain_fraction": _uncertain(frame),
    }


def _fields(done: Done, spp: int, adaptive: int | None, plan: str) -> Iterator[tuple[str, str]]:
    """What a person is told."""
    scene, camera, frame = done.scene, done.camera, done.frame
    yield "picture", str(done.path)
    moment = f", at {done.time:g} of {scene.duration:g} s" if scene.animated else ""
    yield "scene", f"{done.source}, {scene.n_triangles:,} triangles{moment}"
    yield "camera", f"{camera.width}x{camera.height} from {report.vector(camera.position)}"
    yield "lights", ", ".join(type(light).__name__ for light in done.lights)
    if not (frame.gbuffer.face >= 0).any():
        yield "", "the camera sees no surface"
    speed, samples = _speed(frame), [light.samples(spp) for light in done.lights]
    each = f"{spp} a pixel and light" if set(samples) == {spp} else f"{' + '.join(map(str, samples))} a pixel"
    finer = "" if adaptive is None else f", {adaptive} where refined"
    yield "rays", f"{frame.rays:,} ({each}{finer})" + (f", {speed:.1f} million a second" if speed else "")
    if frame.refined is not None:
        yield "refined", f"{100.0 * _refined(frame):.3g} % of the pixels"
    yield "plan", plan
    phases = {"load": done.load, **frame.timings, "save": done.save}
    frame_seconds = phases.pop("total")
    yield "time", ", ".join(f"{name} {report.duration(s)}" for name, s in phases.items() if s > 0.0)
    yield "frame", f"{report.duration(frame_seconds)} without load and save"
    for name, value in (frame.counters or {}).items():
        yield name.replace("_", " "), f"{value:,}"
    if frame.counters is not None:
        yield "uncertain", f"{_uncertain(frame):.2g} of the triangle tests were left to float64"


def _speed(frame) -> float | None:
    seconds = frame.timings["trace"]
    return frame.rays / seconds / 1e6 if frame.rays and seconds > 0.0 else None


def _refined(frame) -> float:
    """The share of all pixels that were refined."""
    return float(frame.refined.mean())


def _uncertain(frame) -> float | None:
    """The share of the triangle tests that float32 left to float64."""
    if frame.counters is None:
        return None
    return frame.counters["uncertain"] / max(1, frame.counters["triangle_tests"])
