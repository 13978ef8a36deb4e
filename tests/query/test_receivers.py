"""Receivers above points: the bits of receivers on surfaces whose normal is an axis."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import antumbra as at
from antumbra.query.receivers import Receivers, receivers_above
from strength import examples

NUMBERS = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, -0.0, 1e-40, -1e-300, 2.0**-110, 85_000.25]))


@examples(200)
@given(
    points=hnp.arrays(np.float64, st.tuples(st.integers(1, 8), st.just(3)), elements=NUMBERS),
    frame=hnp.arrays(np.float64, 3, elements=NUMBERS),
    axis=st.integers(0, 2),
)
def test_points_above_have_the_bits_of_points_on_surfaces(points, frame, axis):
    given = points.copy()
    expected = Receivers.on_surface(points, np.eye(3)[axis], frame).seeing_all_around()
    for one, other in zip(receivers_above(points, axis, frame), expected):
        assert one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    assert points.tobytes() == given.tobytes()


@pytest.mark.parametrize("wrong, words", [(np.nan, "NaN or infinity"), (1e39, "beyond float32")])
def test_faulty_points_are_refused(wrong, words):
    with pytest.raises(at.InputError, match=words):
        receivers_above(np.array([[0.0, wrong, 0.0]]), 2, np.zeros(3))
