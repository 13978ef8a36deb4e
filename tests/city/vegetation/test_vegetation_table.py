"""Tables of trees: points, outlines and CSV files; columns, coordinate reference systems and faults."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.vegetation.vegetation_table import SUFFIXES, VegetationOptions, read_vegetation

gpd = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")

DUTCH = "EPSG:28992"


def frame(crs=DUTCH, **columns):
    places = shapely.points([[85000.0, 446000.0], [85020.0, 446010.0]])
    return gpd.GeoDataFrame({"height": [10.0, 8.0], "radius": [3.0, 2.0], **columns}, geometry=places, crs=crs)


def written(folder, suffix, table):
    path = folder / f"trees{suffix}"
    if suffix == ".csv":
        rows = table.drop(columns="geometry").assign(x=table.geometry.x, y=table.geometry.y)
        rows.to_csv(path, index=False)
    elif suffix == ".parquet":
        table.to_parquet(path)
    else:
        table.to_file(path, engine="pyogrio")
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_all_files_give_the_same_trees(tmp_path, suffix):
    path = written(tmp_path, suffix, frame(id=["a", "b"]))
    trees = read_vegetation(path, VegetationOptions(transmittance=0.5))
    assert sorted(trees.ids) == ["a", "b"]
    order = np.argsort(trees.ids)
    assert trees.plan[order].tolist() == [[85000.0, 446000.0], [85020.0, 446010.0]]
    assert trees.shapes.heights[order].tolist() == [10.0, 8.0] and trees.shapes.radii[order].tolist() == [3.0, 2.0]
    assert trees.shapes.clear[order].tolist() == [2.5, 2.0] and (trees.shapes.shares == 0.5).all()
    assert trees.crs == (None if suffix == ".csv" else DUTCH) and trees.file == path.name


def test_outlines_give_places_and_radii():
    outlines = gpd.GeoDataFrame({"h": [9.0]}, geometry=[shapely.box(2, 4, 6, 8)])
    trees = read_vegetation(outlines, VegetationOptions(height="h"))
    assert trees.plan.tolist() == [[4.0, 6.0]] and trees.shapes.radii.tolist() == [np.sqrt(16.0 / np.pi)]
    assert read_vegetation(outlines, VegetationOptions(height="h", radius=1.5)).shapes.radii.tolist() == [1.5]


def test_points_in_degrees_are_projected_to_the_crs_of_the_scene():
    trees = read_vegetation(frame().to_crs("EPSG:4326"), VegetationOptions(), DUTCH)
    assert trees.crs == DUTCH and np.allclose(trees.plan, [[85000.0, 446000.0], [85020.0, 446010.0]], atol=1e-3)


def test_columns_numbers_and_arrays():
    table = frame(light=[0.25, 0.5], foot=[1.0, -2.0], stem=[0.2, 0.0])
    options = VegetationOptions(9.0, np.array([1.0, 2.0]), "light", base="foot", trunk_radius="stem", crown_base=1)
    trees = read_vegetation(table, options)
    assert trees.shapes.heights.tolist() == [9.0, 9.0] and trees.shapes.radii.tolist() == [1.0, 2.0]
    assert trees.shapes.shares[:, 3, 1].tolist() == [0.25, 0.5] and trees.bases.tolist() == [1.0, -2.0]
    assert trees.shapes.trunk_radii.tolist() == [0.2, 0.0] and trees.shapes.clear.tolist() == [1.0, 1.0]
    year = read_vegetation(frame(), VegetationOptions(transmittance=np.linspace(0, 1, 12)))
    assert np.allclose(year.shapes.shares[1, :, 0], np.linspace(0, 1, 12))
    red = read_vegetation(frame(), VegetationOptions(transmittance=(0.1, 0.2, 0.3)))
    assert red.shapes.shares[0, 5].tolist() == [0.1, 0.2, 0.3]
    assert at.from_trees(table, transmittance="light").n_triangles == 2 * 68


@pytest.mark.parametrize(
    "options, words",
    [
        ({"height": "hight"}, "no column 'hight' for height; did you mean 'height'"),
        ({"radius": 0.0}, "tree '0' has a radius of 0 or less"),
        ({"height": [1.0, np.nan]}, "tree '1' has a height of 0 or less, or none"),
        ({"transmittance": 1.5}, "has a transmittance outside 0 to 1"),
        ({"transmittance": [0.5, 0.5]}, "give a column, a share"),
        ({"crown_base": 12.0}, "has a crown_base outside 0 to its height"),
        ({"trunk_radius": 2.5}, "tree '1' has a trunk wider than its crown; correct it"),
        ({"base": [0.0, np.inf]}, "has a number that is missing or infinite"),
        ({"shape": "cube"}, "shape"),
        ({"id": "names"}, "no column 'names' for id"),
        ({"crs": "EPSG:4258"}, "its CRS is EPSG:28992, and the scene's is EPSG:4258"),
    ],
)
def test_faults_are_named(options, words):
    table = frame(fid=[0, 1])
    with pytest.raises(at.InputError, match=words.replace("(", r"\(")):
        read_vegetation(table, VegetationOptions(**options))
    assert len(read_vegetation(table, VegetationOptions()).ids) == 2


def test_files_and_layers_that_cannot_be_read(tmp_path):
    with pytest.raises(at.InputError, match="unknown format of trees; use one of"):
        read_vegetation(tmp_path / "a.xlsx", VegetationOptions())
    broken = tmp_path / "a.gpkg"
    broken.write_bytes(b"SQLite format 3\0 and no database")
    with pytest.raises(at.InputError, match="is it a file of trees"):
        read_vegetation(broken, VegetationOptions())
    for name, text, words in (
        ("b.csv", "a,b\n1,2\n", "no columns x and y"),
        ("c.csv", "x,y,height,radius\n", "has no trees"),
        (
            "d.csv",
            "x,y,height,radius\n1,2,tall,3\n",
            "1 of 1 row of the column 'height' for height lacks a number, such as 'tall'",
        ),
        ("e.csv", "x,y,height,radius\n1,,4,3\n", "has no place"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(at.InputError, match=words):
            read_vegetation(tmp_path / name, VegetationOptions())
    path = tmp_path / "two.gpkg"
    frame().to_file(path, layer="oaks")
    frame().to_file(path, layer="limes")
    with pytest.raises(at.InputError, match="has the layers oaks, limes; name the one with trees"):
        read_vegetation(path, VegetationOptions())
    assert len(read_vegetation(path, VegetationOptions(layer="limes")).ids) == 2
    with pytest.raises(at.InputError, match="no layer 'lime'; did you mean 'limes'"):
        read_vegetation(path, VegetationOptions(layer="lime"))


def test_degrees_mixed_shapes_and_other_objects_are_refused():
    with pytest.raises(at.InputError, match="is in degrees; name one in metres: crs='EPSG:32631'"):
        read_vegetation(frame().to_crs("EPSG:4326"), VegetationOptions())
    both = gpd.GeoDataFrame(
        {"height": [1, 2], "radius": [1, 1]}, geometry=[shapely.Point(0, 0), shapely.box(1, 1, 2, 2)]
    )
    with pytest.raises(at.InputError, match="both points and outlines"):
        read_vegetation(both, VegetationOptions())
    outlines = frame().set_geometry(frame().buffer(2)).to_crs("EPSG:4326")
    with pytest.raises(at.InputError, match="outlines in degrees have no area"):
        read_vegetation(outlines, VegetationOptions(crs=DUTCH))
    with pytest.raises(at.InputError, match="give the path of a file, or a GeoDataFrame"):
        read_vegetation(3, VegetationOptions())


def test_trees_need_a_surface(tmp_path):
    ground = at.Scene.from_arrays([[[0.0, 0, 0], [9, 0, 0], [0, 9, 0]]], up="z", name="plot")
    with pytest.raises(at.InputError, match=r"tree 'tree 0' \(and 1 more\) has no surface of plot under it; give base"):
        at.from_trees(frame(crs=None), scene=ground)
    assert at.from_trees(frame(crs=None), scene=ground, base=0.0).n_triangles == 1 + 2 * 68
    store = tmp_path / "plot.antumbra"
    at.build_store(ground, store)
    with pytest.raises(at.InputError, match=r"tree 'tree 0' \(and 1 more\) has no surface of plot under it; give base"):
        at.from_trees(frame(crs=None), scene=store)
    assert at.from_trees(frame(crs=None), scene=store, base=0.0).n_triangles == 1 + 2 * 68
