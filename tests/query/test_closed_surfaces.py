"""Open edges and surfaces drawn twice: soups of known topology, and a count by brute force."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from antumbra.query.closed_surfaces import closed_surfaces

TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [3, 3, 3]], np.float32)


def tetrahedron(at=(0.0, 0.0, 0.0)):
    """(4, 3, 3) float32."""
    return POINTS[TETRAHEDRON] + np.float32(at)


def flipped(faces):
    return faces[:, ::-1]


def sheet():
    return np.float32([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])


BESIDE = np.array([[0, 1, 2], [0, 4, 1], [1, 4, 2], [0, 2, 4]])  # a tetrahedron with the same first face
WALL = np.concatenate([POINTS[TETRAHEDRON], POINTS[BESIDE]])


@pytest.mark.parametrize(
    "faces, open_edges, kept",
    [
        (tetrahedron(), 0, None),
        (sheet(), 4, None),
        (np.concatenate([tetrahedron(), flipped(tetrahedron())]), 0, range(4)),
        (np.concatenate([tetrahedron(), tetrahedron()]), 0, range(4)),
        (np.concatenate([tetrahedron(), tetrahedron()[:2]]), 0, range(4)),
        (np.concatenate([tetrahedron(), flipped(tetrahedron()), tetrahedron((5, 0, 0))]), 0, np.r_[:4, 8:12]),
        (WALL, 0, None),
        (np.concatenate([WALL, flipped(WALL)[[0, 0]]]), 0, None),
        (np.concatenate([sheet(), flipped(sheet())]), 4, [0, 1]),
        (np.concatenate([tetrahedron()[:3], flipped(tetrahedron())[:3]]), 3, [0, 1, 2]),
        (np.concatenate([tetrahedron(), sheet() + np.float32(9)]), 4, None),
        (np.zeros((2, 3, 3), np.float32), 0, None),
    ],
    ids=[
        "closed", "open", "once per side", "twice", "partly twice", "one of two bodies twice", "a shared wall",
        "a shared wall four times", "a sheet once per side", "an open body once per side",
        "a body and a sheet", "points",
    ],
)  # fmt: skip
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_repeated_faces_count_once_only_where_that_closes_surfaces(faces, open_edges, kept, dtype):
    found = closed_surfaces(faces.astype(dtype))
    assert found.open_edges == open_edges
    if kept is None:
        assert found.once is None
    else:
        assert found.once.dtype == np.int32
        np.testing.assert_array_equal(found.once, list(kept))


def test_negative_zeros_join_corners():
    faces = tetrahedron()
    faces[0, 0] = -0.0
    assert closed_surfaces(faces) == (0, None)


def open_edges_of(faces):
    sides = [
        tuple(sorted(side))
        for a, b, c in (map(tuple, face.tolist()) for face in faces)
        for side in ((a, b), (b, c), (c, a))
        if side[0] != side[1]
    ]
    return sum(n % 2 for n in Counter(sides).values())


@settings(deadline=None, max_examples=300)
@given(st.lists(st.tuples(*[st.integers(0, 4)] * 3), min_size=1, max_size=24))
def test_open_edges_of_any_soup_are_those_of_its_kept_faces(soup):
    faces = POINTS[np.array(soup)]
    found = closed_surfaces(faces)
    kept = faces if found.once is None else faces[found.once]
    assert found.open_edges == open_edges_of(kept)
    assert {frozenset(map(tuple, face.tolist())) for face in kept} == {frozenset(map(tuple, f.tolist())) for f in faces}
