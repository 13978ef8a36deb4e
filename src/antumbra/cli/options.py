"""Options shared by several commands, and a decorator for commands that take all options as one dataclass.

Options that set fields of `RenderOptions`, `EngineOptions` and the options of studies are derived from those fields.
Options that name output files or folders are checked while the command line is parsed.
"""

import inspect
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, field, fields, make_dataclass
from enum import Enum, StrEnum
from functools import update_wrapper
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import typer

from ..base.checks import alternatives
from ..base.errors import InputError
from ..base.memory import reading_limit
from ..base.option_fields import Choice, CommandOption, WholeNumber, option_of
from ..devices.device_list import device_budget, using_device
from ..picture.render_options import RenderKeywords
from .arguments import parse_bytes
from .completion import completion_of
from .scene_arguments import SceneArguments

# --- Options that name output files or folders ------------------------------------------------------------------------
#
# The declaration of an option states what it writes, ``typer.Option(..., callback=writes(".png"))``, so no command can
# forget the check. Commands check only what depends on other arguments, such as a default name.


TABLES = (*(".csv", ".parquet", ".parquets", ".gpkg", ".json", ".npz", ".png", ".glb", ".html", ".tif", ".zarr"),)
"""Suffixes of table files, as in `city.tables.result_table.WRITERS`, which is slow to import."""

Callback = Callable[[typer.Context, Any], Any]
"""Callback of an option: it checks the value and returns it."""

_OUTPUTS = "antumbra.outputs"  # key in the context of the command: the output paths so far


def writes(*suffixes: str | Callable[[], Any]) -> Callback:
    """The callback of an option that names one or several output files.

    suffixes : in lower case; or a function that returns suffixes, which may import slow modules
    """

    def allowed() -> list[str]:
        return [suffix for each in suffixes for suffix in ([each] if isinstance(each, str) else each())]

    def check(path: Path) -> None:
        from ..base.files import checked_output

        checked_output(path, allowed())

    return _callback(check, allowed)


def tables(about: str, *names: str, suffixes: Sequence[str] = TABLES, **more: Any) -> Any:
    """A repeatable option for table files, whose help lists the suffixes.

    about : start of the help text
    names : of the option
    """
    help = f"{about}; may be repeated: {alternatives(suffixes)}."
    return typer.Option(*names, help=help, show_default=False, callback=writes(*suffixes), **more)


def writes_folder() -> Callback:
    """The callback of an option that names an output folder, which is created if missing."""

    def check(path: Path) -> None:
        from ..base.files import checked_folder

        checked_folder(path)

    return _callback(check, list)


def pictures() -> list[str]:
    """Suffixes of image files."""
    from ..picture.image_files import IMAGE_SUFFIXES

    return list(IMAGE_SUFFIXES)


def films() -> list[str]:
    """Suffixes of film files."""
    from ..picture.image_files import FILM_SUFFIXES

    return list(FILM_SUFFIXES)


def _callback(check: Callable[[Path], None], allowed: Callable[[], list[str]]) -> Callback:
    def run(context: typer.Context, value: Any) -> Any:
        if value is not None and not context.resilient_parsing:
            for path in value if isinstance(value, (list, tuple)) else [value]:
                check(path)
                _once(context, path)
        return value

    callback: Any = run
    callback.writes = allowed  # for tests
    return run


def _once(context: typer.Context, path: Path) -> None:
    """Raise an InputError if two options, or one option twice, name the same file."""
    paths, real = context.meta.setdefault(_OUTPUTS, set()), os.path.realpath(path)
    if real in paths:
        raise InputError(f"{path}: is named twice; give each output its own name")
    paths.add(real)


# --- Options derived from fields of `RenderOptions`, `EngineOptions` and the options of studies -----------------------


class DerivedOption(NamedTuple):
    """A command-line option that sets a field."""

    name: str  # of the parameter
    field: Field[Any]  # the field it sets
    cli: CommandOption

    @property
    def start(self) -> Any:
        """The value if the option is not used."""
        return self.field.default if self.cli.start is MISSING else self.cli.start

    @property
    def kind(self) -> Any:
        """The type of the option's value."""
        if self.cli.kind is not None:
            return self.cli.kind
        check = option_of(self.field).check
        return Literal[check.names] if isinstance(check, Choice) else self.field.type

    def option(self, start: Any) -> Any:
        """The option for Typer."""
        flag, cli, check = f"--{self.name.replace('_', '-')}", self.cli, option_of(self.field).check
        switch = self.kind in (bool, bool | None)
        low, high = check[:2] if isinstance(check, WholeNumber) and cli.kind is None else (None, None)
        return typer.Option(
            f"{flag}/--no-{flag[2:]}" if switch and start is not False else flag,
            help=cli.help + (f"  [default: {cli.note}]" if start is None and cli.note else ""),
            metavar=cli.metavar,
            min=low,
            max=None if cli.hides_limit else high,
            show_default=start is not None,
            rich_help_panel=cli.panel,
        )

    def parameter(self, start: Any) -> "Parameter":
        """The parameter of a command."""
        return Parameter(self.name, Annotated[self.kind, self.option(start)], start)


def derived_options(kind: type = RenderKeywords) -> Iterator[DerivedOption]:
    """All command-line options that set fields of a class."""
    for each in fields(kind):
        for cli in option_of(each).cli_options:
            yield DerivedOption(cli.name or each.name, each, cli)


def derived_option(name: str, start: Any = None) -> Any:
    """The option of this name, for an annotation: ``spp: Annotated[int, derived_option("spp", 16)] = 16``."""
    return next(each for each in derived_options() if each.name == name).option(start)


def arguments_of(command: str, **starts: Any) -> Any:
    """A base class for the arguments of a command of pictures, with a field for each option of `RenderKeywords`.

    starts : defaults that differ from those of the fields
    """
    options = [each for each in derived_options() if not each.cli.commands or command in each.cli.commands]
    parameters = [each.parameter(starts.get(each.name, each.start)) for each in options]
    members = [(each.name, each.kind, field(default=each.default)) for each in parameters]
    return make_dataclass(f"Options of {command}", members, bases=(SceneArguments,), frozen=True, kw_only=True)


class ListedBefore(NamedTuple):
    """Metadata of an option of a command: the help lists it, and those after it, before a derived option."""

    derived: str | None  # name; None: after all of them


LISTED_LAST = ListedBefore(None)
"""The help lists the option, and those after it, after all derived ones."""


def literal(given: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """Name -> value of the fields whose CLI values are theirs, and are not None.

    given : name of a derived option -> its CLI value, used or by default
    """
    values = {each.name: given[each.name] for each in derived_options(kind) if each.cli.is_value}
    return {name: _value(word) for name, word in values.items() if word is not None}


def _value(word: Any) -> Any:
    """The Python value of an option's word, or of a list of words."""
    if isinstance(word, list):
        return [_value(each) for each in word]
    value = word.value if isinstance(word, Enum) else word
    return None if isinstance(word, Enum) and value == "none" else value


# --- Shared options, and the decorator for commands that take all options as one object -------------------------------


UpOption = Annotated[
    Literal["y", "z"] | None,
    typer.Option(
        help="Up axis of the file.  [default: z for CityJSON, and if floors and roofs face z; else y]",
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]

Threads = Annotated[int | None, derived_option("threads")]
CameraOption = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help="An index, POSITION:TARGET[:VFOV], ortho, top or panorama.",
        metavar="CAMERA",
        show_default=False,
    ),
]

LightOption = Annotated[
    list[str] | None,
    typer.Option("--light", help="An index, or KIND:...; may be repeated.", metavar="LIGHT", show_default=False),
]
TimeOption = Annotated[float, derived_option("time", 0.0)]
SppOption = Annotated[int, derived_option("spp", 16)]
SrdhRaysOption = Annotated[
    str | None,
    typer.Option(
        help="Sample shadow rays for the builder srdh: those of NxN pixels, or all; bounce: as many again after a "
        "diffuse bounce; last-frame: those of the previous frame.  [default: 16]",
        metavar="N|all[,bounce][,last-frame]",
        show_default=False,
    ),
]
MaxMemoryOption = Annotated[str | None, derived_option("max_memory")]

_ReadingLimit = Annotated[
    str | None,
    typer.Option(
        "--max-memory",
        help="Memory limit of reading files, and on a device: in bytes, or with M or G, such as 512M.  [default: what "
        "is available]",
        metavar="SIZE",
        show_default=False,
        rich_help_panel="Scene",
    ),
]
_LIMIT = "max_memory"
DeviceOption = Annotated[str | None, derived_option("device")]
_PLAN, _DEVICE = "plan", "device"


SCENE_HELP = (
    "A file or folder, the URL of a GeoTIFF or store, example:NAME, or procedural:NAME?triangles=N&seed=N; antumbra "
    "formats lists the files, and "
    "options such as FILE?lod=2.2."
)
SCENE_OPTIONS = {
    "FILE?lod=N": "a level of detail of CityJSON",
    "FILE?cutouts=off": "alpha cuts no holes",
    "FILE?transmittance=NAME:0.3": "a material or object lets light pass; JAN/FEB/.../DEC: a share for each month",
    "FILE?instances=on": "copies of meshes stay instances",
    "FILE?animation=NAME": "a clip of a glTF file",
    "FILE?clip=W,S,E,N": "a part of a raster of heights",
    "FILE?band=2": "a band of it",
    "FILE?layer=NAME": "a layer of footprints",
    "FILE?invalid=skip": "leaves out faulty footprints",
}
"""Syntax of the options of a scene -> what they do."""
SceneArgument = Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")]


class Parameter(NamedTuple):
    """A parameter of a command."""

    name: str
    kind: Any  # its type, annotated with the option
    default: Any  # MISSING: required

    @property
    def signature(self) -> inspect.Parameter:
        """As a keyword of a function."""
        default = inspect.Parameter.empty if self.default is MISSING else self.default
        for info in get_args(self.kind)[1:]:
            if getattr(info, "autocompletion", True) is None:
                info.autocompletion = completion_of(self.name)
        return inspect.Parameter(self.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=self.kind)


def parameters_of(arguments: type, options: type | None = None) -> list[Parameter]:
    """The parameters of a command in the order of the help.

    The command's own come first, except where `ListedBefore` says, with those of `SceneArguments` after the scene. The
    derived ones follow, and those that every study has come last.

    arguments : a dataclass, with a field for each parameter
    options : a class with further, derived options, which are one field of `arguments`, `OPTIONS`
    """
    shared = fields(SceneArguments) if issubclass(arguments, SceneArguments) else ()
    own, inherited = vars(arguments).get("__annotations__", {}), list[Parameter]()
    groups: dict[str | None, list[Parameter]] = {"": []}
    place: str | None = ""
    for each in fields(arguments):
        if each.name in own:
            place = next((m.derived for m in get_args(each.type) if isinstance(m, ListedBefore)), place)
            after = shared if each.name in ("scene", "scenes") else ()
            groups.setdefault(place, []).extend(map(_parameter, (each, *after)))
        elif each not in shared and each.name != OPTIONS:
            inherited.append(_parameter(each))
    derived = inherited if options is None else [each.parameter(each.start) for each in derived_options(options)]
    moved = [part for each in derived for part in (*groups.get(each.name, []), each)]
    return [*groups[""], *moved, *groups.get(None, []), *(inherited if options else [])]


def _parameter(field: Field[Any]) -> Parameter:
    return Parameter(field.name, Annotated[get_args(field.type)[:2]], field.default)  # without `ListedBefore`


OPTIONS = "options"
"""The field of arguments with the object that is made from derived options."""


def takes(
    arguments: type, options: type | None = None, read: Callable[[dict[str, Any]], Any] = dict
) -> Callable[[Callable[[Any], int]], Callable[..., int]]:
    """Decorator of a command ``f(args)``: Typer gets each field of the dataclass `arguments` as a parameter.

    Fields without a default are required. The help has them in the order of `parameters_of`. A command with a scene
    also has ``--max-memory``, within which files are read, if it has no such field of its own. One with a plan also has
    ``--device``, where the plan traces.

    options : class whose derived options become one field, `OPTIONS`
    read : makes the value of this field of their names and CLI values
    """
    members = {each.name: each for each in parameters_of(arguments, options)}
    derived = [] if options is None else [each.name for each in derived_options(options)]
    keeps_limit = _LIMIT in members
    if issubclass(arguments, SceneArguments) and not keeps_limit:
        members[_LIMIT] = Parameter(_LIMIT, _ReadingLimit, None)
    keeps_device = _DEVICE in members
    if not keeps_device and _PLAN in members and get_args(members[_PLAN].kind)[0] == str | None:
        members[_DEVICE] = Parameter(_DEVICE, DeviceOption, None)

    def wrap(command: Callable[[Any], int]) -> Any:
        def run(**values: Any) -> int:
            size = values.get(_LIMIT) if keeps_limit else values.pop(_LIMIT, None)
            if size is not None and size == members[_LIMIT].default:
                size = None  # the usual limit is not of reading
            limit = None if size is None else parse_bytes(size, "--max-memory")
            device = values.get(_DEVICE) if keeps_device else values.pop(_DEVICE, None)
            if device is not None and not keeps_device:
                from ..engine.device_plans import plan_on

                plan_on(device, values[_PLAN])  # they must not contradict each other
            if options is not None:
                values[OPTIONS] = read({name: values.pop(name) for name in derived})
            with reading_limit(limit), using_device(device), device_budget(limit):
                return command(arguments(**values))

        wrapper: Any = update_wrapper(run, command)
        wrapper.__signature__ = inspect.Signature([each.signature for each in members.values()])
        wrapper.__annotations__ = {each.name: each.kind for each in members.values()}
        wrapper.arguments = arguments
        return wrapper

    return wrap


def outputs_of(arguments: type) -> list[str]:
    """The names of the fields that name output files or folders."""
    return [
        each.name
        for each in fields(arguments)
        if any(hasattr(getattr(info, "callback", None), "writes") for info in get_args(each.type)[1:])
    ]


# --- Options of pictures, for ``render`` and ``compare`` --------------------------------------------------------------


PictureLightOption = Annotated[
    list[str] | None,
    typer.Option(
        "--light", help="An index, or KIND:...[@INTENSITY]; may be repeated.", metavar="LIGHT", show_default=False
    ),
]
AoOption = Annotated[
    str | None,
    typer.Option(
        help="Add ambient occlusion by nearby geometry. RADIUS limits its distance; inf: no limit.",
        metavar="RADIUS[@INTENSITY]",
        show_default=False,
    ),
]
VplOption = Annotated[
    int | None,
    typer.Option(
        help="Bounced light from virtual point lights. PHOTONS from the first light, and as many from the sky, become "
        "such lights. They replace ambient light.",
        min=1,
        max=16384,
        metavar="PHOTONS",
        show_default=False,
    ),
]


class Preset(StrEnum):
    """The values of ``--preset``."""

    draft = "draft"
    standard = "standard"
    final = "final"


class PresetValues(NamedTuple):
    """The values of a preset."""

    spp: int
    filter: bool
    adaptive: bool


QUALITIES = {
    Preset.draft: PresetValues(4, True, False),
    Preset.standard: PresetValues(16, True, False),
    Preset.final: PresetValues(64, True, True),
}

PresetOption = Annotated[
    Preset,
    typer.Option(
        help="Quality: 4, 16 or 64 rays per pixel and light. final also refines penumbrae and edges, and adds bounced "
        "light in rooms and courtyards. Other options take precedence."
    ),
]
SkyOption = Annotated[
    str | None,
    typer.Option(
        help="Sky: a colour, an .hdr or .exr map, daylight or none.  "
        "[default: daylight, if there are no other lights or the file has a sun]",
        metavar="COLOUR|FILE|daylight|none",
        show_default=False,
    ),
]
ExposureOption = Annotated[
    float | None,
    typer.Option(help="Exposure factor of a .png.  [default: automatic]", show_default=False),
]

# --- Options of studies: sensors, result files and the place on Earth -------------------------------------------------


SENSORS_HELP = (
    "Sensor locations: face, vertex, grid:SPACING on every surface, each with +LIFT off it; "
    "raster:SPACING[+HEIGHT|@HEIGHT], raster:FILE.tif (its cells), raster[+HEIGHT] (the cells of the scene's own "
    "raster), or a file of points (.csv, .parquet, .npy, .npz, .gpkg, .geojson)."
)
SensorsOption = Annotated[str, typer.Option(help=SENSORS_HELP, metavar="SENSORS")]
SensorsOrDefault = Annotated[
    str | None,
    typer.Option(
        help=SENSORS_HELP + "  [default: face; on a raster of heights: raster]", metavar="SENSORS", show_default=False
    ),
]
OutputsOption = Annotated[list[Path] | None, tables("Output file", "--output", "-o")]
MapOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--map",
        help="A map sheet with scale, north, legend, place and dates; may be repeated: .pdf, .svg or .png.",
        metavar="FILE",
        show_default=False,
        callback=writes(".pdf", ".svg", ".png"),
    ),
]
SheetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--sheet",
        help="A field of the map sheet; may be repeated: title, project, author, date, licence, paper=a3, "
        "orientation=portrait, scale=1:500, extent=W,S,E,N, labels=COLUMN, pages=map,table,method,sources.",
        metavar="FIELD=VALUE",
        show_default=False,
    ),
]
ColumnOption = Annotated[
    str | None,
    typer.Option(help="Column shown in pictures and models.  [default: the first]", show_default=False),
]
PlanOption = Annotated[
    str | None,
    typer.Option(help="The methods of building and tracing; see antumbra plans.  [default: auto]", show_default=False),
]

CrsOption = Annotated[
    str | None,
    typer.Option(help="Coordinate reference system, such as EPSG:28992.  [default: the file's]", show_default=False),
]
_POSITION = "latitude", "longitude", "north", "timezone"
LatitudeOption = Annotated[
    float | None, typer.Option(help="Latitude of the scene, WGS 84; north is positive.", show_default=False)
]
LongitudeOption = Annotated[
    float | None, typer.Option(help="Longitude of the scene, WGS 84; east is positive.", show_default=False)
]
NorthOption = Annotated[
    float | None,
    typer.Option(
        help="True north, degrees clockwise from +Y (+Z up) or -Z (+Y up).  [default: from the CRS, or 0]",
        show_default=False,
    ),
]
TimezoneOption = Annotated[
    str | None,
    typer.Option(
        help="Time zone: Europe/Amsterdam, UTC or +01:00.  [default: the whole hour nearest to the longitude]",
        show_default=False,
    ),
]


def position_of(arguments: Any) -> dict[str, Any]:
    """The values of --latitude, --longitude, --north and --timezone that are given, checked."""
    from ..sun.location import position_fields

    return position_fields(**{name: getattr(arguments, name) for name in _POSITION})
