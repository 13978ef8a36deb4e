"""Pictures of results in false colours, with a legend."""

import numpy as np

from ..image.heatmap import Scale, scale_of
from ..image.panels import Panel, sheet
from ..rendering.renderer import render
from ..scene.framing import fitted_camera
from ..scene.lights import AmbientOcclusion

_SIZE = 1024  # pixels of a picture, and least width of a map
_MOST_PIXELS = 4096  # of a map's side
_DARKEST = 0.45  # of a colour, where no ambient light arrives
_NOWHERE = 70  # grey of surfaces without a value


def false_colours(table, name: str) -> np.ndarray:
    """(H, W, 3) uint8 sRGB: a column of a `table.Table`, as a map of a raster, else on the surfaces of the scene."""
    values = table[name].astype(np.float64)
    known = np.isfinite(values)
    scale = Scale(scale_of(values[known]), False)
    if table.sensors.raster is not None:
        picture = _map(table.sensors, values, scale)
    else:
        picture = _view(table, values, scale)
    column = table.columns[name]
    caption = f"{column.about} [{column.unit}]" if column.unit else column.about
    return sheet([Panel(picture, [table.about.get("title", name)])], scale.bar(caption))


def _map(sensors, values: np.ndarray, scale: Scale) -> np.ndarray:
    """The cells of a raster, north up, several pixels wide if they are few; dark where it found no surface."""
    raster, found = sensors.raster, sensors.faces >= 0
    cells = np.where(found | ~found.any(), values, np.nan).reshape(raster.rows, raster.columns)
    colours = scale.colours(np.nan_to_num(cells), np.isfinite(cells))
    several = max(1, _SIZE // max(cells.shape))
    step = -(-max(cells.shape) // _MOST_PIXELS)
    return colours[::step, ::step].repeat(several, 0).repeat(several, 1)


def _view(table, values: np.ndarray, scale: Scale) -> np.ndarray:
    """The scene from its default camera, in the colours of its sensors, darker where surfaces are near each other."""
    scene = table.scene
    camera = fitted_camera(table.sensors.points, scene.up, _SIZE, 3 * _SIZE // 4)
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
    return colours


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
