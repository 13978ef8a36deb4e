"""``antumbra view``: shows a scene in the browser."""

import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import typer

from ..errors import InputError
from . import arguments
from .arguments import limit_memory, open_scene
from .console import ProgressDisplay, say
from .options import (
    SCENE_HELP,
    CameraOption,
    CrsOption,
    DegreesOption,
    MaxMemoryOption,
    NorthOption,
    PictureLightOption,
    PlanOption,
    Quiet,
    SkyOption,
    Threads,
    TimeOption,
    TimezoneOption,
    UpOption,
    takes,
)

_SIZE = 1024, 1024  # of the camera before the browser says its own


@dataclass(frozen=True)
class ViewArguments:
    """The parameters of ``antumbra view``."""

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE
    port: Annotated[int, typer.Option(help="Port of the page; 0: any free one.", min=0, max=65535)] = 8080
    host: Annotated[
        str,
        typer.Option(help="Address to listen at; 0.0.0.0 lets all look who can reach it and know its token."),
    ] = "127.0.0.1"
    allow_host: Annotated[
        list[str] | None, typer.Option(help="Another name under which browsers may reach the page. Repeatable.")
    ] = None
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Open no browser.")] = False
    camera: CameraOption = None
    light: PictureLightOption = None
    sky: SkyOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    latitude: DegreesOption = None
    longitude: DegreesOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    plan: PlanOption = None
    threads: Threads = None
    max_memory: MaxMemoryOption = None
    quiet: Quiet = False


@takes(ViewArguments)
def view(args: ViewArguments) -> int:
    """Show SCENE in the browser, until Ctrl-C.

    Drag to turn, scroll to come nearer. While the camera moves, the browser shows triangles with baked light. As soon
    as it rests, traced pictures appear, from coarse to fine. Click a surface: the panel says which lights it sees and
    which triangle blocks them. Lights have handles. Sliders move the sun and the animation. With a place on Earth
    (--latitude and --longitude, or --crs), the sun follows a day and an hour.

    \b
    Examples
      antumbra view
      antumbra view sponza.glb --light sphere:0,8,0:0.3@200
      antumbra view robot.glb --time 1.5 --port 9000
      antumbra view city.city.json --timezone Europe/Amsterdam
      antumbra view city.antumbra --max-memory 2G --no-browser
    """
    spec = arguments.parse_scene(args.scene)
    asked_camera = None if args.camera is None else arguments.parse_camera(args.camera)
    asked_lights = [arguments.parse_light(text) for text in args.light or []]
    asked_sky = None if args.sky is None else arguments.parse_sky(args.sky)
    memory = None if args.max_memory is None else arguments.parse_bytes(args.max_memory, "--max-memory")

    from ..extras import import_extra
    from ..jobs.sun.location import given_position, place_of
    from ..viewer.viewer_page import checked_port
    from ..viewer.viewer_page import view as shown

    import_extra("viser", "antumbra view", "view")
    port = checked_port(args.host, args.port)
    names = "latitude", "longitude", "north", "timezone"
    position = given_position(**{name: getattr(args, name) for name in names})
    with ProgressDisplay(args.quiet) as display:
        display.say("reading the scene")
        opened = open_scene(spec, None if args.up is None else args.up.value, args.quiet, args.crs)
        limit_memory(opened, memory)
        place = place_of(opened, **position)
        if place is None and (args.north is not None or args.timezone is not None):
            raise InputError("--north and --timezone need a place; give --latitude and --longitude, or --crs")
        time = opened.clamped(args.time)
        camera = None if asked_camera is None else arguments.make_camera(asked_camera, opened, time, _SIZE)
        lights = None
        if asked_lights or asked_sky is not None:
            lights = arguments.make_picture_lights(asked_lights, asked_sky, opened, time)
        display.say("preparing the first picture")
        viewer = shown(
            opened, lights, camera=camera, time=time, plan=args.plan, threads=args.threads, max_memory=memory,
            place=place, port=port, host=args.host, allow_host=args.allow_host or (), browser=False,
        )  # fmt: skip
    with viewer:
        if not args.quiet:
            print(f"{opened.name} is at {viewer.url} (Ctrl-C ends it)", flush=True)
        if not args.no_browser and not webbrowser.open(viewer.url):
            say(f"no browser was found; open {viewer.url}")
        with suppress(KeyboardInterrupt):
            viewer.wait()
    return 0
