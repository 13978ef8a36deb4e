"""Caps of open surfaces close every edge: loops, loops that meet in points, and soups."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.query.closed_surfaces import open_edges
from antumbra.query.surface_caps import surface_caps
from support.strength import examples

TETRAHEDRON = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])[[[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]]]
SHEET = np.float32([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
CLOSED = np.concatenate([TETRAHEDRON + np.float32((20 + 9 * k, 0, 0)) for k in range(20)])  # so that caps pay off


def odd_edges(faces):
    """The edges that an odd number of faces share, as pairs of corners."""
    sides = [
        tuple(sorted(side))
        for a, b, c in (map(tuple, face.tolist()) for face in faces)
        for side in ((a, b), (b, c), (c, a))
        if side[0] != side[1]
    ]
    return {side for side, n in Counter(sides).items() if n % 2}


def tube(n):
    """2 n faces between two rims of n edges."""
    turn = 2 * np.pi * (np.arange(n + 1) % n) / n
    low = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1).astype(np.float32)
    high = low + np.float32([0, 0, 1])
    return np.concatenate(
        [np.stack([low[:-1], low[1:], high[1:]], axis=1), np.stack([low[:-1], high[1:], high[:-1]], axis=1)]
    )


@pytest.mark.parametrize(
    "faces, rims, n_caps",
    [
        (TETRAHEDRON[:3], 3, 1),
        (SHEET, 4, 2),
        *((tube(n), 2 * n, 2 * (n - 2)) for n in (3, 4, 5, 7, 8, 60)),
        (np.concatenate([tube(9), SHEET + np.float32(5)]), 22, 16),
    ],
)
def test_a_loop_of_n_edges_has_n_minus_2_caps(faces, rims, n_caps):
    faces = np.concatenate([faces, CLOSED, CLOSED + np.float32(200)])
    assert len(open_edges(faces)) == len(odd_edges(faces)) == rims
    caps = surface_caps(faces)
    assert caps.dtype == np.float32 and len(caps) == n_caps
    assert odd_edges(caps) == odd_edges(faces)


def test_a_closed_surface_has_no_caps():
    assert open_edges(CLOSED).shape == (0, 2, 3) and surface_caps(CLOSED).shape == (0, 3, 3)


def test_a_soup_has_none_since_they_would_not_help():
    assert surface_caps(np.random.default_rng(0).uniform(size=(50, 3, 3)).astype(np.float32)) is None


corner = st.tuples(*[st.integers(0, 2)] * 3)


@examples(200)
@given(st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=12))
def test_caps_of_any_faces_close_them(faces):
    faces = np.array(faces, np.float32)
    caps = surface_caps(np.concatenate([faces, CLOSED]))
    assert odd_edges(caps) == odd_edges(faces)


def test_negative_zeros_are_zeros():
    faces = TETRAHEDRON[:3].copy()
    faces[1] = np.where(faces[1] == 0.0, np.float32(-0.0), faces[1])
    assert len(open_edges(faces)) == 3 and odd_edges(surface_caps(np.concatenate([faces, CLOSED]))) == odd_edges(faces)
