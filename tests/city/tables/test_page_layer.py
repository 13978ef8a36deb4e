"""Pages of tables: commands write them beside other files, and refuse before the work what a page cannot show."""

import json
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.city.tables.page_layer import moment_in, place_in, table_layer
from pages import box_on_floor

needs_linker = pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, pages are NOT checked")
SCENE = "procedural:city?triangles=2000"
PLACE = ("--latitude", "52", "--longitude", "4.4", "--timezone", "Europe/Amsterdam")
ROOM = "procedural:atrium?triangles=1000"
COMMANDS = {
    "sun": ("sun", SCENE, *PLACE, "--days", "2026-03-21", "--step", "120"),
    "shadow": ("shadow", SCENE, *PLACE, "--days", "2026-03-21", "--cell", "4", "--step", "120"),
    "visible": (
        "visible",
        SCENE,
        "--sensors",
        "raster:8+1.6",
        "--turbine",
        "0,0,0",
        "--hub-height",
        "60",
        "--rotor",
        "40",
    ),
    "viewshed": ("viewshed", SCENE, "--sensors", "raster:8", "--observer", "0,30,0"),
}


@needs_linker
@pytest.mark.parametrize("name", COMMANDS)
def test_commands_write_pages_of_their_results(cli, name):
    other = "a.tif" if name == "shadow" else "a.csv"
    outcome = cli(*COMMANDS[name], "-o", "a.html", "-o", other, "-q")
    assert outcome.code == 0, outcome.err
    about = json.loads(re.search(r'id="scene">(.*?)</', Path("a.html").read_text(encoding="utf-8"), re.S)[1])
    assert about["layer"]["name"] and about["layer"]["stops"] and Path(other).exists()
    assert (about["place"] is None) == (name in ("visible", "viewshed"))
    assert name not in ("sun", "shadow") or about["date"] == "2026-03-21"


@needs_linker
def test_what_no_page_shows_is_refused_before_the_work(cli, tmp_path):
    (tmp_path / "leaf.mtl").write_text("newmtl leaf\nKd 0 1 0\n")
    (tmp_path / "leaf.obj").write_text("mtllib leaf.mtl\nusemtl leaf\nv 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 3 2\n")
    leaf = f"{tmp_path / 'leaf.obj'}?transmittance=leaf:0.5"
    outcome = cli("sun", leaf, *PLACE, "--days", "2026-03-21", "-o", "a.html")
    assert outcome.code == 2 and "lets light pass" in outcome.err and list(tmp_path.glob("a.*")) == []


def test_a_table_without_a_scene_has_no_page():
    table = at.Table(at.point_sensors([[0.0, 1.0, 0.0]]), {"a": at.Column(np.ones(1), "h", "a")})
    with pytest.raises(InputError, match="the table has no scene"):
        table.page()


def test_unknown_values_are_not_shown():
    scene = box_on_floor()
    values = np.arange(float(scene.n_triangles))
    values[3] = np.nan
    counts = np.where(np.isnan(values), -1, values).astype(int)
    columns = {"hours": at.Column(values, "h", "hours"), "first": at.Column(counts, "", "first observer")}
    table = at.Table(at.face_sensors(scene), columns, {}, scene)
    for name in columns:
        layer = table_layer(table, name)
        assert np.flatnonzero(np.isnan(layer.values)).tolist() == [3]
        assert layer.faces.tolist() == list(range(scene.n_triangles))


def test_rows_of_buildings_colour_their_faces():
    scene = box_on_floor()
    row_of_face = np.repeat([0, -1], [10, 2])
    sensors = at.point_sensors([[0.0, 1.0, 0.0]])
    columns = {"hours": at.Column(np.array([4.0]), "h", "hours")}
    layer = table_layer(at.Table(sensors, columns, {}, scene, row_of_face=row_of_face), "hours")
    assert layer.faces.tolist() == row_of_face.tolist() and layer.points is None


def test_the_place_and_the_moment_of_a_study_are_found():
    place = at.Place(52.0, 4.4, 3.0, 0.5, "Europe/Amsterdam")
    assert place_in({"job": "sun", **place._asdict()}) == place and place_in({"job": "viewshed"}) is None
    assert moment_in({"first": "2026-03-21T06:30"}) == "2026-03-21" and moment_in({}) is None
    shadow = {"time": "2026-06-21T15:00+02:00", "sun_elevation": 50.0}
    assert str(moment_in(shadow)) == "2026-06-21 15:00:00"
