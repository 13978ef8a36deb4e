"""``antumbra info``, ``scenes`` and ``formats``.

They describe a scene, list and export procedural scenes, and list file formats.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..base.checks import alternatives
from ..base.errors import InputError
from ..base.extras import MissingPackage
from ..base.memory import readable_size
from ..base.wording import counted
from ..engine.scene_reading import SCENE_FORMATS
from ..formats.format_registry import SCENE_WRITERS, check_output, write_scene
from ..picture.picture_records import camera_fields, light_fields
from ..work.result_summary import duration
from . import arguments, console
from .console import ProgressDisplay
from .options import SCENE_OPTIONS, Json, SceneArgument, UpOption, takes, writes
from .scene_arguments import SceneArguments, open_scene

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..scene.lights import Light
    from ..scene.scene_data import CityModel
    from ..store.store_file import Store


# --- ``antumbra info`` ------------------------------------------------------------------------------------------------


TRIANGLE_BYTES = 3 * 3 * 4 + 4 + 3 * 4  # corners, face_id, colour of `Triangles`
_MOST_MESHES = 20


@dataclass(frozen=True)
class InfoArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument
    up: UpOption = None
    check: Annotated[bool, typer.Option("--check", help="Read a whole store and verify its checksums.")] = False
    json: Json = False


@takes(InfoArguments)
def info(args: InfoArguments) -> int:
    """Show the contents of SCENE.

    It lists meshes, triangles, instances, bounds, cameras, lights, animation, memory, and the loader's notes about
    ignored parts. For a store, it also describes the chunks.

    \b
    Examples
      antumbra info sponza.glb
      antumbra info procedural:city --json
      antumbra info city.antumbra --check
    """
    spec = args.spec_of(args.scene)
    with ProgressDisplay() as display:
        display.say("reading the scene")
        start = perf_counter()
        opened = open_scene(spec, quiet=True)
        seconds = perf_counter() - start
        store = getattr(opened, "store", None)
        if args.check:
            _check(store, args.record_of(args.scene), display)
    if args.json:
        answer = _answer(args.record_of(args.scene), opened, seconds)
        console.print_json(answer | ({} if store is None else _store_answer(store, args.check)))
        return 0
    console.print_fields(_info_fields(opened, seconds))
    if store is not None:
        console.print_fields(_store_fields(store, args.check))
        return 0
    meshes = opened.meshes
    largest = sorted(meshes, key=lambda m: -m.triangles * m.instances)[:_MOST_MESHES]
    console.print_table(
        ("mesh", "triangles", "instances"),
        [(m.name, f"{m.triangles:,}", f"{m.instances:,}") for m in largest],
        right=(1, 2),
    )
    if len(meshes) > len(largest):
        print(f"... and {counted(len(meshes) - len(largest), 'smaller mesh')} (--json lists all)")
    return 0


def _check(store: "Store | None", source: str, display: ProgressDisplay) -> None:
    if store is None:
        raise InputError(f"{source}: --check is for stores (.antumbra, .tiles); leave it out")
    memory = store.memory()
    for k in range(len(store)):
        display.say("checking", k, len(store))
        store.check(k, memory)
    if (heights := store.heights()) is not None:
        heights.check()
    store.cutouts()
    if (looks := store.looks()) is not None:
        looks.check()


def _store_answer(store: "Store", checked: bool) -> dict[str, Any]:
    from ..store.tiled_store import TiledStore

    chunks = {name: getattr(store.chunks, name).tolist() for name in ("offset", "bytes", "triangles", "nodes")}
    tiles = {"tiles": [tile._asdict() for tile in store.tiles]} if isinstance(store, TiledStore) else {}
    return {"bytes": store.size, **tiles, "chunks": chunks, "built": store.meta.built, "checked": checked}


def _store_fields(store: "Store", checked: bool) -> Iterator[tuple[str, str]]:
    from ..store.tiled_store import TiledStore

    size, chunks = store.size, store.chunks
    yield "store", f"{readable_size(size)}, {size / store.n_triangles:.1f} bytes per triangle"
    if isinstance(store, TiledStore):
        most = max(tile.triangles for tile in store.tiles)
        yield "tiles", f"{len(store.tiles):,}, up to {counted(most, 'triangle')} each"
    spread = f"{chunks.triangles.min():,} to {counted(chunks.triangles.max(), 'triangle')} each"
    yield "chunks", f"{len(store):,}, {spread}; {counted(len(store.top.nodes), 'node')} above them"
    yield "built", ", ".join(f"{name} {value}" for name, value in store.meta.built.items())
    if checked:
        yield "checksums", "all correct"


def _answer(source: str, scene: "AnyScene", seconds: float) -> dict[str, Any]:
    from ..engine.measured_scenes import notes_of

    return {
        "source": source,
        "name": scene.name,
        "up": scene.up,
        "triangles": scene.n_triangles,
        "bounds": scene.bounds,
        "origin": scene.origin,
        "crs": scene.crs,
        "unit": _unit_name(scene),
        "duration": scene.duration,
        "meshes": [m._asdict() for m in scene.meshes],
        "cameras": [camera_fields(c) for c in scene.cameras],
        "lights": [light_fields(light) for light in scene.lights],
        "notes": notes_of(scene),
        "city": None if scene.city is None else _city_answer(scene.city),
        "triangle_bytes": scene.n_triangles * TRIANGLE_BYTES,
        "load": seconds,
    }


def _city_answer(city: "CityModel") -> dict[str, Any]:
    surfaces = Counter(surface.type or "none" for surface in city.surfaces)
    attributes = {"objects": city.object_attribute_names, "surfaces": city.surface_attribute_names}
    return {
        "crs": city.crs,
        "lods": city.lods,
        "objects": Counter(city.types),
        "surfaces": surfaces,
        "attributes": attributes,
    }


def _unit_name(scene: "AnyScene") -> str | None:
    """The unit of a scene; None without the package that knows that of its CRS, which a note says."""
    try:
        return scene.unit.name
    except MissingPackage:
        return None


def _info_fields(scene: "AnyScene", seconds: float) -> Iterator[tuple[str, str]]:
    from ..engine.measured_scenes import notes_of

    lower, upper = scene.bounds
    yield "scene", f"{scene.name}, read in {duration(seconds)}"
    meshes = f" in {len(scene.meshes):,} mesh{'es' * (len(scene.meshes) != 1)}" if scene.meshes else ""
    yield "triangles", f"{scene.n_triangles:,}{meshes}"
    if scene.meshes:
        yield "memory", f"{readable_size(scene.n_triangles * TRIANGLE_BYTES)} for the triangles at one time"
    yield "bounds", f"{console.vector(lower)} to {console.vector(upper)}"
    yield "size", f"{console.vector(upper - lower)}, +{scene.up.upper()} is up"
    yield "origin", console.vector(scene.origin)
    yield "unit", _unit_name(scene) or "unknown"
    if scene.crs or scene.city is not None:
        yield "CRS", scene.crs or "none in the file"
    if scene.city is not None:
        levels = ", ".join(scene.city.lods) or "not named"
        yield "city", f"{counted(len(scene.city.objects), 'object')}, levels of detail {levels}"
        for kind in "object", "surface":
            names = getattr(scene.city, f"{kind}_attribute_names")
            if names:
                yield f"{kind} data", ", ".join(names)
    yield "animation", f"{scene.duration:g} seconds" if scene.animated else "none"
    for i, camera in enumerate(scene.cameras):
        place = f"{console.vector(camera.position)} to {console.vector(camera.target)}"
        lens = f"vfov {camera.vfov:.4g}" if camera.extent is None else f"orthographic, {camera.extent:.4g} high"
        yield f"camera {i}", f"{place}, {lens}"
    for i, light in enumerate(scene.lights):
        yield f"light {i}", light_text(light)
    if not scene.cameras:
        yield "cameras", "none; the default camera shows the whole scene"
    if not scene.lights:
        yield "lights", "none; the defaults are sun and sky, or a lamp in a closed room"
    for note in notes_of(scene):
        yield "note", note


def light_text(light: "Light") -> str:
    """The fields of a light in one line."""
    values = light_fields(light)
    kind = values.pop("type")
    if tuple(values.get("colour", ())) == (1.0, 1.0, 1.0):
        del values["colour"]
    return f"{kind} " + ", ".join(f"{k} {_short(v)}" for k, v in values.items() if v is not None)


def _short(value: Any) -> str:
    if isinstance(value, (str, bool)):
        return repr(value) if isinstance(value, str) else str(value)
    return console.vector(value) if hasattr(value, "__len__") else f"{value:.6g}"


# --- ``antumbra scenes`` ----------------------------------------------------------------------------------------------


def scenes(
    name: Annotated[str | None, typer.Argument(help="A scene to describe or export.", metavar="NAME")] = None,
    triangles: Annotated[
        str | None,
        typer.Option(
            help="Approximate number of triangles: 5000, 100k, 2M.  [default: depends on the scene]", metavar="N"
        ),
    ] = None,
    seed: Annotated[str, typer.Option(help="Seed for the placement of clutter.", metavar="N")] = "0",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help=f"Export the scene to a {alternatives(list(SCENE_WRITERS))} file.",
            metavar="FILE",
            callback=writes(*SCENE_WRITERS),
        ),
    ] = None,
    json: Json = False,
) -> None:
    """List the built-in scenes, or export one.

    A GLB file also contains the scene's camera and a point light, which replaces the quad light because glTF has no
    area lights. To render a scene, use its name: antumbra render procedural:city, or example:temple

    \b
    Examples
      antumbra scenes
      antumbra scenes city --triangles 1M --seed 7 -o city.glb
    """
    if name is None:
        if output is not None or triangles is not None:
            raise InputError("name a scene to export: antumbra scenes NAME -o FILE")
        _list(json)
        return
    count = None if triangles is None else arguments.parse_count(triangles, "--triangles")
    number = arguments.parse_count(seed, "--seed")
    if output is not None:
        check_output(output)
    with ProgressDisplay() as display:
        display.say("generating")
        answer = _make(name, count, number, output)
    if json:
        console.print_json(answer)
    else:
        lower, upper = answer["bounds"]
        rows = [("scene", f"{name}, {counted(answer['triangles'], 'triangle')}")]
        rows.append(("bounds", f"{console.vector(lower)} to {console.vector(upper)}"))
        rows += [("written", str(file)) for file in answer["files"]]
        console.print_fields(rows)


def _list(json: bool) -> None:
    from ..examples import EXAMPLES
    from ..generate.procedural_scenes import PROCEDURAL, load_plugin_scenes

    load_plugin_scenes()
    rows = [(name, recipe.default_triangles, recipe.description) for name, recipe in PROCEDURAL.items()]
    if json:
        scenes = [dict(zip(("name", "triangles", "description"), row)) for row in rows]
        examples = [{"name": name, **each._asdict()} for name, each in EXAMPLES.items()]
        console.print_json({"scenes": scenes, "examples": examples})
        return
    cells = [(name, f"{triangles:,}", description) for name, triangles, description in rows]
    console.print_table(("procedural:", "triangles", "description"), cells, right=(1,))
    files = [(name, each.description) for name, each in EXAMPLES.items()]
    console.print_table(("example:", "description"), files)


def _make(name: str, triangles: int | None, seed: int, output: Path | None) -> dict[str, Any]:
    from ..generate.procedural_scenes import generate

    generated = generate(name, triangles, seed)
    files = [] if output is None else write_scene(generated, name, output)
    return {
        "name": name,
        "seed": seed,
        "triangles": len(generated.faces),
        "bounds": [generated.vertices.min(0), generated.vertices.max(0)],
        "camera": generated.camera,
        "light": generated.light,
        "files": [str(file) for file in files],
    }


# --- ``antumbra formats`` ---------------------------------------------------------------------------------------------


def formats(json: Json = False) -> None:
    """List the file formats, and the options of SCENE.

    All are read; "write" marks those that antumbra scenes exports. Other commands write GLB files (bake), stores
    (build), and copies of CityJSON files with results (sun --city-output). An extra is installed with
    pip install 'antumbra[NAME]'; glTF needs it only for meshes compressed by
    Draco or meshopt, and for KTX2 textures.

    \b
    Examples
      antumbra formats
      antumbra formats --json
    """
    if json:
        rows = [
            {
                "name": each.name,
                "suffixes": each.suffixes,
                "reads": True,
                "writes": each.write is not None,
                "extra": each.extra,
                "lost": each.lost,
            }
            for each in SCENE_FORMATS
        ]
        console.print_json({"formats": rows, "options": SCENE_OPTIONS})
        return
    console.print_table(
        ("format", "suffix", "use", "extra", "what is lost"),
        [
            (each.name, " ".join(each.suffixes), "read, write" if each.write else "read", each.extra or "", each.lost)
            for each in SCENE_FORMATS
        ],
    )
    console.print_table(("SCENE", "meaning"), SCENE_OPTIONS.items())
