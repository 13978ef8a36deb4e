"""Options shared by several commands, and a decorator for commands that take all options as one dataclass.

Options that set fields of `RenderOptions`, `EngineOptions` and the options of jobs are derived from those fields.
Options that name output files or folders are checked while the command line is parsed.
"""

import inspect
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, Field, field, fields, make_dataclass
from enum import Enum, StrEnum
from functools import update_wrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, get_args

import typer

from ..base.checks import alternatives
from ..base.errors import InputError
from ..base.memory import reading_limit
from ..base.option_fields import Choice, CommandOption, WholeNumber, option_of
from ..engine.scene_reading import SCENE_SUFFIXES
from ..picture.render_options import RenderKeywords
from .arguments import parse_bytes, parse_point
from .scene_arguments import SceneArguments

if TYPE_CHECKING:
    from ..city.sensors.sensors import Sensors


# --- Options that name output files or folders ------------------------------------------------------------------------
#
# The declaration of an option states what it writes, ``typer.Option(..., callback=writes(".png"))``, so no command can
# forget the check. Commands check only what depends on other arguments, such as a default name.


TABLES = ".csv", ".parquet", ".gpkg", ".json", ".npz", ".png", ".glb", ".tif"
"""Suffixes of table files, as in `jobs.result_table.WRITERS`, which is slow to import."""

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


# --- Options derived from fields of `RenderOptions`, `EngineOptions` and the options of jobs --------------------------


class DerivedOption(NamedTuple):
    """A command-line option that sets a field."""

    name: str  # of the parameter
    field: Field[Any]  # the field it sets
    words: CommandOption

    @property
    def start(self) -> Any:
        """The value if the option is not used."""
        return self.field.default if self.words.start is MISSING else self.words.start

    @property
    def kind(self) -> Any:
        """The type of the option's value."""
        if self.words.kind is not None:
            return self.words.kind
        check = option_of(self.field).check
        return Literal[check.names] if isinstance(check, Choice) else self.field.type

    def option(self, start: Any) -> Any:
        """The option for Typer."""
        flag, words, check = f"--{self.name.replace('_', '-')}", self.words, option_of(self.field).check
        switch = self.kind in (bool, bool | None)
        low, high = check[:2] if isinstance(check, WholeNumber) and words.kind is None else (None, None)
        return typer.Option(
            f"{flag}/--no-{flag[2:]}" if switch and start is not False else flag,
            help=words.help + (f"  [default: {words.note}]" if start is None and words.note else ""),
            metavar=words.metavar,
            min=low,
            max=None if words.unbounded else high,
            show_default=start is not None,
            rich_help_panel=words.panel,
        )


def derived_options(kind: type = RenderKeywords) -> Iterator[DerivedOption]:
    """All command-line options that set fields of a class."""
    for each in fields(kind):
        for words in option_of(each).words:
            yield DerivedOption(words.name or each.name, each, words)


def derived_option(name: str, start: Any = None) -> Any:
    """The option of this name, for an annotation: ``spp: Annotated[int, derived_option("spp", 16)] = 16``."""
    return next(each for each in derived_options() if each.name == name).option(start)


def arguments_of(command: str, kind: type = RenderKeywords, **starts: Any) -> Any:
    """A base class for the arguments of a command with a scene (see `takes`), with a field for each derived option.

    starts : defaults that differ from those of the fields
    """

    def start(each: DerivedOption) -> Any:
        return starts.get(each.name, each.start)

    options = [each for each in derived_options(kind) if not each.words.commands or command in each.words.commands]
    members = [
        (each.name, Annotated[each.kind, each.option(start(each))], field(default=start(each))) for each in options
    ]
    return make_dataclass(f"Options of {command}", members, bases=(SceneArguments,), frozen=True, kw_only=True)


class Before(NamedTuple):
    """Metadata of an option of a command: the help lists it, and those after it, before a derived option."""

    name: str  # of the derived option; "": after all of them


def literal(arguments: Any, kind: type) -> dict[str, Any]:
    """Name -> value of the fields whose options are literal and have a value, used or by default."""
    values = {each.name: getattr(arguments, each.name) for each in derived_options(kind) if each.words.literal}
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
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object, and nothing else, on standard output.")]
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
        help="Memory limit of reading files: in bytes, or with M or G, such as 512M.  [default: what is available]",
        metavar="SIZE",
        show_default=False,
        rich_help_panel="Scene",
    ),
]
_LIMIT = "max_memory"


SCENE_HELP = (
    f"A {alternatives(SCENE_SUFFIXES)} file, a folder of vertex frames, example:NAME, or "
    "procedural:NAME?triangles=N&seed=N. FILE?lod=N selects a level of detail of CityJSON; FILE?cutouts=off ignores "
    "alpha; FILE?transmittance=NAME:0.3 lets light pass through a material or object, and NAME:JAN/FEB/.../DEC a share "
    "for each month; FILE?instances=on keeps copies of meshes as instances. FILE?band=2 selects a band of a raster of "
    "heights; FILE?layer=NAME a layer of footprints, and FILE?invalid=skip leaves out faulty ones."
)
SceneArgument = Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")]


def fields_of(arguments: type) -> list[Field[Any]]:
    """The fields of an arguments dataclass in the order of the help.

    Own ones come first, except where `Before` says, and those of `SceneArguments` follow the scene.
    """
    own = vars(arguments).get("__annotations__", {})
    shared = fields(SceneArguments) if issubclass(arguments, SceneArguments) else ()
    groups: dict[str | None, list[Field[Any]]] = {None: []}
    place = None
    for each in fields(arguments):
        if each.name in own:
            place = next((m.name for m in get_args(each.type) if isinstance(m, Before)), place)
            groups.setdefault(place, []).extend((each, *shared) if each.name in ("scene", "scenes") else (each,))
    known = own.keys() | {each.name for each in shared}
    derived = [each for each in fields(arguments) if each.name not in known]
    moved = [part for each in derived for part in (*groups.get(each.name, []), each)]
    return [*groups[None], *moved, *groups.get("", [])]


def takes(arguments: type) -> Callable[[Callable[[Any], int]], Callable[..., int]]:
    """Decorator of a command ``f(args)``: Typer gets each field of the dataclass `arguments` as a parameter.

    Fields without a default are required. The help has them in the order of `fields_of`. A command with a scene also
    has ``--max-memory``, within which files are read, if it has no such field of its own.
    """
    members = fields_of(arguments)
    kinds: dict[str, Any] = {f.name: Annotated[get_args(f.type)[:2]] for f in members}  # without `Before`
    defaults = {f.name: inspect.Parameter.empty if f.default is MISSING else f.default for f in members}
    keeps_limit, usual = _LIMIT in kinds, defaults.get(_LIMIT)
    if issubclass(arguments, SceneArguments) and not keeps_limit:
        kinds[_LIMIT], defaults[_LIMIT] = _ReadingLimit, None

    def wrap(command: Callable[[Any], int]) -> Any:
        def run(**values: Any) -> int:
            size = values.get(_LIMIT) if keeps_limit else values.pop(_LIMIT, None)
            limit = None if size in (None, usual) else parse_bytes(size, "--max-memory")  # the usual is not of reading
            with reading_limit(limit):
                return command(arguments(**values))

        wrapper: Any = update_wrapper(run, command)  # so that a node of a cluster finds it by name
        kind = inspect.Parameter.KEYWORD_ONLY
        wrapper.__signature__ = inspect.Signature(
            [inspect.Parameter(name, kind, default=defaults[name], annotation=each) for name, each in kinds.items()]
        )
        wrapper.__annotations__ = kinds
        wrapper.command = command
        arguments.run = wrapper  # type: ignore[attr-defined]
        return wrapper

    return wrap


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
        help="Add ambient occlusion by geometry within RADIUS (inf: at any distance).",
        metavar="RADIUS[@INTENSITY]",
        show_default=False,
    ),
]
VplOption = Annotated[
    int | None,
    typer.Option(
        help="Replace ambient light by one bounce of indirect light: photons from the first light and the sky become "
        "virtual point lights.",
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
        help="draft: 4 rays; standard: 16; final: 64, adaptive, and bounced light in closed rooms. Other options take "
        "precedence."
    ),
]
SkyOption = Annotated[
    str | None,
    typer.Option(
        help="Sky light: a colour, an environment map (.hdr or .exr), or none.  "
        "[default: daylight, if there are no other lights or the file has a sun]",
        metavar="COLOUR|FILE|none",
        show_default=False,
    ),
]
ExposureOption = Annotated[
    float | None,
    typer.Option(help="Exposure factor of a .png.  [default: automatic]", show_default=False),
]

# --- Options of jobs: sensors, result files and the place on Earth ----------------------------------------------------


SENSORS_HELP = (
    "Sensor locations: face, vertex, grid:SPACING on every surface, each with +LIFT off it; "
    "raster:SPACING[+HEIGHT|@HEIGHT], raster:FILE.tif (its cells), raster[+HEIGHT] (the cells of the scene's own "
    "raster), or a file of points (.csv, .parquet, .npy, .npz)."
)
SensorsOption = Annotated[str, typer.Option(help=SENSORS_HELP)]
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
ColumnOption = Annotated[
    str | None,
    typer.Option(help="Column shown in pictures and models.  [default: the first]", show_default=False),
]
PlanOption = Annotated[str | None, typer.Option(help="Plan; see antumbra plans.  [default: auto]", show_default=False)]

CrsOption = Annotated[
    str | None,
    typer.Option(help="Coordinate reference system, such as EPSG:28992.  [default: the file's]", show_default=False),
]
_POSITION = "latitude", "longitude", "north", "timezone"
DegreesOption = Annotated[float | None, typer.Option(help="Degrees, WGS 84.", show_default=False)]
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


def points_or_file(texts: list[str] | None, file: Path | None, one: str, many: str) -> "Sensors | None":
    """The sensors of a repeated option X,Y,Z or of a file; None without either."""
    if texts and file is not None:
        raise InputError(f"{one} and {many} exclude each other; give one of them")
    if texts:
        from ..city.sensors.sensors import point_sensors

        return point_sensors([parse_point(text, one) for text in texts])
    if file is None:
        return None
    from ..city.sensors.sensor_files import SUFFIXES, read_points

    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{many} is {str(file)!r}; it must be a {', '.join(SUFFIXES)} file")
    return read_points(file)
