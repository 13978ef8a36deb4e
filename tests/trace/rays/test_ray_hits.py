"""One diffuse ray from each pixel."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.engine.method_registry import BUILDERS
from antumbra.picture.renderer import Renderer
from antumbra.query.receivers import NOTHING, surface_receivers
from antumbra.trace.rays.ray_hits import bounce_surfaces


@pytest.fixture(scope="module")
def seen():
    """(scene, triangles, G-buffer, BVH) of an open room. Some pixels see nothing."""
    scene = at.procedural("atrium", triangles=1500)
    triangles = scene.triangles()
    gbuffer = Renderer(scene).see(triangles, scene.cameras[0].resized(32, 24))
    away = np.zeros(gbuffer.face.shape, bool)
    away[:5, :7] = True
    gbuffer.face[away], gbuffer.side[away], gbuffer.depth[away] = -1, NOTHING, np.inf
    gbuffer.position[away], gbuffer.normal[away] = 0, 0
    return scene, triangles, gbuffer, BUILDERS["bsah"].build(triangles.vertices)


def _directions(normals, seed):
    """(m, 3) float32: directions by Malley's method around each normal, with the tangents of Duff et al. 2017."""
    n = normals.astype(np.float64)
    u, v = np.random.default_rng(seed).random((len(n), 2)).T
    s = np.copysign(1.0, n[:, 2])
    a = -1.0 / (s + n[:, 2])
    b = n[:, 0] * n[:, 1] * a
    one = np.stack([1 + s * n[:, 0] ** 2 * a, s * b, -s * n[:, 0]], 1)
    other = np.stack([b, s + n[:, 1] ** 2 * a, -n[:, 1]], 1)
    r, angle = np.sqrt(u), 2 * np.pi * v
    x, y, z = r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - u)
    return (x[:, None] * one + y[:, None] * other + z[:, None] * n).astype(np.float32)


@pytest.mark.parametrize("seed", [0, 7])
def test_it_sees_what_a_ray_meets_first(seen, seed):
    scene, triangles, gbuffer, bvh = seen
    out = bounce_surfaces(gbuffer, triangles, bvh, seed)
    assert out.face.shape == gbuffer.face.shape and np.array_equal(out.origin, gbuffer.origin)
    flat = [a.reshape(-1, *a.shape[2:]) for a in gbuffer[:5]]
    position, normal, face, side = (flat[gbuffer._fields.index(f)] for f in ("position", "normal", "face", "side"))
    origins = surface_receivers(position, normal, face, side, triangles.vertices.reshape(-1, 9))
    directions, asks = _directions(normal, seed), face >= 0
    t, hit = oracle.closest_hit(triangles.vertices, origins[asks], directions[asks], skip=face[asks])
    np.testing.assert_array_equal(out.face.ravel()[asks], hit)
    np.testing.assert_allclose(out.depth.ravel()[asks], t, rtol=1e-5)
    same = scene.closest_hit(origins[asks] + scene.origin, directions[asks], skip_face=face[asks])
    np.testing.assert_array_equal(same.face, hit)
    met = np.flatnonzero(asks)[hit >= 0]
    where = origins[met] + t[hit >= 0, None] * directions[met].astype(np.float64)
    np.testing.assert_allclose(out.position.reshape(-1, 3)[met], where, atol=1e-4)
    assert 0.2 < len(met) / asks.sum() < 1


def test_surfaces_turn_to_the_ray(seen):
    _, triangles, gbuffer, bvh = seen
    out = bounce_surfaces(gbuffer, triangles, bvh)
    met = out.face >= 0
    corners = triangles.vertices[out.face[met]].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    back = gbuffer.position[met].astype(np.float64) - out.position[met]
    assert ((out.normal[met] * back).sum(1) > 0).all()
    np.testing.assert_allclose(out.normal[met], normal * out.side[met, None], atol=1e-5)
    assert set(np.unique(out.side[met]).tolist()) <= {-1, 1}
    below = ((out.position[met] - gbuffer.position[met]) * gbuffer.normal[met]).sum(1)
    assert (below > -1e-4).all()


def test_where_nothing_is_met_there_is_nothing(seen):
    _, triangles, gbuffer, bvh = seen
    out = bounce_surfaces(gbuffer, triangles, bvh)
    nothing = out.face < 0
    assert (nothing & (gbuffer.face >= 0)).any() and nothing[gbuffer.face < 0].all()
    assert (out.side[nothing] == NOTHING).all() and np.isinf(out.depth[nothing]).all()
    assert not out.position[nothing].any() and not out.normal[nothing].any()


def test_seeds_and_threads(seen):
    _, triangles, gbuffer, bvh = seen
    first = bounce_surfaces(gbuffer, triangles, bvh, 3, 1)
    for threads in (2, None):
        again = bounce_surfaces(gbuffer, triangles, bvh, 3, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first[:5], again[:5]))
    assert (bounce_surfaces(gbuffer, triangles, bvh, 4).face != first.face).mean() > 0.1


def test_directions_are_as_dense_as_their_cosine_is_large():
    """The distances from the floor of a large box to its ceiling, at a known height, give the cosines."""
    quad = np.float32([[[-1, 0, -1], [-1, 0, 1], [1, 0, 1]], [[-1, 0, -1], [1, 0, 1], [1, 0, -1]]])
    scene = at.Scene.from_arrays(np.concatenate([quad, quad * np.float32([1e4, 1, 1e4]) + np.float32([0, 1, 0])]))
    triangles = scene.triangles()
    camera = at.Camera((0, 0.5, 0.01), (0, 0, 0), vfov=40, width=64, height=64)
    gbuffer = Renderer(scene).see(triangles, camera)
    assert (gbuffer.face >= 0).all() and (gbuffer.face < 2).all()
    out = bounce_surfaces(gbuffer, triangles, BUILDERS["bsah"].build(triangles.vertices))
    cosine = 1 / out.depth[out.face >= 2]
    assert len(cosine) > 4000
    shares = np.histogram(cosine**2, 8, (0, 1))[0] / len(cosine)  # the squares of a cosine distribution are uniform
    assert abs(shares - 1 / 8).max() < 0.03
