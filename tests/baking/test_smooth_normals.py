"""Normals of vertices from the faces around them, also where faces lie on others that face the opposite way."""

import numpy as np
import pytest

from antumbra.baking.smooth_normals import smooth_normals
from double_rooms import ORDERS, OUTSIDE, TURNS, double_room, single_room


def _units(corners):
    """(f, 3, 3): the unit normals at the corners of faces, (f, 3, 3), whose vertices are not shared."""
    points = corners.reshape(-1, 3)
    normals = smooth_normals(points, np.arange(len(points)).reshape(-1, 3), points)
    return (normals / np.linalg.norm(normals, axis=1, keepdims=True)).reshape(-1, 3, 3)


def _by_place(room, normals, rows):
    """The normals at each corner of the room: all its faces have the same one."""
    out = np.full((8, 3), np.nan)
    for face, at_corners in zip(room.faces[rows], normals[rows]):
        for vertex, normal in zip(face, at_corners):
            assert np.isnan(out[vertex]).all() or np.allclose(out[vertex], normal, atol=1e-14)
            out[vertex] = normal
    return out


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("order", ORDERS)
def test_each_side_of_a_double_room_has_the_normals_of_a_room_of_its_own(order, turn):
    room, alone = double_room(order, turn), single_room(turn)
    inside = _by_place(alone, _units(alone.corners), slice(None))
    towards_the_middle = room.vertices.mean(0) - room.vertices
    assert (np.sign(inside @ np.eye(3)).prod(1) != 0).all() and ((inside * towards_the_middle).sum(1) > 0).all()
    normals = _units(room.corners)
    np.testing.assert_allclose(_by_place(room, normals, room.walls != OUTSIDE), inside, atol=1e-14)
    np.testing.assert_allclose(_by_place(room, normals, room.walls == OUTSIDE), -inside, atol=1e-14)


def test_both_sides_of_a_sheet():
    """The two sides have different diagonals, and noise instead of a normal if they are averaged."""
    square = np.array([[0.1, 0.2, 0.7], [1.3, 0.2, 0.1], [1.3, 1.7, 0.1], [0.1, 1.7, 0.7]])
    above, below = square[[[0, 1, 2], [0, 2, 3]]], square[[[1, 0, 3], [3, 2, 1]]]
    up = np.cross(square[1] - square[0], square[2] - square[0])
    up /= np.linalg.norm(up)
    for sheet in (np.concatenate([above, below]), np.stack([above, below], 1).reshape(-1, 3, 3)):
        facing = np.sign(np.cross(sheet[:, 1] - sheet[:, 0], sheet[:, 2] - sheet[:, 0]) @ up)
        expected = np.broadcast_to((facing[:, None] * up)[:, None], sheet.shape)
        np.testing.assert_allclose(_units(sheet), expected, atol=1e-14)


def test_a_vertex_of_both_sides_has_the_normal_of_its_first_face():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
    for order, height in ((faces, 1.0), (faces[::-1], -1.0)):
        normals = smooth_normals(square, order, square)
        np.testing.assert_array_equal(np.sign(normals), np.broadcast_to((0.0, 0.0, height), (4, 3)))


def test_smooth_surfaces_average_all_faces_around_a_vertex():
    """Without coincident sides, vertices at one place are merged as before: the corner of a cube points outwards."""
    cube = -single_room().corners / (4.0, 3.0, 2.5)
    normals = _units(cube[:, ::-1])
    inwards = cube[:, ::-1] - cube.reshape(-1, 3).mean(0)
    np.testing.assert_allclose(np.abs(normals), 3.0**-0.5, atol=1e-14)
    assert (np.abs((normals * inwards).sum(2)) > 0.1).all()
