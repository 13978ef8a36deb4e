"""Cut-outs against brute force in rational arithmetic, by every plan."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.engine.plan import covering_plans
from asking import answer, query_of, true_occlusion
from cutout_scenes import meets, scene_with_cutouts, true_shadows

LIGHTS = {
    "quad": at.QuadLight((-2, 5, -2), (4, 1, 0), (0, 0, 4)),
    "point": at.PointLight((0.5, 5, 0.25)),
    "ambient": at.AmbientOcclusion(),
    "suns": at.DirectionalLights(np.random.default_rng(2).normal((0.2, -1, 0), 0.3, (21, 3))),
}


@cache
def case(name):
    scene = scene_with_cutouts()
    triangles, query = query_of(scene, at.Camera((0, 2, 9), (0, 0.5, 0), width=20, height=14), LIGHTS[name], 8)
    truth, active = true_shadows(triangles, query)
    solid = true_occlusion(triangles, query)[0]
    assert 0.05 < truth[active].mean() < 0.95 and (solid & ~truth).sum() > 20 and (truth & active).sum() > 20
    return triangles, query, truth


@pytest.mark.parametrize("plan", [p for p in covering_plans()], ids=str)
def test_every_plan_sees_through_holes(plan):
    triangles, query, truth = case("quad")
    assert np.array_equal(answer(str(plan), triangles, query), truth)


@pytest.mark.parametrize("light", [name for name in LIGHTS if name != "quad"])
def test_every_kind_of_light_shines_through_holes(light):
    triangles, query, truth = case(light)
    assert np.array_equal(answer("bsah+multifrusta", triangles, query), truth)


def nearest(triangles, origins, directions):
    """(face, t) by brute force."""
    hits = [[] for _ in origins]
    far = origins + directions.astype(np.float64) * 100
    for i, row in enumerate(oracle.all_hits(triangles.vertices, origins, far.astype(np.float32))):
        along = oracle.rational(directions[i])
        for f in np.flatnonzero(row):
            found = oracle.meets_exactly(origins[i], directions[i], triangles.vertices[f])
            if found[0] and meets(triangles, origins[i], along, int(f)):
                hits[i].append((float(found[1]), int(f)))
    return zip(*(min(each, default=(np.inf, -1)) for each in hits))


def test_rays_pass_through_holes():
    scene, rng = scene_with_cutouts(), np.random.default_rng(5)
    origins = rng.uniform((-3, -0.5, -3), (3, 3, 3), (700, 3)).astype(np.float32)
    directions = rng.normal(size=(700, 3)).astype(np.float32)
    triangles = scene.triangles()
    t, face = nearest(triangles, (origins - scene.origin).astype(np.float32), directions)
    hit = scene.closest_hit(origins, directions)
    assert np.array_equal(hit.face, face) and np.allclose(hit.t, t, rtol=1e-6)
    cut = np.isin(hit.face, scene.cutouts.faces)
    assert cut.sum() > 20 and (hit.face < 0).sum() > 20
    assert np.array_equal(scene.occluded(origins, directions), hit.face >= 0)
    edges = scene.triangles().vertices[hit.face[cut]].astype(np.float64)
    weights = np.stack([1.0 - hit.u - hit.v, hit.u, hit.v], -1)[cut]
    assert np.allclose((weights[..., None] * edges).sum(1) + scene.origin, hit.position[cut], atol=1e-4)


@pytest.mark.parametrize("plan", [None, "bsah+chcrt", "bsah+single"])
def test_cameras_look_through_holes(plan):
    scene = scene_with_cutouts()
    camera = at.Camera((0, 2, 9), (0, 0.5, 0), width=60, height=44)
    light = LIGHTS["quad"]
    seen = [
        at.Renderer(scene, plan, gbuffer=how).render(camera, [light], spp=4, adaptive=4) for how in ("raster", "rays")
    ]
    assert all(np.array_equal(a, b) for a, b in zip(seen[0].gbuffer, seen[1].gbuffer))
    assert np.array_equal(seen[0].image, seen[1].image)
    face = seen[0].gbuffer.face
    rays = camera.rays(scene.origin)
    y, x = np.mgrid[:44, :60]
    along = rays.corner + (x[..., None] + 0.5) * rays.dx + (y[..., None] + 0.5) * rays.dy
    origins = np.broadcast_to(rays.origin.astype(np.float32), (44 * 60, 3))
    truth = list(nearest(scene.triangles(), origins, along.astype(np.float32).reshape(-1, 3)))[1]
    assert np.array_equal(face.ravel(), truth)
    assert np.isin(face, scene.cutouts.faces).sum() > 50


def test_bounced_light_passes_through_holes():
    scene = scene_with_cutouts()
    camera = at.Camera((0, 2, 9), (0, 0.5, 0), width=16, height=12)
    frames = [at.render(scene, camera, [LIGHTS["point"]], plan=p, bounce=4) for p in ("bsah+single", "bsah+chcrt")]
    assert np.array_equal(frames[0].indirect, frames[1].indirect)


def test_lines_of_sight_pass_through_holes():
    scene, rng = scene_with_cutouts(), np.random.default_rng(8)
    begin, end = (rng.uniform((-3, -0.9, -3), (3, 3, 3), (400, 3)).astype(np.float32) for _ in range(2))
    seen = at.line_of_sight(scene, begin, end)
    blocked = scene.occluded(begin, end - begin, tmax=1.0)
    assert (seen.visible == ~blocked).mean() > 0.99  # float32 directions end beside the points
    assert np.isin(seen.face, scene.cutouts.faces).sum() > 10
    bits = at.visibility(scene, begin, at.PointLights(end), plan="bsah+single").seen_samples
    assert np.array_equal(np.diagonal(bits), seen.visible)
