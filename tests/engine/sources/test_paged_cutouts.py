"""A store of a scene whose faces let light pass gives the answers of the scene in memory, to every query."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.renderer import Renderer
from antumbra.store.chunk_residency import Residency
from cutout_scenes import OPEN_SCENES, rays, same, scene_with_cutouts

CAMERA = at.Camera((0, 2, 9), (0, 0.5, 0), width=36, height=28)
LIGHTS = [at.QuadLight((-2, 5, -2), (4, 1, 0), (0, 0, 4)), at.AmbientOcclusion(3.0), at.Sky()]


@pytest.fixture(scope="module", params=OPEN_SCENES)
def pair(request, tmp_path_factory):
    """(scene in memory, its store, of many chunks)."""
    scene = OPEN_SCENES[request.param]()
    path = tmp_path_factory.mktemp("cutouts") / "a.antumbra"
    at.build_store(scene, path, chunk=16)
    stored = at.load(path)
    assert scene.cutouts is not None and len(scene.cutouts.faces) > 10
    gone = np.zeros(scene.n_triangles, bool) if scene.data.hidden is None else scene.data.hidden
    assert np.array_equal(stored.cutouts.faces, scene.cutouts.faces[~gone[scene.cutouts.faces]])
    return scene, stored


@pytest.mark.parametrize("cull", [None, "back"])
def test_rays_meet_what_they_meet_in_memory(pair, cull):
    scene, stored = pair
    origins, directions = rays()
    skip = np.random.default_rng(1).integers(-1, scene.n_triangles, len(origins))
    limits = {"tmin": 0.1, "tmax": 50.0, "skip_face": skip, "cull_faces": cull}
    blocked = scene.occluded(origins, directions, **limits)
    np.testing.assert_array_equal(stored.occluded(origins, directions, **limits), blocked)
    hit, right = (each.closest_hit(origins, directions, **limits) for each in (stored, scene))
    same(hit, right)
    same((hit.position, hit.normal, hit.corners), (right.position, right.normal, right.corners))
    assert np.isin(right.face, scene.cutouts.faces).any() or not blocked.any() or scene.cutouts.depths[:, 3].max() == 0
    targets = origins + directions
    np.testing.assert_array_equal(*(each.occluded(origins, targets=targets) for each in (stored, scene)))


@pytest.mark.parametrize("most", [None, 2])
def test_all_hits_are_those_in_memory(pair, most):
    scene, stored = pair
    same(*(each.all_hits(*rays(), max_hits=most) for each in (stored, scene)))
    same(*([each.count_hits(*rays())] for each in (stored, scene)))


def test_pictures_have_the_visibility_of_memory(pair):
    scene, stored = pair
    frame, right = (at.render(each, CAMERA, LIGHTS, spp=4, threads=2) for each in (stored, scene))
    for name in ("position", "normal", "face", "depth", "side"):
        np.testing.assert_array_equal(getattr(frame.gbuffer, name), getattr(right.gbuffer, name))
    same(frame.bits, right.bits)
    np.testing.assert_array_equal(frame.image, right.image)
    assert np.isin(right.gbuffer.face, scene.cutouts.faces).any() or scene.cutouts.depths[:, 3].max() == 0


def test_light_that_bounces_meets_what_it_meets_in_memory(pair):
    scene, stored = pair
    frame, right = (at.render(each, CAMERA.resized(16, 12), LIGHTS[0], spp=2, bounce=2) for each in (stored, scene))
    np.testing.assert_array_equal(frame.indirect, right.indirect)
    assert right.indirect.any() or scene.cutouts.depths[:, 3].max() == 0


def test_points_see_lights_as_they_do_in_memory(pair):
    scene, stored = pair
    points = np.random.default_rng(3).uniform((-4, -0.9, -4), (4, 2.0, 4), (300, 3))
    for light in LIGHTS[:2]:
        found, right = (at.visibility(each, points, light, (0, 1, 0), spp=20) for each in (stored, scene))
        np.testing.assert_array_equal(found.bits, right.bits)
        np.testing.assert_array_equal(found.fraction, right.fraction)
        assert 0.0 < right.fraction.mean() < 1.0


def test_sun_hours_and_skylines_are_those_in_memory(pair):
    scene, stored = pair
    points = np.random.default_rng(3).uniform((-4, -0.9, -4), (4, -0.5, 4), (20, 3))
    settings = {"place": at.Place(47.0, 8.0, timezone="UTC"), "step": 60}
    tables = [at.sun_hours(each, points, "2026-01-15,2026-07-15", **settings) for each in (stored, scene)]
    for name in tables[1].columns:
        np.testing.assert_array_equal(tables[0][name], tables[1][name])
    lines = [at.skyline(each, points, azimuth_step=30.0) for each in (stored, scene)]
    np.testing.assert_array_equal(lines[0].elevation, lines[1].elevation)


def test_chunks_that_leave_memory_change_nothing(tmp_path):
    """Bands of a picture read chunks again, and each is shown with the cut-outs in front of it."""
    scene = scene_with_cutouts(400)
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    renderer = Renderer(at.load(tmp_path / "a.antumbra"), None, 2)
    paged = renderer.source
    paged.residency = Residency(paged.store, paged.residency.min_budget())
    paged.accelerated.prepared.parts = paged.accelerated.prepared.parts._replace(
        trees=paged.residency.trees, memory=paged.residency
    )
    paged.budget = lambda *_: paged.residency.budget
    camera, options = CAMERA.resized(18, 14), {"spp": 4, "adaptive": 16, "filter": True}
    frame, right = (each.render(camera, LIGHTS, **options) for each in (renderer, Renderer(scene, "bsah+single", 2)))
    np.testing.assert_array_equal(frame.gbuffer.face, right.gbuffer.face)
    same(frame.bits, right.bits)
    np.testing.assert_array_equal(frame.image, right.image)
    assert frame.paging["loaded"] > len(paged.store)


def test_an_orthographic_camera_sees_what_it_sees_in_memory(tmp_path):
    scene = scene_with_cutouts(90)
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    camera = at.Camera((0, 2, 9), (0, 0.5, 0), width=36, height=28, projection="orthographic", extent=6.0)
    frames = [at.render(each, camera, LIGHTS[:1], spp=4) for each in (at.load(tmp_path / "a.antumbra"), scene)]
    same(frames[0].bits, frames[1].bits)
    np.testing.assert_array_equal(frames[0].gbuffer.face, frames[1].gbuffer.face)
