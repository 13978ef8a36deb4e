"""Light that bounces once: its amount and colour. No plan changes it."""

import numpy as np
import pytest

import antumbra as at

WHITE, RED = (0.8, 0.8, 0.8), (0.8, 0.1, 0.05)


def _room(colours):
    """A room from -1 to 1. Its walls are quads with these colours: x = -1, x = 1, floor, ceiling, z = -1, z = 1."""
    corners, faces = [], []
    for axis in range(3):
        for end in (-1.0, 1.0):
            quad = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
            faces += [np.array([0, 1, 2]) + 4 * len(corners), np.array([0, 2, 3]) + 4 * len(corners)]
            corners.append(np.insert(quad, axis, end, axis=1))
    return at.Scene.from_arrays(np.concatenate(corners), np.array(faces), colours=np.repeat(colours, 2, axis=0))


def _floor_irradiance(point, colours, n=80):
    """(3,): irradiance of a point on the floor from a candela at the centre, after one bounce, by a sum over walls."""
    u = (np.arange(n) + 0.5) / n * 2 - 1
    flat = np.stack(np.meshgrid(u, u), -1).reshape(-1, 2)
    total = np.zeros(3)
    for wall, colour in enumerate(colours):
        axis, end = wall // 2, wall % 2 * 2.0 - 1.0
        if wall == 2:  # the floor itself
            continue
        q = np.insert(flat, axis, end, axis=1)
        direct = 1 / np.linalg.norm(q, axis=1) ** 3  # the cosine is 1 / distance
        w = q - point
        r = np.linalg.norm(w, axis=1)
        at_wall = np.abs(w[:, axis])
        total += np.asarray(colour) * np.sum(direct * at_wall * w[:, 1] / r**4) * (2 / n) ** 2 / np.pi
    return total


@pytest.mark.parametrize("sampler", ["larcher-pillichshammer", "halton:full", "sobol"])
def test_a_room_gets_what_the_integral_says(sampler):
    colours = [RED, *[WHITE] * 5]
    scene, lamp = _room(colours), at.PointLight((0, 0, 0))
    camera = at.Camera((0, 0.8, 0.01), (0, -1, 0), vfov=50, width=12, height=12)
    frame = at.render(scene, camera, lamp, spp=1, bounce=256, sampler=sampler, plan="bsah+single")
    there = frame.gbuffer.face
    assert set(np.unique(there).tolist()) <= {4, 5}  # the floor fills the picture
    assert frame.indirect.dtype == np.float32 and frame.indirect.shape == (12, 12, 3)
    points = frame.gbuffer.position + frame.gbuffer.origin
    truth = np.apply_along_axis(_floor_irradiance, -1, points, colours)
    np.testing.assert_allclose(frame.indirect, truth, rtol=0.05)
    np.testing.assert_allclose(frame.indirect.mean((0, 1)), truth.mean((0, 1)), rtol=0.01)
    white = at.render(_room([WHITE] * 6), camera, lamp, spp=1, bounce=16, plan="bsah+single").indirect
    assert (white.max(-1) == white.min(-1)).all()
    ratio = frame.indirect[..., 0] / frame.indirect[..., 2]
    left = points[..., 0] < 0
    assert ratio.min() > 1.05 and ratio[left].mean() > ratio[~left].mean() + 0.1  # colour bleeds from the red wall


def test_what_arrives_directly_is_added():
    scene, lamp = _room([WHITE] * 6), at.PointLight((0, 0, 0))
    camera = at.Camera((0, 0.8, 0.01), (0, -1, 0), width=9, height=7)
    frame = at.render(scene, camera, lamp, spp=1, bounce=4, plan="bsah+single")
    dark = at.PointLights([(0, 0, 0)], 0.0, indirect=True)  # instead of ambient light, and black
    direct = at.render(scene, camera, [lamp, dark], spp=1, plan="bsah+single")
    assert frame.rays == 5 * 9 * 7 and direct.indirect is None
    np.testing.assert_allclose(frame.image, direct.image + np.float32(0.8 / np.pi) * frame.indirect, rtol=1e-5)
    np.testing.assert_array_equal(frame.bits[0], direct.bits[0])
    np.testing.assert_array_equal(frame.visibility[0], direct.visibility[0])


@pytest.mark.parametrize("options", [dict(), dict(filter=True, adaptive=16)], ids=str)
def test_where_rays_end_nowhere_there_is_no_light(options):
    floor = np.array([[-9.0, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]])
    scene = at.Scene.from_arrays(floor, np.array([[0, 1, 2], [0, 2, 3]]))
    camera, lamp = at.Camera((0, 4, 9), (0, 0, 0), width=20, height=16), at.PointLight((0, 3, 0))
    options = dict(spp=2, plan="bsah+single", counters=True) | options
    frame = at.render(scene, camera, lamp, bounce=5, **options)
    dark = at.render(scene, camera, [lamp, at.PointLights([(0, 9, 0)], 0.0, indirect=True)], **options)
    assert not frame.indirect.any() and frame.image.any() and (frame.gbuffer.face < 0).any()
    np.testing.assert_array_equal(frame.image, dark.image)
    assert frame.rays == frame.counters["rays"] == at.render(scene, camera, lamp, **options).rays


PLANS = [
    "bsah+multifrusta",
    "lbvh+refit+single",
    "grid32+bsah+multifrusta",
    "grid32+bsah+refit+single",
    "cones",
    "grid32+cones",
]


@pytest.mark.parametrize("options", [dict(), dict(gbuffer="rays", filter=True, adaptive=8)], ids=str)
def test_no_plan_and_no_thread_changes_it(options):
    scene = at.procedural("cellar", triangles=4000)
    lamp = at.PointLight(scene.cameras[0].position + (0, 1, 0), intensity=3.0)
    many = at.PointLights(scene.lights[0].corner + np.random.default_rng(1).normal(size=(20, 3)), interleave=True)
    args = scene, scene.cameras[0].resized(41, 30), [*scene.lights, lamp, many]
    options = dict(spp=2, bounce=3, sampler="halton") | options
    first = at.render(*args, plan="bsah+single", threads=1, **options)
    assert (first.indirect > 0).mean() > 0.5
    for plan in PLANS:
        for threads in (1, 3) if plan == PLANS[0] else (None,):
            frame = at.render(*args, plan=plan, threads=threads, **options)
            np.testing.assert_array_equal(frame.indirect, first.indirect, err_msg=plan)
            np.testing.assert_array_equal(frame.image, first.image, err_msg=plan)
            assert frame.rays == first.rays and (frame.timings["cull"] > 0.0) == plan.startswith("grid")


def test_a_tree_for_shadow_rays_does_not_change_it():
    scene = at.procedural("cellar", triangles=2000)
    args = scene, scene.cameras[0].resized(16, 12), scene.lights
    first = at.render(*args, spp=2, bounce=2, plan="bsah+single")
    for plan in ("srdh+single", "grid32+srdh+single"):
        np.testing.assert_array_equal(at.render(*args, spp=2, bounce=2, plan=plan).image, first.image)
    assert first.indirect.any()


def test_the_filter_smooths_it():
    scene = at.procedural("cellar", triangles=2000)
    args = scene, scene.cameras[0].resized(64, 48), scene.lights
    rough, smooth, truth = (
        at.render(*args, spp=1, plan="bsah+single", bounce=n, filter=f).indirect
        for n, f in ((4, False), (4, True), (256, False))
    )
    assert np.abs(smooth - truth).mean() < 0.6 * np.abs(rough - truth).mean()


def test_progress_is_told_of_each_pass():
    scene = at.procedural("cellar", triangles=2000)
    ends = []
    at.render(
        scene, scene.cameras[0].resized(16, 12), scene.lights[:1], spp=2, plan="bsah+single", bounce=3,
        progress=lambda done, total: ends.append(done == total),
    )  # fmt: skip
    assert sum(ends) >= 4


def _skylit(sky, points, rng):
    """(3,): mean irradiance of points (n, 3) of a white floor before a red wall at z = -1, from random paths."""

    def seen(directions):  # the texels that directions meet
        x, y, z = directions.T
        row = (np.arccos(np.clip(y, -1, 1)) / np.pi * len(sky.map)).astype(int)
        return sky.map[row, ((np.arctan2(x, -z) / (2 * np.pi) + 0.5) * sky.map.shape[1]).astype(int)]

    d = _cosine(np.broadcast_to((0.0, 1, 0), points.shape), rng)
    far = (-1 - points[:, 2:]) / d[:, 2:]
    end = points + far * d
    on_wall = (far[:, 0] > 0) & (end[:, 1] < 3) & (np.abs(end[:, 0]) < 3)
    back = _cosine(np.broadcast_to((0.0, 0, 1), points.shape), rng)
    down = end - end[:, 1:2] / back[:, 1:2] * back
    on_floor = (back[:, 1] < 0) & (np.abs(down[:, 0]) < 3) & (down[:, 2] < 3)
    bounced = np.where(on_floor[:, None], 0.0, np.array(RED) * seen(back))
    return np.pi * np.where(on_wall[:, None], bounced, seen(d)).mean(0)


def _cosine(normals, rng):
    d = rng.normal(size=normals.shape)
    d = normals + 0.999999 * d / np.linalg.norm(d, axis=1, keepdims=True)
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_under_a_sky_all_light_of_one_bounce_arrives_once():
    """Rays that miss see the sky; it is a light, so what they would bring must not be added again."""
    floor = [[-3.0, 0, -3], [3, 0, -3], [3, 0, 3], [-3, 0, 3]]
    wall = [[-3.0, 0, -1], [3, 0, -1], [3, 3, -1], [-3, 3, -1]]
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])
    scene = at.Scene.from_arrays(np.array(floor + wall), faces, np.array([WHITE] * 2 + [RED] * 2))
    image = np.full((4, 8, 3), 0.3) + np.random.default_rng(1).random((4, 8, 3)) * [[[2.0]], [[1.0]], [[0.0]], [[0.0]]]
    sky = at.Sky(image, count=1024)
    camera = at.Camera((0, 1, 0.5), (0, 0, 0), up=(0, 0, -1), vfov=20, width=4, height=4)
    frame = at.render(scene, camera, sky, bounce=128, spp=1, filter=False)
    assert (frame.gbuffer.face < 2).all()
    points = (frame.gbuffer.position + frame.gbuffer.origin).reshape(-1, 3)
    truth = _skylit(sky, np.tile(points, (20_000, 1)), np.random.default_rng(2))
    found = (frame.image / np.float32(0.8) * np.pi).mean((0, 1))
    np.testing.assert_allclose(found, truth, rtol=0.02)
    bounced = frame.indirect.mean((0, 1))
    assert bounced[0] > 0.05 * truth[0] and bounced[0] > 3 * bounced[2]
