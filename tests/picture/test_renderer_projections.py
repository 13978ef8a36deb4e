"""Orthographic and panoramic cameras: their rays, and frames that no method changes."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.engine.method_registry import TRACERS
from antumbra.query.pixel_refinement import OFFSETS
from devices import device_plans

SIZE = 40, 24
CAMERAS = {
    "orthographic": at.Camera((3, 4, 5), (0, 0.2, 0), width=40, height=24, projection="orthographic", extent=3.0),
    "panoramic": at.Camera((0.3, 0.9, 0.2), (1, 0.4, -2), width=40, height=24, projection="panoramic"),
}
PLANS = [f"bsah+{name}" if tracer.builds else name for name, tracer in TRACERS.items()]


def own_rays(camera, x, y):
    """Origins and directions of rays through places of the picture, in float64, by other formulas."""
    ahead = (camera.target - camera.position) / np.linalg.norm(camera.target - camera.position)
    right = np.cross(ahead, camera.up) / np.linalg.norm(np.cross(ahead, camera.up))
    x, y = (np.asarray(v, float)[..., None] for v in np.broadcast_arrays(x, y))
    if camera.projection == "orthographic":
        above = np.cross(right, ahead)
        u, v = (x - camera.width / 2) / camera.height, (camera.height / 2 - y) / camera.height
        return camera.position + camera.extent * (u * right + v * above), np.broadcast_to(ahead, (*u.shape[:-1], 3))
    level = np.cross(camera.up, right)
    longitude, latitude = 2 * np.pi * x / camera.width - np.pi, np.pi / 2 - np.pi * y / camera.height
    flat = np.cos(longitude) * level + np.sin(longitude) * right
    directions = np.cos(latitude) * flat + np.sin(latitude) * camera.up
    return np.broadcast_to(camera.position, directions.shape), directions


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(7)
    soup = rng.normal(size=(150, 1, 3)) * (1.5, 0.6, 1.5) + 0.3 * rng.normal(size=(150, 3, 3))
    floor = np.array([[[-4.0, -2, -4], [-4, -2, 4], [4, -2, 4]], [[-4, -2, -4], [4, -2, 4], [4, -2, -4]]])
    return at.Scene.from_arrays(np.concatenate([soup, floor]), colours=rng.random((152, 3)))


LIGHTS = [at.SphereLight((1, 5, 2), 0.4, intensity=20.0), at.Sky()]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_each_pixel_sees_what_its_ray_meets_first(scene, camera):
    frame = at.render(scene, camera, LIGHTS, spp=1)
    triangles = scene.triangles()
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height)[:, None] + 0.5
    listed = camera.view(scene.origin)
    found = [part.reshape(-1, 3) for part in listed.through(x, y)]
    for mine, truth in zip(found, own_rays(camera, x, y)):
        shift = scene.origin if mine is found[0] else 0.0
        np.testing.assert_allclose(mine, truth.reshape(-1, 3) - shift, atol=1e-6)
    t, faces = oracle.closest_hit(triangles.vertices, *found)[:2]
    np.testing.assert_array_equal(frame.gbuffer.face.ravel(), faces)
    np.testing.assert_allclose(frame.gbuffer.depth.ravel(), np.where(faces >= 0, t, np.inf), rtol=1e-5)
    assert 0.2 < frame.mask.mean() < 0.95


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("plan", [*PLANS, "grid32+bsah+multifrusta", "grid32+cones", "auto", *device_plans(text=True)])
def test_no_plan_changes_the_picture(scene, camera, plan):
    how = dict(spp=4, adaptive=16, filter=True, layers=True)
    first, frame = (at.render(scene, camera, LIGHTS, plan=each, **how) for each in ("bsah+single", plan))
    for name, a, b in zip(at.GBuffer._fields, first.gbuffer, frame.gbuffer):
        np.testing.assert_array_equal(a, b, err_msg=name)
    for a, b in zip(first.bits, frame.bits):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(first.image, frame.image)
    np.testing.assert_array_equal(first.coverage, frame.coverage)
    assert first.refined.any() and ((first.coverage > 0) & (first.coverage < 1)).any()


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_store_gives_the_same_picture(scene, camera, tmp_path):
    at.build_store(scene, tmp_path / "s.antumbra")
    stored, how = at.load(tmp_path / "s.antumbra"), dict(spp=4, adaptive=16, bounce=2)
    memory, paged = (at.render(each, camera, LIGHTS[:1], **how) for each in (scene, stored))
    for name in ("position", "normal", "face", "depth", "side"):
        np.testing.assert_array_equal(getattr(memory.gbuffer, name), getattr(paged.gbuffer, name), err_msg=name)
    np.testing.assert_array_equal(memory.image, paged.image)
    assert memory.indirect.any()


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_sub_pixels_of_edges_are_within_their_pixels(scene, camera):
    frame = at.render(scene, camera, LIGHTS, spp=1, adaptive=16)
    at_edges = np.argwhere((frame.coverage > 0) & (frame.coverage < 1))
    for y, x in at_edges[:20]:
        origins, directions = own_rays(camera, x + OFFSETS[..., 0], y + OFFSETS[..., 1])
        hit = scene.closest_hit(origins, directions)
        assert abs((hit.face >= 0).mean() - frame.coverage[y, x]) <= 1 / 16
    assert len(at_edges) > 5


def test_an_empty_panorama_is_the_map_of_the_sky():
    image = np.random.default_rng(3).random((16, 32, 3))
    sky = at.Sky(image)
    scene = at.Scene.from_arrays(np.array([[[0, 90.0, 0], [1e-3, 90, 0], [0, 90, 1e-3]]]))
    camera = at.Camera((0, 0, 0), (0, 0, -1), width=32, height=16, projection="panoramic")
    np.testing.assert_allclose(at.render(scene, camera, sky, spp=1).image, image, atol=1e-5)


def test_the_pixels_of_an_orthographic_picture_have_one_width(scene):
    camera = CAMERAS["orthographic"]
    back = 30.0 * camera.axes[2]
    far = at.Camera(camera.position - back, camera.target, width=40, height=24, projection="orthographic", extent=3.0)
    near, away = (at.render(scene, each, LIGHTS[:1], spp=4, adaptive=4, filter=True) for each in (camera, far))
    assert (near.refined != away.refined).mean() < 0.01 and near.refined.any()
    np.testing.assert_allclose(away.image, near.image, atol=0.02 * near.image.max())


@pytest.mark.parametrize(
    "given, says",
    [
        (dict(projection="fisheye"), "fisheye"),
        (dict(projection="orthographic"), "extent"),
        (dict(projection="orthographic", extent=0), "extent"),
        (dict(projection="panoramic", extent=2.0), "extent"),
        (dict(extent=2.0), "extent"),
    ],
)
def test_bad_projections(given, says):
    with pytest.raises(at.InputError, match=says):
        at.Camera((0, 0, 0), (0, 0, -1), **given)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_methods_for_perspective_cameras_alone_say_so(camera):
    with pytest.raises(at.InputError, match=f"perspective camera, and the camera is {camera.projection}"):
        camera.rays(np.zeros(3))


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("kind", ["orthographic", "top", "panoramic"])
def test_default_cameras_show_the_scene(scene, up, kind):
    turned = at.Scene.from_arrays(scene.triangles().vertices + scene.origin + (5e3, 0, 0), up=up)
    camera = turned.default_camera(90, 60, kind)
    frame = at.render(turned, camera, [at.AmbientOcclusion(1.0)], spp=1)
    assert (camera.width, camera.height) == (90, 60)
    assert frame.mask.mean() > (0.01 if kind == "panoramic" else 0.1)
    assert not frame.mask[[0, -1]].any() and not frame.mask[:, [0, -1]].any()
    if kind == "top":
        np.testing.assert_array_equal(camera.up, (0, 0, -1) if up == "y" else (0, 1, 0))
    with pytest.raises(at.InputError, match="fisheye"):
        turned.default_camera(kind="fisheye")
