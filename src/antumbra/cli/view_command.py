"""``antumbra view``: show a scene in the browser."""

import shlex
import webbrowser
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..base.errors import InputError
from . import arguments
from .console import ProgressDisplay, say
from .options import (
    CameraOption,
    CrsOption,
    LatitudeOption,
    LongitudeOption,
    MaxMemoryOption,
    NorthOption,
    PictureLightOption,
    PlanOption,
    Quiet,
    SceneArgument,
    SkyOption,
    Threads,
    TimeOption,
    TimezoneOption,
    UpOption,
    position_of,
    takes,
)
from .scene_arguments import DEFAULT_SCENE, SceneArguments, limit_memory, open_scene

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..sun.location import Place

_SIZE = 1024, 1024  # of the camera until the browser reports its size


@dataclass(frozen=True)
class ViewArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    port: Annotated[int, typer.Option(help="Port of the page; 0: any free port.", min=0, max=65535)] = 8080
    host: Annotated[
        str,
        typer.Option(help="Address to listen on; 0.0.0.0 exposes the page to the network, protected by a token."),
    ] = "127.0.0.1"
    allow_host: Annotated[
        list[str] | None,
        typer.Option(help="Additional host name of the page, such as that of a proxy; may be repeated."),
    ] = None
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Do not open a browser.")] = False
    camera: CameraOption = None
    light: PictureLightOption = None
    sky: SkyOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    latitude: LatitudeOption = None
    longitude: LongitudeOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    plan: PlanOption = None
    threads: Threads = None
    max_memory: MaxMemoryOption = None
    quiet: Quiet = False


@takes(ViewArguments)
def view(args: ViewArguments) -> int:
    """Show SCENE in the browser.

    Drag to rotate, scroll to zoom, and press Ctrl-C to stop. While the camera moves, the browser shows a mesh with
    baked light; when it stops, traced pictures appear, from coarse to fine. Click a surface to list the lights it sees
    and the triangles that block the others. Drag the handles of lights to move them, and use sliders for the sun and
    the animation. If the place is known (by --latitude and --longitude, or a CRS), the sun follows a date and time.

    \b
    Examples
      antumbra view
      antumbra view sponza.glb --light sphere:0,8,0:0.3@200
      antumbra view robot.glb --time 1.5 --port 9000
      antumbra view city.city.json --timezone Europe/Amsterdam
      antumbra view city.antumbra --max-memory 2G --no-browser
    """
    spec = args.spec_of(args.scene)
    camera_spec = None if args.camera is None else arguments.parse_camera(args.camera)
    light_specs = [arguments.parse_light(text) for text in args.light or []]
    sky = None if args.sky is None else arguments.parse_sky(args.sky)
    memory = None if args.max_memory is None else arguments.parse_bytes(args.max_memory, "--max-memory")

    from ..base.extras import import_extra
    from ..scene.lights import DirectionalLight
    from ..viewer.viewer_page import checked_port, name_scene
    from ..viewer.viewer_page import view as open_viewer

    import_extra("viser", "antumbra view", "view")
    port = checked_port(args.host, args.port)
    position = position_of(args)
    with ProgressDisplay(args.quiet) as display:
        display.say("reading the scene")
        opened = open_scene(spec, args.quiet)
        memory = limit_memory(opened, memory)
        place = _place_of(opened, position)
        if place is None and (args.north is not None or args.timezone is not None):
            raise InputError("--north and --timezone need a place; give --latitude and --longitude, or --crs")
        time = opened.clamped(args.time)
        camera = None if camera_spec is None else arguments.make_camera(camera_spec, opened, time, _SIZE)
        lights = None
        if light_specs or sky is not None:
            lights = arguments.make_picture_lights(light_specs, sky, opened, time)
        display.say("preparing the first picture")
        viewer = open_viewer(
            opened,
            lights,
            camera=camera,
            time=time,
            plan=args.plan,
            threads=args.threads,
            max_memory=memory,
            place=place,
            port=port,
            host=args.host,
            allow_host=args.allow_host or (),
            browser=False,
        )
    name_scene(viewer, _source_of(args))
    with viewer:
        if not args.quiet:
            if position and not any(isinstance(light, DirectionalLight) for light in viewer.lights):
                say("note: no sun follows the date, since there are only other lights; add one: --light sun:1,-1,0.2")
            print(f"{opened.name} is at {viewer.url} (press Ctrl-C to stop)", flush=True)
        if not args.no_browser and not webbrowser.open(viewer.url):
            say(f"no browser was found; open {viewer.url}")
        with suppress(KeyboardInterrupt):
            viewer.wait()
    return 0


def _source_of(args: ViewArguments) -> str:
    """SCENE and the options that describe it, as words of another command."""
    words = [args.scene]
    for name in "height", "terrain", "unit", "add", "remove", "up", "crs":
        value = getattr(args, name)
        values = value if isinstance(value, list) else [] if value is None else [value]
        words += [f"--{name}={each}" for each in values]
    return shlex.join(map(str, words))


def _place_of(scene: "AnyScene", position: dict[str, Any]) -> "Place | None":
    """The place that the options or the CRS name; None, with a note, if a CRS, such as one in degrees, has none."""
    from ..sun.location import place_of

    try:
        return place_of(scene, **position)
    except InputError as error:
        if position:
            raise
        say(f"note: the sun follows no date; {error}")
        return None
