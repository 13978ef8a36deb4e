"""``antumbra page``: a scene as one HTML file with exact shadows."""

from dataclasses import dataclass
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..base.errors import InputError
from ..base.files import checked_output
from ..base.wording import counted
from ..cli import arguments
from ..cli.console import ProgressDisplay, say
from ..cli.options import (
    CameraOption,
    CrsOption,
    LatitudeOption,
    LongitudeOption,
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
from ..cli.scene_arguments import Added, SceneArguments, SceneSpec, open_change, open_scene, parse_placed

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..sun.location import Place

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
        str | None,
        typer.Option(
            help="Author and licence of the model, below the picture.  [default: those in the glTF or CityJSON file]",
            show_default=False,
        ),
    ] = None
    variant: Annotated[
        str | None,
        typer.Option(
            help="Another state of the scene, behind a divider: SCENE is before, this is after. "
            "--add and --remove make such a state, too.",
            metavar="FILE[?OPTIONS]",
            show_default=False,
        ),
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
    latitude: LatitudeOption = None
    longitude: LongitudeOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    quiet: Quiet = False


@takes(PageArguments)
def page(args: PageArguments) -> int:
    """Write SCENE as one HTML file that works offline.

    The page shows the shadows of the sun at any date and time, and for each clicked place, when it has sun and what
    blocks it. It checks its own bits against those of this program when it opens. The place on Earth is that of the
    CRS, or --latitude and --longitude; without one, the sun is set by hand. With --variant, --add or --remove, a
    divider separates the states before and after, and the page shows what changes at a clicked place.

    \b
    Examples
      antumbra page city.city.json --timezone Europe/Amsterdam -o city.html
      antumbra page model.glb --latitude 48.14 --longitude 11.58 --timezone Europe/Berlin --language de
      antumbra page city.city.json --add "tower.obj?up=z" -o tower.html
      antumbra page example:hills --title Hills --credits "Example scene, CC0"
    """
    spec = args.spec_of(args.scene)
    camera_spec = None if args.camera is None else arguments.parse_camera(args.camera)
    position = position_of(args)
    variant = _variant_of(args, spec)
    path = args.output or checked_output(Path(f"{spec.stem}.html"), (".html",))

    from .page_export import PageOptions, check_scene, write_page
    from .scene_page import NOON, local_time

    when = datetime.combine(date.today(), NOON) if args.date is None else local_time(args.date, "--date")

    with ProgressDisplay(args.quiet) as display:
        display.say("reading the scene")
        changes = variant is not None or spec.added or spec.removed
        change = open_change(spec, args.quiet, variant) if changes else None
        scene = open_scene(spec, args.quiet) if change is None else change.after
        check_scene(scene)
        place = _place_of(scene, position)
        moment = scene.clamped(args.time)
        camera = None if camera_spec is None else arguments.make_camera(camera_spec, scene, moment, _SIZE)
        display.say("packing the page")
        options = PageOptions(
            args.title or scene.name, when, place, args.credits or _credits_in(spec, variant), args.language
        )
        report = write_page(scene, path, options, camera, moment, before=None if change is None else change.before)
    if not args.quiet:
        for note in report.notes:
            say(f"note: {note}")
        if scene.animated:
            say(f"note: the scene is animated, and the page shows it at {moment:g} s")
        if place is None:
            say("note: the page has no dates, since the scene has no place; give --latitude and --longitude, or --crs")
        elif place.timezone is None:
            say("note: times are in the whole-hour zone of the longitude, without summer time; give --timezone")
        print(f"{path}  {counted(report.triangles, 'triangle')}, {report.size / 1e6:.2f} MB", flush=True)
    return 0


def _place_of(scene: "AnyScene", position: dict[str, Any]) -> "Place | None":
    """The place that the options or the CRS name; None if neither does."""
    from ..sun.location import place_of

    place = place_of(scene, **position)
    if place is None and position:
        raise InputError("--north and --timezone need a place; give --latitude and --longitude, or --crs")
    return place


def _variant_of(args: PageArguments, spec: SceneSpec) -> Added | None:
    """The state after that an option names; None: none does."""
    if args.variant is None:
        return None
    if spec.added or spec.removed:
        raise InputError(
            f"--variant {args.variant} is one state, and --add and --remove make another; give one of them"
        )
    return parse_placed(args.variant, "--variant")


def _credits_in(spec: SceneSpec, variant: Added | None) -> str:
    """The licences that the files of a scene and its changes state, each once."""
    from ..formats.stated_licence import licence_in

    specs = [spec, *(each.scene for each in (*spec.added, *((variant,) if variant else ())))]
    texts = [licence_in(each.path) for each in specs if each.path is not None]
    return "; ".join(dict.fromkeys(" ".join(text.split()) for text in texts if text))
