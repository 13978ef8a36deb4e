"""``antumbra info``, ``scenes``, ``formats`` and ``build``.

They describe a scene, list and export procedural scenes, list file formats, and build stores.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..base.checks import alternatives
from ..base.errors import InputError
from ..engine.scene_reading import SCENE_FORMATS
from ..formats.array_files import FILES
from ..formats.format_registry import SCENE_WRITERS, check_output, write_scene
from ..picture.picture_records import camera_fields, light_fields
from ..work.result_summary import duration
from . import arguments, console
from .console import ProgressDisplay
from .options import SCENE_HELP, SCENE_OPTIONS, Json, Quiet, SceneArgument, Threads, UpOption, takes, writes
from .scene_arguments import SceneArguments, SceneSpec, is_raster, open_scene, stream_rasters

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..generate.generated_scene import StreamedCity
    from ..scene.lights import Light
    from ..scene.scene_data import CityModel
    from ..scene.terrain import StreamedTerrain
    from ..store.store_build import BuildReport
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
        print(f"... and {len(meshes) - len(largest)} smaller meshes (--json lists all)")
    return 0


def _check(store: "Store | None", source: str, display: ProgressDisplay) -> None:
    if store is None:
        raise InputError(f"{source}: --check is for stores (.antumbra); leave it out")
    memory = store.memory()
    for k in range(len(store)):
        display.say("checking", k, len(store))
        store.check(k, memory)


def _store_answer(store: "Store", checked: bool) -> dict[str, Any]:
    chunks = {name: getattr(store.chunks, name).tolist() for name in ("offset", "bytes", "triangles", "nodes")}
    return {"bytes": store.path.stat().st_size, "chunks": chunks, "built": store.meta.built, "checked": checked}


def _store_fields(store: "Store", checked: bool) -> Iterator[tuple[str, str]]:
    size, chunks = store.path.stat().st_size, store.chunks
    yield "store", f"{console.size_in_memory(size)}, {size / store.n_triangles:.1f} bytes per triangle"
    spread = f"{chunks.triangles.min():,} to {chunks.triangles.max():,} triangles each"
    yield "chunks", f"{len(store):,}, {spread}; {len(store.top.nodes):,} nodes above them"
    yield "built", ", ".join(f"{name} {value}" for name, value in store.meta.built.items())
    if checked:
        yield "checksums", "all correct"


def _answer(source: str, scene: "AnyScene", seconds: float) -> dict[str, Any]:
    return {
        "source": source,
        "name": scene.name,
        "up": scene.up,
        "triangles": scene.n_triangles,
        "bounds": scene.bounds,
        "origin": scene.origin,
        "crs": scene.crs,
        "unit": scene.unit.name,
        "duration": scene.duration,
        "meshes": [m._asdict() for m in scene.meshes],
        "cameras": [camera_fields(c) for c in scene.cameras],
        "lights": [light_fields(light) for light in scene.lights],
        "notes": _notes(scene),
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


def _info_fields(scene: "AnyScene", seconds: float) -> Iterator[tuple[str, str]]:
    lower, upper = scene.bounds
    yield "scene", f"{scene.name}, read in {duration(seconds)}"
    meshes = f" in {len(scene.meshes):,} mesh{'es' * (len(scene.meshes) != 1)}" if scene.meshes else ""
    yield "triangles", f"{scene.n_triangles:,}{meshes}"
    if scene.meshes:
        yield "memory", f"{console.size_in_memory(scene.n_triangles * TRIANGLE_BYTES)} for the triangles at one time"
    yield "bounds", f"{console.vector(lower)} to {console.vector(upper)}"
    yield "size", f"{console.vector(upper - lower)}, +{scene.up.upper()} is up"
    yield "origin", console.vector(scene.origin)
    yield "unit", scene.unit.name
    if scene.crs or scene.city is not None:
        yield "CRS", scene.crs or "none in the file"
    if scene.city is not None:
        levels = ", ".join(scene.city.lods) or "not named"
        yield "city", f"{len(scene.city.objects):,} objects, levels of detail {levels}"
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
    for note in _notes(scene):
        yield "note", note


def _notes(scene: "AnyScene") -> list[str]:
    """The notes of the loader, and why studies would refuse the scene."""
    from ..engine.measured_scenes import measuring_fault

    fault = measuring_fault(scene)
    return list(scene.notes) if fault is None else [*scene.notes, f"pictures only; {fault}"]


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
        rows = [("scene", f"{name}, {answer['triangles']:,} triangles")]
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


# --- ``antumbra build`` -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BuildArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scenes: Annotated[list[str], typer.Argument(help=SCENE_HELP, metavar="SCENE...")]
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="The store to write: *.antumbra.", metavar="FILE", callback=writes(".antumbra")
        ),
    ]
    max_memory: Annotated[
        str, typer.Option(help="Memory limit of the build, in bytes or with a suffix: 512M, 4G.", metavar="SIZE")
    ] = "4G"
    up: UpOption = None
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(BuildArguments)
def build(args: BuildArguments) -> int:
    """Build a store, which may exceed memory.

    A store holds the triangles in chunks, each with its BVH and checksums. Several scenes are merged in the given
    order, in their state at time 0, with all their cameras and lights. procedural:city is generated and written block
    by block, at any size, and so are rasters of heights. Rasters that follow one another, and those of a folder, are
    tiles of one surface. Other scenes are read into memory one at a time. The same scenes give the same bytes for any
    --max-memory and --threads.

    \b
    Examples
      antumbra build sponza.glb -o sponza.antumbra
      antumbra build "procedural:city?triangles=350M" -o city.antumbra --max-memory 4G
      antumbra build dem.tif -o dem.antumbra --max-memory 4G
      antumbra build west.tif east.tif -o dem.antumbra
      antumbra info city.antumbra --check
    """
    args.refuse_changes("stores hold whole files; name all of them as SCENEs")
    specs = [spec for text in args.scenes for spec in _tiles_of(args.spec_of(text))]
    memory = arguments.parse_bytes(args.max_memory, "--max-memory")

    from ..engine.store_building import build_store
    from ..store.system_resources import peak_resident_memory

    with ProgressDisplay(args.quiet) as display:
        display.say("reading")
        opened = _opened(specs, args.threads, args.quiet)
        report = build_store(opened, args.output, max_memory=memory, threads=args.threads, progress=display.say)
    peak = peak_resident_memory()
    if args.json:
        console.print_json({**report._asdict(), "path": str(report.path), "max_memory": memory, "peak_resident": peak})
    elif not args.quiet:
        console.print_fields(_build_fields(report, peak))
    return 0


def _tiles_of(spec: SceneSpec) -> list[SceneSpec]:
    """The scene, or the rasters of heights in a folder, by name; a folder of vertex frames is a scene."""
    if spec.path is None or not spec.path.is_dir() or any((spec.path / name).exists() for name in FILES):
        return [spec]
    return [spec._replace(path=path) for path in sorted(spec.path.iterdir()) if is_raster(path)] or [spec]


def _opened(
    specs: list[SceneSpec], threads: int | None, quiet: bool
) -> "Iterator[AnyScene | StreamedCity | StreamedTerrain]":
    """Yield the scenes one by one. Cities and rasters of heights are streams of blocks, which are made later."""
    from ..generate.generated_scene import StreamedCity
    from ..kernels.parallel import thread_count

    for streamed, group in groupby(specs, lambda spec: spec.is_streamed):
        if streamed:
            yield stream_rasters(list(group))
            continue
        for spec in group:
            if spec.path is None and spec.name == "city" and spec.up is None:
                yield StreamedCity(spec.triangles, spec.seed, thread_count(threads))
            else:
                yield open_scene(spec, quiet)


def _build_fields(report: "BuildReport", peak: int | None) -> Iterator[tuple[str, str]]:
    phases = dict(report.seconds)
    total = phases.pop("total")
    yield "store", str(report.path)
    yield "triangles", f"{report.triangles:,} in {report.chunks:,} chunk{'s' * (report.chunks != 1)}"
    yield "size", f"{console.size_in_memory(report.bytes)}, {report.bytes / report.triangles:.1f} bytes per triangle"
    yield "time", f"{duration(total)}: " + ", ".join(f"{k} {duration(s)}" for k, s in phases.items())
    if peak is not None:
        yield "memory", f"{console.size_in_memory(peak)} at the peak"
