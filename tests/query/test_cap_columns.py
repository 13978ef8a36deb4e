"""Columns of caps: what they say about rays is what exact counts say, and they say it about most rays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.query.cap_columns import ALL, AWAY, AXES, LINES, CapMesh, all_directions, cap_columns
from antumbra.query.closed_surfaces import open_edges
from support.strength import examples

ALONG = [*np.eye(3), *-np.eye(3)]
STEPS, LEAST, GREATEST, FLIPS = 6, 12, 13, 14  # the layout of a column


def columns_of(caps, axis, size, side=64, around=0.0):
    """Columns of caps in a box from -size to size."""
    caps = np.float32(caps)
    box = np.float32([[-size] * 3, [size] * 3])
    return cap_columns(CapMesh(caps, open_edges(caps)), axis, box, side, around)


def read(columns, points):
    """(n, 14) twice: about which rays from float32 points columns know, and which of these cross caps oddly often."""
    known, odd = np.zeros((2, len(points), ALL), bool)
    for line, (one, other) in enumerate(columns.ends):
        u, v, depth = columns.frames[line] @ points.T + columns.starts[line][:, None]
        u, v = (np.clip(each, 0, columns.depths.shape[1] - 1).astype(int) for each in (u, v))
        column = columns.depths[line, u, v]
        below = column < depth[:, None]
        begun, ended = below[:, :STEPS], below[:, STEPS : 2 * STEPS]
        between, flips = (begun == ended).all(1), column[:, FLIPS].astype(int)[:, None] >> np.arange(STEPS) & 1
        known[:, one], known[:, other] = between & below[:, GREATEST], between & ~below[:, LEAST]
        odd[:, one], odd[:, other] = (flips * ~begun).sum(1) & 1, (flips * begun).sum(1) & 1
    return known, odd


def truth(caps, points, directions):
    """((n, 14) int, (n,) bool): how many caps each ray crosses, and which points are on caps."""
    scene = at.Scene.from_arrays(np.float32(caps))
    counts = [scene.count_hits(points, each, merge="surface") for each in directions]
    return np.stack(counts, axis=1), scene.closest_points(points).distance == 0.0


def share_known(columns, caps, points):
    """The share of rays about which columns know, after a comparison with exact counts."""
    known, odd = read(columns, points)
    crossings, on_cap = truth(caps, points, columns.directions)
    assert not known[on_cap].any()
    np.testing.assert_array_equal(odd[known], crossings[known] % 2 == 1)
    return known.mean()


@pytest.mark.parametrize("axis", ALONG, ids=str)
def test_directions_are_fourteen_and_lines_join_opposite_ones(axis):
    directions = all_directions(axis)
    assert directions.shape == (ALL, 3) and len({tuple(np.abs(each) * 2 + each) for each in directions}) == ALL
    assert (directions[0] == axis).all() and (np.abs(directions[:AXES]).sum(1) == 1).all()
    assert (np.diff(directions[AXES:] @ axis) <= 0).all()
    columns = columns_of([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], axis, 1.0)
    assert sorted(columns.ends.reshape(-1)) == list(range(ALL)) and len(columns.ends) == LINES
    assert {tuple(each) for each in columns.directions} == {tuple(each) for each in directions}
    assert (columns.directions[: 1 + AWAY] @ axis == 1).all()
    for line, (one, other) in enumerate(columns.ends):
        assert (columns.directions[one] == -columns.directions[other]).all()
        assert columns.frames[line, 2] @ columns.directions[one] > 0


coordinate = st.integers(-8, 8)
corner = st.tuples(coordinate, coordinate, coordinate)


@examples(60)
@given(
    st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=6),
    st.lists(corner, max_size=7),
    st.sampled_from([1e-3, 0.1, 1.0, 1e4]),
    st.integers(0, 1000),
)
def test_columns_agree_with_exact_counts(caps, fan, size, seed):
    """Coordinates in steps, so that many points lie on caps, and rays pass through corners. A fan has inner edges."""
    fan = [(fan[0], fan[k], fan[k + 1]) for k in range(1, len(fan) - 1)]
    caps, rng = np.float32(caps + fan) * np.float32(size), np.random.default_rng(seed)
    points = np.concatenate([rng.integers(-9, 10, (60, 3)) * size, rng.uniform(-9, 9, (40, 3)) * size])
    columns = columns_of(caps, ALONG[seed % 6], 9 * size, side=4 << seed % 6)
    share_known(columns, caps, points.astype(np.float32))


def test_columns_know_most_rays_past_small_caps_and_through_a_large_one():
    rng = np.random.default_rng(0)
    places = np.append(rng.uniform(-100, 100, (300, 1, 2)), np.zeros((300, 1, 1)), axis=2)
    caps = (places + rng.uniform(-3, 3, (300, 3, 3)) * (1, 1, 0)).astype(np.float32)
    large = np.float32([[[-100, -100, -5], [100, -100, -5], [100, 100, -5]]])
    points = rng.uniform((-100, -100, -9), (100, 100, 40), (2000, 3)).astype(np.float32)
    caps = np.concatenate([caps, large])
    columns = columns_of(caps, np.eye(3)[2], 101, side=128)
    assert share_known(columns, caps, points) > 0.75
    known, odd = read(columns, points)
    down = columns.directions[:, 2] < 0
    assert known[:, ~down].mean() > 0.8 and 0.2 < odd[:, down][known[:, down]].mean() < 0.8


@pytest.mark.parametrize("layers", [6, 7, 20])
def test_layers_are_joined_where_a_column_has_too_many(layers):
    """Squares of two triangles above each other: of columns within the square, only the layers are unknown."""
    square = np.float32([[[-8, -8, 0], [8, -8, 0], [8, 8, 0]], [[-8, -8, 0], [8, 8, 0], [-8, 8, 0]]])
    heights = np.random.default_rng(layers).permutation(np.linspace(-6, 6, layers))
    caps = np.concatenate([square + np.float32([0, 0, z]) for z in heights])
    points = np.random.default_rng(1).uniform((-7, -7, -9), (7, 7, 9), (3000, 3)).astype(np.float32)
    columns = columns_of(caps, np.eye(3)[2], 9)
    assert share_known(columns, caps, points) > 0.3
    known, odd = read(columns, points)
    vertical = known[:, 0]
    assert (vertical.mean() > 0.99) == (layers == 6) and vertical.mean() > 0.3
    assert 0.1 < odd[vertical, 0].mean() < 0.9


def test_columns_of_too_many_large_caps_say_nothing():
    corners = np.random.default_rng(0).integers(0, 2, (5000, 3, 3)).astype(np.float32)
    columns = columns_of(corners, np.eye(3)[0], 1.0, side=128)
    unknown = (columns.depths[..., [LEAST, GREATEST]] == (-np.inf, np.inf)).all(axis=(1, 2, 3))
    assert unknown.sum() >= 3
    known, _ = read(columns, np.float32([[0.5] * 3, [-3.0] * 3, [9.0] * 3]))
    assert not known[:, columns.ends[unknown].reshape(-1)].any()


@pytest.mark.parametrize("around", [0.25, 2.0])
def test_columns_around_cells_hold_for_all_their_points(around):
    rng = np.random.default_rng(1)
    caps = (rng.uniform(-4, 4, (3, 1, 3)) + rng.uniform(-1, 1, (3, 3, 3))).astype(np.float32)
    caps = np.concatenate([caps, np.float32([[[-8, -8, 0], [8, -8, 0], [8, 8, 1]]])])
    columns = columns_of(caps, np.eye(3)[1], 9, around=around)
    centres = rng.uniform(-9, 9, (300, 3)).astype(np.float32)
    known, odd = read(columns, centres)
    assert 0.2 < known.mean() < 0.995 and (around == 2.0 or odd[known].any())
    for shift in rng.uniform(-around, around, (4, 3)):
        crossings, on_cap = truth(caps, (centres + shift).astype(np.float32), columns.directions)
        assert not known[on_cap].any()
        np.testing.assert_array_equal(odd[known], crossings[known] % 2 == 1)
