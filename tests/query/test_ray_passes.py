"""Passes of diffuse rays: their origins and directions, and their samples of the lights."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import SAMPLERS, domain_sets, light_samples
from antumbra.query.ray_passes import diffuse_passes, diffuse_rays, path_passes
from antumbra.query.shadow_query import segments, shadow_queries
from antumbra.trace.rays.ray_hits import hit_surfaces, nearest_hits

QUAD = at.QuadLight((0, 0, 0), (1, 0, 0), (0, 1, 0))


@pytest.fixture(scope="module")
def seen():
    """(scene, triangles, G-buffer, receivers) of a picture that is partly empty. Its size is no multiple of 4."""
    scene = at.procedural("city", triangles=3000)
    triangles = scene.triangles()
    gbuffer = Renderer(scene).see(triangles, scene.cameras[0].resized(37, 30))
    (query,) = shadow_queries(triangles, gbuffer, [QUAD], [light_samples(QUAD, 1)])
    return scene, triangles, gbuffer, query.origins


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("n", [1, 7, 16])
def test_the_passes_together_are_the_sample_sets(sampler, n):
    passes = diffuse_passes([QUAD], n, sampler)
    sets = domain_sets(n, sampler, "hemisphere")
    assert passes.directions.shape == (n, 4, 4, 3)
    for x, y in np.ndindex(4, 4):
        np.testing.assert_array_equal(passes.directions[:, y, x], sets[x + 4 * y])
    (shone,) = passes.lights
    assert len(shone) == n and all(s.shape == (16, 1, 3) and s.flags.c_contiguous for s in shone)
    found = {s.tobytes() for s in np.stack(shone)[:, :, 0].transpose(1, 0, 2).reshape(-1, 3)}
    assert found == {s.tobytes() for s in light_samples(QUAD, n, sampler).reshape(-1, 3)}


@pytest.mark.parametrize("sampler", ["larcher-pillichshammer", "halton"])
def test_directions_and_light_samples_come_in_all_pairs(sampler):
    passes = diffuse_passes([QUAD], 16, sampler)
    directions = passes.directions.reshape(-1, 3)[:, :2]
    lights = np.stack(passes.lights[0]).reshape(-1, 3)[:, :2]
    cells = np.concatenate([directions > 0, lights > 0.5], 1) @ (8, 4, 2, 1)
    share = np.bincount(cells, minlength=16) / len(cells)
    assert share.min() > 0.5 / 16 and share.max() < 2 / 16  # if sample k went with direction k, most would be 0
    assert abs(np.corrcoef(directions.T, lights.T)[:2, 2:]).max() < 0.15


def segment(distance):
    """The share of a unit disk beyond a chord at a distance from its centre."""
    return (np.arccos(distance) - distance * np.sqrt(1 - distance**2)) / np.pi


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_the_rays_of_a_path_and_its_light_samples_come_in_all_pairs_over_seeds(sampler):
    """The mean over seeds is the product of the parts, for each set: nothing ties one part to another for all seeds."""
    seeds, n = 256, 4
    found = []
    for seed in range(1, seeds + 1):
        rays = path_passes([QUAD], n, sampler, 3, seed)
        first, second, third = ((ray.directions[..., 0] > 0.3).reshape(n, 16) for ray in rays)
        lit, lit_before = (np.stack(ray.lights[0])[:, :, 0, 0] > 0.5 for ray in rays[1::-1])
        found.append([first & second, second & third, second & lit, first & lit_before])
    found = np.mean(found, 2)  # over the passes: (seeds, pairs, sets)
    ahead = segment(0.3)
    error = found.mean(0) - np.array([ahead**2, ahead**2, ahead / 2, ahead / 2])[:, None]
    assert (abs(error) < 4.5 * np.maximum(found.std(0), 0.02) / np.sqrt(seeds)).all()
    assert found.std(0).min() > 0.02


def test_every_pass_asks_all_of_a_list():
    lists = at.PointLights(np.arange(9.0).reshape(3, 3)), at.PointLights(np.ones((40, 3)), interleave=True)
    passes = diffuse_passes(lists, 5, "sobol")
    for light, samples in zip(lists, passes.lights):
        assert len(samples) == 5 and all(np.array_equal(s, light_samples(light, 5)) for s in samples)


def test_rays_are_those_of_unlimited_ambient_occlusion(seen):
    """Directions equal the ends of its shadow segments of length 1, for receivers at the frame's origin, in float32."""
    _, triangles, gbuffer, origins = seen
    passes = diffuse_passes([QUAD], 3, "halton")
    at_zero = gbuffer._replace(position=np.zeros_like(gbuffer.position))
    samples = [domain_sets(3, "halton", "hemisphere")]
    (query,) = shadow_queries(triangles, at_zero, [at.AmbientOcclusion(1)], samples)
    ends, _ = segments(query._replace(origins=np.zeros_like(origins)))
    there = gbuffer.face >= 0
    for k in range(3):
        rays = diffuse_rays(gbuffer, origins, passes.directions[k])
        assert rays.directions.dtype == np.float32 and rays.directions.flags.c_contiguous
        directions = rays.directions.reshape(origins.shape)
        np.testing.assert_array_equal(directions[there], ends[:, :, k][there])
        assert not directions[~there].any() and (~there).any()
        np.testing.assert_allclose(np.linalg.norm(directions[there], axis=1), 1, atol=1e-6)
        assert ((directions * gbuffer.normal).sum(-1)[there] > 0).all()
        np.testing.assert_array_equal(rays.origins.reshape(origins.shape), origins)
        np.testing.assert_array_equal(rays.skip.reshape(there.shape), gbuffer.face)


@pytest.mark.parametrize("sampler", ["larcher-pillichshammer", "sobol", "halton", "halton:full"])
def test_directions_are_as_dense_as_their_cosine_is_large(seen, sampler):
    _, _, gbuffer, origins = seen
    passes = diffuse_passes([QUAD], 64, sampler)
    there = gbuffer.face >= 0
    cosines = [
        (diffuse_rays(gbuffer, origins, d).directions.reshape(origins.shape) * gbuffer.normal).sum(-1)[there]
        for d in passes.directions
    ]
    shares = np.histogram(np.square(cosines), 8, (0, 1))[0] / np.size(cosines)
    assert abs(shares - 1 / 8).max() < 0.02


def test_nearest_hits_are_those_of_any_other_way(seen):
    scene, triangles, gbuffer, origins = seen
    bvh = Renderer(scene).accelerate().bvh
    rays = diffuse_rays(gbuffer, origins, diffuse_passes([QUAD], 2, "halton").directions[1])
    asks = gbuffer.face.ravel() >= 0
    face, t = nearest_hits(bvh, *rays)
    hit = scene.closest_hit(rays.origins[asks] + scene.origin, rays.directions[asks], skip_face=rays.skip[asks])
    np.testing.assert_array_equal(face[asks], hit.face)
    np.testing.assert_array_equal(t[asks], hit.t)
    assert (face[~asks] == -1).all() and np.isinf(t[~asks]).all()
    assert 0.1 < (face[asks] >= 0).mean() < 1
    met = hit_surfaces(rays, face, t, gbuffer.face.shape, triangles)
    np.testing.assert_array_equal(met.face.ravel(), face)
    np.testing.assert_array_equal(met.side != 0, met.face >= 0)
    np.testing.assert_array_equal(met.depth.ravel(), t.astype(np.float32))
