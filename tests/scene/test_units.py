"""The length unit of a scene: where it comes from, and who keeps it."""

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.crs import in_one_unit, parts_of_crs, unit_of_crs
from antumbra.scene.units import METRE, UNITS, LengthUnit, checked_unit, unit_named
from city_files import city
from gis_files import hills, write_raster

US_FOOT = 1200.0 / 3937.0
TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 1]])


@pytest.mark.parametrize(
    "name, metres",
    [
        ("mm", 0.001), ("cm", 0.01), ("dm", 0.1), ("m", 1.0), ("Metre", 1.0), ("METERS", 1.0), ("km", 1000.0),
        ("in", 0.0254), ("ft", 0.3048), ("foot", 0.3048), ("us-ft", US_FOOT), ("Foot_US", US_FOOT),
        ("US survey foot", US_FOOT), ("ftUS", US_FOOT), (" decimetre ", 0.1),
    ],
)  # fmt: skip
def test_units_have_the_names_that_files_write(name, metres):
    assert unit_named(name).metres == metres == checked_unit(name).metres


def test_an_unknown_unit_is_refused_with_the_known_ones():
    assert unit_named("fathom") is None
    with pytest.raises(at.InputError, match="unit is 'fathom'; it must be one of m, mm"):
        at.Scene.from_arrays(TRIANGLE, unit="fathom")


def test_a_unit_is_its_own_inverse():
    for unit in UNITS.values():
        assert unit.of_metres(unit.metres) == 1.0 and unit.square_metres == unit.metres**2
    assert UNITS["ft"].same_as(UNITS["us-ft"]) and not UNITS["ft"].same_as(METRE)


@pytest.mark.parametrize(
    "crs, plan, heights",
    [
        ("EPSG:28992", "m", None),
        ("EPSG:7415", "m", "m"),
        ("EPSG:2263", "us-ft", None),
        ("EPSG:2263+5703", "us-ft", "m"),
        ("EPSG:2222", "ft", None),
        ("EPSG:4326", None, None),
        ("EPSG:6697", None, "m"),
        ("+proj=utm +zone=31 +units=km", "km", None),
        ('LOCAL_CS["Undefined Cartesian SRS"]', None, None),
        ("IAU_2015:30110", "m", None),
    ],
)
def test_a_crs_names_the_unit_of_its_axes(crs, plan, heights):
    parts = parts_of_crs(crs)
    assert [unit and unit.name for unit in (parts.unit, parts.height_unit)] == [plan, heights]
    assert unit_of_crs(crs).name == (plan or heights or "m")


def test_heights_in_the_unit_of_the_plan_leave_the_vertical_crs():
    assert in_one_unit("EPSG:2263+5703") == ("EPSG:2263", 1.0 / US_FOOT)
    assert in_one_unit("EPSG:2263+6360") == ("EPSG:2263+6360", 1.0)
    assert in_one_unit("EPSG:7415") == ("EPSG:7415", 1.0)


# --- Scenes -----------------------------------------------------------------------------------------------------------


def from_arrays(folder, **more):
    return at.Scene.from_arrays(TRIANGLE, **more)


def from_instances(folder, **more):
    return at.Scene.from_instances([TRIANGLE[None]], [np.eye(4)[None]], instances=True, **more)


def flattened(folder, **more):
    return at.Scene.from_instances([TRIANGLE[None]], [np.eye(4)[None]], instances=False, **more)


def from_mesh(folder, **more):
    trimesh = pytest.importorskip("trimesh")
    return at.Scene.from_mesh(trimesh.Trimesh(TRIANGLE, [[0, 1, 2]]), **more)


def from_obj(folder, **more):
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 3\n")
    return at.load(folder / "a.obj", **more)


def from_raster(folder, **more):
    return at.from_raster((hills(), (2.0, 0.0, 1000.0, 0.0, -2.0, 2000.0)), **more)


def from_tif(folder, **more):
    return at.load(write_raster(folder / "a.tif", hills(), crs=None), **more)


def from_footprints(folder, **more):
    geopandas, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    return at.from_footprints(geopandas.GeoDataFrame({"height": [3.0]}, geometry=[shapely.box(0, 0, 2, 2)]), **more)


def from_trees(folder, **more):
    (folder / "trees.csv").write_text("x,y,height,radius\n3,4,3,1\n")
    return at.from_trees(folder / "trees.csv", **more)


def from_city(folder, **more):
    import json

    (folder / "a.city.json").write_text(json.dumps(city(crs=None)))
    return at.load(folder / "a.city.json", **more)


def from_store(folder, **more):
    at.build_store(from_arrays(folder, **more), folder / "a.antumbra")
    return at.load(folder / "a.antumbra")


def from_streamed_store(folder, **more):
    from antumbra.cli import main

    write_raster(folder / "b.tif", hills(), crs=more.get("crs"))
    unit = ["--unit", more["unit"]] if "unit" in more else []
    assert main(["build", str(folder / "b.tif"), *unit, "-o", str(folder / "b.antumbra")]) == 0
    return at.load(folder / "b.antumbra")


SOURCES = (
    from_arrays, from_instances, flattened, from_mesh, from_obj, from_raster, from_tif, from_footprints, from_trees,
    from_city, from_store, from_streamed_store,
)  # fmt: skip


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.__name__)
@pytest.mark.filterwarnings("ignore:.*the unit of its heights is unknown:UserWarning")
def test_every_scene_has_the_unit_given_or_that_of_its_crs(source, tmp_path):
    assert source(tmp_path).unit == METRE
    assert source(tmp_path, unit="mm").unit == UNITS["mm"]
    assert source(tmp_path, crs="EPSG:2263").unit == UNITS["us-ft"]


@pytest.mark.parametrize("source", SOURCES[:-2], ids=lambda source: source.__name__)
def test_a_unit_that_contradicts_the_crs_is_refused(source, tmp_path):
    with pytest.raises(
        at.InputError, match="unit is mm, and the coordinates of the crs EPSG:28992 are in m; leave one"
    ):
        source(tmp_path, unit="mm", crs="EPSG:28992")


def test_both_feet_are_no_contradiction():
    assert from_arrays(None, unit="ft", crs="EPSG:2263").unit == UNITS["us-ft"]


def test_a_unit_of_any_length_can_be_given():
    assert from_arrays(None, unit=LengthUnit("chain", 20.1168)).unit.metres == 20.1168


def test_trees_have_the_unit_of_their_scene(tmp_path):
    ground = at.Scene.from_arrays(TRIANGLE * [100, 100, 0] - [1, 1, 0], up="z", unit="ft")
    assert from_trees(tmp_path, scene=ground, base=0.0).unit == UNITS["ft"]
    with pytest.raises(at.InputError, match="arrays is in ft, and arrays in m; scale one"):
        from_trees(tmp_path, scene=ground, base=0.0, unit="m")


def test_scenes_of_a_store_share_a_unit(tmp_path):
    with pytest.raises(at.InputError, match="have coordinates in m, mm; scale them to one unit"):
        at.build_store([from_arrays(None, unit="mm"), from_arrays(None)], tmp_path / "a.antumbra")


def test_a_unit_can_be_set_afterwards():
    scene = from_arrays(None)
    scene.unit = "cm"
    assert scene.unit == UNITS["cm"] and "cm" in scene._repr_html_()
    scene.crs = "EPSG:28992"
    with pytest.raises(at.InputError, match="unit is cm"):
        _ = scene.unit


# --- Heights in another unit than the plan ----------------------------------------------------------------------------

FEET = (10.0, 0.0, 985000.0, 0.0, -10.0, 220000.0)  # cells of 10 US survey feet in EPSG:2263


@pytest.mark.parametrize(
    "crs, band, factor",
    [
        ("EPSG:2263", "metre", 1.0 / US_FOOT),
        ("EPSG:2263", "Foot_US", 1.0),
        ("EPSG:2263", "US survey foot", 1.0),
        ("EPSG:2263+5703", "", 1.0 / US_FOOT),
        ("EPSG:2263+5703", "dm", 0.1 / US_FOOT),
        ("EPSG:28992", "Foot_US", US_FOOT),
        ("EPSG:28992", "dm", 0.1),
        ("EPSG:28992", "mm", 0.001),
        ("EPSG:28992", "", 1.0),
        ("EPSG:28992+8228", "", 0.3048),
    ],
)
def test_heights_of_rasters_are_in_the_unit_of_the_plan(tmp_path, crs, band, factor):
    heights = hills() + 1.0
    path = write_raster(tmp_path / "a.tif", heights, FEET, crs, **({"units": (band,)} if band else {}))
    scene = at.load(path)
    assert np.allclose(scene.bounds[:, 2], np.array([heights.min(), heights.max()]) * factor, rtol=1e-6)
    assert scene.unit == unit_of_crs(crs) and not parts_of_crs(scene.crs).mixed
    xarray = pytest.importorskip("xarray")
    y, x = 220000.0 - 10.0 * np.arange(heights.shape[0]), 985000.0 + 10.0 * np.arange(heights.shape[1])
    array = xarray.DataArray(heights, {"y": y, "x": x}, ("y", "x"), attrs={"units": band})
    assert np.allclose(at.from_raster(array, crs=crs).bounds[:, 2], scene.bounds[:, 2], rtol=1e-6)


@pytest.mark.parametrize("band", ["fathom", ""])
def test_an_unknown_unit_of_heights_is_noted(tmp_path, band):
    path = write_raster(tmp_path / "a.tif", hills(), FEET, "EPSG:2263", units=(band,))
    with pytest.warns(UserWarning, match="unknown; they are taken in us-ft, the unit of the plan; if that is wrong"):
        assert at.load(path).bounds[1, 2] == hills().max()
    assert at.from_raster(path, z_scale=2.0).bounds[1, 2] == 2.0 * hills().max()


def test_heights_of_a_city_are_in_the_unit_of_the_plan(tmp_path):
    import json

    crs = "https://www.opengis.net/def/crs-compound?1=http://www.opengis.net/def/crs/EPSG/0/2263&2=http://www.opengis.net/def/crs/EPSG/0/5703"
    vertices = [[985000 + 10 * x, 220000 + 10 * y, 3 * z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    path = tmp_path / "a.city.json"
    path.write_text(json.dumps(city(crs=crs, vertices=vertices)))
    with pytest.warns(UserWarning, match="heights are converted from m to us-ft, the unit of the plan of EPSG:2263"):
        scene = at.load(path)
    assert scene.crs == "EPSG:2263" and scene.bounds[:, 2].tolist() == [0.0, pytest.approx(3.0 / US_FOOT)]
    assert at.place_of(scene).elevation == 0.0


# --- Files ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("units, name", [("millimeters", "mm"), ("inches", "in"), (None, "m"), ("cubits", "m")])
def test_the_units_of_a_trimesh_are_those_of_the_scene(units, name):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.box()
    mesh.units = units
    assert at.load(mesh).unit.name == name and at.Scene.from_mesh(mesh, unit="ft").unit.name == "ft"


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_a_building_of_two_kilometres_is_noted(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / f"a.{suffix}"
    trimesh.creation.box((10_000, 8_000, 6_000)).export(path)
    with pytest.warns(UserWarning, match='is 6,000 m high, if its unit is the metre; pass its own, such as unit="mm"'):
        at.load(path, up="z")
    assert not any("high" in note for note in at.load(path, up="z", unit="mm").notes)


@pytest.mark.parametrize("up", ["y", "z"])
def test_models_of_results_are_in_metres(tmp_path, up):
    scene = at.Scene.from_arrays(TRIANGLE * [3000, 2000, 1000], up=up, unit="mm")
    table = at.sky_view(scene, "face", directions=16)
    table.save(tmp_path / "a.glb")
    size = np.ptp(at.load(tmp_path / "a.glb").bounds, axis=0)
    assert np.allclose(size, [3, 2, 1] if up == "y" else [3, 1, 2], rtol=1e-6)
