"""Rasters of heights: files, arrays, DataArrays and tiles; units, holes and CRS; refusals; stores."""

import numpy as np
import pytest

import antumbra as at
import gis_files
from antumbra.base.errors import InputError
from gis_files import CRS, PLACE, hills, write_raster

HEIGHTS = hills()


def same(a, b):
    assert (a.bounds == b.bounds).all() and a.raster == b.raster and a.crs == b.crs and a.up == b.up == "z"
    assert (a.triangles().vertices == b.triangles().vertices).all()


@pytest.fixture
def reference():
    return at.from_raster((HEIGHTS, PLACE, CRS))


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".vrt"])
def test_files_give_the_surface_of_their_array(suffix, tmp_path, reference):
    path = write_raster(tmp_path / f"a{suffix}", HEIGHTS)
    same(at.load(path), reference)
    same(at.from_raster(path), reference)
    assert at.load(path).name == "a"


def test_an_ascii_grid_takes_its_crs_from_the_argument(tmp_path, reference):
    path = write_raster(tmp_path / "a.asc", HEIGHTS, crs=None)
    same(at.load(path, crs=CRS), reference)


@pytest.mark.parametrize("dtype", ["int16", "uint8", "int32", "float32", "float64"])
def test_types_of_numbers(dtype, tmp_path):
    heights = np.round(HEIGHTS).astype(dtype)
    scene = at.load(write_raster(tmp_path / "a.tif", heights))
    same(scene, at.from_raster((heights.astype(np.float64), PLACE, CRS)))


def test_vertices_lie_at_the_centres_of_cells(reference):
    low, high = reference.bounds
    assert low[:2].tolist() == [100001.0, 450000.0 - 13.0] and high[:2].tolist() == [100017.0, 449999.0]
    assert reference.raster == at.Raster(100000.0, 450000.0, 2.0, 9, 7, CRS)
    assert [(each.name, each.type) for each in reference.objects] == [("terrain", "TINRelief")]


def test_values_at_corners_move_by_half_a_cell(reference):
    scene = at.from_raster((HEIGHTS, PLACE, CRS), values_at="corners")
    assert (scene.bounds - reference.bounds == [[-1.0, 1.0, 0.0]] * 2).all()


def test_a_south_up_array_is_turned(reference):
    south_up = (2.0, 0.0, 100000.0, 0.0, 2.0, 450000.0 - 14.0)
    same(at.from_raster((HEIGHTS[::-1], south_up, CRS)), reference)


def test_a_south_up_file_is_turned(tmp_path, reference):
    path = write_raster(tmp_path / "a.tif", HEIGHTS[::-1], (2.0, 0.0, 100000.0, 0.0, 2.0, 450000.0 - 14.0))
    same(at.load(path), reference)


def test_holes(tmp_path):
    heights = HEIGHTS.copy()
    heights[2, 3] = np.nan
    scene = at.from_raster((heights, PLACE, CRS))
    assert scene.n_triangles == 2 * 6 * 8 - 6
    same(at.from_raster((np.ma.masked_invalid(heights), PLACE, CRS)), scene)
    marked = np.where(np.isnan(heights), -9999.0, heights)
    same(at.load(write_raster(tmp_path / "a.tif", marked, nodata=-9999.0)), scene)
    path = write_raster(tmp_path / "b.tif", marked)
    with pytest.warns(UserWarning, match="lowest height is -9999.*pass nodata=-9999"):
        assert at.load(path).n_triangles == 2 * 6 * 8
    same(at.from_raster(path, nodata=-9999.0), scene)


def test_units_and_scales(tmp_path):
    metres = at.from_raster((HEIGHTS * 0.3048, PLACE, CRS))
    same(at.load(write_raster(tmp_path / "a.tif", HEIGHTS, units=("ft",))), metres)
    same(at.from_raster((HEIGHTS, PLACE, CRS), z_scale=0.3048), metres)
    stored = np.round(HEIGHTS * 4.0).astype(np.int16)
    scaled = write_raster(tmp_path / "b.tif", stored, scales=(0.25,), offsets=(3.0,))
    same(at.load(scaled), at.from_raster((HEIGHTS + 3.0, PLACE, CRS)))
    assert at.from_raster(scaled, z_scale=2.0).bounds[1, 2] == 2.0 * (HEIGHTS.max() + 3.0)


def test_data_arrays(tmp_path, reference):
    xarray = pytest.importorskip("xarray")
    import rioxarray  # noqa: F401 - the accessor

    path = write_raster(tmp_path / "a.tif", np.where(HEIGHTS.max() == HEIGHTS, -1.0, HEIGHTS), nodata=-1.0)
    holes = at.load(path)
    assert 0 < holes.n_triangles < 2 * 6 * 8
    for masked in False, True:
        same(at.from_raster(xarray.open_dataarray(path, engine="rasterio", mask_and_scale=masked)), holes)
    x, y = 100001.0 + 2.0 * np.arange(9), 449999.0 - 2.0 * np.arange(7)
    plain = xarray.DataArray(HEIGHTS, dims=("y", "x"), coords={"y": y, "x": x}, name="hills")
    same(at.from_raster(plain, crs=CRS), reference)
    same(at.from_raster(plain[::-1, ::-1], crs=CRS), reference)
    assert at.from_raster(plain).name == "hills"
    with pytest.raises(InputError, match="not evenly spaced"):
        at.from_raster(plain[[0, 1, 3]])
    with pytest.raises(InputError, match="no coordinates 'x'"):
        at.from_raster(plain.drop_vars("x"))


AXES = [
    (("y", "x"), {}),
    (("Y", "X"), {}),
    (("northing", "easting"), {}),
    (("Northings", "Eastings"), {}),
    (("row", "x"), {}),
    (("y", "column"), {}),
    (("j", "i"), {"j": {"axis": "Y"}, "i": {"axis": "X"}}),
    (("rlat", "rlon"), {"rlon": {"standard_name": "projection_x_coordinate"}}),
    (("x", "y"), {"x": {"axis": "Y"}, "y": {"axis": "X"}}),  # the convention is more binding than the name
]


@pytest.mark.parametrize("dims, attributes", AXES, ids=lambda value: ",".join(value))
@pytest.mark.parametrize("turned", [False, True], ids=["northing first", "easting first"])
def test_the_dimensions_of_data_arrays_are_found_by_name_in_either_order(dims, attributes, turned, reference):
    xarray = pytest.importorskip("xarray")
    x, y = 100001.0 + 2.0 * np.arange(9), 449999.0 - 2.0 * np.arange(7)
    array = xarray.DataArray(HEIGHTS[None, ..., None], dims=("band", *dims, "time"), coords={dims[0]: y, dims[1]: x})
    for name, values in attributes.items():
        array[name].attrs |= values
    same(at.from_raster(array.transpose(..., *dims[::-1]) if turned else array, crs=CRS), reference)
    same(at.from_raster(array.squeeze().T if turned else array.squeeze(), crs=CRS), reference)


@pytest.mark.parametrize("dims", [("a", "b"), ("x", "easting"), ("dim_0", "dim_1")])
def test_data_arrays_with_unknown_dimensions_are_refused_with_the_known_names(dims):
    xarray = pytest.importorskip("xarray")
    array = xarray.DataArray(HEIGHTS, dims=dims, coords=dict(zip(dims, map(np.arange, HEIGHTS.shape))))
    words = f"which of the dimensions {dims[0]}, {dims[1]} is x. rename them to x/y, easting/northing, "
    with pytest.raises(InputError, match=rf"{words}longitude/latitude, or set their CF axis"):
        at.from_raster(array)


@pytest.mark.parametrize("named", ["name", "standard name", "units"])
def test_longitudes_and_latitudes_of_data_arrays_are_refused_as_degrees_without_a_crs_too(named):
    xarray = pytest.importorskip("xarray")
    dims = ("lat", "lon") if named == "name" else ("y", "x")
    x, y = 4.3 + 0.001 * np.arange(9), 52.1 - 0.001 * np.arange(7)
    array = xarray.DataArray(HEIGHTS, dims=dims, coords={dims[0]: y, dims[1]: x})
    if named == "standard name":
        array["x"].attrs["standard_name"] = "longitude"
    if named == "units":
        array["y"].attrs["units"] = "degrees_north"
    with pytest.raises(InputError, match=r"EPSG:4326, is in degrees.*gdalwarp .* -t_srs EPSG:32631"):
        at.from_raster(array)


def test_tiles_join_without_cracks(tmp_path, reference):
    places = [(2.0, 0.0, 100000.0 + 2.0 * j, 0.0, -2.0, 450000.0 - 2.0 * i) for i in (0, 3) for j in (0, 5)]
    parts = HEIGHTS[:3, :5], HEIGHTS[:3, 5:], HEIGHTS[3:, :5], HEIGHTS[3:, 5:]
    tiles = [(part, place, CRS) for part, place in zip(parts, places)]
    same(at.from_raster(tiles), reference)
    same(at.from_raster(tiles[::-1]), reference)
    files = [write_raster(tmp_path / f"{k}.tif", part, place) for k, (part, place, _) in enumerate(tiles)]
    same(at.from_raster(files), reference)
    assert at.from_raster(tiles[::3]).n_triangles == 2 * (2 * 4 + 3 * 3)
    with pytest.raises(InputError, match="do not continue"):
        at.from_raster([tiles[0], (parts[1], (2.0, 0.0, 100010.5, 0.0, -2.0, 450000.0), CRS)])
    with pytest.raises(InputError, match="its CRS is EPSG:32631, and that of terrain EPSG:28992"):
        at.from_raster([tiles[0], (parts[1], places[1], "EPSG:32631")])


def test_the_first_of_overlapping_tiles_counts():
    holes = HEIGHTS.copy()
    holes[0] = np.nan
    scene = at.from_raster([(holes, PLACE), (HEIGHTS + 100.0, PLACE)])
    expected = np.where(np.isnan(holes), HEIGHTS + 100.0, HEIGHTS)
    assert (scene.triangles().vertices == at.from_raster((expected, PLACE)).triangles().vertices).all()


def test_the_ground_shows_through_holes(tmp_path):
    surface = HEIGHTS + 10.0
    surface[2:5, 3:6] = np.nan
    wide = (4.0, 0.0, 99990.0, 0.0, -4.0, 450010.0)
    scene = at.from_raster((surface, PLACE, CRS), ground=(np.zeros((12, 12)), wide, CRS))
    assert [each.name for each in scene.objects] == ["terrain", "terrain"] and len(scene.meshes) == 2
    down = scene.closest_hit([[100009.0, 449993.0, 99.0], [100003.0, 449997.0, 99.0]], (0.0, 0.0, -1.0))
    assert down.object.tolist() == [1, 0] and down.t[0] == 99.0
    assert len(at.sensors_of("raster", scene)) == HEIGHTS.size
    with pytest.raises(InputError, match="its CRS is EPSG:32631, and the scene's is EPSG:28992"):
        at.from_raster((surface, PLACE, CRS), ground=(np.zeros((12, 12)), wide, "EPSG:32631"))


DEGREES = (0.001, 0.0, 4.3, 0.0, -0.001, 52.1)


@pytest.mark.parametrize(
    "raster, options, words",
    [
        ((HEIGHTS, DEGREES, "EPSG:4326"), {}, "is in degrees; project it, for example with: gdalwarp .*EPSG:32631"),
        ((HEIGHTS, (2.0, 0.5, 0.0, 0.5, -2.0, 0.0)), {}, "do not run from west to east"),
        ((HEIGHTS, (-2.0, 0.0, 0.0, 0.0, -2.0, 0.0)), {}, "do not run from west to east"),
        ((HEIGHTS, (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)), {}, "cells have no height"),
        ((HEIGHTS[:1], PLACE), {}, "at least 2 x 2"),
        ((HEIGHTS[0], PLACE), {}, "must be numbers"),
        ((HEIGHTS * np.nan, PLACE), {}, "no cell has a height"),
        ((HEIGHTS + np.inf, PLACE), {}, "infinite heights"),
        ((HEIGHTS.astype(str), PLACE), {}, "must be numbers|numbers"),
        ((HEIGHTS, PLACE[:5]), {}, "transform"),
        ((HEIGHTS, PLACE, "EPSG:99999999"), {}, "EPSG:99999999' is unknown"),
        ((HEIGHTS, PLACE), {"crs": "nonsense"}, "nonsense' is unknown"),
        ((HEIGHTS, PLACE), {"values_at": "middles"}, "values_at"),
        ((HEIGHTS, PLACE), {"z_scale": 0.0}, "z_scale is 0"),
        ((HEIGHTS, PLACE), {"band": 0}, "band"),
        ([], {}, "empty list"),
        (7, {}, "raster is 7; give a raster file"),
        ("missing.tif", {}, "missing.tif"),
    ],
)
def test_refusals_name_the_thing_and_the_cure(raster, options, words):
    with pytest.raises(InputError, match=words) as caught:
        at.from_raster(raster, **options)
    assert "\n" not in str(caught.value)


def test_files_are_refused_by_name(tmp_path):
    import rasterio

    path = tmp_path / "a.tif"
    with rasterio.open(path, "w", driver="GTiff", width=3, height=3, count=2, dtype="uint8", crs=CRS) as file:
        file.transform = rasterio.Affine(*PLACE)
        file.write(np.arange(18, dtype=np.uint8).reshape(2, 3, 3))
    with pytest.raises(InputError, match=r"a\.tif: has 2 bands; name the one"):
        at.load(path)
    assert at.from_raster(path, band=2).bounds[:, 2].tolist() == [9.0, 17.0]
    with pytest.raises(InputError, match="no band 3"):
        at.from_raster(path, band=3)
    with pytest.raises(InputError, match="z up, as all geographic data"):
        at.load(path, up="y")
    with rasterio.open(tmp_path / "b.tif", "w", driver="GTiff", width=3, height=3, count=1, dtype="uint8") as file:
        file.write(np.zeros((1, 3, 3), np.uint8))
    with pytest.raises(InputError, match=r"b\.tif: has no georeference"):
        at.load(tmp_path / "b.tif")


def test_a_store_of_a_raster_is_streamed_and_answers_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("antumbra.scene.terrain._HIGH", 5)
    monkeypatch.setattr("antumbra.scene.terrain._WIDE", 7)
    heights = hills(24, 31)
    heights[10:13, 4:9] = -1.0
    path = write_raster(tmp_path / "a.tif", heights, nodata=-1.0)
    scene = at.load(path)
    at.build_store(path, tmp_path / "a.antumbra", chunk=256)
    at.build_store(scene, tmp_path / "b.antumbra", chunk=256)
    store = at.load(tmp_path / "a.antumbra")
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "b.antumbra").read_bytes()
    assert store.raster == scene.raster and store.crs == scene.crs and store.up == "z"
    eye = scene.bounds.mean(0) + [0.0, 0.0, 9.0]
    seen, expected = (at.viewshed(each, "raster+0.5", eye).table for each in (store, scene))
    assert (seen["seen"] == expected["seen"]).all() and 0 < seen["seen"].sum() < len(seen)


def test_a_store_of_tiles_has_one_surface(tmp_path, monkeypatch):
    monkeypatch.setattr("antumbra.scene.terrain._HIGH", 5)
    monkeypatch.setattr("antumbra.scene.terrain._WIDE", 7)
    heights = hills(24, 31)
    heights[10:13, 4:9] = np.nan
    parts = {(0, 0): heights[:9, :20], (7, 0): heights[7:, :20], (0, 20): heights[:, 20:]}  # two of them overlap
    places = [(2.0, 0.0, 100000.0 + 2.0 * j, 0.0, -2.0, 450000.0 - 2.0 * i) for i, j in parts]
    tiles = [write_raster(tmp_path / f"{k}.tif", *each) for k, each in enumerate(zip(parts.values(), places))]
    whole = at.from_raster(tiles)
    same(whole, at.from_raster((heights, places[0], CRS), name=whole.name))
    at.build_store(whole, tmp_path / "whole.antumbra", chunk=256)
    for scenes in tiles, (str(tile) for tile in tiles):
        at.build_store(scenes, tmp_path / "tiles.antumbra", chunk=256)
        assert (tmp_path / "tiles.antumbra").read_bytes() == (tmp_path / "whole.antumbra").read_bytes()
    apart = write_raster(tmp_path / "b.tif", heights, (2.0, 0.0, 100063.0, 0.0, -2.0, 450000.0))
    with pytest.raises(
        InputError, match=r"b: its cells do not continue those of 0; warp one with: gdalwarp .* -tr SIZE SIZE -tap"
    ):
        at.build_store([*tiles, apart], tmp_path / "c.antumbra")
    house = at.Scene.from_arrays(whole.bounds[0] + [[[0.0, 0, 0], [9, 0, 0], [9, 9, 9]]], up="z")
    report = at.build_store([*tiles, house, apart], tmp_path / "c.antumbra")  # `apart` is a surface of its own
    assert report.triangles == 2 * whole.n_triangles + 1


def test_results_come_back_on_the_grid_of_the_input(tmp_path):
    import rasterio

    path = write_raster(tmp_path / "a.tif", hills(20, 30))
    scene = at.load(path)
    at.viewshed(scene, "raster+1.7", scene.bounds.mean(0) + [0.0, 0.0, 9.0]).table.save(tmp_path / "seen.tif")
    with rasterio.open(path) as before, rasterio.open(tmp_path / "seen.tif") as after:
        assert (before.transform, before.crs, before.shape) == (after.transform, after.crs, after.shape)
        assert set(np.unique(after.read(1))) == {0.0, 1.0}


def test_oblong_cells_have_a_surface_and_no_raster():
    scene = at.from_raster((HEIGHTS, (2.0, 0.0, 0.0, 0.0, -3.0, 0.0)))
    assert scene.raster is None and np.ptp(scene.bounds, axis=0)[:2].tolist() == [16.0, 18.0]
    assert gis_files.CRS == CRS
