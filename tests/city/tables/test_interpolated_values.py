"""Values between sensors: exact at them, linear between them, and apart on surfaces that lie beside each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import antumbra as at
from antumbra.city.sensors.sensors import corners_of
from antumbra.city.tables.interpolated_values import Places, smooth_cells, spacing_of, values_on_surfaces
from strength import examples

FLOOR = np.array([[[0.0, 0, 0], [9, 0, 0], [9, 9, 0]], [[0, 0, 0], [9, 9, 0], [0, 9, 0]]])


def floor_and(*more, up="z"):
    corners = np.concatenate([FLOOR, *more])
    if up == "y":
        corners = np.stack([corners[..., 0], corners[..., 2], -corners[..., 1]], -1)
    return at.Scene.from_arrays(corners, up=up)


def shown(scene, sensors, values, points, normals, faces, smooth=True):
    places = Places(np.asarray(points, float), np.broadcast_to(normals, np.shape(points)), np.asarray(faces))
    return values_on_surfaces(sensors, np.asarray(values, float), places, corners_of(scene), scene.up, smooth)


def faces_at(x, y):
    return np.where(y > x, 1, 0)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("lift", [0.0, 0.05])
def test_values_on_a_lattice_are_exact_at_sensors_and_bilinear_between_them(up, lift):
    scene = floor_and(up=up)
    sensors = at.grid_sensors(scene, 0.5, lift=lift)
    east, north = sensors.points[:, 0], sensors.points[:, 1] if up == "z" else -sensors.points[:, 2]
    values = 3.0 * east - 2.0 * north + east * north  # bilinear
    x, y = np.random.default_rng(3).uniform(1.0, 8.0, (2, 500))
    flat = [x, y, 0 * x] if up == "z" else [x, 0 * x, -y]
    normal = (0, 0, 1) if up == "z" else (0, 1, 0)
    found = shown(scene, sensors, values, np.stack(flat, 1), normal, faces_at(x, y))
    inner = np.floor((x - 0.5 * (0.5 + 2**-7)) / 0.5), np.floor((y - 0.5 * (0.5 + 2**-7)) / 0.5)
    assert len({*zip(*inner)}) > 100
    np.testing.assert_allclose(found, 3.0 * x - 2.0 * y + x * y, atol=0.1)  # bilinear in each cell
    foot = sensors.points - lift * np.array(normal)
    np.testing.assert_allclose(shown(scene, sensors, values, foot, normal, sensors.faces), values, atol=1e-9)
    nearest = shown(scene, sensors, values, np.stack(flat, 1), normal, faces_at(x, y), smooth=False)
    away = np.hypot(x[:, None] - east, y[:, None] - north)
    np.testing.assert_array_equal(nearest, values[away.argmin(1)])


def test_a_kerb_a_wall_and_its_other_side_keep_their_own_values():
    kerb = FLOOR + (0, 0, 0.15)
    wall = FLOOR[..., [0, 2, 1]] + (0, 9, 0)
    scene = floor_and(kerb, wall, wall[:, ::-1])
    sensors = at.grid_sensors(scene, 1.0)
    values = (sensors.faces // 2).astype(float)
    for k, normal in enumerate([(0, 0, 1), (0, 0, 1), (0, -1, 0), (0, 1, 0)]):
        on = sensors.faces // 2 == k
        points = sensors.points[on] + (0.21, 0.0 if k > 1 else 0.13, 0.13 if k > 1 else 0.0)
        assert on.sum() > 50 and sensors.normals[on][0] @ normal in (-1.0, 1.0)
        found = shown(scene, sensors, values, points, sensors.normals[on], sensors.faces[on])
        assert (found == k).all()


def test_small_faces_have_the_value_of_their_only_sensor_and_left_out_ones_none():
    leaf = np.array([[[4.0, 4, 1], [4.2, 4, 1], [4, 4.2, 1]]])
    scene = floor_and(leaf)
    sensors = at.grid_sensors(scene, 1.0)
    assert spacing_of(sensors) == 1.0 and (sensors.faces == 2).sum() == 1
    values = np.where(sensors.faces == 2, 7.0, 1.0)
    assert shown(scene, sensors, values, [[4.05, 4.05, 1.0]], (0, 0, 1), [2]) == 7.0
    kept = sensors.faces < 2
    part = at.Sensors(sensors.points[kept], sensors.normals[kept], sensors.areas[kept], sensors.faces[kept], "grid")
    found = shown(scene, part, values[kept], [[4.05, 4.05, 1.0], [4, 3, 0]], (0, 0, 1), [2, 0])
    assert np.isnan(found[0]) and found[1] == 1.0


def test_places_beside_all_sensors_of_a_strip_have_the_value_of_one():
    strip = np.array([[[0.0, 0, 5], [40, 0, 5], [40, 0.3, 5]]])
    scene = floor_and(strip)
    sensors = at.grid_sensors(scene, 1.0)
    values = np.where(sensors.faces == 2, 7.0, 1.0)
    found = shown(scene, sensors, values, [[0.5, 0.001, 5.0], [20, 0.1, 5], [39.9, 0.2, 5]], (0, 0, 1), [2, 2, 2])
    assert (found == 7.0).all()


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("half", [1.0, 3.0])
def test_places_nearest_to_sensors_without_a_value_have_none(smooth, half):
    """However far the next sensor with a value is."""
    scene = floor_and()
    sensors = at.grid_sensors(scene, 1.0)
    hole = (np.abs(sensors.points[:, :2] - 4.5) < half).all(1)
    values = np.where(hole, np.nan, sensors.points[:, 0])
    at_sensors = shown(scene, sensors, values, sensors.points, (0, 0, 1), sensors.faces, smooth)
    assert 0 < hole.sum() < len(hole) and np.array_equal(np.isnan(at_sensors), hole)
    np.testing.assert_allclose(at_sensors[~hole], values[~hole], atol=1e-9)
    x, y = np.random.default_rng(5).uniform(0.6, 8.4, (2, 500))
    found = shown(scene, sensors, values, np.stack([x, y, 0 * x], 1), (0, 0, 1), faces_at(x, y), smooth)
    away = np.abs(np.stack([x, y], 1)[:, None] - sensors.points[:, :2]).max(2)
    inside = np.sort(away, 1)[:, 0] < 0.45  # nearer to one sensor than to any other
    assert inside.sum() > 300 and (np.isnan(found) == hole[away.argmin(1)])[inside].all()


def test_sensors_may_be_given_twice_lie_on_no_face_or_lack_normals_and_areas():
    scene = floor_and()
    sensors = at.grid_sensors(scene, 1.0)
    on_faces = sensors.points, (0, 0, 1), sensors.faces
    twice = at.Sensors(*(np.concatenate([each, each[:9]]) for each in sensors_fields(sensors)), "grid")
    values = sensors.points[:, 0] - sensors.points[:, 1]
    assert spacing_of(at.Sensors(*(each[[0, 0]] for each in sensors_fields(sensors)), "grid")) > 0.0
    both = np.concatenate([values, values[:9]])
    np.testing.assert_allclose(shown(scene, twice, both, *on_faces), values, atol=1e-9)
    bare = at.Sensors(sensors.points, None, None, sensors.faces, "grid")
    assert np.array_equal(shown(scene, bare, values, *on_faces), values)
    wall = FLOOR[..., [0, 2, 1]] + (0, 9, 0)
    with_wall = floor_and(wall)
    faces = np.where(sensors.faces == 1, -1, 0)
    part = at.Sensors(sensors.points, sensors.normals, sensors.areas, faces, "grid")
    found = shown(with_wall, part, values, [[8, 1, 0], [1, 8, 0], [1, 9, 8]], (0, 0, 1), [0, 1, 3])
    assert np.isfinite(found).tolist() == [True, False, False]
    none = at.Sensors(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0, int), "grid")
    assert np.isnan(shown(scene, none, [], *on_faces)).all()


def sensors_fields(sensors):
    return sensors.points, sensors.normals, sensors.areas, sensors.faces


def test_values_of_vertices_are_interpolated_in_their_face():
    scene = floor_and()
    sensors = at.vertex_sensors(scene)
    values = 2.0 * sensors.points[:, 0] + sensors.points[:, 1]
    x, y = np.random.default_rng(4).uniform(0.0, 9.0, (2, 100))
    points = np.stack([x, y, 0 * x], 1)
    found = shown(scene, sensors, values, points, (0, 0, 1), faces_at(x, y))
    np.testing.assert_allclose(found, 2.0 * x + y, atol=1e-9)
    one = shown(scene, sensors, values, points, (0, 0, 1), faces_at(x, y), smooth=False)
    assert set(one) <= set(values) and len(set(one)) > 2


def test_faces_have_one_value_each():
    scene = floor_and()
    found = shown(scene, at.face_sensors(scene), [3.0, 4.0], [[5, 1, 0], [1, 5, 0]], (0, 0, 1), [0, 1])
    assert found.tolist() == [3.0, 4.0]


# --- Smooth rasters ---------------------------------------------------------------------------------------------------


@examples(40)
@given(
    cells=hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.floats(-10, 10)),
    holes=st.integers(0, 2**36 - 1),
    parts=st.integers(1, 5),
)
def test_smooth_cells_stay_between_their_neighbours_and_holes_stay(cells, holes, parts):
    cells.ravel()[[k for k in range(cells.size) if holes >> k & 1]] = np.nan
    smooth = smooth_cells(cells, parts)
    assert smooth.shape == (cells.shape[0] * parts, cells.shape[1] * parts)
    assert (np.isnan(smooth) == np.isnan(cells).repeat(parts, 0).repeat(parts, 1)).all()
    if np.isfinite(cells).any():
        inside = smooth[np.isfinite(smooth)]
        assert inside.min() >= np.nanmin(cells) and inside.max() <= np.nanmax(cells)


def test_smooth_cells_have_the_values_of_cells_at_their_centres_and_are_linear():
    cells = np.add.outer(np.arange(4.0), 10.0 * np.arange(5.0))
    smooth = smooth_cells(cells, 3)
    assert np.allclose(smooth[1::3, 1::3], cells)
    assert np.allclose(np.diff(smooth[1:-1], axis=0), 1 / 3) and np.allclose(np.diff(smooth[:, 1:-1], axis=1), 10 / 3)
