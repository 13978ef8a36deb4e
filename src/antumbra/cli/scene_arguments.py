"""The argument SCENE with its options, and opening the scene that they name.

Options of a file are part of its text, ``buildings.gpkg?height=h&terrain=dem.tif``, or options of the command:
``--height``, ``--terrain`` and ``--unit``, which every command with a scene has. Both make one `SceneSpec`. So do
``--add`` and ``--remove``, which change the scene.
"""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, cast
from urllib.parse import parse_qsl, quote, unquote

import typer

from ..base import wings
from ..base.checks import spelling_hint
from ..base.errors import InputError
from ..base.wording import counted
from ..formats.example_files import EXAMPLE_PREFIX, PROCEDURAL_PREFIX, file_of
from ..formats.format_registry import GLB, GLTF, format_of, suffixes_of
from ..formats.scene_format import Contents, ReadOptions, Tile, check_z_up
from ..scene.materials import MONTHS, Transmittance
from ..scene.scene_data import SceneData, group_notes
from ..scene.units import checked_unit
from .arguments import parse_count, parse_number, parse_point
from .console import say

if TYPE_CHECKING:
    from .. import SceneChange
    from ..engine.paged_scene import PagedScene
    from ..engine.scene import AnyScene
    from ..scene.terrain import StreamedTerrain

DEFAULT_SCENE = PROCEDURAL_PREFIX + "atrium"

_LOD = re.compile(r"(.+\.jsonl?)\?lod=(.*)", re.IGNORECASE)
_MESH_OPTIONS = re.compile(
    r"(.+\.(?:glb|gltf|obj|ply))\?((?:cutouts|transmittance|instances|animation)=.*)", re.IGNORECASE
)
_OF_RASTERS = "terrain", "clip", "band", "nodata", "z_scale", "values_at"
_OF_FOOTPRINTS = "height", "terrain", "base", "id", "layer", "invalid"
_UNIT = "unit="  # of all files

# --- What is to be opened ---------------------------------------------------------------------------------------------


class SceneSpec(NamedTuple):
    """A scene to open: a path, or the name of a procedural scene; and how to read it."""

    path: Path | None
    name: str = ""
    triangles: int | None = None
    seed: int = 0
    lod: str | None = None  # level of detail of a CityJSON file
    cutouts: bool = True  # False: alpha cuts no holes
    transmittance: tuple[tuple[str, Transmittance], ...] = ()  # the light that materials or objects let pass
    instances: bool | None = None  # whether copies of meshes stay instances; None: if that saves much memory
    animation: str | None = None  # the clip of a glTF file that plays; None: all at once
    gis: tuple[tuple[str, Any], ...] = ()  # keywords of `from_raster` or `from_footprints`
    terrain: tuple[Path, ...] = ()  # rasters of the ground
    unit: str | None = None  # of the coordinates
    up: str | None = None
    crs: str | None = None
    added: tuple["Added", ...] = ()
    removed: tuple[str, ...] = ()  # names of objects
    own_cells: bool = False  # whether only shadows at the own cells of a raster are needed, which then may be large
    bounds: tuple[float, ...] | None = None  # of these cells, (x0, n0, x1, n1); None: all

    @property
    def on_raster(self) -> bool:
        """Whether the scene is a raster of heights, or stands on one."""
        return is_raster(self.path) or bool(self.terrain)

    @property
    def is_streamed(self) -> bool:
        """Whether `antumbra build` reads the scene piece by piece: a raster without terrain below it."""
        return is_raster(self.path) and not self.terrain

    @property
    def stem(self) -> str:
        """The default name of the scene's pictures, without suffix."""
        if self.path is None:
            return "antumbra"
        folder = self.path.is_dir()
        return (self.path.resolve().name if folder else self.path.stem.removesuffix(".city")) or "antumbra"


class Added(NamedTuple):
    """A scene that is added to another one."""

    scene: SceneSpec
    at: tuple[float, ...] | None  # world position of its origin; None: its coordinates are those of the other scene


def is_raster(path: Path | None) -> bool:
    """Whether a path has the suffix of a raster of heights."""
    return path is not None and path.suffix.lower() in suffixes_of(Contents.HEIGHTS)


def is_footprints(path: Path | None) -> bool:
    """Whether a path has the suffix of a file of footprints."""
    return path is not None and path.suffix.lower() in suffixes_of(Contents.FOOTPRINTS)


# --- The text of a scene ----------------------------------------------------------------------------------------------


def parse_scene(text: str) -> SceneSpec:
    """Parse a path, which may have options, an example scene, or a procedural scene.

    ``city.json?lod=2.2``, ``tree.glb?cutouts=off``, ``tree.glb?transmittance=leaf:0.3&transmittance=glass:0.9,1,0.9``,
    ``tree.glb?transmittance=leaf:0.7/0.7/0.6/0.4/0.3/0.2/0.2/0.2/0.3/0.5/0.6/0.7``,
    ``forest.glb?instances=on``, ``fox.glb?animation=Run``, ``dem.tif?band=2``, ``house.obj?unit=mm``,
    ``buildings.gpkg?height=h&terrain=dem.tif``, ``example:NAME``, ``procedural:NAME?triangles=100k&seed=3``.
    """
    if not text:
        raise InputError(f"SCENE is empty; name a file, a folder or {DEFAULT_SCENE}")
    if text.startswith(PROCEDURAL_PREFIX):
        return _procedural(text)
    if text.startswith(EXAMPLE_PREFIX):
        example, mark, query = text[len(EXAMPLE_PREFIX) :].partition("?")
        text = f"{file_of(example)}{mark}{query}"
    text, unit = _split_unit(text)
    return _of_file(text)._replace(unit=unit)


def _procedural(text: str) -> SceneSpec:
    name, _, query = text[len(PROCEDURAL_PREFIX) :].partition("?")
    options: dict[str, int] = {}
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in ("triangles", "seed") or key in options:
            raise InputError(f"{text}: {key!r} is unknown or repeated; use triangles=... and seed=...")
        options[key] = parse_count(value, f"{text}: {key}")
    return SceneSpec(None, name, options.get("triangles"), options.get("seed", 0))


def _split_unit(text: str) -> tuple[str, str | None]:
    """The text of a file without its option ``unit``, and its unit; None: it has none."""
    file, mark, query = text.rpartition("?")
    parts = query.split("&") if mark else []
    units = [part for part in parts if part.startswith(_UNIT)]
    if not units:
        return text, None
    others = "&".join(part for part in parts if part not in units)
    return f"{file}?{others}" if others else file, _checked_unit(text, *(unquote(u.removeprefix(_UNIT)) for u in units))


def _checked_unit(text: str, unit: str, *more: str) -> str:
    """A unit that is neither empty nor one of several."""
    if more or not unit:
        raise InputError(f"{text}: unit is empty or repeated; write FILE?unit=UNIT, or --unit UNIT")
    checked_unit(unit)
    return unit


def _of_file(text: str) -> SceneSpec:
    if match := _MESH_OPTIONS.fullmatch(text):
        return _of_mesh(SceneSpec(Path(match[1])), match[2], text)
    path = Path(text.partition("?")[0])
    if is_raster(path) or is_footprints(path):
        return _of_gis(SceneSpec(path), text)
    match = _LOD.fullmatch(text)
    if match and "&" in match[2]:
        raise InputError(f"{text}: lod is repeated, or another option follows; write FILE?lod=N")
    return SceneSpec(Path(match[1]), lod=match[2]) if match else SceneSpec(Path(text))


def _of_mesh(spec: SceneSpec, query: str, text: str) -> SceneSpec:
    """The scene of a file with the options of a query, such as ``cutouts=off&transmittance=NAME:SHARE``."""
    pairs = parse_qsl(query, keep_blank_values=True)
    for key, value in pairs:
        if key != "transmittance" and [each for each, _ in pairs].count(key) > 1:
            raise InputError(f"{text}: {key} is repeated; write it once")
        if key in ("cutouts", "instances"):
            if value not in ("on", "off"):
                raise InputError(f"{text}: {key} is {value!r}; it must be on or off")
            switch: dict[str, Any] = {key: value == "on"}
            spec = spec._replace(**switch)
        elif key == "transmittance":
            share = _parse_transmittance(value, text)
            if share[0] in dict(spec.transmittance):
                raise InputError(f"{text}: the transmittance of {share[0]!r} is repeated; write it once")
            spec = spec._replace(transmittance=(*spec.transmittance, share))
        elif key == "animation":
            if not value or spec.path is None or format_of(spec.path) not in (GLB, GLTF):
                raise InputError(f"{text}: animation is empty, or not of a glTF file; write FILE.glb?animation=NAME")
            spec = spec._replace(animation=value)
        else:
            known = "cutouts=off, instances=on, animation=NAME or transmittance=NAME:SHARE"
            raise InputError(f"{text}: {key!r} is unknown; use {known}")
    return spec


def _parse_transmittance(value: str, text: str) -> tuple[str, Transmittance]:
    """Parse ``NAME:SHARE`` or ``NAME:RED,GREEN,BLUE``, or such shares of the twelve months, separated by slashes."""
    name, colon, shares = value.rpartition(":")
    months = [
        tuple(parse_number(each, f"{text}: transmittance") for each in month.split(","))
        for month in (shares.split("/") if colon else ())
    ]
    if not name or len(months) not in (1, len(MONTHS)) or any(len(month) not in (1, 3) for month in months):
        raise InputError(
            f"{text}: transmittance is {value!r}; write NAME:SHARE, NAME:RED,GREEN,BLUE, or twelve such shares for the "
            "months, NAME:JAN/FEB/.../DEC"
        )
    values = [month if len(month) == 3 else month[0] for month in months]
    return name, values[0] if len(values) == 1 else tuple(values)


def _of_gis(spec: SceneSpec, text: str) -> SceneSpec:
    """The scene of a raster or of footprints, with the options of its text."""
    allowed = _OF_RASTERS if is_raster(spec.path) else _OF_FOOTPRINTS
    for name, value in parse_qsl(text.partition("?")[2], keep_blank_values=True):
        if name not in allowed:
            raise InputError(f"{text}: {name!r} is unknown; {spelling_hint(name, allowed)}use {', '.join(allowed)}")
        spec = _with_gis(spec, name, value, text)
    return spec


def _with_gis(spec: SceneSpec, name: str, value: str, text: str) -> SceneSpec:
    """The scene with one more option of rasters or footprints; `text` begins the error about one without a value."""
    if not value or name in dict(spec.gis):
        raise InputError(f"{text}: {name} is empty or repeated; write FILE?{name}=VALUE")
    if name == "terrain":
        return spec._replace(terrain=(*spec.terrain, Path(value)))
    return spec._replace(gis=(*spec.gis, (name, _READERS.get(name, str)(value))))


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


_READERS: dict[str, Callable[[str], Any]] = {
    "clip": lambda value: tuple(_number(each, "clip") for each in value.split(",")),
    "band": lambda value: int(_number(value, "band")),
    "nodata": lambda value: _number(value, "nodata"),
    "z_scale": lambda value: _number(value, "z_scale"),
    "height": _column_or_number,
    "base": _column_or_number,
}

# --- Changes of a scene -----------------------------------------------------------------------------------------------


_OF_ADDED = "up", "crs", "at"  # besides the options of any scene


def parse_added(text: str) -> Added:
    """Parse the text of ``--add``: that of a scene, also with ``up``, ``crs``, and ``at``, the position of its origin.

    ``tower.obj?up=z&at=85010,446520,0``, ``plan.gpkg?height=h&crs=EPSG:28992``
    """
    added = parse_placed(text, "--add")
    if is_raster(added.scene.path):
        raise InputError(
            f"--add {text}: rasters are scenes or terrain; give buildings as OBJ, glTF, CityJSON, or footprints"
        )
    return added


def parse_placed(text: str, option: str) -> Added:
    """Parse the text of a scene, also with ``up``, ``crs``, and ``at``; `option` begins errors."""
    file, mark, query = text.rpartition("?")
    given, others = dict[str, str](), list[str]()
    for part in query.split("&") if mark else []:
        name, _, value = part.partition("=")
        if name not in _OF_ADDED:
            others.append(part)
        elif not value or name in given:
            raise InputError(f"{option} {text}: {name} is empty or repeated; write FILE?{name}=VALUE")
        else:
            given[name] = unquote(value)
    rest = f"{file}{'?' * bool(others)}{'&'.join(others)}" if mark else text
    spec = parse_scene(rest)._replace(up=given.get("up"), crs=given.get("crs"))
    at = None if "at" not in given else tuple(parse_point(given["at"], f"{option} {file}?at").tolist())
    return Added(spec, at)


def open_change(spec: SceneSpec, quiet: bool = False, variant: Added | None = None) -> "SceneChange":
    """The states of a scene without and with its changes, or of a scene and its variant.

    Notes are printed on standard error.
    """
    from .. import scene_change, scene_variant

    base = open_scene(spec._replace(added=(), removed=()), quiet)
    if variant is not None:
        change = scene_variant(base, _open_placed(variant, base.crs, quiet))
    else:
        change = scene_change(base, [_open_placed(each, base.crs, quiet) for each in spec.added], list(spec.removed))
    for note in () if quiet else change.notes:
        say(f"note: {note}")
    return change


def _open_placed(each: Added, crs: str | None, quiet: bool) -> Any:
    """A scene that is added to one in a CRS, or a pair of it and its position."""
    footprints = is_footprints(each.scene.path) and each.scene.crs is None
    with_crs = each.scene._replace(crs=crs) if footprints else each.scene
    still = each.scene.path is not None and each.scene.path.suffix.lower() in (".glb", ".gltf")
    scene = open_scene(with_crs._replace(instances=False) if still else with_crs, quiet)
    at = (0.0, 0.0, 0.0) if each.at is None and "base" in dict(each.scene.gis) else each.at
    return scene if at is None else (scene, at)


# --- Options of all commands with a scene -----------------------------------------------------------------------------


def _option(name: str, text: str, metavar: str) -> Any:
    """An option of scenes, whose help names its default where there is one."""
    return typer.Option(name, help=text, metavar=metavar, show_default=False, rich_help_panel="Scene")


@dataclass(frozen=True, kw_only=True)
class SceneArguments:
    """Options of every command with a scene. The help lists them after SCENE."""

    height: Annotated[
        str | None,
        _option(
            "--height",
            "For footprints: the column of their heights, or one height.  [default: height]",
            "COLUMN|NUMBER",
        ),
    ] = None
    terrain: Annotated[
        list[Path] | None,
        _option(
            "--terrain",
            "Raster of the ground on which footprints stand, or that lies below a raster; may be repeated, for tiles.",
            "FILE",
        ),
    ] = None
    unit: Annotated[
        str | None,
        _option(
            "--unit",
            "Length unit of the coordinates: mm, cm, m, ft or us-ft.  [default: that of the CRS, or m]",
            "UNIT",
        ),
    ] = None
    add: Annotated[
        list[str] | None,
        _option(
            "--add",
            "Add the objects of a file: OBJ, glTF, CityJSON or footprints, with options such as "
            "FILE?up=z&at=X,Y,Z, the axis that points up and the position of its origin; may be repeated.",
            "FILE[?OPTIONS]",
        ),
    ] = None
    remove: Annotated[
        list[str] | None,
        _option(
            "--remove",
            "Remove an object, such as a building by its id; may be repeated.",
            "ID",
        ),
    ] = None

    def spec_of(self, text: str) -> SceneSpec:
        """The scene of a text, with these options and, if the command has them, ``--up`` and ``--crs``.

        Raises
        ------
        InputError
            If the text cannot be parsed, or an option does not suit the scene or is in its text, too.
        """
        spec, record = parse_scene(text), self.record_of(text)
        if self.height is not None:
            if not is_footprints(spec.path):
                suffixes = ", ".join(suffixes_of(Contents.FOOTPRINTS))
                raise InputError(f"--height {self.height} is for footprints ({suffixes}), unlike {text}; leave it out")
            spec = _with_gis(spec, "height", self.height, record)
        for file in self.terrain or ():
            if not (is_footprints(spec.path) or is_raster(spec.path)):
                raise InputError(f"--terrain {file} is for footprints and rasters, unlike {text}; leave it out")
            spec = _with_gis(spec, "terrain", str(file), record)
        if self.unit is not None:
            if spec.path is None:
                raise InputError(f"--unit {self.unit} is for files, and procedural scenes are in metres; leave it out")
            of_text = () if spec.unit is None else (spec.unit,)
            spec = spec._replace(unit=_checked_unit(record, self.unit, *of_text))
        spec = spec._replace(added=tuple(map(parse_added, self.add or ())), removed=tuple(self.remove or ()))
        return spec._replace(up=getattr(self, "up", None), crs=getattr(self, "crs", None))

    def refuse_changes(self, why: str) -> None:
        """Raise an InputError if the command has --add or --remove; `why`: it does not support them, and the remedy."""
        for option, values in (("--add", self.add), ("--remove", self.remove)):
            if values:
                raise InputError(f"{option} {values[0]}: {why}")

    def record_of(self, text: str) -> str:
        """The text of the scene with all these options, for records and reports."""
        parts = [] if self.height is None else [f"height={quote(self.height)}"]
        parts += [f"terrain={quote(str(file))}" for file in self.terrain or ()]
        parts += [] if self.unit is None else [f"{_UNIT}{quote(self.unit)}"]
        return f"{text}{'&' if '?' in text else '?'}{'&'.join(parts)}" if parts else text


BeforeOption = Annotated[
    bool,
    typer.Option(
        "--before",
        help="Add the state before --add and --remove. At the same sensors: columns Q_before, Q and Q_loss.",
    ),
]

# --- Opening of scenes ------------------------------------------------------------------------------------------------


_MOST_NOTES = 5
_STREAMED = Contents.MESHES, Contents.CITY
"""Contents of files that builds read by `ReadOptions.streamed`."""


def open_scene(spec: SceneSpec, quiet: bool = False) -> "AnyScene":
    """Open a scene, with its changes. The loader's notes are printed on standard error."""
    if spec.added or spec.removed:
        return open_change(spec, quiet).after
    if spec.path is None:
        from .. import procedural

        if spec.up is not None or spec.crs is not None:
            raise InputError("--up and --crs are for files; procedural scenes have +Y up and no CRS, leave them out")
        return procedural(spec.name, triangles=spec.triangles, seed=spec.seed)
    with quietly():  # the notes are printed below
        scene = _open_file(spec, spec.path)
    if not quiet:
        _say_notes(scene.notes)
    return scene


def _say_notes(all_notes: Sequence[str]) -> None:
    notes = group_notes(all_notes, "antumbra info shows all")
    for note in notes[:_MOST_NOTES]:
        say(f"note: {note}")
    if len(notes) > _MOST_NOTES:
        say(f"note: {counted(len(notes) - _MOST_NOTES, 'more kind')} of notes; antumbra info shows all of them")


def open_for_store(spec: SceneSpec, quiet: bool = False) -> SceneData:
    """The data of `open_scene` for a build, which reads the faces of a mesh or city file as it stores them."""
    found = None if spec.path is None else format_of(spec.path)
    if spec.path is None or spec.transmittance or found is None or found.contents not in _STREAMED:
        return open_scene(spec, quiet).data
    from ..engine.scene_reading import read_scene_data
    from ..scene.crs import checked_crs

    unit = None if spec.unit is None else checked_unit(spec.unit)
    crs = None if spec.crs is None else checked_crs(spec.crs)
    options = ReadOptions(spec.up, spec.lod, spec.instances, spec.cutouts, crs, unit, spec.animation, streamed=True)
    data = read_scene_data(spec.path, options)
    data.unit = unit or data.given_unit
    if not spec.cutouts:
        data.ignore_alpha()
    if not quiet:
        _say_notes(data.notes)
    return data


def _open_file(spec: SceneSpec, path: Path) -> "AnyScene":
    place: dict[str, Any] = {"crs": spec.crs, "unit": spec.unit}
    if is_raster(path) or is_footprints(path):
        from .. import from_footprints, from_raster

        check_z_up(spec.up, path.name)
        terrain, keywords = list(spec.terrain) or None, dict[str, Any](spec.gis)
        if spec.own_cells:
            raster: AnyScene = wings.named(wings.OPEN_RASTER)(path, bounds=spec.bounds, **place, **keywords)
            return raster
        if is_raster(path):
            return from_raster(path, ground=terrain, **place, **keywords)
        return from_footprints(path, terrain=terrain, **place, **keywords)

    from .. import load
    from ..store.store_format import STORE_SUFFIX, TILES_SUFFIX

    if spec.up is not None and path.suffix.lower() in (STORE_SUFFIX, TILES_SUFFIX):
        raise InputError(f"{path.name}: a store has its own up axis; leave --up out")
    shares = dict(spec.transmittance) or None
    switches: dict[str, Any] = {"cutouts": spec.cutouts, "instances": spec.instances, "animation": spec.animation}
    return load(path, up=spec.up, lod=spec.lod, transmittance=shares, **switches, **place)


def stream_rasters(tiles: Sequence[SceneSpec]) -> "StreamedTerrain":
    """The single surface of rasters, read piece by piece."""
    files = list[Tile]()
    for spec in tiles:
        assert spec.path is not None  # procedural scenes are no rasters
        length = None if spec.unit is None else checked_unit(spec.unit)
        files.append((spec.path, {**dict(spec.gis), "unit": length, "up": spec.up}))
    raster = format_of(files[0][0])
    assert raster is not None and raster.stream is not None
    return raster.stream(files)


@contextmanager
def quietly() -> Iterator[None]:
    """Hide the loader's notes, which are warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        yield


def limit_memory(scene: "AnyScene", max_memory: int | None) -> int | None:
    """Limit the memory used by queries of a scene in a store, and return the limit; None for a scene in memory.

    A scene in memory has been read within the limit, and its queries have none.
    """
    if scene.data.resident:
        return None
    cast("PagedScene", scene).max_memory = max_memory
    return max_memory
