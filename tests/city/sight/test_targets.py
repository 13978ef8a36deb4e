"""The visible share of targets, and viewsheds from points along lines: closed forms and brute force."""

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.crs import reproject
from gis_files import buildings

PLACE = (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)


def walled(height=10.0, columns=60, rows=15):
    """A flat raster with a wall along column 20."""
    heights = np.zeros((rows, columns))
    heights[:, 20] = height
    return at.from_raster((heights, PLACE))


def test_the_visible_share_of_a_rotor_is_that_of_a_disk():
    """Behind a wall, the visible part of a far rotor is the segment of a disk above the line over the wall."""
    scene = walled(rows=201)
    foot, hub, radius = (88041.0, 445799.0, 0.0), 60.0, 40.0  # 4 km east of the wall
    turbine = at.Turbine(foot, hub, 2.0 * radius)
    eyes = np.array([[84041.0 - x, 445799.0, 1.0] for x in (500.0, 300.0, 200.0, 140.0, 100.0)])
    table = at.visible_share(scene, eyes, turbine, samples=1024)
    x = 84041.0 - eyes[:, 0]
    line = 1.0 + 9.0 * (4000.0 + x) / x  # height over the foot from which the rotor is seen
    s = np.clip((line - hub) / radius, -1.0, 1.0)
    expected = (np.arccos(s) - s * np.sqrt(1.0 - s * s)) / np.pi
    assert expected[-1] == 0.0 or expected[-1] < 0.05
    assert np.abs(table["share"] - expected).max() < 0.01 and (np.diff(table["share"]) <= 0.0).all()
    assert (table["visible"] == np.round(table["share"] * 1024)).all() and table.about["samples"] == 1024


def test_the_visible_share_of_points_is_counted():
    scene = at.from_raster((np.random.default_rng(0).integers(0, 40, (20, 25)) / 4.0, PLACE))
    target = np.random.default_rng(1).uniform(*scene.bounds, (70, 3)) + [0.0, 0.0, 5.0]
    table = at.visible_share(scene, "raster+1.6", target)
    cells = at.sensors_of("raster+1.6", scene)
    matrix = at.visibility_matrix(scene, cells, target)
    assert (table["visible"] == matrix.counts).all() and table["visible"].min() + table["visible"].max() > 0
    assert np.allclose(table["share"], matrix.counts / 70.0) and len(np.unique(table["visible"])) > 10


def test_a_polygon_is_seen_from_its_front():
    scene = walled(0.0)
    corners = [(84041.0, 445990.0, 1.0), (84041.0, 445980.0, 1.0), (84041.0, 445980.0, 5.0), (84041.0, 445990.0, 5.0)]
    target = at.polygon_points(corners, 0.5)
    assert len(target) == 160 and np.allclose(target.normals, [-1.0, 0.0, 0.0]) and np.isclose(target.areas.sum(), 40.0)
    share = at.visible_share(scene, [[84010.0, 445985.0, 2.0], [84080.0, 445985.0, 2.0]], target)["share"]
    assert share.tolist() == [1.0, 0.0]


def test_the_points_of_a_concave_polygon_lie_in_it():
    ring = np.array([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], float)
    target = at.polygon_points(np.column_stack([ring, np.zeros(5)]), 0.05)
    x, y = target.points[:, :2].T
    assert (y <= 1.0 + 1.5 * abs(x - 2.0) + 1e-9).all() and (y >= 0.0).all() and np.isclose(target.areas.sum(), 10.0)
    assert len(target) * 0.05**2 == pytest.approx(10.0, rel=0.02)
    assert np.allclose(target.normals, [0.0, 0.0, 1.0])


def test_a_facade_of_a_scene_is_a_target():
    pytest.importorskip("geopandas")
    scene = at.from_footprints(buildings())  # "a" is 6 x 6 with a courtyard of 2 x 2, and 3 high
    target = at.surface_points(scene, 0.5, objects="a", types="WallSurface")
    assert np.isclose(target.areas.sum(), 3.0 * (24.0 + 8.0)) and np.allclose(target.normals[:, 2], 0.0)
    every = at.surface_points(scene, 0.5, objects=["a"])
    assert np.isclose(every.areas.sum(), 96.0 + 2.0 * 32.0)
    south = at.visible_share(scene, [[100007.0, 449900.0, 1.5]], target)["visible"]
    assert south[0] == 6 * 12  # one outer wall; the courtyard is hidden


def test_lines_are_divided_evenly():
    line = at.points_along([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0)], 2.0)
    assert np.isclose(line.lengths.sum(), 15.0) and len(line.lengths) == 8 and (line.lengths == 1.875).all()
    assert np.allclose(line.points[0], [0.9375, 0.0, 0.0]) and np.allclose(line.points[-1], [10.0, 5.0 - 0.9375, 0.0])
    slope = at.points_along([[(0, 0, 0), (4, 0, 8)], np.array([(0.0, 9.0, 1.0), (0.0, 9.5, 1.0)])], 2.0)
    assert slope.points[:2, 2].tolist() == [2.0, 6.0] and slope.lengths.tolist() == [2.0, 2.0, 0.5]


def test_lines_are_read_from_files(tmp_path):
    geopandas, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    shapes = [shapely.LineString([(0, 0), (10, 0)]), shapely.MultiLineString([[(0, 5), (4, 5)], [(9, 9), (9, 11)]])]
    geopandas.GeoDataFrame(geometry=shapes, crs="EPSG:28992").to_file(tmp_path / "roads.gpkg")
    road = at.points_along(tmp_path / "roads.gpkg", 1.0, crs="EPSG:28992")
    assert len(road.points) == 16 and road.lengths.sum() == 16.0
    moved = at.points_along(tmp_path / "roads.gpkg", 1.0, crs="EPSG:32631")
    assert abs(moved.lengths.sum() - 16.0) < 0.1 and np.allclose(
        reproject(moved.points[:, :2], "EPSG:32631", "EPSG:28992")[0], [0.5, 0.0], atol=0.01
    )
    (tmp_path / "road.csv").write_text("x,y\n0,0\n10,0\n")
    assert (at.points_along(tmp_path / "road.csv", 1.0).points == road.points[:10]).all()


def test_lines_run_along_the_ground_with_y_up(tmp_path):
    line = np.array([(0.0, 0.0, 1.0), (10.0, 0.0, 2.0), (10.0, 5.0, 2.0)])
    turned = line[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    level, upright = at.points_along(line, 2.0), at.points_along(turned, 2.0, up="y")
    assert np.array_equal(upright.points, level.points[:, [0, 2, 1]] * [1.0, 1.0, -1.0])
    assert np.array_equal(upright.lengths, level.lengths) and level.lengths.sum() == 15.0
    rows = "".join(f"{x},{y},{z}\n" for x, y, z in turned.tolist())
    (tmp_path / "road.csv").write_text("x,y,z\n" + rows)
    assert np.array_equal(at.points_along(tmp_path / "road.csv", 2.0, up="y").points, upright.points)


def test_a_viewshed_from_a_line_sums_its_length():
    scene = walled()
    road = at.points_along([(84003.0, 445995.0), (84117.0, 445995.0)], 1.0)
    table = at.viewshed(scene, "raster+0.5", road, on_surface=True, eye_height=1.5).table
    single = at.viewshed(scene, "raster+0.5", road.points, on_surface=True, eye_height=1.5, bits=True)
    bits = np.unpackbits(single.bits.view(np.uint8), axis=1, bitorder="little")[:, : len(road.points)]
    assert np.allclose(table["length"], bits @ road.lengths) and (table["seen"] == single.table["seen"]).all()
    assert "length" not in single.table.columns and 0.0 < table["length"].min() < 100.0


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: at.Turbine((0, 0), 10, 5), "position"),
        (lambda: at.Turbine((0, 0, 0), -1, 5), "hub height"),
        (lambda: at.polygon_points([(0, 0, 0), (1, 0, 0)], 1.0), "three or more"),
        (lambda: at.polygon_points([(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 0)], 1.0), "plane"),
        (lambda: at.polygon_points([(0, 0, 0), (1, 0, 0), (0, 1, 0)], 9.0), "smaller spacing"),
        (lambda: at.points_along([(0, 0)], 1.0), "two or more"),
        (lambda: at.points_along([(0, 0), (0, 0)], 1.0), "no length"),
        (lambda: at.points_along([(0, 0), (1e9, 0)], 1.0), "widen"),
        (lambda: at.visible_share(walled(), "raster", np.empty((0, 3))), "no points"),
        (lambda: at.surface_points(walled(), 5.0, objects="tower"), "no surface"),
        (lambda: at.surface_points(walled(), 5.0, types="WallSurface"), "semantic"),
    ],
)
def test_bad_input(call, words):
    with pytest.raises(at.InputError, match=words):
        call()
