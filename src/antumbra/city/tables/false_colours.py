"""False-colour output of results: pictures with a legend, and unlit GLB models with vertex colours (`COLOR_0`)."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.wording import exponent_of_ten
from ...engine.scene import AnyScene
from ...formats.gltf.gltf_writer import TRIANGLES, GltfWriter, Json, up_axis_transform
from ...kernels.elementary import atan, tan
from ...kernels.small_matrices import product
from ...picture.heat_maps import LIGHT, ColourBar, Panel, Scale, linear_scale, linear_ticks, panel_sheet
from ...picture.renderer import render
from ...scene.camera import Camera, ExplicitRays, axes, fitted_camera
from ...scene.lights import AmbientOcclusion
from ...scene.materials import srgb_to_linear
from ..sensors.sensors import Sensors, corners_of
from ..sheets.map_frame import Extent
from ..sheets.scene_plan import brightness, hillshade
from .interpolated_values import Places, smooth_cells, values_on_surfaces
from .map_scale import MapScale, map_scale

# --- Projecting points into a picture ---------------------------------------------------------------------------------


def project_points(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 2) float64: pixel coordinates, right and down, of world points; NaN behind the camera."""
    rays = camera.view(camera.position)
    away = points - camera.position
    if isinstance(rays, ExplicitRays):
        return rays.places(away)
    right, down, view = camera.axes
    depth = away @ view
    scale = camera.height / (2.0 * tan(np.radians(camera.vfov) / 2.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.stack([away @ right, away @ down], 1) / depth[:, None]
    flat[depth <= 0.0] = np.nan
    return np.asarray(flat * scale + (camera.width / 2.0, camera.height / 2.0))


# --- False-colour pictures --------------------------------------------------------------------------------------------


_SIZE = 1024  # pixels: width of a picture, and minimum width of a map
_MOST_PIXELS = 4096  # maximum side of a map
_LEAST_WIDTH = 640  # of a picture of a tall scene, below which its legend has room
_MARGIN = 0.04  # of the width of a picture, beside what it shows
_FINER, _MOST_FINE = (
    2,
    4_000_000,
)  # pixels that are drawn for one of the picture, along each axis, unless it is larger than so many
_DARKEST = 0.45  # factor on a colour where no ambient light arrives
_LIT = np.array(
    [-0.45, 0.75, 0.48]
)  # right, up, towards the viewer: where light is from; level surfaces stay as they are
_SHADED = 0.45  # how much darker or brighter surfaces are that face away from it or towards it
_BRIGHTEST = 1.12
_DIGITS = 2  # of numbers in a legend, behind the first one of its length
_NOWHERE = 200  # grey of surfaces without a value
_DOT = 5  # pixels: radius of a mark
_POINTS = "discs: points; rings: points behind surfaces"
_OFF = 0.05  # metres: how far off their surface sensors must be hidden
_SPREAD = 20_000.0  # square pixels, of the squares around the discs of all sensors


def false_colours(table: Any, name: str) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB: a column of a table, as a map if the sensors form a raster, else on the scene's surfaces.

    The table's marks are drawn as dots.
    """
    values, known = column_values(table, name)
    scale = column_scale(table[name], known, name)
    values[~known] = np.nan
    if table.sensors.raster is not None:
        picture, places = _map(table, values, scale, is_smooth(table, name))
    else:
        picture, places = _view(table, values, scale, is_smooth(table, name))
    unit = table.columns[name].unit
    lines = [heading_of(table, name), *([_POINTS] if _shows_points(table) else [])]
    panel = Panel(_dotted(picture, places), lines)
    return panel_sheet([panel], scale.bar(f"{name} [{unit}]" if unit else name), LIGHT)


def heading_of(table: Any, name: str) -> str:
    """The title of a picture or a map of a column: what it holds, and per what."""
    text, per = table.columns[name].about or name, table.about.get("per")
    is_name = any(letter.isdigit() for letter in text.partition(" ")[0])  # such as br209-vsc
    return (text if is_name else text[:1].upper() + text[1:]) + (f", per {per}" if per else "")


def column_values(table: Any, name: str) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(n,) float64: the values of a column; (n,) bool: which of them to show.

    NaN, negative integers (no index) and raster cells off the surfaces that the raster follows are not shown.
    """
    values = table[name].astype(np.float64)
    known = np.isfinite(values)
    if table[name].dtype.kind == "i":
        known &= values >= 0
    return values, known & table.sensors.covered


class SheetScale(NamedTuple):
    """The scale of maps, of classes, such as verdicts, and of losses, whose gains differ from none."""

    scale: MapScale

    @property
    def ticks(self) -> NDArray[np.float64]:
        return np.array(self.scale.ticks())

    def colours(self, values: np.ndarray, known: NDArray[np.bool_]) -> NDArray[np.uint8]:
        """As `Scale.colours`."""
        return np.where(known[..., None], self.scale.colours(np.where(known, values, 0.0)), np.uint8(0))

    def bar(self, caption: str) -> ColourBar:
        """As `Scale.bar`."""
        if classes := self.scale.classes:
            n = len(classes)
            colours = np.array([each.colour for each in classes], np.uint8).repeat(-(-1024 // n), 0)
            return ColourBar(colours, [((k + 0.5) / n, each.name) for k, each in enumerate(classes)], caption)
        low, span = self.scale.low, self.scale.span or 1.0
        digits = _DIGITS - exponent_of_ten(span)
        ticks = [((tick - low) / span, f"{round(tick, digits) + 0.0:,.6g}") for tick in self.scale.ticks()]
        return ColourBar(self.scale.colours(np.linspace(low, low + span, 1024)), ticks, caption)


def column_scale(values: np.ndarray, known: np.ndarray, name: str = "") -> Scale | SheetScale:
    """The colour scale of a column.

    Booleans and losses, whose `name` ends in ``_loss``, have the scale of map sheets, integers one up to their maximum;
    the scale of floats leaves out a few outliers.
    """
    of_map = map_scale(values, known, name=name)
    if of_map.classes or of_map.diverging:
        return SheetScale(of_map)
    if values.dtype.kind not in "iu" or not known.any():
        return linear_scale(values[known].astype(np.float64))
    top = max(int(values[known].max()), 1)
    ticks = np.unique(np.ceil(linear_ticks(np.array([float(top)]))))
    return Scale(np.append(ticks[ticks < top], top).astype(np.float64), False)


def _dotted(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The picture with a dot at each place ((k, 2) pixels, right and down)."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for x, y in places[np.isfinite(places).all(1)].tolist():
        pen.ellipse((x - _DOT, y - _DOT, x + _DOT, y + _DOT), (255, 255, 255), (0, 0, 0), 2)
    return np.asarray(image)


def _map(
    table: Any, values: np.ndarray, scale: Scale | SheetScale, smooth: bool
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """A map of a raster, north up, enlarged if it has few cells; and the pixels of the marks.

    Values on a continuous scale are interpolated. Slopes are shaded as on maps, level cells have the legend's colours.
    """
    raster, scene = table.sensors.raster, _shown_scene(table)
    assert raster is not None
    cells = table.sensors.on_raster(values)
    magnification = max(1, _SIZE // max(cells.shape))
    step = -(-max(cells.shape) // _MOST_PIXELS)
    height, width = raster.spacing * np.array(cells.shape)
    extent = Extent(raster.west, raster.north - height, raster.west + width, raster.north)
    cells = cells[::step, ::step]
    fine = smooth_cells(cells, magnification) if smooth else cells.repeat(magnification, 0).repeat(magnification, 1)
    known = np.isfinite(fine)
    shade = brightness(hillshade(scene, extent, fine.shape[1], fine.shape[0]))[..., None]
    colours = np.minimum(scale.colours(np.nan_to_num(fine), known) * shade, 255.0).round().astype(np.uint8)
    colours[~known] = _NOWHERE
    marks = _marks(table)
    north = marks[:, 1] if scene.up == "z" else -marks[:, 2]
    places = np.stack([marks[:, 0] - raster.west, raster.north - north], 1) * (magnification / step / raster.spacing)
    return colours, places


def _shown_scene(table: Any) -> AnyScene:
    scene: AnyScene | None = table.scene
    if scene is None:
        raise InputError("the table has no scene, which pictures and models show; give the table a scene")
    return scene


def _marks(table: Any) -> NDArray[np.float64]:
    return np.empty((0, 3)) if table.marks is None else table.marks


def _view(
    table: Any, values: np.ndarray, scale: Scale | SheetScale, smooth: bool
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """The scene in the colours of its sensors, shaded; and the pixels of the marks."""
    scene = _shown_scene(table)
    extent_points = corners_of(scene).reshape(-1, 3) if table.sensors.kind == "points" else table.sensors.points
    camera = table.camera or _close_camera(np.concatenate([extent_points, _marks(table)]), scene.up)
    finer = _FINER if camera.width * camera.height <= _MOST_FINE else 1
    fine = camera.resized(finer * camera.width, finer * camera.height)
    frame = render(scene, fine, [AmbientOcclusion()], spp=16 // finer, filter=True, materials="diffuse")
    buffer = frame.gbuffer
    covered = buffer.face >= 0
    places = Places(buffer.position[covered] + buffer.origin, buffer.normal[covered], buffer.face[covered])
    if _shows_points(table):
        surface_values = np.full(len(places.points), np.nan)
    elif table.row_of_face is None:
        surface_values = values_on_surfaces(table.sensors, values, places, corners_of(scene), scene.up, smooth)
    else:
        surface_values = np.append(values, np.nan)[table.row_of_face[places.faces]]
    known = np.isfinite(surface_values)
    surface_colours = np.where(known[:, None], scale.colours(np.nan_to_num(surface_values), known), np.uint8(_NOWHERE))
    light = _DARKEST + (1.0 - _DARKEST) * frame.visibility[0][covered]
    light = light * _shade(places.normals, camera, scene.up)
    colours = np.full((*covered.shape, 3), LIGHT.ground, np.float64)
    colours[covered] = np.minimum(surface_colours * light[:, None], 255.0)
    h, w = camera.height, camera.width
    picture = colours.reshape(h, finer, w, finer, 3).mean((1, 3)).round().astype(np.uint8)
    if _shows_points(table):
        _draw_points(picture, table, values, scale, camera)
    return picture, project_points(camera, _marks(table))


def _close_camera(points: NDArray[np.float64], up: str) -> Camera:
    """A fitted camera whose picture ends a margin beside what it shows, but has room for its legend."""
    camera = fitted_camera(points, up, _SIZE, 3 * _SIZE // 4)
    places = project_points(camera, points)
    spans, margin = np.ptp(places, axis=0), 2.0 * _MARGIN * _SIZE
    width, height = (
        min(math.ceil(span + margin), most) for span, most in zip(spans.tolist(), (camera.width, camera.height))
    )
    vfov = 2.0 * math.degrees(atan(tan(math.radians(camera.vfov) / 2.0) * height / camera.height))
    return Camera(camera.position, camera.target, camera.up, vfov, max(width, _LEAST_WIDTH), height)


def _shade(normals: np.ndarray, camera: Camera, up: str) -> NDArray[np.float64]:
    """(k,) float64: factors on the colours of surfaces, lit from above the viewer's left; 1 on level ones."""
    right, upward = camera.axes[0], axes(up)[1]
    light = product(_LIT[None], np.stack([right, upward, np.cross(right, upward)]))
    facing = product(normals - upward, light.T)[:, 0]
    return np.clip(1.0 + _SHADED * facing, 1.0 - _SHADED, _BRIGHTEST)


def is_smooth(table: Any, name: str) -> bool:
    """Whether numbers between those of two sensors mean something.

    Not so of counts, numbers of faces and verdicts, nor of azimuths: south lies between two that are nearly north.
    """
    return bool(table[name].dtype.kind == "f" and name != "azimuth")


def _shows_points(table: Any) -> bool:
    """Whether a picture shows the sensors as single points, since they belong to no surface."""
    return table.sensors.kind == "points" and table.row_of_face is None


def _draw_points(
    picture: NDArray[np.uint8], table: Any, values: np.ndarray, scale: Scale | SheetScale, camera: Camera
) -> None:
    """Draw a disc at each sensor, and a ring at those that the scene hides; the nearest last."""
    sensors, scene = table.sensors, table.scene
    normals = 0.0 if sensors.normals is None else sensors.normals
    eye = np.asarray(camera.position, np.float64)
    hidden = np.asarray(scene.occluded(sensors.points + normals * scene.unit.of_metres(_OFF), targets=eye))
    places = project_points(camera, sensors.points)
    inside = np.asarray((np.isfinite(places) & (places >= 0) & (places < picture.shape[1::-1])).all(1))
    order = np.argsort(-np.linalg.norm(sensors.points - eye, axis=1), kind="stable")
    order = order[inside[order]]
    right, down = np.floor(places[order]).astype(np.int64).T
    known = np.isfinite(values[order])
    colours = scale.colours(np.nan_to_num(values[order]), known)
    colours[~known] = _NOWHERE
    radius = int(np.clip(np.sqrt(_SPREAD / max(len(order), 1)), 1, _DOT + 2))
    steps = np.arange(-radius, radius + 1)
    x, y = np.meshgrid(steps, steps)
    away = np.sqrt(x * x + y * y)
    rim = 1.5 if radius > 2 else 0.0
    for dy, dx in np.argwhere(away <= radius + 0.5).tolist():
        on_rim = away[dy, dx] > radius + 0.5 - rim
        edge = np.where(hidden[order, None], colours, np.uint8(0)) if on_rim else colours
        drawn = on_rim | ~hidden[order] | (radius <= 2)
        y, x = down + dy - radius, right + dx - radius
        drawn &= (y >= 0) & (y < picture.shape[0]) & (x >= 0) & (x < picture.shape[1])
        picture[y[drawn], x[drawn]] = edge[drawn]


# --- False-colour models ----------------------------------------------------------------------------------------------


_GREY = 0.35  # linear: surfaces without a value
_LIFT = 0.02  # offset of a sensor's square from its surface, in widths of the square


class ColouredMesh(NamedTuple):
    """A mesh or a set of lines with vertex colours."""

    name: str
    vertices: np.ndarray  # (v, 3) float32
    colours: np.ndarray  # (v, 3) float32, linear
    faces: np.ndarray  # (f, 3) uint32; (f, 2) for lines
    mode: int = TRIANGLES


def coloured_model(table: Any, name: str) -> bytes:
    """A GLB file of a column of a table: coloured faces or vertices, else a square for each sensor.

    Coordinates are relative to the scene's `origin`, since glTF stores float32; the asset's `extras` record the origin.
    """
    sensors, scene = table.sensors, _shown_scene(table)
    values, known = column_values(table, name)
    scale = column_scale(table[name], known, name)
    sensor_colours = srgb_to_linear(scale.colours(np.nan_to_num(values), known) / 255.0)
    sensor_colours[~known] = _GREY
    corners = corners_of(scene) - scene.origin
    colours = np.full((len(corners), 3, 3), _GREY)
    if table.row_of_face is not None:
        has_row = table.row_of_face >= 0
        colours[has_row] = sensor_colours[table.row_of_face[has_row], None]
    elif sensors.kind == "face":
        colours[sensors.faces] = sensor_colours[:, None]
    elif sensors.kind == "vertex":
        assert sensors.corners is not None
        used = sensors.corners[:, 0] >= 0
        colours[used] = sensor_colours[sensors.corners[used]]
    soup = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    parts = [ColouredMesh(scene.name, corners.reshape(-1, 3), colours.reshape(-1, 3), soup)]
    if sensors.kind not in ("face", "vertex") and table.row_of_face is None:
        parts.append(_squares(sensors, sensor_colours, scene))
    extras = {"column": name, "unit": table.columns[name].unit, "origin": scene.origin.tolist(), **table.about}
    extras["scale"] = [float(scale.ticks[0]), float(scale.ticks[-1])]
    return coloured_glb(parts, scene, extras)


def _squares(sensors: Sensors, colours: np.ndarray, scene: AnyScene) -> ColouredMesh:
    """A square for each sensor, of the sensor's area and a little off its surface; horizontal without a normal."""
    n = len(sensors)
    width = np.sqrt(sensors.areas) if sensors.areas is not None else np.full(n, 1.0)
    normals = sensors.normals if sensors.normals is not None else np.broadcast_to(axes(scene.up)[1], (n, 3))
    side = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(side, normals)
    u *= (width / np.linalg.norm(u, axis=1) / 2.0)[:, None]
    v = np.cross(normals, u)
    middle = sensors.points - scene.origin + _LIFT * width[:, None] * normals
    vertices = np.stack([middle - u - v, middle + u - v, middle + u + v, middle - u + v], 1)
    faces = 4 * np.arange(n, dtype=np.uint32)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    return ColouredMesh("sensors", vertices.reshape(-1, 3), colours.repeat(4, 0), faces.reshape(-1, 3))


def coloured_glb(parts: list[ColouredMesh], scene: AnyScene, extras: Json) -> bytes:
    """A binary glTF 2.0 file of unlit coloured meshes in the coordinates of a scene, one node each, in metres."""
    writer = GltfWriter()
    writer.json["asset"]["extras"] = extras
    material = writer.add("materials", writer.make_unlit({"doubleSided": True}))
    for part in parts:
        primitive = writer.primitive(part.vertices, part.faces, part.colours, material=material, mode=part.mode)
        mesh = writer.add("meshes", {"name": part.name, "primitives": [primitive]})
        writer.add_root({"name": part.name, "mesh": mesh, **up_axis_transform(scene.up, scene.unit.metres)})
    return writer.glb()
