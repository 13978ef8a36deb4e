"""Styles of QGIS beside rasters and layers: their structure, and what QGIS itself makes of them, where it is."""

import json
import shutil
import subprocess
import xml.etree.ElementTree as Xml
from itertools import pairwise

import numpy as np
import pytest
import rasterio

import antumbra as at
from antumbra.city.tables.map_scale import map_scale
from antumbra.city.tables.qgis_style import VectorStyle, style_beside, write_style
from antumbra.city.tables.result_table import Column
from result_tables import table

pyogrio = pytest.importorskip("pyogrio")
gpd = pytest.importorskip("geopandas")

CRS = "EPSG:7415"

# What QGIS reads, by its documentation of the XML of layers: the values are attributes that it requires.
RASTER = {
    "rasterrenderer": {"type", "band", "opacity", "alphaBand"},
    "colorrampshader": {"colorRampType", "clip", "classificationMode", "minimumValue", "maximumValue"},
    "item": {"value", "label", "color", "alpha"},
    "paletteEntry": {"value", "label", "color", "alpha"},
}
VECTOR = {
    "renderer-v2": {"type", "attr", "symbollevels", "enableorderby"},
    "range": {"lower", "upper", "symbol", "label", "render"},
    "category": {"value", "symbol", "label", "render"},
    "symbol": {"name", "type", "alpha"},
    "layer": {"class", "enabled", "locked", "pass"},
    "prop": {"k", "v"},
}


def results(kind="raster"):
    made = table(kind, crs=CRS)
    made.columns["passes"] = Column(np.arange(len(made)) % 3 == 0, "", "whether it passes")
    return made


def style_of(path):
    root = Xml.parse(style_beside(path)).getroot()
    assert root.tag == "qgis" and root.get("version")
    for tag, attributes in (RASTER | VECTOR).items():
        for each in root.iter(tag):
            assert attributes <= set(each.attrib), tag
    names = {each.get("name") for each in root.iter("symbol")}
    used = {each.get("symbol") for tag in ("range", "category") for each in root.iter(tag)} or {"0"}
    assert used == names
    return root


# --- Structure --------------------------------------------------------------------------------------------------------


def test_a_ramp_has_the_unit_and_the_true_range(tmp_path):
    made = results()
    made.save(tmp_path / "a.tif")
    root = style_of(tmp_path / "a.tif")
    renderer = root.find("pipe/rasterrenderer")
    assert (renderer.get("type"), renderer.get("band")) == ("singlebandpseudocolor", "1")
    items = [(float(each.get("value")), each.get("label")) for each in renderer.iter("item")]
    assert items[0] == (0.0, "0 h") and items[-1] == (np.nanmax(made["hours"]), "8 h") and len(items) == 17
    ranges = [(float(each.get("lower")), float(each.get("upper"))) for each in root.iter("range")]
    assert ranges[0][0] == 0.0 and ranges[-1][1] == 8.0 and all(a[1] == b[0] for a, b in pairwise(ranges))
    assert root.find("renderer-v2").get("attr") == "hours"


def test_yes_and_no_are_classes(tmp_path):
    results().save(tmp_path / "a.tif", "passes")
    root = style_of(tmp_path / "a.tif")
    renderer = root.find("pipe/rasterrenderer")
    assert (renderer.get("type"), renderer.get("band")) == ("paletted", "3")
    assert [(each.get("value"), each.get("label")) for each in renderer.iter("paletteEntry")] == [
        ("0", "fails"), ("1", "passes"),
    ]  # fmt: skip
    kinds = [(each.get("value"), each.get("label")) for each in root.iter("category")]
    assert kinds == [("false", "fails"), ("true", "passes")]


def test_points_have_no_raster_style_and_files_without_a_crs_none(tmp_path):
    results("grid").save(tmp_path / "a.parquet")
    assert style_of(tmp_path / "a.parquet").find("pipe") is None
    table("grid").save(tmp_path / "b.parquet")
    table("grid").save(tmp_path / "c.csv")
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.parquet", "a.qml", "b.parquet", "c.csv"]


@pytest.mark.parametrize("kind, shape", [("marker", "SimpleMarker"), ("fill", "SimpleFill"), ("line", "SimpleLine")])
def test_kinds_of_layers(tmp_path, kind, shape):
    scale = map_scale(np.array([1.0, 2.0]), np.ones(2, bool), "h")
    assert write_style(tmp_path / "a.gpkg", VectorStyle("h", scale, kind))
    root = style_of(tmp_path / "a.gpkg")
    assert {each.get("class") for each in root.iter("layer")} == {shape}
    assert {each.get("type") for each in root.iter("symbol")} == {kind}


def test_styles_that_users_saved_stay(tmp_path):
    made, style = results(), tmp_path / "a.qml"
    made.save(tmp_path / "a.tif")
    first = style.read_bytes()
    made.save(tmp_path / "a.tif", "passes")
    assert style.read_bytes() != first
    style.write_text("<qgis><pipe/></qgis>")
    made.save(tmp_path / "a.tif")
    assert style.read_text() == "<qgis><pipe/></qgis>"


# --- Files ------------------------------------------------------------------------------------------------------------


def test_geotiffs_have_the_crs_names_units_and_holes(tmp_path):
    made = results()
    made.save(tmp_path / "a.tif")
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.crs.to_wkt().startswith("COMPD") or "7415" in file.crs.to_string()
        assert file.descriptions == ("hours", "count", "passes") and file.units == ("h", "1", "1")
        assert np.isnan(file.nodata) and np.isnan(file.read(1)).any() and file.read(1).shape == (10, 12)


@pytest.mark.parametrize("suffix", [".gpkg", ".parquet"])
def test_layers_have_the_crs_and_all_columns(tmp_path, suffix):
    made, path = results("grid"), tmp_path / f"a{suffix}"
    made.save(path, "passes")
    frame = gpd.read_parquet(path) if suffix == ".parquet" else gpd.read_file(path)
    assert frame.crs == CRS and len(frame) == len(made)
    assert list(frame.columns)[:3] == ["x", "y", "z"] and {"hours", "first", "count", "passes"} <= set(frame.columns)
    assert (frame["passes"].to_numpy(bool) == made["passes"]).all()
    assert np.array_equal(frame["hours"].to_numpy(float), made["hours"], equal_nan=True)
    assert (frame.geometry.x.to_numpy() == made.sensors.points[:, 0]).all() and frame.geometry.has_z.all()
    if suffix == ".gpkg":
        assert pyogrio.list_layers(path).tolist() == [["a", "Point Z"]]


def test_geopackages_without_a_crs_and_with_y_up(tmp_path):
    table("face").save(tmp_path / "a.gpkg")
    assert len(gpd.read_file(tmp_path / "a.gpkg")) == 4
    with pytest.raises(at.InputError, match=r"\.gpkg"):
        table("face").save(tmp_path / "a.shp")


def test_shadows_have_one_colour_or_classes_of_hours(tmp_path):
    hill = at.Scene.from_arrays(
        np.array([[85000.0, 447000, 0], [85020, 447000, 0], [85020, 447020, 0], [85010, 447010, 9]]),
        [[0, 1, 3], [1, 2, 3], [0, 1, 2]], up="z", crs=CRS,
    )  # fmt: skip
    at.shadow(hill, at="2026-06-21T15:00", plane=0.0).save(tmp_path / "a.gpkg")
    root = style_of(tmp_path / "a.gpkg")
    assert root.find("renderer-v2").get("type") == "singleSymbol" and root.find("pipe") is None
    hours = at.shadow(hill, days="2026-03-21", cell=2.0, classes=[0.0, 2.0, 4.0])
    assert len(hours.columns["hours_from"]) > 1
    for suffix in ".gpkg", ".tif":  # the style serves both, in whichever order they are saved
        hours.save(tmp_path / f"b{suffix}")
        root = style_of(tmp_path / f"b{suffix}")
        labels = [(each.get("value"), each.get("type"), each.get("label")) for each in root.iter("category")]
        assert labels[0] == ("0", "double", "0 to 2 h") and root.find("renderer-v2").get("attr") == "hours_from"
        assert root.find("pipe/rasterrenderer").get("type") == "singlebandpseudocolor"


# --- QGIS itself ------------------------------------------------------------------------------------------------------

_PROGRAM = """
import json, sys
from qgis.core import QgsApplication, QgsRasterLayer, QgsRenderContext, QgsVectorLayer
application = QgsApplication([], False)
application.initQgis()
report = {}
for name in ("hours", "passes"):
    raster = QgsRasterLayer(f"{sys.argv[1]}/{name}.tif", name)
    renderer = raster.renderer()
    paletted = renderer.type() == "paletted"
    entries = renderer.classes() if paletted else renderer.shader().rasterShaderFunction().colorRampItemList()
    layer = QgsVectorLayer(f"{sys.argv[1]}/{name}.gpkg", name)
    context, colours = QgsRenderContext(), []
    layer.renderer().startRender(context, layer.fields())
    for feature in layer.getFeatures():
        symbol = layer.renderer().symbolForFeature(feature, context)
        colours.append(symbol and symbol.color().name())
    layer.renderer().stopRender(context)
    report[name] = {
        "valid": raster.isValid() and layer.isValid(), "crs": [raster.crs().isValid(), layer.crs().authid()],
        "kinds": [renderer.type(), layer.renderer().type()], "labels": [each.label for each in entries],
        "band": renderer.usesBands()[0], "colours": colours,
    }
print(json.dumps(report))
"""


def test_qgis_opens_rasters_and_layers_in_their_styles(tmp_path):
    python = shutil.which("python3", path="/usr/bin:/usr/local/bin")
    environment = {"QT_QPA_PLATFORM": "offscreen", "HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}

    def run(program):
        command = [str(python), "-c", program, str(tmp_path)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)

    if python is None or run("import qgis.core").returncode != 0:
        pytest.skip("QGIS is not installed for the system's Python (package python3-qgis)")
    made = results()
    for name in "hours", "passes":
        for suffix in ".tif", ".gpkg":
            made.save(tmp_path / f"{name}{suffix}", name)
    answer = run(_PROGRAM)
    assert answer.stdout, answer.stderr
    report = json.loads(answer.stdout.splitlines()[-1])
    assert all(each["valid"] and each["crs"] == [True, CRS] for each in report.values())
    assert report["hours"]["kinds"] == ["singlebandpseudocolor", "graduatedSymbol"]
    assert report["passes"]["kinds"] == ["paletted", "categorizedSymbol"]
    assert report["hours"]["labels"][-1] == "8 h" and report["passes"]["labels"] == ["no", "yes"]
    assert report["hours"]["band"] == 1 and report["passes"]["band"] == 3
    assert report["hours"]["colours"][0] is None and len(set(report["hours"]["colours"])) == 17  # NaN has no symbol
    yes = report["passes"]["colours"].count("#21786e")
    assert yes == made["passes"].sum() and yes + report["passes"]["colours"].count("#bebec4") == len(made)
