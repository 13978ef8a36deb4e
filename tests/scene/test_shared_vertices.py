"""Rows of vertices in scratch files, and the shading that ranges of a mesh add up to."""

import numpy as np
import pytest

from antumbra.scene import shared_vertices
from antumbra.scene.appearance import appearance_of_piece
from antumbra.scene.materials import PLAIN, MeshAppearance
from antumbra.scene.mesh import Piece, distinct_vertices
from antumbra.scene.shared_vertices import SharedVertices, shares_vertices


@pytest.mark.parametrize("gap, window", [(1, 7), (3, 1 << 18), (1 << 8, 1 << 18)])
@pytest.mark.parametrize("width", [1, 7])
def test_rows_are_those_written_last_and_zeros_elsewhere(tmp_path, monkeypatch, gap, window, width):
    monkeypatch.setattr(shared_vertices, "_GAP", gap)
    monkeypatch.setattr(shared_vertices, "_WINDOW", window)
    rng, expected, path = np.random.default_rng(0), np.zeros((400, width)), tmp_path / "rows"
    for n in (1, 30, 200, 5):
        numbers, rows = np.sort(rng.choice(400, n, replace=False)), rng.normal(size=(n, width))
        before = np.sort(rng.choice(400, 50, replace=False))
        np.testing.assert_array_equal(shared_vertices._read(path, before, width), expected[before])
        shared_vertices._write(path, numbers, rows)
        expected[numbers] = rows
    np.testing.assert_array_equal(shared_vertices._read(path, np.arange(400), width), expected)


def sphere(n=12):
    """((v, 3), (f, 3)): vertices on a sphere, each of which many faces share."""
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(0, 6.2, n), np.linspace(0.1, 3.0, n)))
    points = np.stack([np.cos(u) * np.sin(v), np.cos(v), np.sin(u) * np.sin(v)], 1)
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return points, np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)])


def piece_of(points, faces, normals, is_range):
    numbers, corners = distinct_vertices(faces)
    look = MeshAppearance((PLAIN,), normals=normals[numbers], rest_positions=points[numbers])
    return Piece(
        points[None, numbers], corners, np.ones(3, np.float32), "mesh", look=look, is_range=is_range, numbers=numbers
    )


def test_ranges_have_the_shading_of_the_whole():
    points, faces = sphere()
    normals = (points + 0.3 * np.random.default_rng(1).normal(size=points.shape)).astype(np.float32)
    faces = np.random.default_rng(2).permutation(faces)
    whole = appearance_of_piece(piece_of(points, faces, normals, False))
    parts = [piece_of(points, some, normals, True) for some in np.array_split(faces, 9)]
    assert all(map(shares_vertices, parts)) and not shares_vertices(parts[0]._replace(numbers=None))
    shared = SharedVertices("mesh")
    for part in parts:
        shared.add(part)
    found = [appearance_of_piece(part, shared.of(part)) for part in parts]
    np.testing.assert_array_equal(np.concatenate([each.bends for each in found]), whole.bends)
    np.testing.assert_array_equal(np.concatenate([each.normals for each in found]), whole.normals)
    alone = np.concatenate([appearance_of_piece(part).bends for part in parts])
    assert (alone < whole.bends).any() and (alone <= whole.bends).all()


def test_meshes_have_files_of_their_own():
    points, faces = sphere()
    one = piece_of(points, faces[:40], points.astype(np.float32), True)
    other = one._replace(first=1)
    shared = SharedVertices("mesh")
    shared.add(one)
    assert shared.of(one).widest.any() and not shared.of(other).widest.any()
