"""`antumbra visible` of wind farms: repeated options, tables in any CRS, and errors without a partial file."""

import json

import numpy as np
import pytest

import antumbra as at

pytest.importorskip("rasterio")
geopandas = pytest.importorskip("geopandas")
import rasterio  # noqa: E402

CRS = "EPSG:28992"
FEET = [(84100.0, 445950.0), (84090.0, 445990.0), (84050.0, 445975.0)]


@pytest.fixture
def dem(tmp_path, monkeypatch):
    """A raster with a wall, in the Dutch national grid."""
    heights = np.full((60, 60), 3.0, np.float32)
    heights[:, 20] = 13.0
    place = rasterio.Affine(2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)
    options = {"height": 60, "width": 60, "count": 1, "dtype": "float32", "nodata": -99.0}
    with rasterio.open(tmp_path / "dem.tif", "w", "GTiff", transform=place, crs=CRS, **options) as file:
        file.write(heights, 1)
    monkeypatch.chdir(tmp_path)
    return at.load("dem.tif")


def farm():
    """The turbines, whose feet are on the ground."""
    sizes = zip(FEET, (20.0, 14.0, 18.0), (12.0, 20.0, 8.0))
    return {f"WT{k}": at.Turbine((*foot, 3.0), hub, rotor) for k, (foot, hub, rotor) in enumerate(sizes, 1)}


def table(name, crs, z=None):
    """Write the turbines as a layer of points."""
    shapes = geopandas.points_from_xy(*zip(*FEET), z=None if z is None else [z] * 3, crs=CRS).to_crs(crs)
    columns = {"id": ["WT1", "WT2", "WT3"], "hub_height": [20.0, 14.0, 18.0], "rotor_diameter": [12.0, 20.0, 8.0]}
    frame = geopandas.GeoDataFrame(columns, geometry=shapes)
    if name.endswith(".csv"):
        rows = zip(*columns.values(), shapes.x, shapes.y)
        text = (
            "".join(f"{i},{h},{r},{x!r},{y!r}\n" for i, h, r, x, y in rows).replace("np.float64(", "").replace(")", "")
        )
        with open(name, "w") as file:
            file.write("id,hub_height,rotor_diameter,longitude,latitude\n" + text)
    elif name.endswith(".parquet"):
        frame.to_parquet(name)
    else:
        frame.to_file(name)


@pytest.mark.parametrize(
    "name, crs, z",
    [
        ("farm.gpkg", CRS, 3.0),
        ("farm.gpkg", "EPSG:25831", None),
        ("farm.geojson", "EPSG:4326", None),
        ("farm.csv", "EPSG:4326", None),
        ("farm.parquet", "EPSG:32631", None),
    ],
)
def test_farms_from_tables_in_any_crs(cli, dem, name, crs, z):
    table(name, crs, z)
    on = () if z is not None else ("--on-surface",)
    told = cli("visible", "dem.tif", "--sensors", "raster+1.6", "--turbines", name, *on, "-o", "a.tif", "--json").json()
    expected = at.visible_share(dem, "raster+1.6", farm())
    with rasterio.open("a.tif") as file:
        bands = dict(zip(file.descriptions, file.read()))
    assert list(bands) == ["turbines", "share", "visible", "share_WT1", "share_WT2", "share_WT3"]
    for band, values in bands.items():  # reprojected places differ by a millimetre
        assert np.abs(values.ravel() - expected[band]).mean() < 0.002 * max(1.0, expected[band].max())
    assert (told["turbines"], told["most_turbines"]) == (3, 3) and told["samples"] == 192
    assert len(np.unique(bands["turbines"])) > 2


def test_a_turbine_given_twice_is_two_turbines(cli, dem):
    feet = [word for foot in FEET for word in ("--turbine", f"{foot[0]},{foot[1]},3")]
    sizes = "--hub-height", "14", "--rotor", "16"
    assert cli("visible", "dem.tif", "--sensors", "raster+1.6", *feet, *sizes, "-o", "a.csv").code == 0
    expected = at.visible_share(dem, "raster+1.6", [at.Turbine((*foot, 3.0), 14.0, 16.0) for foot in FEET])
    with open("a.csv") as file:
        assert {"turbines", "share", "share_1", "share_2", "share_3"} <= set(file.readline().strip().split(","))
        assert sum(1 for _ in file) == len(expected) == 3600


@pytest.mark.parametrize(
    "words, told",
    [
        (("--turbines", "none.gpkg"), "none.gpkg"),
        (("--turbines", "farm.gpkg"), "its points have no heights; add a column z, or place them with --on-surface"),
        (
            ("--turbines", "farm.gpkg", "--on-surface", "--rotor", "9"),
            "has the column rotor_diameter; leave --rotor out",
        ),
        (
            ("--turbines", "bare.csv", "--rotor", "9"),
            "bare.csv: has no column hub_height; add it, or give --hub-height",
        ),
        (("--turbines", "twice.csv", "--rotor", "9", "--hub-height", "20"), "the id 'a' is that of several rows"),
        (("--turbines", "farm.gpkg", "--turbine", "1,2,3"), "give one target"),
        (("--turbines", "tall.csv", "--rotor", "9"), "tall.csv: the row b: the hub height of a turbine is -5"),
        (("--points", "bare.csv", "--on-surface"), "--on-surface places the feet of turbines"),
        (("--points", "bare.csv", "--rotor", "3"), "--hub-height and --rotor are of turbines"),
        (
            ("--turbines", "lines.geojson", "--on-surface"),
            "lines.geojson: has the layers lines (LineString); write one layer of points",
        ),
    ],
)
def test_errors_leave_no_file(cli, dem, words, told, tmp_path):
    table("farm.gpkg", "EPSG:25831")
    (tmp_path / "bare.csv").write_text("x,y,z\n84100,445950,3\n")
    (tmp_path / "twice.csv").write_text("id,x,y,z\na,84100,445950,3\na,84090,445990,3\n")
    (tmp_path / "tall.csv").write_text("id,x,y,z,hub_height\na,84100,445950,3,20\nb,84090,445990,3,-5\n")
    line = {"type": "LineString", "coordinates": [[4.3, 52.0], [4.31, 52.0]]}
    feature = {"type": "Feature", "properties": {"id": 1}, "geometry": line}
    (tmp_path / "lines.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    done = cli("visible", "dem.tif", "--sensors", "raster+1.6", *words, "-o", "a.tif")
    assert done.code == 2 and told in done.err and not (tmp_path / "a.tif").exists(), done


def test_observers_have_heights_ranges_and_bands_of_their_own(cli, dem, tmp_path):
    rows = {"id": ["a", "b"], "eye_height": [1.7, 30.0], "max_distance": [25.0, np.nan]}
    places = geopandas.points_from_xy([84010.0, 84081.0], [445951.0, 445931.0], crs=CRS).to_crs("EPSG:4326")
    geopandas.GeoDataFrame(rows, geometry=places).to_file("eyes.geojson")
    words = "--observers", "eyes.geojson", "--on-surface", "--each", "--polygons", "seen.gpkg", "-o", "a.tif"
    assert cli("viewshed", "dem.tif", "--sensors", "raster+1", *words).code == 0
    one = at.viewshed(dem, "raster+1", [84010.0, 445951.0, 4.7], max_distance=25.0).table["seen"]
    two = at.viewshed(dem, "raster+1", [84081.0, 445931.0, 33.0]).table["seen"]
    with rasterio.open("a.tif") as file:
        bands = dict(zip(file.descriptions, file.read()))
    assert (bands["seen_a"].ravel() == one).mean() > 0.998 and (bands["seen_b"].ravel() == two).mean() > 0.998
    assert 50 < one.sum() < 600 < two.sum() and (bands["seen"] == bands["seen_a"] + bands["seen_b"]).all()
    seen = geopandas.read_file("seen.gpkg")
    assert seen["observer"].tolist() == ["a", "b"] and seen.crs.to_epsg() == 28992
    assert np.allclose(seen.geometry.area, [4.0 * bands["seen_a"].sum(), 4.0 * bands["seen_b"].sum()])
    assert np.allclose(seen["area"], seen.geometry.area)


def test_polygons_need_cells(cli, dem, tmp_path):
    words = "--observer", "84010,445951,9", "--polygons", "seen.gpkg"
    cli("viewshed", "dem.tif", "--sensors", "face", *words).refused(
        "--polygons are made of cells, and the sensors are face"
    )
    with pytest.raises(at.InputError, match="a column for each observer; give each=True"):
        at.viewshed(dem, "raster+1", [84010.0, 445951.0, 9.0]).polygons()
    assert not (tmp_path / "seen.gpkg").exists()
