"""Numbers of hits that are computed together."""

import numpy as np
import pytest

import antumbra as at
import oracle

TRIANGLES = {
    "plain": [[-1.0, -0.75, 0.1], [1.0, -0.5, 0.25], [0.2, 0.75, -0.25]],
    "with inexact differences": [[-1.0, -0.75, 2.0**-70], [1.0, -0.5, -1.0], [0.3, 0.75, 1.0]],
}


def _fan(name):
    """(scene, origin, (128, 3) directions to points in its triangle), all float32."""
    scene, rng = at.Scene.from_arrays(np.array([TRIANGLES[name]])), np.random.default_rng(3)
    weights = rng.dirichlet(np.ones(3), 128)
    origin = np.array([0.3, 0.2, 2.7], np.float32)
    return scene, origin, (weights @ scene.triangles().vertices[0] - origin).astype(np.float32)


@pytest.mark.parametrize("name", TRIANGLES)
def test_rays_from_one_point_to_one_triangle_have_the_t_of_rational_arithmetic(name):
    scene, origin, directions = _fan(name)
    assert not scene.origin.any()  # so that no corner is rounded
    hit = scene.closest_hit(origin, directions)
    assert (hit.face == 0).all() and len(np.unique(hit.t)) > 100
    triangle = scene.triangles().vertices[0]
    assert hit.t.tolist() == [float(oracle.meets_exactly(origin, d, triangle)[1]) for d in directions]


@pytest.mark.parametrize("name", TRIANGLES)
def test_rays_from_one_point_have_the_numbers_that_they_have_among_rays_from_another(name):
    scene, origin, directions = _fan(name)
    alone = scene.closest_hit(origin, directions)
    origins = np.stack([origin, origin + np.float32(0.125)])  # of every second ray
    among = scene.closest_hit(origins, np.repeat(directions, 2, 0).reshape(-1, 2, 3))
    for field in ("t", "u", "v", "face"):
        assert getattr(among, field)[:, 0].tolist() == getattr(alone, field).tolist()
    assert (among.t[:, 1] != alone.t).any()
