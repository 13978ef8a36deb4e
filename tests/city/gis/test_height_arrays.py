"""DataArrays of heights: scenes for every study, results in their form, and lazy ones that are read by chunk."""

import numpy as np
import pytest

import antumbra as at
from gis_files import CRS, PLACE, hills

xarray = pytest.importorskip("xarray")

HEIGHTS = hills(30, 40)
Y, X = 449999.0 - 2.0 * np.arange(30), 100001.0 + 2.0 * np.arange(40)
EYE = (100030.0, 449970.0, 40.0)


def array(values=HEIGHTS, dims=("y", "x")):
    found = xarray.DataArray(values, dict(zip(dims, (Y, X))), dims, name="dem")
    return found.assign_coords(spatial_ref=((), 0, {"crs_wkt": CRS}))


FORMS = {
    "y down": array(),
    "y up": array()[::-1],
    "x first": array().T,
    "x from the east": array()[:, ::-1],
    "other names": array(dims=("northing", "easting")),
    "uneven by rounding": array().assign_coords(x=X.astype(np.float32) + np.float32(0.0)),
    "another dimension": array().expand_dims("band"),
}
STUDIES = {
    "sun_hours": lambda dem: at.sun_hours(dem, "raster", "2026-03-21", step=120),
    "viewshed": lambda dem: at.viewshed(dem, "raster+1", [EYE]).table,
}


@pytest.mark.parametrize("study", STUDIES)
@pytest.mark.parametrize("form", FORMS)
def test_a_data_array_goes_in_and_a_dataset_with_its_coordinates_comes_out(form, study):
    dem = FORMS[form]
    table = STUDIES[study](dem)
    expected = STUDIES[study](at.from_raster((HEIGHTS, PLACE, CRS)))
    found = table.to_xarray()
    flat = dem.squeeze(drop=True) if "band" in dem.dims else dem
    xarray.align(flat, found, join="exact")
    first = next(iter(table.columns))
    assert found[first].dims == flat.dims and len(np.unique(found[first])) > 1
    rows, columns = ("northing", "easting") if form == "other names" else ("y", "x")
    ordered = found[first].transpose(rows, columns).sortby(rows, ascending=False).sortby(columns)
    assert np.array_equal(ordered.values.reshape(-1), expected[first].astype(np.float32))


def test_a_dataset_has_the_crs_and_units_that_rioxarray_and_scenes_read():
    rioxarray = pytest.importorskip("rioxarray")
    assert rioxarray
    found = at.sun_hours(array(), "raster", "2026-03-21", step=120).to_xarray()
    assert found.sun_hours.rio.crs.to_epsg() == 28992 and found.sun_hours.attrs["units"] == "h"
    assert found.rio.transform() == array().rio.transform()
    again = at.from_raster(found.sun_hours)
    assert again.crs == CRS and again.raster == at.from_raster(array()).raster


def test_sensors_that_form_no_raster_have_no_dataset():
    table = at.sun_hours(at.from_raster(array()[:4, :4]), "face", "2026-03-21", step=240)
    with pytest.raises(at.InputError, match="of kind 'face'; use raster:SPACING"):
        table.to_xarray()


def test_other_cells_than_those_of_the_array_have_their_own_coordinates():
    found = at.viewshed(array(), "raster:5", [EYE]).table.to_xarray()
    assert found.seen.dims == ("y", "x") and (np.diff(found.x) == 5.0).all() and (np.diff(found.y) == -5.0).all()


class Chunks:
    """An array that reads its chunks and counts them, as an array of Dask does."""

    def __init__(self, values, rows):
        self.values, self.rows, self.read = values, rows, []

    def lazy(self):
        dask = pytest.importorskip("dask.array", reason="chunks need Dask: NOT checked")
        delayed = pytest.importorskip("dask").delayed

        def chunk(k):
            self.read.append(k)
            return self.values[k * self.rows : (k + 1) * self.rows]

        sizes = [len(self.values[k : k + self.rows]) for k in range(0, len(self.values), self.rows)]
        parts = [
            dask.from_delayed(delayed(chunk)(k), (size, self.values.shape[1]), self.values.dtype)
            for k, size in enumerate(sizes)
        ]
        return dask.concatenate(parts)


@pytest.mark.parametrize("turned", [False, True])
def test_a_store_of_a_lazy_array_reads_a_chunk_at_a_time_and_once_a_pass(tmp_path, monkeypatch, turned):
    monkeypatch.setattr("antumbra.scene.terrain._HIGH", 4)
    chunks = Chunks(HEIGHTS[::-1] if turned else HEIGHTS, 9)
    dem = array(chunks.lazy()).assign_coords(y=Y[::-1] if turned else Y)
    at.build_store(dem, tmp_path / "lazy.antumbra", chunk=64)
    at.build_store(array(), tmp_path / "whole.antumbra", chunk=64)
    assert (tmp_path / "lazy.antumbra").read_bytes() == (tmp_path / "whole.antumbra").read_bytes()
    order = [3, 2, 1, 0] if turned else [0, 1, 2, 3]
    assert chunks.read in (order, order * 2)


def test_a_lazy_array_that_does_not_fit_is_refused_before_it_is_read(tmp_path):
    chunks = Chunks(HEIGHTS, 9)
    with pytest.raises(
        at.InputError, match=r"dem: a scene of 1,200 cells, unlike a store, which build_store streams, "
    ):
        at.from_raster(array(chunks.lazy()), max_memory=9000)
    assert not chunks.read


def test_lazy_tiles_are_joined_in_a_store(tmp_path):
    left, right = array()[:, :20], array()[:, 20:]
    at.build_store([left, right], tmp_path / "tiles.antumbra", chunk=64)
    store, whole = at.load(tmp_path / "tiles.antumbra"), at.from_raster(array())
    assert store.raster == whole.raster and store.n_triangles == whole.n_triangles


def test_a_dataset_is_refused_as_a_scene_with_what_is_one():
    with pytest.raises(
        at.InputError, match="scene is of type Dataset; give the path of a file, a scene, a DataArray, or"
    ):
        at.load(array().to_dataset())
