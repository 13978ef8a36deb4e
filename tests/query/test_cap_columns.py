"""Columns of caps: rays that a table says to be clear cross no cap, by exact counts, and most of the others may."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.query.cap_columns import ALL, AXES, LINES, SIDE, all_directions, cap_columns
from support.strength import examples

ALONG = [*np.eye(3), *-np.eye(3)]


def is_clear(columns, points):
    """(n, 14): what the table says about float32 points."""
    clear = np.empty((len(points), ALL), bool)
    for line, ends in enumerate(columns.ends):
        u, v, depth = columns.frames[line] @ points.T + columns.starts[line][:, None]
        u, v = (np.clip(each, 0, SIDE - 1).astype(int) for each in (u, v))
        least, greatest = columns.depths[line, u, v].T
        clear[:, ends[0]], clear[:, ends[1]] = depth > greatest, depth < least
    return clear


def crossings(caps, points, direction):
    scene = at.Scene.from_arrays(caps)
    return scene.count_hits(points, direction, merge="surface") + (scene.closest_points(points).distance == 0.0)


@pytest.mark.parametrize("axis", ALONG, ids=str)
def test_directions_are_fourteen_and_lines_join_opposite_ones(axis):
    directions = all_directions(axis)
    assert directions.shape == (ALL, 3) and len({tuple(np.abs(each) * 2 + each) for each in directions}) == ALL
    assert (directions[0] == axis).all() and (np.abs(directions[:AXES]).sum(1) == 1).all()
    assert (np.diff(directions[AXES:] @ axis) <= 0).all()
    columns = cap_columns(np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]), axis, np.float32([[-1] * 3, [1] * 3]))
    assert sorted(columns.ends.reshape(-1)) == list(range(ALL)) and len(columns.ends) == LINES
    for a, b in columns.ends:
        assert (columns.directions[a] == -columns.directions[b]).all()


coordinate = st.integers(-8, 8)
corner = st.tuples(coordinate, coordinate, coordinate)


@examples(60)
@given(
    st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=6),
    st.sampled_from([1e-3, 0.1, 1.0, 1e4]),
    st.integers(0, 1000),
)
def test_rays_are_clear_only_where_they_cross_no_cap(caps, size, seed):
    """Coordinates in steps, so that many points lie on caps, and rays through their corners."""
    caps, rng = np.float32(caps) * np.float32(size), np.random.default_rng(seed)
    points = np.concatenate([rng.integers(-9, 10, (60, 3)) * size, rng.uniform(-9, 9, (40, 3)) * size])
    columns = cap_columns(caps, ALONG[seed % 6], np.float32([[-9 * size] * 3, [9 * size] * 3]))
    clear = is_clear(columns, points.astype(np.float32))
    for k, direction in enumerate(columns.directions):
        assert not (crossings(caps, points.astype(np.float32), direction)[clear[:, k]]).any()


def test_most_rays_above_small_caps_are_clear_and_those_that_cross_one_never():
    rng = np.random.default_rng(0)
    places = np.append(rng.uniform(-100, 100, (300, 1, 2)), np.zeros((300, 1, 1)), axis=2)
    caps = (places + rng.uniform(-3, 3, (300, 3, 3)) * (1, 1, 0)).astype(np.float32)
    caps[0] = [[-100, -100, 0], [100, -100, 0], [100, 100, 0]]  # a large one, in a coarser grid
    points = rng.uniform((-100, -100, 0), (100, 100, 40), (2000, 3)).astype(np.float32)
    columns = cap_columns(caps, np.eye(3)[2], np.float32([[-101, -101, -1], [101, 101, 41]]))
    clear = is_clear(columns, points)
    crossed = np.stack([crossings(caps, points, each) > 0 for each in columns.directions], axis=1)
    assert not (clear & crossed).any() and crossed.any()
    assert clear[:, columns.directions[:, 2] >= 0].mean() > 0.95
    assert 0.1 < clear[:, columns.directions[:, 2] < 0].mean() < 0.9  # half of the ground is below the large one


def test_columns_of_too_many_large_caps_say_nothing():
    corners = np.random.default_rng(0).integers(0, 2, (5000, 3, 3)).astype(np.float32)
    columns = cap_columns(corners, np.eye(3)[0], np.float32([[0] * 3, [1] * 3]))
    unknown = (columns.depths == (-np.inf, np.inf)).all(axis=(1, 2, 3))
    assert unknown.sum() >= 3
    clear = is_clear(columns, np.float32([[0.5] * 3, [-3.0] * 3, [9.0] * 3]))
    assert not clear[:, columns.ends[unknown].reshape(-1)].any()


@pytest.mark.parametrize("around", [0.25, 2.0])
def test_columns_around_cells_hold_for_all_their_points(around):
    rng = np.random.default_rng(1)
    caps = rng.uniform(-4, 4, (3, 1, 3)) + rng.uniform(-1, 1, (3, 3, 3))
    columns = cap_columns(caps.astype(np.float32), np.eye(3)[1], np.float32([[-9] * 3, [9] * 3]), around)
    centres = rng.uniform(-9, 9, (300, 3)).astype(np.float32)
    clear = is_clear(columns, centres)
    assert 0.3 < clear.mean() < 0.995
    for shift in rng.uniform(-around, around, (4, 3)):
        points = (centres + shift).astype(np.float32)
        for k, direction in enumerate(columns.directions):
            assert not crossings(caps, points, direction)[clear[:, k]].any()
