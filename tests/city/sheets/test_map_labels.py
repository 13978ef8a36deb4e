"""Labels of points: none overlaps another, a mark or the frame; points above each other are drawn apart."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.city.sheets.map_labels import joined_texts, placed_labels, spread_points
from strength import examples

pytest.importorskip("matplotlib")


def apart(a, b):
    """Whether two boxes (left, bottom, width, height) do not overlap."""
    return a[0] + a[2] <= b[0] or b[0] + b[2] <= a[0] or a[1] + a[3] <= b[1] or b[1] + b[3] <= a[1]


@examples(30)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 60), side=st.sampled_from([15.0, 60.0, 200.0]))
def test_labels_overlap_neither_each_other_nor_marks_nor_the_frame(seed, count, side):
    random = np.random.default_rng(seed)
    points, texts = random.uniform(0, side, (count, 2)), [f"W{k}" for k in range(count)]
    taken = (side - 5.0, side - 5.0, 5.0, 5.0)
    labels, left_out = placed_labels(points, texts, side, side, 1.0, [taken])
    boxes = [(each.left, each.bottom, each.width, each.height) for each in labels]
    assert all(apart(*pair) for pair in combinations([*boxes, taken], 2))
    marks = [(x - 1.0, y - 1.0, 2.0, 2.0) for x, y in points.tolist()]
    assert all(apart(box, mark) for box in boxes for mark in marks)
    assert all(x >= 0 and y >= 0 and x + w <= side and y + h <= side for x, y, w, h in boxes)
    assert sorted([*(each.text for each in labels), *left_out]) == sorted(texts)
    assert side < 200.0 or not left_out


def test_labels_stay_at_their_points_where_there_is_room():
    (label,), left_out = placed_labels(np.array([[50.0, 50.0]]), ["A1"], 100.0, 100.0, 1.0)
    assert not left_out and not label.far and label.left > 50.0 and label.bottom > 50.0


def test_a_full_frame_leaves_labels_out():
    points = np.full((40, 2), 5.0) + np.linspace(0, 1, 40)[:, None]
    labels, left_out = placed_labels(points, [f"window {k}" for k in range(40)], 20.0, 12.0, 0.5)
    assert labels and left_out and len(labels) + len(left_out) == 40


def test_points_at_one_place_share_a_label():
    points = np.array([[1.0, 1.0], [9.0, 9.0], [1.0, 1.01]])
    places, names = joined_texts(points, ["A", "B", "C"])
    assert names == ["A, C", "B"] and places.tolist() == [[1.0, 1.0], [9.0, 9.0]]
    assert joined_texts(np.zeros((30, 2)), [f"window {k}" for k in range(30)])[1][0].endswith("…")


def test_windows_above_each_other_are_drawn_outwards_by_height():
    points = np.array([[5.0, 5.0], [5.0, 5.0], [8.0, 5.0], [5.0, 5.0]])
    shared = spread_points(points, np.array([6.0, 3.0, 0.0, 9.0]), np.tile([0.0, -1.0], (4, 1)), 2.0)
    assert shared.tolist() == [True, True, False, True]
    assert points.tolist() == [[5.0, 3.0], [5.0, 5.0], [8.0, 5.0], [5.0, 1.0]]
