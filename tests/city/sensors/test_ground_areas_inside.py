"""Points inside solids: unions of boxes as the truth, and the faults of real models."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.ground_areas import below_roofs, covered_by_solids, inside_solids
from city_files import CUBE, CUBE_FACES

FACES = np.array([corners for a, b, c, d in CUBE_FACES for corners in ([a, b, c], [a, c, d])])
FLOOR = 2  # triangles at the beginning of `FACES`


def boxes(lower, size):
    """(12 n, 3, 3): triangles of boxes, outwards."""
    corners = np.asarray(lower, float)[:, None] + CUBE * np.asarray(size, float)[:, None]
    return corners[:, FACES].reshape(-1, 3, 3)


def scene_of(triangles, up="z"):
    turned = triangles if up == "z" else triangles[..., [0, 2, 1]] * [1, 1, -1]
    return at.Scene.from_arrays(turned, up=up)


def found(triangles, points, up="z", by=inside_solids):
    points = np.asarray(points, float)
    return by(scene_of(triangles, up), points if up == "z" else points[:, [0, 2, 1]] * [1, 1, -1])


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_union_of_boxes(up):
    rng = np.random.default_rng(4)
    lower, size = rng.integers(-6, 6, (40, 3)), rng.integers(1, 4, (40, 3))  # many overlap, and share walls
    points = rng.uniform(-6, 9, (2000, 3))
    wanted = ((points[:, None] > lower) & (points[:, None] < lower + size)).all(2).any(1)
    assert 100 < wanted.sum() < 1900
    np.testing.assert_array_equal(found(boxes(lower, size), points, up), wanted)


def test_on_the_ground_of_a_town():
    grid = np.array([[x, y, 0] for x in range(0, 40, 8) for y in range(0, 40, 8)])
    ground = [[[-5, -5, 0], [45, -5, 0], [45, 45, 0]], [[-5, -5, 0], [45, 45, 0], [-5, 45, 0]]]
    town = np.concatenate([ground, boxes(grid, np.full((25, 3), 4))])
    x, y = (np.indices((90, 90)).reshape(2, -1) + 0.5) / 2.0 - 2.5
    wanted = (x % 8 < 4) & (y % 8 < 4) & (x > 0) & (y > 0) & (x < 36) & (y < 36)
    np.testing.assert_array_equal(found(town, np.stack([x, y, 0 * x], 1), by=covered_by_solids), wanted)
    assert wanted.sum() == 25 * 64


@pytest.mark.parametrize("height", [-0.5, -0.01, 0.0, 0.01, 0.5])
def test_floors_beside_the_ground(height):
    """A cell of the ground below a house is no garden, whether the floor lies a little above or below the ground."""
    ground = [[[-9, -9, 0], [9, -9, 0], [0, 9, 0]]]
    house = np.concatenate([ground, boxes([[-1, -1, height]], [[2, 2, 3]])])
    points = [[0, 0, min(0.0, height)], [2, 0, 0]]
    assert found(house, points, by=covered_by_solids).tolist() == [True, False]


def test_missing_floors_and_other_faults():
    house = boxes([[0, 0, 0]], [[4, 4, 4]])
    points = [[2, 2, 1], [6, 2, 1], [2, 2, 5]]
    wanted = [True, False, False]
    assert found(house[FLOOR:], points).tolist() == wanted
    assert found(house[:, ::-1], points).tolist() == wanted  # inside out
    hill = [[[-30, -30, -1], [30, -30, -1], [0, 30, 8]]]  # the points lie below it, and above nothing
    assert found(np.concatenate([hill, house + [0, 0, 40]]), np.array(points) + [0, 0, 40]).tolist() == wanted
    roof = [[[0, 0, 3], [4, 0, 3], [4, 4, 3]], [[0, 0, 3], [4, 4, 3], [0, 4, 3]]]  # of a carport
    assert not found(np.array(roof, float), [[2, 2, 1]]).any()
    yard = boxes(
        [[-9, -9, 0], [7, -9, 0], [-7, 7, 0], [-7, -9, 0]], [[2, 18, 30], [2, 18, 30], [14, 2, 30], [14, 2, 30]]
    )
    assert found(yard, [[0, 0, 0.1], [-8, 0, 0.1]]).tolist() == [False, True]


@pytest.mark.parametrize("up", ["y", "z"])
def test_roofs_of_buildings_without_floor_and_ground(up):
    """A gable over walls, and a hillside with a house: roofs are found at all of their points, the hill at none."""
    gable = np.array([[0, 0, 0], [10, 0, 0], [10, 8, 0], [0, 8, 0], [0, 4, 3], [10, 4, 3]]) + [0, 0, 3]
    sides = [[0, 1, 5], [0, 5, 4], [2, 3, 4], [2, 4, 5], [1, 2, 5], [3, 0, 4]]
    walls = boxes([[0, 0, 0]], [[10, 8, 3]])[2 * FLOOR :]
    house = np.concatenate([gable[sides], walls])
    hill = np.array([[[-80, -80, -30], [80, -80, -30], [80, 80, 30]], [[-80, -80, -30], [80, 80, 30], [-80, 80, 30]]])
    scene = scene_of(np.concatenate([house + [0, 0, 12], hill]), up)
    x, y = (np.indices((9, 7)).reshape(2, -1) + [[0.7], [0.6]]).astype(float)
    roof = np.stack([x, y, 15 + 0.75 * np.minimum(y, 8 - y)], 1)
    slope = np.stack([x - 30, y + 20, 0.375 * (y + 20)], 1)
    points = np.concatenate([roof, slope])
    turned = points if up == "z" else points[:, [0, 2, 1]] * [1, 1, -1]
    found = below_roofs(scene, turned, np.full(len(points), -30.0))
    assert found.tolist() == [True] * len(roof) + [False] * len(slope)


def test_a_store_has_the_insides_of_its_scene(tmp_path):
    scene = scene_of(boxes([[0, 0, 0], [9, 2, 0]], [[4, 4, 4], [3, 3, 5]]))
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    points = np.random.default_rng(0).uniform(-1, 13, (300, 3)) * (1, 0.6, 0.5)
    inside = inside_solids(scene, points)
    assert 20 < inside.sum() < 280
    np.testing.assert_array_equal(inside_solids(at.load(tmp_path / "a.antumbra"), points), inside)
