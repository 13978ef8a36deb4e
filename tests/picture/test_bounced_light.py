"""Light that bounces several times: closed forms of its amount, and the same bits by any plan and source."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.store_building import build_store
from antumbra.picture.renderer import Renderer

ALBEDO, CANDELA, RADIUS = 0.6, 5.0, 2.0


def _ball(level=4):
    """(n, 3, 3): the triangles of a sphere, from an octahedron whose faces are divided again and again."""
    signs = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)])
    corners = signs[:, :, None] * np.eye(3)
    for _ in range(level):
        a, b, c = corners.swapaxes(0, 1)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.concatenate([np.stack(f, 1) for f in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return RADIUS * corners / np.linalg.norm(corners, axis=-1, keepdims=True)


def _furnace(turn=0.0, other=None):
    """(scene, camera, light) inside a closed diffuse ball with a light in its middle; the upper half may be `other`."""
    corners = _ball()
    s, c = np.sin(np.radians(turn)), np.cos(np.radians(turn))
    albedo = np.full((len(corners), 3), ALBEDO)
    albedo[corners[..., 1].mean(1) > 0.0] = ALBEDO if other is None else other
    rotated = corners @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    scene = at.Scene.from_arrays(rotated, colours=albedo)
    camera = at.Camera((0.1, 0.2, -0.1), (1, 0.1, 0.5), vfov=100, width=20, height=16)
    return scene, camera, at.PointLight((0, 0, 0), intensity=CANDELA)


def _series(albedo, n):
    """The irradiance that has met 1 to n surfaces, inside a ball whose mean albedo is `albedo`."""
    a, b, c = _ball().swapaxes(0, 1)
    direct = 4.0 * np.pi * CANDELA / (np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)
    return direct * albedo * (1.0 - albedo**n) / (1.0 - albedo)


@pytest.mark.parametrize("turn", [0.0, 90.0])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_light_in_a_furnace_is_a_geometric_series(n, turn):
    scene, camera, light = _furnace(turn)
    found = at.render(scene, camera, light, spp=1, bounce=4, bounces=n, filter=False).indirect
    np.testing.assert_allclose(found, _series(ALBEDO, n), rtol=0.01)  # facets are nearer in their middle
    once = at.render(scene, camera, light, spp=1, bounce=4, filter=False).indirect
    np.testing.assert_allclose(found.mean() / once.mean(), _series(ALBEDO, n) / _series(ALBEDO, 1), rtol=2e-3)


@pytest.mark.parametrize("turn", [0.0, 90.0])
def test_each_surface_of_a_path_takes_its_own_share(turn):
    """Every point of a ball sees all others equally, so the mean albedo counts; shares of one colour would not do."""
    scene, camera, light = _furnace(turn, other=0.1)
    found = at.render(scene, camera, light, spp=1, bounce=64, bounces=3, filter=False).indirect
    mean = (ALBEDO + 0.1) / 2.0
    np.testing.assert_allclose(found.mean(), _series(mean, 3), rtol=0.02)
    assert abs(_series(mean, 3) / _series(mean, 1) - 1.0) > 0.3


def _cellar():
    scene = at.procedural("cellar", triangles=3000)
    lamp = at.PointLight(scene.cameras[0].position + (0, 1, 0), intensity=3.0)
    many = at.PointLights(scene.lights[0].corner + np.random.default_rng(1).normal(size=(5, 3)), interleave=True)
    return scene, scene.cameras[0].resized(41, 30), [*scene.lights, lamp, many]


OPTIONS = dict(spp=2, bounce=3, bounces=3, sampler="halton", seed=2)


def test_no_plan_and_no_source_changes_a_bit(tmp_path):
    scene, *view = _cellar()
    first = at.render(scene, *view, plan="bsah+single", threads=1, **OPTIONS)
    once = at.render(scene, *view, plan="bsah+single", **OPTIONS | {"bounces": 1})
    assert (first.indirect > once.indirect).mean() > 0.5 and first.rays > 1.5 * once.rays
    build_store([scene], tmp_path / "a.antumbra", chunk=200)
    stored = at.load(tmp_path / "a.antumbra")
    frames = [at.render(scene, *view, plan=p, **OPTIONS) for p in ("auto", "bsah+packet16", "bsah+chcrt")]
    frames.append(at.render(stored, *view, **OPTIONS))
    for frame in frames:
        np.testing.assert_array_equal(frame.indirect, first.indirect)
        np.testing.assert_array_equal(frame.image, first.image)
        assert frame.rays == first.rays


def test_passes_that_are_traced_together_change_no_bit(tmp_path, monkeypatch):
    scene, *view = _cellar()
    build_store([scene], tmp_path / "a.antumbra", chunk=200)
    found = []
    for n in (1, 2, 3):
        renderer = Renderer(at.load(tmp_path / "a.antumbra"), None, 2)
        monkeypatch.setattr(renderer.source, "together", lambda size, n=n: n)
        found.append(renderer.render(*view, **OPTIONS).indirect)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    assert found[0].any()


@pytest.mark.parametrize("step", [1, 2])
def test_bands_change_no_bit(step):
    scene, *view = _cellar()
    options = at.RenderOptions(**OPTIONS, bounce_step=step)
    renderer = Renderer(scene, "bsah+multifrusta", 2)
    request = renderer.request(*view, options)
    rows = renderer.rows(request)
    bands = [rows.band(first, min(first + 8, 30))["indirect"] for first in range(0, 30, 8)]
    made = np.concatenate(bands)
    np.testing.assert_array_equal(made, renderer.rows(request).band(0, 30)["indirect"])
    if step == 1:
        np.testing.assert_array_equal(made, renderer.render(*view, options=options, filter=False).indirect)
    assert made.any()


def test_paths_need_diffuse_rays():
    scene, camera, light = _furnace()
    with pytest.raises(at.InputError, match="bounces is 2, but there are no diffuse rays; add bounce"):
        at.render(scene, camera, light, bounces=2)
