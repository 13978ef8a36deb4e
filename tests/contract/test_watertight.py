"""Closed meshes do not leak: rays from inside, aimed at vertices and edges, always hit."""

import numpy as np
import pytest

import antumbra as at

RAYS = 1_000_000


def _icosphere(levels, rng):
    g = (1 + 5**0.5) / 2
    v = np.array([(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g), (0, -1, -g), (0, 1, -g),
                  (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)])  # fmt: skip
    f = np.array([(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2),
                  (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11),
                  (6, 2, 10), (8, 6, 7), (9, 8, 1)])  # fmt: skip
    for _ in range(levels):
        edges, inverse = np.unique(np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0, return_inverse=True)
        mid = (inverse.reshape(-1, 3) + len(v)).astype(int)
        v = np.concatenate([v, v[edges].mean(1)])
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        a, b, c = f.T
        ab, bc, ca = mid.T
        f = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return v * (1 + 0.2 * rng.uniform(size=(len(v), 1))), f


def _box():
    v = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return v, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


@pytest.mark.parametrize("mesh", ["bumpy sphere", "box"])
def test_rays_at_vertices_and_edges_of_a_closed_mesh_never_leak(mesh):
    rng = np.random.default_rng(4)
    v, f = _icosphere(4, rng) if mesh == "bumpy sphere" else _box()
    scene = at.Scene.from_arrays(v, f)
    corners = scene.triangles().vertices
    face = rng.integers(0, len(corners), RAYS)
    edge = rng.integers(0, 3, RAYS)
    a, b = corners[face, edge], corners[face, (edge + 1) % 3]
    along = np.where(rng.uniform(size=RAYS) < 0.5, 0.0, rng.uniform(size=RAYS))[:, None]
    target = (a + along * (b.astype(np.float64) - a)) + scene.origin
    origin = rng.uniform(-0.4, 0.4, (RAYS, 3))
    if mesh == "box":
        origin = np.round(origin * 8) / 8  # rays in the planes of edges and diagonals
    leaks = ~scene.occluded(origin, target - origin)
    assert leaks.sum() == 0
    first = slice(0, 50_000)
    assert (scene.closest_hit(origin[first], (target - origin)[first]).face >= 0).all()


def test_a_closed_mesh_seen_from_inside_has_no_hole():
    scene = at.Scene.from_arrays(*_icosphere(3, np.random.default_rng(5)))
    camera = at.Camera((0.1, 0.05, 0.2), (1, 0.3, -0.4), vfov=120, width=200, height=160)
    frame = at.render(scene, camera, [at.PointLight((0.2, 0.1, 0))], spp=1)
    assert (frame.gbuffer.face >= 0).all()


def test_without_an_offset_surfaces_would_shadow_themselves_and_with_it_none_does():
    """A convex body is seen from outside, with the light outside. All samples above a pixel's horizon are visible."""
    v, f = _icosphere(4, np.random.default_rng(6))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    scene = at.Scene.from_arrays(v * 3.7 + (11.3, -7.1, 5.9), f)
    light = at.PointLight((30.0, 25.0, 40.0))
    frame = at.render(scene, at.Camera((20, -2, 17), (11.3, -7.1, 5.9), width=256, height=256), [light], spp=1)
    g = frame.gbuffer
    seen = g.face >= 0
    world = g.position[seen] + g.origin
    above = ((light.position - world) * g.normal[seen]).sum(1) > 1e-3
    assert above.sum() > 5_000
    np.testing.assert_array_equal(frame.bits[0][seen][above, 0], 0)
    to_light = light.position - world
    naive = scene.occluded(world, to_light, tmin=0.0, tmax=1.0)
    assert naive[above].mean() > 0.05  # the self-shadowing that the offset prevents
