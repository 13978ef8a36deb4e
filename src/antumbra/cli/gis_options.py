"""Options of geographic scenes, and opening these scenes.

The options are part of the scene's text, ``buildings.gpkg?height=h&terrain=dem.tif``, so every command understands
them. Every command with a scene also has ``--height``, ``--terrain`` and ``--unit``, which are added here to that text.
"""

import inspect
from collections.abc import Callable, Sequence
from functools import update_wrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any
from urllib.parse import parse_qsl, quote, unquote

import typer

from ..checks import spelling_hint
from ..errors import InputError
from ..formats.format_registry import FOOTPRINTS, HEIGHTS
from ..scene.units import checked_unit

if TYPE_CHECKING:
    from ..engine.scene import Scene
    from ..scene.terrain import StreamedTerrain

Options = tuple[tuple[str, str], ...]
"""Names and values in the text of a scene."""

_OF_RASTERS = "terrain", "band", "nodata", "z_scale", "values_at"
_OF_FOOTPRINTS = "height", "terrain", "base", "id", "layer", "invalid"
_UNIT = "unit="  # of all files

# --- Options in the text of a scene -----------------------------------------------------------------------------------


def is_raster(path: Path | None) -> bool:
    """Whether a path has the suffix of a raster of heights."""
    return path is not None and path.suffix.lower() in HEIGHTS.suffixes


def is_footprints(path: Path | None) -> bool:
    """Whether a path has the suffix of a file of footprints."""
    return path is not None and path.suffix.lower() in FOOTPRINTS.suffixes


def split_options(text: str) -> tuple[Path, Options] | None:
    """The path and the options of a geographic scene's text; None for other scenes."""
    file, _, query = text.partition("?")
    path = Path(file)
    if not (is_raster(path) or is_footprints(path)):
        return None
    allowed = _OF_RASTERS if is_raster(path) else _OF_FOOTPRINTS
    options = tuple(parse_qsl(query, keep_blank_values=True))
    for name, value in options:
        if name not in allowed:
            raise InputError(f"{text}: {name!r} is unknown; {spelling_hint(name, allowed)}use {', '.join(allowed)}")
        if not value or (name != "terrain" and [each for each, _ in options].count(name) > 1):
            raise InputError(f"{text}: {name} is empty or repeated; write FILE?{name}=VALUE")
    return path, options


def split_unit(text: str) -> tuple[str, str | None]:
    """The text of a file without its option ``unit``, and its unit; None: it has none."""
    file, mark, query = text.rpartition("?")
    parts = query.split("&") if mark else []
    units = [part for part in parts if part.startswith(_UNIT)]
    if not units:
        return text, None
    unit = unquote(units[0].removeprefix(_UNIT))
    if len(units) > 1 or not unit:
        raise InputError(f"{text}: unit is empty or repeated; write FILE?unit=UNIT, or --unit UNIT")
    checked_unit(unit)
    others = "&".join(part for part in parts if part not in units)
    return f"{file}?{others}" if others else file, unit


def _number(value: str, name: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise InputError(f"{name} is {value!r}; it must be a number") from None


def _column_or_number(value: str) -> str | float:
    try:
        return float(value)
    except ValueError:
        return value


def _keywords(options: Options, readers: dict[str, Callable[[str], Any]]) -> dict[str, Any]:
    """Python keywords; those without a reader stay text."""
    return {name: readers.get(name, str)(value) for name, value in options if name != "terrain"}


def _terrain(options: Options) -> list[str] | None:
    return [value for name, value in options if name == "terrain"] or None


_READERS: dict[str, Callable[[str], Any]] = {
    "band": lambda value: int(_number(value, "band")),
    "nodata": lambda value: _number(value, "nodata"),
    "z_scale": lambda value: _number(value, "z_scale"),
    "height": _column_or_number,
    "base": _column_or_number,
}


def open_gis_scene(path: Path, options: Options, up: str | None, crs: str | None, unit: str | None) -> "Scene":
    """The scene of a raster or of footprints; --terrain is the ground of both."""
    from .. import from_footprints, from_raster
    from ..formats.gis.gis_data import check_z_up

    check_z_up(up, path.name)
    keywords, terrain = _keywords(options, _READERS), _terrain(options)
    if is_raster(path):
        return from_raster(path, ground=terrain, crs=crs, unit=unit, **keywords)
    return from_footprints(path, terrain=terrain, crs=crs, unit=unit, **keywords)


def is_streamed(path: Path | None, options: Options) -> bool:
    """Whether `antumbra build` reads a scene piece by piece: a raster without terrain below it."""
    return is_raster(path) and not _terrain(options)


def stream_rasters(tiles: Sequence[tuple[Path, Options, str | None]], up: str | None) -> "StreamedTerrain":
    """The single surface of rasters with their options and units, read piece by piece."""
    from ..formats.gis.gis_data import check_z_up, streamed_terrain
    from ..formats.gis.height_files import HeightOptions

    files = list[tuple[Path, HeightOptions]]()
    for path, options, unit in tiles:
        check_z_up(up, path.name)
        length = None if unit is None else checked_unit(unit)
        files.append((path, HeightOptions(**_keywords(options, _READERS), unit=length)))
    return streamed_terrain(files)


# --- Options of commands ----------------------------------------------------------------------------------------------


_Height = Annotated[
    str | None,
    typer.Option(
        "--height",
        help="For footprints: the column of their heights, or one height.  [default: height]",
        metavar="COLUMN|NUMBER",
        show_default=False,
        rich_help_panel="Scene",
    ),
]
_Terrain = Annotated[
    list[Path] | None,
    typer.Option(
        "--terrain",
        help="Raster of the ground on which footprints stand, or that lies below a raster; tiles: repeat it.",
        metavar="FILE",
        show_default=False,
        rich_help_panel="Scene",
    ),
]
_Unit = Annotated[
    str | None,
    typer.Option(
        "--unit",
        help="Length unit of the coordinates: mm, cm, m, ft or us-ft.  [default: that of the CRS, or m]",
        metavar="UNIT",
        show_default=False,
        rich_help_panel="Scene",
    ),
]
_SCENES = "scene", "scenes"


def with_gis_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command with ``--height``, ``--terrain`` and ``--unit`` if it takes scenes; otherwise the command unchanged."""
    parameters = dict(inspect.signature(command).parameters)
    argument = next((name for name in _SCENES if name in parameters), None)
    if argument is None:
        return command

    def run(
        height: str | None = None, terrain: Sequence[Path] | None = None, unit: str | None = None, **values: Any
    ) -> Any:
        scenes = values[argument]
        if height is not None or terrain or unit is not None:
            add = lambda text: scene_text(text, height, terrain or (), unit)
            values[argument] = add(scenes) if isinstance(scenes, str) else [add(text) for text in scenes]
        return command(**values)

    wrapper: Any = update_wrapper(run, command)
    kind, more = inspect.Parameter.KEYWORD_ONLY, {"height": _Height, "terrain": _Terrain, "unit": _Unit}
    added = [inspect.Parameter(name, kind, default=None, annotation=each) for name, each in more.items()]
    existing = [parameter.replace(kind=kind) for parameter in parameters.values()]
    place = 1 + list(parameters).index(argument)
    wrapper.__signature__ = inspect.Signature([*existing[:place], *added, *existing[place:]])
    wrapper.__annotations__ = {name: each.annotation for name, each in wrapper.__signature__.parameters.items()}
    return run


def scene_text(text: str, height: str | None, terrain: Sequence[Path], unit: str | None = None) -> str:
    """The text of a scene with the values of ``--height``, ``--terrain`` and ``--unit``."""
    path = Path(text.partition("?")[0])
    if height is not None and not is_footprints(path):
        raise InputError(
            f"--height {height} is for footprints ({', '.join(FOOTPRINTS.suffixes)}), unlike {text}; leave it out"
        )
    if terrain and not (is_footprints(path) or is_raster(path)):
        raise InputError(f"--terrain {terrain[0]} is for footprints and rasters, unlike {text}; leave it out")
    if unit is not None and text.startswith("procedural:"):
        raise InputError(f"--unit {unit} is for files, and procedural scenes are in metres; leave it out")
    parts = [] if height is None else [f"height={quote(height)}"]
    parts += [f"terrain={quote(str(file))}" for file in terrain]
    parts += [] if unit is None else [f"{_UNIT}{quote(unit)}"]
    return f"{text}{'&' if '?' in text else '?'}{'&'.join(parts)}"
