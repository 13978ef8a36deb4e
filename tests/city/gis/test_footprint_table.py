"""Footprints with heights: closed solids, their surfaces, the terrain below them, files and faults."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import gis_files
from antumbra.base.errors import InputError
from antumbra.city.gis.footprint_bases import lowest_under
from antumbra.city.gis.footprint_table import SUFFIXES, FootprintOptions, read_footprints
from antumbra.scene.terrain import GridPoints, HeightGrid
from gis_files import AREAS, CRS, PLACE, buildings, hills, write_buildings
from strength import examples

geopandas = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")

HEIGHTS = np.array([3.0, 5.0, 8.0])


def world(scene):
    return scene.triangles().vertices.astype(np.float64) + scene.origin


def volumes(scene, n):
    """Six times the signed volume below the faces of each object, divided by six."""
    a, b, c = (world(scene) - scene.origin).swapaxes(0, 1)
    signed = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return np.bincount(scene.object_of_face, signed, minlength=n)[:n]


def check_closed(scene):
    """Each directed edge of an object occurs as often as its reverse."""
    edges = Counter()
    for one, corners in zip(scene.object_of_face.tolist(), world(scene).tolist()):
        for k in range(3):
            a, b = tuple(corners[k]), tuple(corners[(k + 1) % 3])
            edges[one, a, b] += 1
            edges[one, b, a] -= 1
    assert not any(edges.values())


def test_solids_are_closed_and_have_the_volume_of_prisms():
    scene = at.from_footprints(buildings())
    check_closed(scene)
    np.testing.assert_allclose(volumes(scene, 3), AREAS * HEIGHTS, rtol=1e-5)
    assert scene.bounds[:, 2].tolist() == [0.0, 8.0] and scene.up == "z" and scene.crs == CRS and scene.raster is None
    points = [[100005, 449989, 1.0], [100007, 449991, 1.0], [100001.5, 449998, 7.9], [100002.5, 449998, 1.0]]
    assert scene.contains(points).tolist() == [True, False, True, False]


def test_orientation_closing_corners_and_straight_corners_do_not_matter():
    turned = buildings()
    turned["geometry"] = [shapely.reverse(shapely.segmentize(shape, 0.5)) for shape in turned.geometry]
    scene, plain = at.from_footprints(turned), at.from_footprints(buildings())
    assert scene.n_triangles == plain.n_triangles
    check_closed(scene)
    np.testing.assert_allclose(volumes(scene, 3), AREAS * HEIGHTS, rtol=1e-5)


@examples(30)
@given(st.integers(0, 10_000), st.integers(3, 12))
def test_stars_are_closed(seed, corners):
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0.0, 2.0 * np.pi, corners))
    ring = random.uniform(1.0, 9.0, corners)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    shape = shapely.Polygon(ring + [100000.0, 450000.0])
    if not shape.is_valid or shape.area < 1e-3:
        return
    scene = at.from_footprints(geopandas.GeoDataFrame({"height": [4.0]}, geometry=[shape]))
    check_closed(scene)
    np.testing.assert_allclose(volumes(scene, 1), 4.0 * shape.area, rtol=1e-3)


def test_surfaces_keep_their_types_and_buildings_their_attributes():
    scene = at.from_footprints(buildings())
    city = scene.city
    assert [(each.name, each.type) for each in scene.objects] == [(name, "Building") for name in "abc"]
    assert city.objects == ["a", "b", "c"] and [row["use"] for row in city.attributes] == ["home", "shop", "shed"]
    counts = Counter((surface.object, surface.type) for surface in city.surfaces)
    walls = {0: 8, 1: 6, 2: 8}
    parts = {0: 1, 1: 1, 2: 2}
    assert counts == {
        (k, kind): n[k]
        for k in range(3)
        for kind, n in (("WallSurface", walls), ("RoofSurface", parts), ("GroundSurface", parts))
    }
    corners = world(scene)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kinds = city.surface_types(np.arange(scene.n_triangles))
    up = normals[:, 2] / np.linalg.norm(normals, axis=1)
    expected = {"RoofSurface": 1.0, "WallSurface": 0.0, "GroundSurface": -1.0}
    np.testing.assert_allclose(up, [expected[kind] for kind in kinds], atol=1e-6)
    assert (city.object_of_face == scene.object_of_face).all()
    for surface in np.unique(city.surface_of_face):
        faces = city.surface_of_face == surface
        unit = normals[faces] / np.linalg.norm(normals[faces], axis=1, keepdims=True)
        np.testing.assert_allclose(unit, unit[:1].repeat(len(unit), 0), atol=1e-5)
    assert [s.semantic for s in city.surfaces if s.object == 2] == list(range(12))


def test_heights_and_bases_are_columns_numbers_or_arrays():
    table = buildings(h=[1.0, 2.0, 4.0], floor=[10.0, 20.0, 30.0])
    assert at.from_footprints(table, "h", "floor").bounds[:, 2].tolist() == [10.0, 34.0]
    assert at.from_footprints(table, 7, -1).bounds[:, 2].tolist() == [-1.0, 6.0]
    assert at.from_footprints(table, [1.0, 1.0, 9.0], np.zeros(3)).bounds[1, 2] == 9.0
    texts = buildings(height=["3", "4.5", "6"])
    assert at.from_footprints(texts).bounds[1, 2] == 6.0


# --- Terrain ----------------------------------------------------------------------------------------------------------


def grid_of(heights):
    return HeightGrid("dem", GridPoints(0.0, 0.0, 1.0, 1.0, *heights.shape), None, heights)


@examples(60)
@given(st.integers(0, 100_000))
def test_the_base_is_the_lowest_terrain_under_a_footprint(seed):
    random = np.random.default_rng(seed)
    grid = grid_of(random.integers(0, 8, (9, 9)).astype(float))
    angle = np.sort(random.uniform(0.0, 2.0 * np.pi, random.integers(3, 8)))
    radius = random.uniform(0.2, 3.5, len(angle))
    shape = shapely.Polygon(np.stack([4.0 + radius * np.cos(angle), -4.0 + radius * np.sin(angle)], 1))
    if not shape.is_valid or shape.area < 0.05:
        return
    table = geopandas.GeoDataFrame({"height": [1.0]}, geometry=[shape])
    (lowest,) = lowest_under(grid, read_footprints(table, FootprintOptions()).rings)
    steps = np.linspace(0.0, 8.0, 161)
    x, y = (axis.ravel() for axis in np.meshgrid(steps, -steps))
    inside = shapely.covers(shape, shapely.points(x, y))
    around = shapely.get_coordinates(shapely.segmentize(shape.exterior, 0.01))
    samples = np.concatenate([grid.at_cells(x[inside], -y[inside]), grid.at_cells(around[:, 0], -around[:, 1])])
    assert lowest <= samples.min() + 1e-9
    assert samples.min() - lowest < 0.3  # no sample is farther than 0.05 from the minimum, on slopes of 8 at most


def test_on_a_plane_the_base_is_that_of_the_lowest_corner():
    i, j = np.mgrid[:40, :40]
    scene = at.from_footprints(buildings(), terrain=(0.5 * j + 0.25 * i, PLACE, CRS))
    x, y = np.array([100004.0, 100011.0, 100001.0]), np.array([449994.0, 449999.0, 449999.0])
    expected = 0.5 * (x - 100001.0) / 2.0 + 0.25 * (449999.0 - y) / 2.0
    corners = world(scene)
    for k in range(3):
        heights = corners[scene.object_of_face == k][..., 2]
        np.testing.assert_allclose([heights.min(), heights.max()], expected[k] + [0.0, HEIGHTS[k]], atol=1e-5)


def test_buildings_on_terrain_are_one_scene():
    dem = hills(20, 20), PLACE, CRS
    scene = at.from_footprints(buildings(), terrain=dem)
    alone, ground = at.from_footprints(buildings(), base=dem), at.from_raster(dem)
    assert (scene.triangles().vertices == alone.triangles().vertices).all()
    assert scene.raster == ground.raster and scene.n_triangles > ground.n_triangles
    *houses, terrain = scene.objects
    assert [each.type for each in houses] == ["Building"] * 3 and terrain.type == "TINRelief"
    assert scene.city.types[-1] == "TINRelief" and (scene.city.object_of_face == scene.object_of_face).all()
    last = scene.object_of_face == 3
    assert last.sum() == ground.n_triangles and set(scene.city.surface_types(np.flatnonzero(last))) == {""}
    np.testing.assert_allclose(world(scene)[last], world(ground), atol=1e-5)
    lower = world(scene)[scene.city.surface_types(np.arange(scene.n_triangles)) == "GroundSurface"][..., 2]
    corners = world(scene)[scene.city.surface_types(np.arange(scene.n_triangles)) == "GroundSurface"].reshape(-1, 3)
    above = ground.closest_hit(corners + [0.0, 0.0, 99.0], (0.0, 0.0, -1.0))
    assert above.mask.all() and (99.0 - above.t >= -1e-4).all() and len(lower)


def test_footprints_off_the_terrain_are_named_or_left_out():
    dem = np.full((10, 10), 5.0), PLACE, CRS
    table = buildings()
    table.loc[1, "geometry"] = shapely.box(200000, 449990, 200005, 449995)
    with pytest.raises(InputError, match="footprint 'b' lies off the heights of terrain"):
        at.from_footprints(table, terrain=dem)
    with pytest.warns(UserWarning, match="left out 1 footprint off the heights of the terrain"):
        scene = at.from_footprints(table, terrain=dem, invalid="skip")
    assert [each.name for each in scene.objects] == ["a", "c", "terrain"]
    assert [row.get("use") for row in scene.city.attributes] == ["home", "shed", None]
    uses = scene.city.object_attribute("use", np.arange(scene.n_triangles))
    assert set(uses) == {"home", "shed", ""} and (uses[scene.city.object_of_face == 1] == "shed").all()
    np.testing.assert_allclose(volumes(scene, 2), (AREAS * HEIGHTS)[[0, 2]], rtol=1e-4)


# --- Files, CRS and faults --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_files_give_the_same_solids(suffix, tmp_path):
    path = write_buildings(tmp_path / f"b{suffix}")
    scene, table = at.load(path), at.from_footprints(buildings())
    assert sorted(volumes(scene, 3)) == pytest.approx(sorted(volumes(table, 3)))
    assert scene.crs == CRS and scene.name == "b"
    assert sorted(each.name for each in scene.objects) == ["a", "b", "c"]


def test_layers_are_chosen_by_name(tmp_path):
    path = tmp_path / "b.gpkg"
    buildings().to_file(path, layer="houses", driver="GPKG")
    points = geopandas.GeoDataFrame({"height": [1.0]}, geometry=[shapely.Point(0, 0)], crs=CRS)
    points.to_file(path, layer="trees", driver="GPKG")
    assert at.load(path).n_triangles == at.from_footprints(path, layer="houses").n_triangles
    buildings().to_file(path, layer="sheds", driver="GPKG")
    with pytest.raises(InputError, match="has the layers houses, trees, sheds; name the one"):
        at.load(path)
    with pytest.raises(InputError, match="no layer 'shed'; did you mean 'sheds'"):
        at.from_footprints(path, layer="shed")
    with pytest.raises(InputError, match="'0' is no polygon"):
        at.from_footprints(path, layer="trees")


def test_footprints_in_degrees_are_projected_to_the_crs_of_the_scene():
    degrees, plain = buildings().to_crs("EPSG:4326"), at.from_footprints(buildings())
    with pytest.raises(InputError, match="EPSG:4326, is in degrees; project it: crs='EPSG:32"):
        at.from_footprints(degrees)
    scene = at.from_footprints(degrees, crs=CRS)
    assert scene.crs == CRS
    np.testing.assert_allclose(scene.bounds, plain.bounds, atol=1e-3)
    on_ground = at.from_footprints(degrees, terrain=(np.zeros((10, 10)), PLACE, CRS))
    np.testing.assert_allclose(volumes(on_ground, 3), AREAS * HEIGHTS, rtol=1e-3)


def test_differing_crs_are_refused_by_name():
    with pytest.raises(InputError, match="its CRS is EPSG:28992, and the scene's is EPSG:32631; reproject one"):
        at.from_footprints(buildings(), terrain=(np.zeros((10, 10)), PLACE, "EPSG:32631"))
    with pytest.raises(InputError, match="its CRS is EPSG:28992, and the scene's is EPSG:25831"):
        at.from_footprints(buildings(), crs="EPSG:25831")


def faulty(**changes):
    table = buildings()
    for name, value in changes.items():
        table.loc[1, name] = value
    return table


BOW = shapely.Polygon([(0, 0), (2, 2), (2, 0), (0, 2)])


@pytest.mark.parametrize(
    "table, words",
    [
        (faulty(geometry=BOW), r"'b' is invalid \(Self-intersection\[1 1\]\)"),
        (faulty(geometry=shapely.Polygon([(0, 0), (1, 1), (2, 2)])), "'b' has no area"),
        (faulty(geometry=shapely.Polygon()), "'b' has no geometry"),
        (faulty(geometry=None), "'b' has no geometry"),
        (faulty(geometry=shapely.LineString([(0, 0), (1, 1)])), "'b' is no polygon"),
        (faulty(height=np.nan), "'b' has no height"),
        (faulty(height=0.0), "'b' has a height of 0 or less"),
        (faulty(height=-3.0), "'b' has a height of 0 or less"),
        (buildings(height=["3", None, "8"]), "'b' has no height"),
    ],
)
def test_faulty_footprints_are_named_or_left_out_and_counted(table, words):
    with pytest.raises(InputError, match=f"footprint {words}; repair it, or leave such footprints out") as caught:
        at.from_footprints(table)
    assert "\n" not in str(caught.value)
    with pytest.warns(UserWarning, match="left out 1 footprint; the first, " + words.replace("'b' ", "'b', ")):
        scene = at.from_footprints(table, invalid="skip")
    assert [each.name for each in scene.objects] == ["a", "c"]
    check_closed(scene)


@pytest.mark.parametrize(
    "table, options, words",
    [
        (buildings().drop(columns="height"), {}, "no column 'height' for height; it has no numbers"),
        (buildings(h=[1.0, 2.0, 3.0]), {"height": "hh"}, "no column 'hh' for height; did you mean 'h'"),
        (buildings(), {"base": "floor"}, "no column 'floor' for base"),
        (buildings(), {"base": None}, "base is None"),
        (buildings(), {"height": [1.0, 2.0]}, "height must be a column, a number, or 3 numbers"),
        (buildings(), {"id": "name"}, "no column 'name' for id"),
        (buildings(), {"invalid": "drop"}, "invalid"),
        (buildings()[:0], {}, "has no footprints"),
        (
            buildings(height=[np.nan] * 3),
            {"invalid": "skip"},
            "no footprint is valid; the first one, 'a', has no height",
        ),
        ("missing.gpkg", {}, "missing.gpkg"),
        ("houses.dwg", {}, "houses.dwg"),
        (3, {}, "footprints are 3"),
    ],
)
def test_refusals_name_the_thing_and_the_cure(table, options, words):
    with pytest.raises(InputError, match=words) as caught:
        at.from_footprints(table, **options)
    assert "\n" not in str(caught.value)


def test_stores_hold_buildings_and_their_raster(tmp_path):
    scene = at.from_footprints(buildings(), terrain=(hills(10, 10), PLACE, CRS))
    at.build_store(scene, tmp_path / "a.antumbra")
    store = at.load(tmp_path / "a.antumbra")
    assert store.raster == scene.raster and store.n_triangles == scene.n_triangles
    assert store.crs == gis_files.CRS
