"""``antumbra page``: a scene as one HTML file with exact shadows."""

from dataclasses import dataclass
from datetime import date, datetime, time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..base.errors import InputError
from ..base.files import checked_output
from ..cli import arguments
from ..cli.console import ProgressDisplay, say
from ..cli.options import (
    CameraOption,
    CrsOption,
    DegreesOption,
    NorthOption,
    Quiet,
    SceneArgument,
    TimeOption,
    TimezoneOption,
    UpOption,
    position_of,
    takes,
    writes,
)
from ..cli.scene_arguments import SceneArguments, open_scene

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..sun.location import Place

_NOON = time(14)  # of the first picture
_SIZE = 1280, 800  # for which the first view is framed


@dataclass(frozen=True)
class PageArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="The file, .html.  [default: the scene's name]",
            show_default=False,
            callback=writes(".html"),
        ),
    ] = None
    title: Annotated[
        str | None, typer.Option(help="Title of the page.  [default: the scene's name]", show_default=False)
    ] = None
    credits: Annotated[
        str | None, typer.Option(help="Author and licence of the model, below the picture.", show_default=False)
    ] = None
    language: Annotated[Literal["en", "de"], typer.Option(help="Language of the page.")] = "en"
    date: Annotated[
        str | None,
        typer.Option(
            help="Day, or day and local time, of the first picture, such as 2026-06-21T15:30.  [default: today, 14:00]",
            metavar="DATE",
            show_default=False,
        ),
    ] = None
    camera: CameraOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    latitude: DegreesOption = None
    longitude: DegreesOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    quiet: Quiet = False


@takes(PageArguments)
def page(args: PageArguments) -> int:
    """Write SCENE as one HTML file with exact shadows, which any browser opens offline.

    The page shows the shadows of the sun at any date and time, and tells of each clicked place when it has sun and what
    blocks it. It checks its own bits against those of this program when it opens. The place on Earth is that of the
    CRS, or --latitude and --longitude; without one, the sun is set by hand.

    \b
    Examples
      antumbra page city.city.json --timezone Europe/Amsterdam -o city.html
      antumbra page model.glb --latitude 48.14 --longitude 11.58 --timezone Europe/Berlin --language de
      antumbra page example:hills --title Hills --credits "Example scene, CC0"
    """
    spec = args.spec_of(args.scene)
    when = _when_of(args.date)
    camera_spec = None if args.camera is None else arguments.parse_camera(args.camera)
    position = position_of(args)
    path = args.output or checked_output(Path(f"{spec.stem}.html"), (".html",))

    from .page_export import PageOptions, check_scene, write_page

    with ProgressDisplay(args.quiet) as display:
        display.say("reading the scene")
        scene = open_scene(spec, args.quiet)
        check_scene(scene)
        place = _place_of(scene, position)
        moment = scene.clamped(args.time)
        camera = None if camera_spec is None else arguments.make_camera(camera_spec, scene, moment, _SIZE)
        display.say("packing the page")
        options = PageOptions(args.title or scene.name, when, place, args.credits or "", args.language)
        report = write_page(scene, path, options, camera, moment)
    if not args.quiet:
        for note in report.notes:
            say(f"note: {note}")
        if scene.animated:
            say(f"note: the scene is animated, and the page shows it at {moment:g} s")
        if place is None:
            say("note: the page has no dates, since the scene has no place; give --latitude and --longitude, or --crs")
        elif place.timezone is None:
            say("note: times are in the whole-hour zone of the longitude, without summer time; give --timezone")
        print(f"{path}  {report.triangles:,} triangles, {report.size / 1e6:.2f} MB", flush=True)
    return 0


def _when_of(text: str | None) -> datetime:
    """The local time of an option."""
    if text is None:
        return datetime.combine(date.today(), _NOON)
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        when = None
    if when is None or when.tzinfo is not None or not 1900 <= when.year <= 2199:
        raise InputError(f"--date {text[:40]!r} is not a day; write 2026-06-21, or 2026-06-21T15:30 in local time")
    return when if len(text) > len("2026-06-21") else datetime.combine(when.date(), _NOON)


def _place_of(scene: "AnyScene", position: dict[str, Any]) -> "Place | None":
    """The place that the options or the CRS name; None if neither does."""
    from ..sun.location import place_of

    place = place_of(scene, **position)
    if place is None and position:
        raise InputError("--north and --timezone need a place; give --latitude and --longitude, or --crs")
    return place
