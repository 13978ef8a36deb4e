"""Tangents at the corners of faces: given by files, or derived from texture coordinates."""

import numpy as np

from antumbra.scene.tangents import corner_tangents
from gltf_materials import SQUARE, SQUARE_FACES, SQUARE_UV, ball

UP = np.tile([0.0, 0.0, 1.0], (4, 1))


def test_tangents_point_where_u_grows_and_bitangents_where_v_falls():
    found = corner_tangents(SQUARE, SQUARE_FACES, SQUARE_UV[SQUARE_FACES], UP)
    np.testing.assert_allclose(found, np.broadcast_to([1.0, 0.0, 0.0, 1.0], (2, 3, 4)), atol=1e-12)


def test_a_mirrored_texture_turns_the_tangent_and_the_hand():
    mirrored = SQUARE_UV * (-1, 1)
    found = corner_tangents(SQUARE, SQUARE_FACES, mirrored[SQUARE_FACES], UP)
    np.testing.assert_allclose(found, np.broadcast_to([-1.0, 0.0, 0.0, -1.0], (2, 3, 4)), atol=1e-12)


def test_a_turned_square_has_turned_tangents():
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = corner_tangents(SQUARE @ turn.T, SQUARE_FACES, SQUARE_UV[SQUARE_FACES], UP)
    np.testing.assert_allclose(found, np.broadcast_to([0.0, 1.0, 0.0, 1.0], (2, 3, 4)), atol=1e-12)


def test_tangents_of_a_ball_lie_along_its_parallels():
    points, uv, faces = ball(24)
    found = corner_tangents(points, faces, uv[faces], points)
    corners = points[faces].astype(np.float64)
    inside = np.abs(corners[..., 1]).max(1) < 0.9  # away from the poles, where u has no direction
    along = np.stack([corners[..., 2], 0 * corners[..., 1], -corners[..., 0]], -1)  # u falls with the angle
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    assert inside.sum() > 500
    assert (np.sum(found[inside, :, :3] * along[inside], -1) > 0.99).all()
    assert (found[inside, :, 3] == 1.0).all()


def test_given_tangents_are_kept_and_missing_ones_derived():
    given = np.array([[0, 1, 0, -1], [0, 1, 0, -1], [0, 0, 0, 0], [0, 1, 0, -1]], np.float32)
    found = corner_tangents(SQUARE, SQUARE_FACES, SQUARE_UV[SQUARE_FACES], UP, given)
    expected = np.where(SQUARE_FACES[..., None] == 2, [1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, -1.0])
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_faces_without_area_in_the_texture_have_no_tangent():
    found = corner_tangents(SQUARE, SQUARE_FACES, np.zeros((2, 3, 2)), UP)
    assert (found == 0.0).all()


def test_flat_faces_have_tangents_of_their_own():
    found = corner_tangents(SQUARE, SQUARE_FACES, SQUARE_UV[SQUARE_FACES])
    np.testing.assert_allclose(found, np.broadcast_to([1.0, 0.0, 0.0, 1.0], (2, 3, 4)), atol=1e-12)
