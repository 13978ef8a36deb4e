"""The look of a scene in its page: the lights of its picture, and the materials, textures and normals of its faces."""

import io
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.wording import counted
from ..engine.scene import AnyScene
from ..kernels.elementary import atan2
from ..picture.light_list_irradiance import list_fields
from ..query.light_samples import light_samples
from ..scene.appearance import SHARPEST, Appearance, normals_from_frames
from ..scene.light_lists import LightList
from ..scene.lights import DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight
from ..scene.materials import Texture, is_plain_image
from ..scene.sky import Sky
from ..scene.triangles import Triangles
from ..sun.location import Place
from .page_columns import Columns

LARGEST = 1024  # pixels of a side of a texture in a page
SUN_WIDTH = 0.533  # degrees of the sun over a place
_STEPS = 32767  # of a component of a normal
_EMBEDDED = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}


# --- Lights -----------------------------------------------------------------------------------------------------------


def picture_lights(scene: AnyScene, time: float, place: Place | None) -> list[Light]:
    """The lights of the scene's picture; with a place, the sun shines in any case."""
    lights = scene.default_lights(time)
    if place is None or any(isinstance(light, DirectionalLight) for light in lights):
        return lights
    skies = [] if any(isinstance(light, Sky) for light in lights) else [Sky(up=scene.up)]
    return [scene.view.sun(), *(lights if scene.lights else []), *(skies if scene.lights else [Sky(up=scene.up)])]


def add_lights(columns: Columns, lights: list[Light], origin: NDArray[np.float64], place: Place | None) -> list[Any]:
    """Add the numbers of lists of lights to the columns, and return a record of each light, in the frame at `origin`.

    The first sun is the one that the page moves. It dims, as skies do, while it is low.
    """
    suns = [k for k, light in enumerate(lights) if isinstance(light, DirectionalLight)]
    records = []
    for k, light in enumerate(lights):
        moves = k in suns[:1]
        record = _list_record(columns, k, light, origin) if isinstance(light, LightList) else _record(light, origin)
        if moves and place is not None:
            record["angularDiameter"] = SUN_WIDTH
        is_sky = isinstance(light, Sky)
        records.append({**record, "moves": moves, "smooth": is_sky, "daylight": is_sky and bool(suns)})
    return records


def sun_angles(look: dict[str, Any], up: str) -> dict[str, float] | None:
    """Azimuth and altitude in degrees of the sun that a page moves; None without one."""
    moved = next((record for record in look["lamps"] if record["moves"]), None)
    if moved is None:
        return None
    x, y, z = (-each for each in moved["direction"])
    east, north, height = (x, y, z) if up == "z" else (x, -z, y)
    azimuth = float(np.degrees(atan2(east, north))) % 360.0
    altitude = float(np.degrees(atan2(height, np.sqrt(east * east + north * north))))
    return {"azimuth": round(azimuth, 3), "altitude": round(altitude, 3)}


def _record(light: Light, origin: NDArray[np.float64]) -> dict[str, Any]:
    """A light as the modules for JavaScript take it, and its tint."""
    tint = (light.intensity * np.asarray(light.colour, np.float64)).tolist()
    vector = lambda value: np.asarray(value, np.float64).tolist()
    match light:
        case PointLight():
            return {"kind": "point", "tint": tint, "position": vector(light.position - origin)}
        case QuadLight():
            corner = vector(light.corner - origin)
            return {"kind": "quad", "tint": tint, "corner": corner, "u": vector(light.u), "v": vector(light.v)}
        case DiskLight():
            round_light = {"center": vector(light.center - origin), "radius": float(light.radius)}
            return {"kind": "disk", "tint": tint, **round_light, "normal": vector(light.normal)}
        case SphereLight():
            round_light = {"center": vector(light.center - origin), "radius": float(light.radius)}
            return {"kind": "sphere", "tint": tint, **round_light}
        case DirectionalLight():
            way = {"direction": vector(light.direction), "angularDiameter": float(light.angular_diameter)}
            return {"kind": "sun", "tint": tint, **way}
    raise InputError(f"pages do not show {type(light).__name__}; give the scene other lights")


def _list_record(columns: Columns, k: int, light: LightList, origin: NDArray[np.float64]) -> dict[str, Any]:
    """A list of lights, whose samples and fields become columns."""
    samples = light_samples(light, 1)
    fields = list_fields(light, samples, origin)
    columns.add(f"samples{k}", samples if fields.distant else samples - origin)
    columns.add(f"lights{k}", fields.values.astype(np.float32))
    about = {"distant": fields.distant, "facing": fields.facing, "least": float(fields.least)}
    return {"kind": "list", "tint": [1, 1, 1], "columns": [f"samples{k}", f"lights{k}"], **about}


def add_sky(columns: Columns, lights: list[Light]) -> dict[str, Any] | None:
    """The sky that is seen behind the scene; None without one."""
    skies = [light for light in lights if isinstance(light, Sky)]
    if not skies:
        return None
    map_of_sky = skies[0].radiance_map
    columns.add("sky", map_of_sky)
    daylight = skies[0].intensity if skies[0].is_daylight else 0.0
    return {"shape": list(map_of_sky.shape), "axes": skies[0].axes.tolist(), "daylight": daylight}


# --- Materials, textures and normals ----------------------------------------------------------------------------------


class LookReport(NamedTuple):
    """The look of a scene: a record for the page, and notes on what its pictures lack."""

    record: dict[str, Any]
    notes: list[str]


def add_look(columns: Columns, scene: AnyScene, triangles: Triangles, time: float, place: Place | None) -> LookReport:
    """Add what pictures need besides triangles to the columns."""
    lights = picture_lights(scene, time, place)
    record: dict[str, Any] = {
        "lamps": add_lights(columns, lights, triangles.origin, place),
        "sky": add_sky(columns, lights),
        "textures": [],
        "sharpest": SHARPEST,
    }
    notes: list[str] = []
    looks = scene.data.stored_looks
    appearance = scene.appearance if looks is None else looks.of(np.arange(scene.n_triangles))
    if appearance is not None:
        record["textures"], notes = _add_appearance(columns, appearance, triangles)
    return LookReport(record, notes)


def _add_appearance(
    columns: Columns, appearance: Appearance, triangles: Triangles
) -> tuple[list[dict[str, Any]], list[str]]:
    """Add the materials, texture coordinates, vertex colours and normals of faces; return the textures, and notes."""
    rows = triangles.face_id
    material_of = appearance.material_of_face[rows]
    shown = np.unique(material_of[appearance.textured[rows] & (material_of >= 0)])
    textures = [appearance.materials[k].texture if k in shown else None for k in range(len(appearance.materials))]
    kept = list(dict.fromkeys(each for each in textures if each is not None))
    columns.add("materialOf", material_of, step=True)
    columns.add("factors", np.array([each.factor[:3] for each in appearance.materials], np.float32).reshape(-1, 3))
    columns.add("textureOf", np.array([-1 if t is None else kept.index(t) for t in textures], np.int32))
    columns.add("textured", appearance.textured[rows])
    if appearance.uv is not None and kept:
        columns.add_distinct("uv", appearance.uv[rows].reshape(-1, 2))
    if appearance.colours is not None:
        columns.add_distinct("tone", appearance.colours[rows].reshape(-1, 4))
    if appearance.normals is not None and appearance.bends is not None:
        normals = normals_from_frames(triangles.vertices.astype(np.float64), appearance.normals[rows])
        columns.add_distinct("normal", np.round(normals.reshape(-1, 3) * _STEPS).astype(np.int16))
        columns.add("bends", np.round(appearance.bends[rows] * (255.0 / SHARPEST)).astype(np.uint8))
    listed, smaller = [], []
    for k, texture in enumerate(kept):
        kind, data, reduced = _image(texture)
        columns.add(f"texture{k}", np.frombuffer(data, np.uint8))
        smaller += [texture.name] if reduced else []
        wraps = [texture.wrap_s, texture.wrap_t]
        listed.append({"type": kind, "wraps": wraps, "nearest": texture.nearest, "column": f"texture{k}"})
    notes = (
        []
        if not smaller
        else [f"{counted(len(smaller), 'texture', 'are')} larger than {LARGEST} pixels; the page has them smaller"]
    )
    return listed, notes


def _image(texture: Texture) -> tuple[str, bytes, bool]:
    """(type, bytes, whether it was reduced) of an image that browsers decode to the colours of a texture.

    The file itself is kept if it is small and has no alpha, by which browsers change colours.
    """
    from PIL import Image

    try:
        pixels = Image.fromarray(texture.pixels).convert("RGB")
    except ValueError as error:
        raise InputError(f"{texture.name} cannot be decoded ({error}); load the scene without textures") from error
    large = max(pixels.size) > LARGEST
    data = texture.picture
    if isinstance(data, bytes) and not large and texture.opacity is None:
        kind = next((kind for start, kind in _EMBEDDED.items() if data.startswith(start)), None)
        if kind is not None and is_plain_image(data):
            return kind, data, False
    if large:
        pixels.thumbnail((LARGEST, LARGEST), Image.Resampling.BOX)
    file = io.BytesIO()
    if isinstance(data, bytes) and data.startswith(b"\xff\xd8"):
        pixels.save(file, "JPEG", quality=90)
        return "image/jpeg", file.getvalue(), large
    pixels.save(file, "PNG", optimize=True)
    return "image/png", file.getvalue(), large
