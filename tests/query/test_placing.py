"""What the frame of a scene cannot hold is refused, in one line; what is next to its zero is there."""

import numpy as np
import pytest

import antumbra as at
from antumbra.errors import InputError
from antumbra.query.placing import MOST_RATIO, place
from antumbra.scene.recentre import MIN_EXTENT, NEAREST, settled

RNG = np.random.default_rng(8)
SOUP = RNG.integers(-9, 10, (40, 3, 3)).astype(float)


@pytest.mark.parametrize("scale", [2.0**-149, 1e-42, 2.0**-126, MIN_EXTENT / 32])
def test_scenes_that_float32_does_not_hold(scale):
    with pytest.raises(InputError, match=r"units wide; float32 does not hold .* multiply all coordinates"):
        at.Scene.from_arrays(SOUP * scale)


def test_a_store_of_such_a_scene(tmp_path):
    np.save(tmp_path / "frames.npy", (SOUP * 1e-40).reshape(1, -1, 3))
    np.save(tmp_path / "faces.npy", np.arange(120, dtype=np.int32).reshape(40, 3))
    with pytest.raises(InputError, match="multiply all coordinates"):
        at.load(tmp_path)


def test_the_narrowest_scenes():
    assert at.Scene.from_arrays(SOUP * MIN_EXTENT).n_triangles == 40
    assert at.Scene.from_arrays(np.full((2, 3, 3), 1e-44)).n_triangles == 2  # one point has no scale


def test_coordinates_next_to_zero():
    """They are zero, or as large as error bounds need; those of ordinary scenes do not change."""
    soup = SOUP * 2.0 ** RNG.integers(-149, 1, (40, 1, 1))
    soup = np.concatenate([soup, [[[k, k, k], [k, k, 0], [k, 0, 0]] for k in (-16.0, 16.0)]])
    scene = at.Scene.from_arrays(soup)
    vertices = scene.triangles().vertices
    assert not scene.origin.any()
    np.testing.assert_array_equal(vertices, np.where(abs(soup) < NEAREST, 0, soup).astype(np.float32))
    assert (vertices != soup.astype(np.float32)).any() and np.isnan(settled(np.array([np.nan]))).all()
    np.testing.assert_array_equal(settled(SOUP), SOUP)


LIGHTS = {
    "point": lambda far: at.PointLight((0, far, 0)),
    "quad": lambda far: at.QuadLight((0, 1, 0), (far, 0, 0), (0, 0, 1)),
    "disk": lambda far: at.DiskLight((0, 9, 0), (0, 1, 0), far),
    "sphere": lambda far: at.SphereLight((0, far, 0), 1.0),
    "list": lambda far: at.PointLights([(0, 1, 0), (far, 0, 0)]),
}


@pytest.mark.parametrize("name", LIGHTS)
def test_lights_that_are_too_far_for_a_scene(name):
    scene, far = at.Scene.from_arrays(SOUP * 2.0**-60), 2.0**65
    with pytest.raises(InputError, match=r"are .* units away from a scene that is .* units wide; bring them nearer"):
        at.visibility(scene, np.zeros((1, 3)), LIGHTS[name](far))
    with pytest.raises(InputError, match="bring them nearer"):
        at.render(scene, at.Camera((0, 0, 1e-17), (0, 0, 0), width=4, height=4), LIGHTS[name](far), spp=1)
    at.visibility(scene, np.zeros((1, 3)), LIGHTS[name](2.0**55))


def test_points_that_are_too_far_for_a_scene():
    scene = at.Scene.from_arrays(SOUP * 2.0**-60)
    with pytest.raises(InputError, match="bring them nearer"):
        at.visibility(scene, [[2.0**65, 0, 0]], at.PointLight((0, 1e-10, 0)))


def test_lights_next_to_zero_and_distant_ones():
    origin, box = np.zeros(3), np.array([[-1, -1, -1], [1, 1, 1]], np.float32)
    made = place(at.QuadLight((0, 1e-40, 1), (1, 0, 1e-35), (1e-36, 1, 0)), origin, box, 4.0)
    np.testing.assert_array_equal([made.base, made.u, made.v], [[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    sun = at.DirectionalLight((0, -1, 0))
    assert place(sun, origin, box, 4.0).base.tobytes() == sun.patch(origin, 4.0).base.tobytes()
    assert place(sun, origin, None, 2 * MOST_RATIO) is not None
