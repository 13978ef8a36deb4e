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
    for one, other in zip(receivers_above(points, axis, frame, frame), expected):
        assert one.dtype == other.dtype and one.shape == other.shape and one.tobytes() == other.tobytes()
    assert points.tobytes() == given.tobytes()


@pytest.mark.parametrize("wrong, words", [(np.nan, "NaN or infinity"), (1e39, "beyond float32")])
def test_faulty_points_are_refused(wrong, words):
    with pytest.raises(at.InputError, match=words):
        receivers_above(np.array([[0.0, wrong, 0.0]]), 2, np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("size", [1e-6, 1e-2, 1.0])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_points_near_the_world_origin_are_not_in_the_shadow_of_their_own_face(size, kind):
    """The corners of a slanted face lie far from points on it, whose coordinates are small but have errors as large."""
    rng, shadowed = np.random.default_rng(0), 0
    for _ in range(10):
        normal = rng.normal(size=3)
        a = np.cross(normal, [1.0, 0.0, 0.3])
        b = np.cross(normal, a)
        corners = np.array([[20.0, 3.0], [-11.0, 17.0], [-9.0, -20.0]]) @ np.stack(
            [a, b] / np.linalg.norm([a, b], axis=1)[:, None]
        )
        corners = np.float32(corners + 1e-3 * rng.normal(size=3))
        scene = at.Scene.from_arrays(corners[None])
        up = np.cross(*np.diff(corners.astype(float), axis=0))
        near = rng.normal(size=(50, 3)) * size
        near -= np.outer((near - corners[0]) @ up / (up @ up), up)
        weights = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.vstack([near.T, np.ones(50)]), rcond=None)[0]
        points = (np.float32(weights.T)[:, :, None] * corners).sum(1, dtype=np.float32).astype(kind)
        sun = at.DirectionalLight(tuple(-up), angular_diameter=0.0)
        shadowed += int((at.visibility(scene, points, sun, np.tile(up, (50, 1)), spp=1).fraction < 1.0).sum())
        assert np.abs(points).max() < 9 * size + 0.1 and (scene.origin == 0.0).all()
    assert shadowed <= 2
