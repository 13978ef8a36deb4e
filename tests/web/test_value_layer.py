"""Numbers on surfaces of a page in node: their colours beside those of map sheets, and which number belongs where."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.map_scale import map_scale, range_scale
from antumbra.city.tables.page_layer import layer_of, table_layer
from antumbra.web.page_source import PAGE
from pages import box_on_floor

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="without node, the colours of pages are NOT checked")
RNG = np.random.default_rng(5)
NUMBERS = RNG.uniform(-3.0, 9.0, 400)
KNOWN = np.ones(400, bool)
SCALES = {
    "hours": (map_scale(np.abs(NUMBERS), KNOWN, "h"), np.abs(NUMBERS)),
    "below zero": (map_scale(NUMBERS, KNOWN, "m"), NUMBERS),
    "losses": (map_scale(NUMBERS, KNOWN, "h", "sun_hours_loss"), NUMBERS),
    "all the same": (map_scale(np.zeros(400), KNOWN, "h"), np.zeros(400)),
    "verdicts": (map_scale(NUMBERS > 2, KNOWN, name="br209_vsc_passes"), (NUMBERS > 2).astype(float)),
    "ranges": (range_scale(np.arange(4.0), np.arange(1.0, 5.0), "h"), RNG.integers(0, 4, 400).astype(float)),
}


def asked(folder, **call):
    """The answer of a module of the page in node."""
    (folder / "calls.json").write_text(json.dumps([call]))
    subprocess.run([NODE, Path(__file__).parent / "page_parts.mjs", PAGE, folder], check=True)
    return json.loads((folder / "answers.json").read_text())[0]


@pytest.mark.parametrize("name", SCALES)
def test_colours_are_those_of_map_sheets(tmp_path, name):
    scale, values = SCALES[name]
    about = layer_of("numbers", scale.unit, values, scale)._replace(faces=np.arange(400)).about()
    found = asked(tmp_path, call="colours", scale=about, values=values.tolist())
    assert np.abs(np.array(found) - scale.colours(values).astype(int)).max() <= 1
    assert len(np.unique(found, axis=0)) > 1 or name == "all the same"
    texts = asked(tmp_path, call="texts", scale=about, values=values[:5].tolist())
    if scale.classes:
        named = {each.value: each.name for each in scale.classes}
        assert texts == [named[value] for value in values[:5].tolist()]
    else:
        unit = f" {scale.unit}" if scale.unit else ""
        assert texts == [f"{value:.6g}{unit}" for value in values[:5].tolist()]


SENSORS = {
    "face": lambda scene: at.face_sensors(scene),
    "grid": lambda scene: at.grid_sensors(scene, 0.9),
    "raster": lambda scene: at.raster_sensors(scene, 0.9),
    "vertex": lambda scene: at.vertex_sensors(scene),
}


@pytest.mark.parametrize("kind", SENSORS)
def test_a_click_on_a_sensor_gives_its_number(tmp_path, kind):
    scene = box_on_floor()
    sensors = SENSORS[kind](scene)
    values = RNG.uniform(0.0, 9.0, len(sensors))
    table = at.Table(sensors, {"sun_hours": at.Column(values, "h", "hours of direct sun")}, {}, scene)
    layer, triangles = table_layer(table, "sun_hours"), scene.triangles()
    corners = triangles.vertices.astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    if kind == "vertex":
        faces = np.flatnonzero(sensors.corners[:, 0] >= 0)
        points, expected = corners[faces].mean(1), values[sensors.corners[faces]].mean(1)
    else:
        faces = np.zeros(len(sensors), int) if kind == "raster" else sensors.faces
        points, expected = sensors.points - triangles.origin, np.where(sensors.covered, values, np.nan)
    assert len(points) >= 6
    arrays = {name: array.ravel().tolist() for name, array in layer.arrays(triangles).items()}
    arrays |= {"positions": corners.ravel().tolist(), "indices": list(range(3 * len(corners)))}
    up = np.array([0.0, 1.0, 0.0])
    hits = [
        {"face": int(face), "point": point.tolist(), "normal": (up if kind == "raster" else normals[face]).tolist()}
        for face, point in zip(faces, points)
    ]
    found = asked(tmp_path, call="values", layer=layer.about(), arrays=arrays, hits=hits)
    assert np.allclose(np.array(found, float), expected, rtol=1e-12 if kind != "vertex" else 1e-6, equal_nan=True)


def test_surfaces_out_of_reach_have_no_number(tmp_path):
    scene = box_on_floor()
    sensors = at.Sensors(np.array([[0.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]]), None, None, "points")
    table = at.Table(sensors, {"hours": at.Column(np.array([3.0]), "h", "hours")}, {}, scene)
    layer = table_layer(table, "hours")
    arrays = {name: array.ravel().tolist() for name, array in layer.arrays(scene.triangles()).items()}
    origin = -scene.triangles().origin
    near, far = (origin + [shift * layer.reach, 0.0, 0.0] for shift in (0.5, 1.5))
    hits = [
        {"face": 0, "point": near.tolist(), "normal": [0, 1, 0]},
        {"face": 0, "point": far.tolist(), "normal": [0, 1, 0]},
        {"face": 0, "point": near.tolist(), "normal": [0, -1, 0]},
    ]
    assert asked(tmp_path, call="values", layer=layer.about(), arrays=arrays, hits=hits) == [3.0, None, None]
