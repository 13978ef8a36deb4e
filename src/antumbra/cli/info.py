"""``antumbra info``: shows the contents of a scene."""

from collections import Counter
from collections.abc import Iterator
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .options import SCENE_HELP, Json, UpOption
from .progress import ProgressDisplay
from .sceneinput import open_scene

if TYPE_CHECKING:
    from ..store.store_file import Store

TRIANGLE_BYTES = 3 * 3 * 4 + 4 + 3 * 4  # corners, face_id, colour of `Triangles`
_MOST_MESHES = 20


def info(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")],
    up: UpOption = None,
    check: Annotated[bool, typer.Option("--check", help="Of a store: read all of it and check its checksums.")] = False,
    json: Json = False,
) -> None:
    """Show the contents of SCENE.

    It lists meshes, triangles, instances, bounds, cameras, lights, animation, memory, and the loader's notes about
    parts it left out. For a store it shows its chunks.

    \b
    Examples
      antumbra info sponza.glb
      antumbra info procedural:city --json
      antumbra info city.antumbra --check
    """
    spec = arguments.parse_scene(scene)
    with ProgressDisplay() as display:
        display.say("reading the scene")
        start = perf_counter()
        opened = open_scene(spec, None if up is None else up.value, quiet=True)
        seconds = perf_counter() - start
        store = getattr(opened, "store", None)
        if check:
            _check(store, scene, display)
    if json:
        report.print_json(_answer(scene, opened, seconds) | ({} if store is None else _store_answer(store, check)))
        return
    report.print_fields(_fields(opened, seconds))
    if store is not None:
        report.print_fields(_store_fields(store, check))
        return
    meshes = opened.meshes
    shown = sorted(meshes, key=lambda m: -m.triangles * m.instances)[:_MOST_MESHES]
    report.print_table(
        ("mesh", "triangles", "instances"),
        [(m.name, f"{m.triangles:,}", f"{m.instances:,}") for m in shown],
        right=(1, 2),
    )
    if len(meshes) > len(shown):
        print(f"... and {len(meshes) - len(shown)} smaller meshes (--json lists all)")


def _check(store: "Store | None", source: str, display: ProgressDisplay) -> None:
    if store is None:
        raise InputError(f"{source}: --check is for stores (.antumbra); leave it out")
    memory = store.memory()
    for k in range(len(store)):
        display.say("checking", k, len(store))
        store.check(k, memory)


def _store_answer(store: "Store", checked: bool) -> dict:
    chunks = {name: getattr(store.chunks, name).tolist() for name in ("offset", "bytes", "triangles", "nodes")}
    return {"bytes": store.path.stat().st_size, "chunks": chunks, "built": store.meta.built, "checked": checked}


def _store_fields(store: "Store", checked: bool) -> Iterator[tuple[str, str]]:
    size, chunks = store.path.stat().st_size, store.chunks
    yield "store", f"{report.size_in_memory(size)}, {size / store.n_triangles:.1f} bytes a triangle"
    spread = f"{chunks.triangles.min():,} to {chunks.triangles.max():,} triangles each"
    yield "chunks", f"{len(store):,}, {spread}; {len(store.top.nodes):,} nodes above them"
    yield "built", ", ".join(f"{name} {value}" for name, value in store.meta.built.items())
    if checked:
        yield "checksums", "all as they should be"


def _answer(source: str, scene, seconds: float) -> dict:
    return {
        "source": source,
        "name": scene.name,
        "up": scene.up,
        "triangles": scene.n_triangles,
        "bounds": scene.bounds,
        "origin": scene.origin,
        "crs": scene.crs,
        "duration": scene.duration,
        "meshes": [m._asdict() for m in scene.meshes],
        "cameras": [report.camera_fields(c) for c in scene.cameras],
        "lights": [report.light_fields(light) for light in scene.lights],
        "notes": list(scene.notes),
        "city": None if scene.city is None else _city_answer(scene.city),
        "triangle_bytes": scene.n_triangles * TRIANGLE_BYTES,
        "load": seconds,
    }


def _city_answer(city) -> dict:
    surfaces = Counter(surface.type or "none" for surface in city.surfaces)
    return {"crs": city.crs, "lods": city.lods, "objects": Counter(city.types), "surfaces": surfaces}


def _fields(scene, seconds: float) -> Iterator[tuple[str, str]]:
    lower, upper = scene.bounds
    yield "scene", f"{scene.name}, read in {report.duration(seconds)}"
    meshes = f" in {len(scene.meshes):,} mesh{'es' * (len(scene.meshes) != 1)}" if scene.meshes else ""
    yield "triangles", f"{scene.n_triangles:,}{meshes}"
    if scene.meshes:
        yield "memory", f"{report.size_in_memory(scene.n_triangles * TRIANGLE_BYTES)} for the triangles at one moment"
    yield "bounds", f"{report.vector(lower)} to {report.vector(upper)}"
    yield "size", f"{report.vector(upper - lower)}, +{scene.up.upper()} is up"
    yield "origin", report.vector(scene.origin)
    if scene.crs or scene.city is not None:
        yield "CRS", scene.crs or "none in the file"
    if scene.city is not None:
        levels = ", ".join(scene.city.lods) or "not named"
        yield "city", f"{len(scene.city.objects):,} objects, levels of detail {levels}"
    yield "animation", f"{scene.duration:g} seconds" if scene.animated else "none"
    for i, camera in enumerate(scene.cameras):
        place = f"{report.vector(camera.position)} to {report.vector(camera.target)}"
        lens = f"vfov {camera.vfov:.4g}" if camera.extent is None else f"orthographic, {camera.extent:.4g} high"
        yield f"camera {i}", f"{place}, {lens}"
    for i, light in enumerate(scene.lights):
        yield f"light {i}", _in_words(light)
    if not scene.cameras:
        yield "cameras", "none: a camera that shows the whole scene is used"
    if not scene.lights:
        yield "lights", "none: sun and sky are used, or a lamp in a closed room"
    for note in scene.notes:
        yield "note", note


def _in_words(light) -> str:
    values = report.light_fields(light)
    kind = values.pop("type")
    if tuple(values.get("colour", ())) == (1.0, 1.0, 1.0):
        del values["colour"]
    return f"{kind} " + ", ".join(f"{k} {_short(v)}" for k, v in values.items() if v is not None)


def _short(value) -> str:
    if isinstance(value, (str, bool)):
        return repr(value) if isinstance(value, str) else str(value)
    return report.vector(value) if hasattr(value, "__len__") else f"{value:.6g}"
