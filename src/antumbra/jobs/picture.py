"""Pictures of results in false colours, with a legend."""

import numpy as np

from ..picture.heat_maps import Panel, Scale, linear_scale, scale_of, sheet
from ..picture.renderer import render
from ..scene.camera import fitted_camera
from ..scene.lights import AmbientOcclusion
from .sensors import corners_of
from .view import projected

_SIZE = 1024  # pixels of a picture, and least width of a map
_MOST_PIXELS = 4096  # of a map's side
_DARKEST = 0.45  # of a colour, where no ambient light arrives
_NOWHERE = 70  # grey of surfaces without a value
_DOT = 5  # pixels: radius of a mark


def false_colours(table, name: str) -> np.ndarray:
    """(H, W, 3) uint8 sRGB: a column of a `table.Table`, as a map of a raster, else on the surfaces of the scene.

    The table's marks are dots.
    """
    values, known = shown_values(table, name)
    scale = shown_scale(table[name], known)
    values[~known] = np.nan
    if table.sensors.raster is not None:
        picture, places = _map(table, values, scale)
    else:
        picture, places = _view(table, values, scale)
    column = table.columns[name]
    caption = f"{name} [{column.unit}]" if column.unit else name
    panel = Panel(_dotted(picture, places), [column.about[:1].upper() + column.about[1:]])
    return sheet([panel], scale.bar(caption))


def shown_values(table, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(n,) float64: the numbers of a column; (n,) bool: which are shown.

    Not shown: NaN, whole numbers below 0 (no index), and cells of a raster beside the surfaces that it follows.
    """
    values = table[name].astype(np.float64)
    known = np.isfinite(values)
    if table[name].dtype.kind == "i":
        known &= values >= 0
    return values, known & table.sensors.covered


def shown_scale(values: np.ndarray, known: np.ndarray) -> Scale:
    """The scale of a column: of whole numbers up to the highest one, else without a few extreme ones; yes and no."""
    if values.dtype.kind == "b":
        return Scale(np.array([0.0, 1.0]), False, names=("no", "yes"))
    if values.dtype.kind not in "iu" or not known.any():
        return linear_scale(values[known].astype(np.float64))
    top = max(int(values[known].max()), 1)
    ticks = np.unique(np.ceil(scale_of(np.array([float(top)]))))
    return Scale(np.append(ticks[ticks < top], top).astype(np.float64), False)


def _dotted(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    """The picture with a dot at each place ((k, 2), pixels to the right and down)."""
    from PIL import Image, ImageDraw

    drawn = Image.fromarray(picture)
    pen = ImageDraw.Draw(drawn)
    for x, y in places[np.isfinite(places).all(1)].tolist():
        pen.ellipse((x - _DOT, y - _DOT, x + _DOT, y + _DOT), (255, 255, 255), (0, 0, 0), 2)
    return np.asarray(drawn)


def _map(table, values: np.ndarray, scale: Scale) -> tuple[np.ndarray, np.ndarray]:
    """The cells of a raster, north up, several pixels wide if they are few; and the places of marks."""
    raster = table.sensors.raster
    cells = table.sensors.on_raster(values)
    colours = scale.colours(np.nan_to_num(cells), np.isfinite(cells))
    colours[~np.isfinite(cells)] = _NOWHERE
    several = max(1, _SIZE // max(cells.shape))
    step = -(-max(cells.shape) // _MOST_PIXELS)
    marks = _marks(table)
    north = marks[:, 1] if table.scene.up == "z" else -marks[:, 2]
    places = np.stack([marks[:, 0] - raster.west, raster.north - north], 1) * (several / step / raster.spacing)
    return colours[::step, ::step].repeat(several, 0).repeat(several, 1), places


def _marks(table) -> np.ndarray:
    return np.empty((0, 3)) if table.marks is None else table.marks


def _view(table, values: np.ndarray, scale: Scale) -> tuple[np.ndarray, np.ndarray]:
    """The scene in the colours of its sensors, darker where surfaces are near each other; and the places of marks."""
    scene = table.scene
    around = corners_of(scene).reshape(-1, 3) if table.sensors.kind == "points" else table.sensors.points
    shown = np.concatenate([around, _marks(table)])
    camera = table.camera or fitted_camera(shown, scene.up, _SIZE, 3 * _SIZE // 4)
    frame = render(scene, camera, [AmbientOcclusion()], spp=16)
    buffer = frame.gbuffer
    met = buffer.face >= 0
    colours = np.full((*met.shape, 3), 30, np.uint8)
    at = buffer.position[met] + buffer.origin
    found = _values_at(table.sensors, values, at, buffer.normal[met], buffer.face[met])
    known = np.isfinite(found)
    shown = np.where(known[:, None], scale.colours(np.nan_to_num(found), known), np.uint8(_NOWHERE))
    light = _DARKEST + (1.0 - _DARKEST) * frame.visibility[0][met][:, None]
    colours[met] = np.round(shown * light).astype(np.uint8)
    return colours, projected(camera, _marks(table))


def _values_at(sensors, values: np.ndarray, at: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The values at surface points: of the face's sensor if each face has one, else of the nearest sensor.

    Sensors that look another way count as farther away, so both sides of a wall keep their own.
    """
    if sensors.kind == "face":
        of_face = np.full(max(int(faces.max(initial=0)), int(sensors.faces.max(initial=0))) + 1, np.nan)
        of_face[sensors.faces] = values
        return of_face[faces]
    from scipy.spatial import cKDTree

    if sensors.normals is None:
        return values[cKDTree(sensors.points).query(at, workers=-1)[1]]
    away = float(np.ptp(sensors.points, axis=0).max()) / 20.0 or 1.0
    tree = cKDTree(np.hstack([sensors.points, sensors.normals * away]))
    return values[tree.query(np.hstack([at, normals * away]), workers=-1)[1]]
