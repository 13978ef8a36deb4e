"""`Scene.occluded` and `Scene.closest_hit` on arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from strategies import soups
from strength import examples


@given(soups(), st.integers(0, 2**32 - 1))
@examples(40)
def test_any_hit_and_closest_hit_equal_the_oracle(soup, seed):
    rng = np.random.default_rng(seed)
    scene = at.Scene.from_arrays(soup)
    triangles = scene.triangles()
    size = np.abs(soup).max()
    m = 200
    origins = (rng.normal(size=(m, 3)) * size).astype(np.float32)
    directions = rng.normal(size=(m, 3)).astype(np.float32)
    directions[::4, 0] = 0
    directions[::8, 1:] = [0, 1]
    pick = rng.integers(0, len(soup), m // 2)
    corner = triangles.vertices[pick, rng.integers(0, 3, m // 2)]
    directions[: m // 2] = corner - origins[: m // 2]
    directions[~directions.any(1)] = 1
    tmin, tmax = np.float32(rng.uniform(0, 0.5)), np.float32(rng.choice([1.0, 2.0, np.inf]))
    world = origins.astype(np.float64) + scene.origin
    local = (world - scene.origin).astype(np.float32)
    skip = np.where(rng.uniform(size=m) < 0.3, rng.integers(0, len(soup), m), -1)
    args = world, directions, tmin, tmax, skip
    blocked = scene.occluded(*args)
    truth = oracle.occluded(triangles.vertices, local, directions, tmin=tmin, tmax=tmax, skip=skip)
    np.testing.assert_array_equal(blocked, truth)
    hit = scene.closest_hit(*args)
    np.testing.assert_array_equal(hit.face >= 0, truth)
    t, face = oracle.closest_hit(triangles.vertices, local, directions, tmin, tmax, skip)
    np.testing.assert_allclose(hit.t, t, rtol=2.0**-29)
    other = hit.face != face
    if other.any():  # equally far within float64's precision: shared edges, duplicates
        for i in np.nonzero(other)[0]:
            there = oracle.meets_exactly(local[i], directions[i], triangles.vertices[hit.face[i]], tmin, tmax)[1]
            assert abs(float(there) - t[i]) <= 1e-12 * t[i]


def _wall():
    return at.Scene.from_arrays(np.array([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]]), np.array([[0, 1, 2]]))


def test_shapes_and_values():
    scene = _wall()
    origins = np.zeros((2, 4, 3)) + (0.25, 0.5, 2.0)
    hit = scene.closest_hit(origins, (0, 0, -4.0))
    assert hit.t.shape == hit.face.shape == (2, 4) and hit.t.dtype == np.float64 and hit.face.dtype == np.int32
    np.testing.assert_array_equal(hit.face, 0)
    np.testing.assert_allclose(hit.t, 0.5)
    np.testing.assert_allclose(hit.u, 1.25 / 4)
    np.testing.assert_allclose(hit.v, 1.5 / 4)
    miss = scene.closest_hit(origins, (0, 0, 1.0))
    assert (miss.face == -1).all() and np.isinf(miss.t).all() and (miss.u == 0).all()
    assert scene.occluded(origins, (0, 0, -4.0)).all() and not scene.occluded(origins, (0, 0, 4.0)).any()
    six = np.concatenate([origins, np.broadcast_to((0, 0, -4.0), origins.shape)], -1)
    assert scene.occluded(six).shape == (2, 4) and scene.occluded(six).all()
    assert scene.occluded((0.25, 0.5, 2.0), (0, 0, -1.0)).shape == ()
    assert scene.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_the_interval_counts_in_lengths_of_the_direction_and_is_open():
    scene = _wall()
    o, d = (0.25, 0.5, 2.0), (0, 0, -4.0)
    assert scene.occluded(o, d, tmax=0.51) and not scene.occluded(o, d, tmax=0.5)
    assert scene.occluded(o, d, tmin=0.49) and not scene.occluded(o, d, tmin=0.5)


def test_skip_face_and_cull_faces():
    scene = _wall()
    o, d = (0.25, 0.5, 2.0), (0, 0, -1.0)
    assert not scene.occluded(o, d, skip_face=0) and scene.occluded(o, d, skip_face=-1)
    assert not scene.occluded(o, d, cull_faces="front") and scene.occluded(o, d, cull_faces="back")
    assert scene.occluded((0.25, 0.5, -2.0), (0, 0, 1.0), cull_faces="front")


def test_dlpack_and_other_dtypes():
    class Tensor:
        def __init__(self, array):
            self.array = array

        def __dlpack__(self, **kw):
            return self.array.__dlpack__(**kw)

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    scene = _wall()
    origins = np.array([[0.25, 0.5, 2.0]], np.float32)
    assert scene.occluded(Tensor(origins), Tensor(np.array([[0, 0, -1.0]]))).all()
    assert scene.occluded(np.array([[0, 0, 2]]), np.array([[0, 0, -1]], np.int16)).all()


def test_map_grid_origins_are_recentred_before_rounding():
    offset = np.array([5e6, 0, 4e5])
    scene = at.Scene.from_arrays(np.array([[-1.0, -1, 0], [3, -1, 0], [-1, 3, 0]]) + offset, np.array([[0, 1, 2]]))
    inside = np.array([0.9999, 0.9999, 1e-3]) + offset
    assert scene.occluded(inside, (0, 0, -1.0)) and not scene.occluded(inside + (1e-3, 1e-3, 0), (0, 0, -1.0))


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(origins=np.zeros((3, 2))), "origins must have shape"),
        (dict(directions=None), "shape \\(..., 6\\)"),
        (dict(directions=np.zeros((3, 3))), "zero"),
        (dict(directions=np.full((3, 3), np.nan)), "NaN"),
        (dict(origins=np.full((3, 3), np.inf)), "NaN or infinity"),
        (dict(origins=np.zeros((2, 3))), "broadcast"),
        (dict(tmin=-1.0), "tmin"),
        (dict(tmin=np.nan), "tmin"),
        (dict(tmax=np.nan), "tmax"),
        (dict(origins="abc"), "numbers"),
        (dict(origins=np.zeros((3, 3), complex)), "numbers"),
        (dict(skip_face=0.5), "integers"),
        (dict(cull_faces="both"), "cull_faces"),
        (dict(threads=0), "threads"),
        (dict(time="noon"), "time"),
    ],
)
@pytest.mark.parametrize("method", ["occluded", "closest_hit"])
def test_bad_arguments_are_named(method, change, says):
    args = dict(origins=np.zeros((3, 3)), directions=np.ones((3, 3))) | change
    with pytest.raises(at.InputError, match=says) as error:
        getattr(_wall(), method)(**args)
    assert "\n" not in str(error.value)
