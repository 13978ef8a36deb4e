"""Blocker ids against the brute-force oracle."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.datasets.dataset_layers import blockers, has_centre

SCENE = at.procedural("atrium", triangles=1000)
CAMERA = SCENE.cameras[0].resized(24, 16)
LIGHTS = {
    "point": (at.PointLight((1.0, 6.0, 2.0)), (1.0, 6.0, 2.0)),
    "quad": (at.QuadLight((-1.0, 7.0, 1.0), (2.0, 0.0, 0.0), (0.0, 0.5, 4.0)), (0.0, 7.25, 3.0)),
    "disk": (at.DiskLight((0.0, 5.0, 0.0), (1.0, 1.0, 0.0), 0.5), (0.0, 5.0, 0.0)),
    "sphere": (at.SphereLight((2.0, 4.0, -1.0), 0.5), (2.0, 4.0, -1.0)),
    "sun": (at.DirectionalLight((0.3, -1.0, 0.2)), None),
}


def expected(gbuffer, light, centre):
    """(H, W) int: the blockers by their definition, with the oracle's hits."""
    seen = gbuffer.face >= 0
    own, p, n = (values[seen] for values in (gbuffer.face, gbuffer.position, gbuffer.normal))
    p, n = p.astype(np.float64), n.astype(np.float64)
    world = (p + 2.0**-21 * np.abs(p).max(axis=1)[:, None] * n).astype(np.float32) + gbuffer.origin
    towards = np.broadcast_to(-light.direction, p.shape) if centre is None else np.asarray(centre) - world
    far = np.inf if centre is None else 1.0
    vertices = SCENE.triangles().vertices
    start = (world - gbuffer.origin).astype(np.float32)
    _, face = oracle.closest_hit(vertices, start, towards.astype(np.float32), 0.0, far, own)
    out = np.full(seen.shape, -1)
    out[seen] = np.where((n * towards).sum(axis=1) > 0.0, face, own)
    return out


@pytest.mark.parametrize("name", LIGHTS)
def test_blockers_are_those_of_the_oracle(name):
    light, centre = LIGHTS[name]
    frame = at.render(SCENE, CAMERA, light, spp=1)
    found = blockers(SCENE, frame.gbuffer, light, 0.0, None)
    assert found.dtype == np.int32 and (found == expected(frame.gbuffer, light, centre)).all()
    lit, own = found == -1, found == frame.gbuffer.face
    assert lit.any() and own.any() and (~lit & ~own).any()


def test_blockers_agree_with_the_shadow_of_a_point():
    light = LIGHTS["point"][0]
    frame = at.render(SCENE, SCENE.cameras[0].resized(160, 120), light, spp=1)
    found = blockers(SCENE, frame.gbuffer, light, 0.0, None)
    seen = frame.gbuffer.face >= 0
    differ = (found[seen] >= 0) != (frame.bits[0][seen, 0] != 0)
    assert differ.mean() < 0.002  # rays to the centre are rounded, and shadow rays are not


def test_a_plan_or_threads_change_no_blocker():
    light = LIGHTS["quad"][0]
    frames = [at.render(SCENE, CAMERA, light, spp=1, plan=plan) for plan in ("bsah+single", "bsah+multifrusta")]
    found = [blockers(SCENE, f.gbuffer, light, 0.0, threads) for f, threads in zip(frames, (1, 2))]
    assert (found[0] == found[1]).all()


def test_the_background_has_no_blocker():
    camera = at.Camera((0, 500, 0), (0, 1000, 0), (0, 0, 1), width=4, height=3)
    frame = at.render(SCENE, camera, LIGHTS["point"][0], spp=1)
    assert (blockers(SCENE, frame.gbuffer, LIGHTS["point"][0], 0.0, None) == -1).all()


def test_ambient_light_and_lists_have_no_centre():
    assert not has_centre(at.AmbientOcclusion()) and not has_centre(at.PointLights([[0.0, 0.0, 0.0]]))
    assert all(has_centre(light) for light, _ in LIGHTS.values())
