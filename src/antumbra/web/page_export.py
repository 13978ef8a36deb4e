"""A scene as one HTML file with exact shadows, which any browser opens from a folder, without a network.

The file has the scene's triangles with their bits, compressed; the kernels in WebAssembly; and the program of `page`.
Its content security policy allows no request.
"""

import base64
import hashlib
import json
from datetime import datetime
from html import escape
from pathlib import Path
from string import Template
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import atomic_output
from ..base.wording import counted
from ..engine.scene import AnyScene, Scene
from ..picture.heat_maps import RAMP
from ..scene.camera import Camera
from ..scene.height_tints import height_tints
from ..scene.scene_data import MemoryData
from ..scene.triangles import Triangles
from ..sun.location import Place
from ..version import VERSION
from ..viewer.page_html import ICON_ADDRESS
from ..work.scene_records import scene_digest
from .kernel_module import kernel_module
from .page_columns import Columns, distinct_rows
from .page_look import add_look, sun_angles
from .page_source import PAGE, page_program
from .page_still import still_of
from .value_layer import ValueLayer

MOST_TRIANGLES = 2_000_000
PROOF_RAYS = 2000
LANGUAGES = "en", "de"
_VISIBLE = 0.6  # share of the way to the middle of the scene, for a camera whose centre shows nothing


class PageOptions(NamedTuple):
    """What a page shows besides the scene."""

    title: str
    when: datetime  # local time of the place that the page opens with; without a place, it is ignored
    place: Place | None = None  # None: the sun is set by its direction and height
    credits: str = ""
    language: str = "en"


class PageReport(NamedTuple):
    """What was written."""

    triangles: int
    size: int  # bytes of the file
    digest: str  # of the scene
    notes: tuple[str, ...] = ()  # what its pictures lack


# --- Geometry and proof -----------------------------------------------------------------------------------------------


def _add_geometry(columns: Columns, triangles: Triangles, objects: NDArray[np.int32]) -> None:
    """Distinct vertices, indices, colours and objects of faces."""
    corners = triangles.vertices.reshape(-1, 3)
    vertices, indices = distinct_rows(corners)
    columns.add("positions", vertices)
    columns.add("indices", indices, step=True)
    columns.add_distinct("colour", triangles.colour)
    columns.add("objectOf", objects, step=True)


def _add_proof(columns: Columns, scenes: dict[str, AnyScene], triangles: Triangles) -> None:
    """Rays to vertices, edges and anywhere, with the answers of scenes here; their keys end the columns' names."""
    generator = np.random.default_rng(20)
    corners = triangles.vertices.reshape(-1, 3)
    lower, upper = corners.min(0).astype(np.float64), corners.max(0).astype(np.float64)
    starts = triangles.origin + lower + (upper - lower) * generator.uniform(-0.3, 1.3, (PROOF_RAYS, 3))
    origins = (starts - triangles.origin).astype(np.float32)
    aims = corners[generator.integers(0, len(corners), PROOF_RAYS)]
    faces = generator.integers(0, len(triangles.vertices), PROOF_RAYS // 2)
    aims[::2] = triangles.vertices[faces, :2].mean(1)
    directions = (aims - origins).astype(np.float32)
    directions[::5] = generator.normal(size=directions[::5].shape)
    directions[(directions == 0).all(1)] = 1.0
    world = origins.astype(np.float64) + triangles.origin
    columns.add("origins", (world - triangles.origin).astype(np.float32))
    columns.add("directions", directions)
    rows = np.full(int(triangles.face_id.max()) + 1, -1, np.int32)
    rows[triangles.face_id] = np.arange(len(triangles.face_id), dtype=np.int32)
    for state, scene in scenes.items():
        hits = scene.closest_hit(world, directions.astype(np.float64))
        columns.add(f"blocked{state}", scene.occluded(world, directions.astype(np.float64)))
        columns.add(f"faces{state}", np.where(hits.face < 0, np.int32(-1), rows[hits.face]).astype(np.int32))
        columns.add(f"distances{state}", hits.t.astype(np.float64))


# --- Both states of a scene that changes ------------------------------------------------------------------------------


def _hidden(scene: AnyScene) -> NDArray[np.bool_]:
    """(n,) bool: the faces that a state lacks."""
    data = cast(MemoryData, scene.data)
    return np.zeros(data.n_triangles, bool) if data.hidden is None else data.hidden


def _whole(before: Scene, after: AnyScene) -> Scene:
    """The scene with the faces of both states."""
    absent = _hidden(before) & _hidden(after)
    return Scene.of_data(cast(MemoryData, after.data).hiding(absent))


# --- The page ---------------------------------------------------------------------------------------------------------


def check_scene(scene: AnyScene) -> None:
    """Raise an InputError if a page cannot show the scene exactly."""
    if scene.n_triangles > MOST_TRIANGLES:
        raise InputError(
            f"{scene.name} has {counted(scene.n_triangles, 'triangle')}, and a page holds {MOST_TRIANGLES:,}; "
            "export a part of the scene, or a lower level of detail"
        )
    if scene.n_triangles == 0:
        raise InputError(f"{scene.name} has no triangles; a page needs a scene with surfaces")
    if scene.data.lets_light_pass:
        raise InputError(
            f"{scene.name} has holes or lets light pass by alpha or transmittance, which pages do not show; "
            "load it with ?cutouts=off and without transmittance, so that these faces block all light"
        )


def write_page(
    scene: AnyScene,
    path: Path,
    options: PageOptions,
    camera: Camera | None = None,
    time: float = 0.0,
    layer: ValueLayer | None = None,
    before: Scene | None = None,
) -> PageReport:
    """Write a scene as one HTML file that needs nothing else.

    Parameters
    ----------
    scene : Scene
    path : Path
    options : PageOptions
    camera : Camera or None
        The view that the page opens with, perspective. None: the scene's default view.
    time : float
        Seconds into the animation. Pages do not move.
    layer : ValueLayer or None
        Numbers that the surfaces show as colours.
    before : Scene or None
        The state before a change whose state after `scene` is (`SceneChange`); the page has a divider between them.

    Raises
    ------
    InputError
        If the scene has more than 2 million triangles, or lets light pass; if an option is invalid; if the linker is
        missing; or if the file cannot be written. An existing file then stays.
    """
    html, report = page_html(scene, options, camera, time, layer, before)
    with atomic_output(path) as temporary:
        temporary.write_bytes(html)
    return report


def page_html(
    scene: AnyScene,
    options: PageOptions,
    camera: Camera | None = None,
    time: float = 0.0,
    layer: ValueLayer | None = None,
    before: Scene | None = None,
) -> tuple[bytes, PageReport]:
    """The text of a page, in UTF-8, and what it holds; parameters and errors as for `write_page`."""
    check_scene(scene)
    if options.language not in LANGUAGES:
        raise InputError(f"language is {options.language!r}; choose {' or '.join(LANGUAGES)}")
    scenes: dict[str, AnyScene] = {"": scene}
    if before is not None:
        scenes = {"Before": before, "": scene}
    whole = scene if before is None else _whole(before, scene)
    triangles = whole.triangles(time)
    tints = height_tints(whole.data, triangles.vertices.mean(1))
    if tints is not None:
        triangles = triangles._replace(colour=tints)
    columns = Columns()
    _add_geometry(columns, triangles, whole.data.object_of_face[triangles.face_id])
    look = add_look(columns, scene, triangles, time, options.place)
    _add_proof(columns, scenes, triangles)
    if before is not None:
        states = ~_hidden(before) + 2 * ~_hidden(scene)  # of each face: 1 before, 2 after, 3 both
        columns.add("states", states[triangles.face_id].astype(np.uint8))
    module = kernel_module()
    columns.add("wasm", np.frombuffer(module.wasm, np.uint8))
    for name, values in ({} if layer is None else layer.arrays(triangles)).items():
        columns.add(name, values, step=values.dtype.kind == "i")
    digests = [scene_digest(each, time) for each in scenes.values()]
    view = camera or scene.default_camera(1280, 800, time=time)
    names = [each.parent or each.name for each in whole.objects]
    shown = int(len(triangles.vertices) if before is None else (~_hidden(whole)).sum())
    about = {
        "version": VERSION,
        "digest": " / ".join(each[:12] for each in digests),
        "bytes": columns.digest(),
        "changes": before is not None,
        "triangles": shown,
        "up": scene.up,
        "origin": triangles.origin.tolist(),
        "palette": RAMP.astype(int).tolist(),
        "unit": scene.unit.name,
        "metres": scene.unit.metres,
        "camera": _orbit_of(scene, triangles, view),
        "place": None if options.place is None else options.place._asdict(),
        "date": f"{options.when:%Y-%m-%d}",
        "minute": 60 * options.when.hour + options.when.minute,
        "angles": sun_angles(look.record, scene.up),
        "look": look.record,
        "objects": names if len(set(names)) > 1 else [],
        "kernels": {"kernels": module.kernels},
        "layer": None if layer is None else layer.about(),
        "columns": columns.listed,
    }
    still = still_of(scene, view, options.when, options.place, time)
    html = _html(about, columns.packed().decode(), options, still)
    return html, PageReport(shown, len(html), digests[-1], tuple(look.notes))


def _orbit_of(scene: AnyScene, triangles: Triangles, camera: Camera) -> dict[str, Any]:
    """The camera in the frame of the triangles, with the point at its centre as its target."""
    if camera.projection != "perspective":
        raise InputError(f"camera is {camera.projection}, and pages have perspective views; give POSITION:TARGET")
    ahead = camera.target - camera.position
    ahead = ahead / np.linalg.norm(ahead)
    away = float(scene.closest_hit(camera.position[None], ahead[None]).t[0])
    if not np.isfinite(away):
        middle = float((scene.bounds.mean(0) - camera.position) @ ahead)
        away = middle if middle > 0.0 else float(np.linalg.norm(scene.bounds[1] - scene.bounds[0])) * _VISIBLE
    position = camera.position - triangles.origin
    return {"position": position.tolist(), "target": (position + away * ahead).tolist(), "vfov": float(camera.vfov)}


def _html(about: dict[str, Any], data: str, options: PageOptions, still: bytes) -> bytes:
    """The file; `still`: the picture that it shows first, or nothing."""
    template = Template((PAGE / "page.html").read_text(encoding="utf-8"))
    style, code = (PAGE / "page.css").read_text(encoding="utf-8"), page_program()
    policy = (
        f"default-src 'none'; script-src 'sha256-{_digest(code)}' 'wasm-unsafe-eval'; "
        f"style-src 'sha256-{_digest(style)}'; img-src data:; worker-src blob:; base-uri 'none'; form-action 'none'"
    )
    text = template.substitute(
        language=options.language,
        policy=policy,
        icon=ICON_ADDRESS,
        version=VERSION,
        title=escape(options.title),
        credits=escape(options.credits or f"Antumbra {VERSION}"),
        style=style,
        about=json.dumps(about, separators=(",", ":")).replace("<", "\\u003c"),
        still=f'<img id="still" alt="" src="data:image/webp;base64,{base64.b64encode(still).decode()}">' * bool(still),
        data=data,
        code=code,
    )
    return text.encode("utf-8")


def _digest(text: str) -> str:
    """SHA-256 in base64, as a content security policy has it."""
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode()
