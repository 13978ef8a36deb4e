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


@pytest.mark.parametrize("blocks", ["AAAA", "AABB", "ABAB", "AxAA", "AAax", "aABb", "xxBB", "AmAA", "mmmm", "AAoo"])
def test_blocks_of_a_batch_hit_triangles_alone_or_together(blocks):
    """Each letter is a block.

    A, B: all its rays hit this triangle; a, b: likewise, from another point; x: some hit either one; m: some of these
    miss; o: they come from many points.
    """
    rng = np.random.default_rng(4)
    corners = np.array([TRIANGLES["plain"], TRIANGLES["with inexact differences"]]) + [[[-3.0, 0, 0]], [[3.0, 0, 0]]]
    scene = at.Scene.from_arrays(corners)
    vertices, origins, targets = scene.triangles().vertices, [], []
    for block in blocks:
        which = {"A": 0, "B": 1}.get(block.upper(), rng.integers(0, 2, 16))
        points = (rng.dirichlet(np.ones(3), 16)[:, :, None] * np.broadcast_to(vertices[which], (16, 3, 3))).sum(1)
        if block == "m":
            points[::3, 1] += 9.0
        origins.append(np.broadcast_to([0.3, 0.2, 2.7], (16, 3)) + 0.125 * block.islower())
        if block == "o":
            origins[-1] = origins[-1] + rng.normal(scale=0.01, size=(16, 3))
        targets.append(points)
    origins = np.concatenate(origins).astype(np.float32)
    directions = (np.concatenate(targets) - origins).astype(np.float32)
    hit = scene.closest_hit(origins, directions)
    assert (hit.face < 0).any() if "m" in blocks else (hit.face >= 0).mean() > 0.9  # some graze the edges
    for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
        one = scene.closest_hit(o, d)
        assert [hit.t[i], hit.face[i], hit.u[i], hit.v[i]] == [one.t, one.face, one.u, one.v]
