"""Frames: their contents, the agreement of both G-buffers, and errors for input that cannot be rendered."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh.block_tree import BlockTree
from antumbra.generate.procedural_scenes import PROCEDURAL
from antumbra.picture.frame import PHASES
from antumbra.trace.counters import COUNTERS
from antumbra.trace.rays.ray_traversal import BUILT, Ordered

KINDS = list(PROCEDURAL)


@pytest.fixture(scope="module")
def atrium():
    return at.procedural("atrium", triangles=5000)


def _small(scene, width=48, height=36):
    return scene.cameras[0].resized(width, height)


@pytest.mark.parametrize("kind", KINDS)
def test_both_gbuffers_give_the_same_bits(kind):
    scene = at.procedural(kind, triangles=20_000)
    camera = _small(scene, 160, 120)
    raster, rays = (at.render(scene, camera, scene.lights, spp=4, gbuffer=g) for g in ("raster", "rays"))
    for name, a, b in zip(at.GBuffer._fields, raster.gbuffer, rays.gbuffer):
        np.testing.assert_array_equal(a, b, err_msg=name)
    np.testing.assert_array_equal(raster.bits[0], rays.bits[0])
    np.testing.assert_array_equal(raster.image, rays.image)
    assert (raster.gbuffer.face >= 0).mean() > 0.3


def test_a_frame_holds_what_it_promises(atrium):
    lights = [*atrium.lights, at.PointLight((0, 3, 0), intensity=4.0, colour=(1, 0.5, 0.2))]
    frame = at.render(atrium, _small(atrium), lights, spp=70, counters=True)
    assert frame.image.shape == (36, 48, 3) and frame.image.dtype == np.float32
    assert len(frame.visibility) == len(frame.bits) == 2
    seen = frame.gbuffer.face >= 0
    assert frame.rays == seen.sum() * (70 + 1) == frame.counters["rays"]  # samples of the point light are equal
    assert set(frame.timings) == {*PHASES, "total"} and all(s >= 0 for s in frame.timings.values())
    assert frame.timings["total"] == pytest.approx(sum(frame.timings[p] for p in PHASES), rel=1e-6)
    assert set(frame.counters) == set(COUNTERS)
    for v, b in zip(frame.visibility, frame.bits):
        assert v.shape == (36, 48) and v.dtype == np.float32
        assert b.shape == (36, 48, 2) and b.dtype == np.uint64
        assert not (b[..., 1] >> np.uint64(6)).any()
        np.testing.assert_allclose(v, 1 - np.bitwise_count(b).sum(-1) / 70, atol=1e-6)
        assert 0 < v[seen].mean() < 1
    assert np.isfinite(frame.image).all() and (frame.image >= 0).all() and frame.image[seen].mean() > 0


def test_nothing_seen_is_zero_bits_full_visibility_and_black():
    scene = at.Scene.from_arrays(np.eye(3)[None])
    away = at.Camera((5, 5, 5), (9, 9, 9), width=8, height=8)
    frame = at.render(scene, away, at.PointLight((0, 9, 0)), counters=True)
    g = frame.gbuffer
    assert (g.face == -1).all() and np.isinf(g.depth).all() and not g.position.any() and not g.normal.any()
    assert not frame.bits[0].any() and (frame.visibility[0] == 1).all() and not frame.image.any()
    assert frame.rays == 0 == frame.counters["rays"]


def test_the_gbuffer_says_where_surfaces_are():
    scene = at.Scene.from_arrays(
        np.array([[-9.0, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]]), np.array([[0, 1, 2], [0, 2, 3]])
    )
    frame = at.render(scene, at.Camera((0, 4, 0.5), (0, 0, 0), width=9, height=7), at.PointLight((0, 3, 0)))
    g = frame.gbuffer
    assert (g.face >= 0).all()
    np.testing.assert_allclose(g.position[..., 1] + g.origin[1], 0, atol=1e-6)
    np.testing.assert_allclose(g.normal, np.broadcast_to((0, 1, 0), g.normal.shape), atol=1e-6)
    np.testing.assert_allclose(g.depth[3, 4], np.hypot(4, 0.5), rtol=1e-5)
    assert (frame.visibility[0] == 1).all()
    assert set(np.unique(g.face)) == {0, 1}


def test_a_known_shadow():
    """A blocker halfway below a quad light: geometry gives the umbra, the penumbra and the lit floor."""
    quad = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    corners = np.concatenate([quad * 20, quad + (0, 2, 0)])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    scene = at.Scene.from_arrays(corners, faces)
    light = at.QuadLight((-0.5, 4, -0.5), (1, 0, 0), (0, 0, 1))  # umbra: |x| < 1.5; penumbra: up to 2.5
    points = np.zeros((200, 3))
    points[:, 0] = np.linspace(0, 4, 200)
    fraction = at.visibility(scene, points, light, normals=(0, 1, 0), spp=256).fraction
    x = points[:, 0]
    assert (fraction[x < 1.49] == 0).all() and (fraction[x > 2.51] == 1).all()
    inside = (x > 1.5) & (x < 2.5)
    np.testing.assert_allclose(fraction[inside], x[inside] - 1.5, atol=0.02)


def test_animated_lights_and_default_camera_and_light():
    scene = at.Scene.from_arrays(np.eye(3)[None])
    frame = at.render(scene, spp=1)
    assert frame.image.shape == (1024, 1024, 3) and (frame.gbuffer.face >= 0).any()


def test_counters_do_not_depend_on_threads_and_cost_no_bits(atrium):
    named = {"plan": "bsah+multifrusta", "counters": True}
    one, three = (at.render(atrium, _small(atrium), atrium.lights, threads=t, **named) for t in (1, 3))
    off = at.render(atrium, _small(atrium), atrium.lights)
    assert one.counters == three.counters and off.counters is None
    assert one.counters["box_tests"] == 2 * one.counters["nodes"] > 0
    assert one.counters["triangle_tests"] > one.counters["uncertain"] >= one.counters["exact"]
    np.testing.assert_array_equal(one.bits[0], off.bits[0])


def test_progress_is_told(atrium):
    seen = []
    at.render(atrium, _small(atrium), atrium.lights, spp=4, progress=lambda done, total: seen.append((done, total)))
    assert seen and seen[-1][0] == seen[-1][1]


def test_culling_by_facing_only_removes_shadows(atrium):
    full, front, back = (
        at.render(atrium, _small(atrium), atrium.lights, cull_faces=c).bits[0] for c in (None, "front", "back")
    )
    for less in (front, back):
        assert not (less & ~full).any()
    assert (front != full).any() or (back != full).any()


@pytest.mark.parametrize(
    "change, says",
    [
        (dict(spp=0), "spp"),
        (dict(spp=1025), "1024"),
        (dict(plan="nothing"), "bsah"),
        (dict(plan="bsah"), "no tracer"),
        (dict(plan="single"), "no builder"),
        (dict(plan="bsah+bsah+single"), "two builders"),
        (dict(plan="bsah+cones"), "needs no builder"),
        (dict(gbuffer="guess"), "raster"),
        (dict(sampler="dice"), "hammersley"),
        (dict(lights=[]), "lights"),
        (dict(lights=["lamp"]), "light"),
        (dict(camera="front"), "Camera"),
        (dict(threads=0), "threads"),
        (dict(threads=1.5), "threads"),
        (dict(cull_faces="up"), "cull_faces"),
        (dict(bounce=0), "bounce"),
        (dict(bounce=1025), "1024"),
        (dict(bounce=2.5), "bounce"),
        (dict(bounce=2, lights=at.AmbientOcclusion()), "AmbientOcclusion dims .* leave"),
        (dict(bounce=2, lights=at.PointLights([(0, 1, 0)], indirect=True)), "PointLights .* leave"),
        (dict(bounce=2, sampler="dice"), "halton:full"),
        (dict(time=float("nan")), "time"),
    ],
)
def test_bad_arguments_are_named(atrium, change, says):
    args = dict(camera=_small(atrium), lights=atrium.lights) | change
    with pytest.raises(at.InputError, match=says) as error:
        at.render(atrium, **args)
    assert "\n" not in str(error.value)


def _accelerated(scene, plan):
    return scene.engine.with_options(plan, 1, None).accelerated()


@pytest.mark.parametrize("frames", [0, -1, 1.5, True, "2", None])
def test_expected_frames_are_a_positive_number(atrium, frames):
    with pytest.raises(at.InputError, match=r"frames is .*; it must be a whole number from 1"):
        at.Renderer(atrium).expect(frames)


def test_plans_of_one_builder_share_what_it_built(atrium):
    """For one time, a builder's tree is built once. Only the tracer's own structure is made for each plan."""
    one, other = (_accelerated(atrium, plan) for plan in ("bsah+single", "bsah+multifrusta"))
    assert one.bvh is other.bvh and one.triangles is other.triangles
    assert one.prepared == Ordered(one.bvh, BUILT) and isinstance(other.prepared, BlockTree)
    assert atrium.engine.with_options("bsah+single", 1, None).accelerated() is one


def test_a_plan_without_a_builder_has_no_bvh(atrium):
    one, other, walked = (_accelerated(atrium, plan) for plan in ("cones", "cones:sorted:spheres", "bsah+single"))
    assert one.bvh is other.bvh is None and one.triangles is other.triangles and walked.bvh is not None
    assert np.shares_memory(one.prepared.corners, one.triangles.vertices)
    np.testing.assert_array_equal(one.prepared.ids, np.arange(atrium.n_triangles))
    assert one.prepared.corners.shape == (atrium.n_triangles, 9) and one.prepared.ids.dtype == np.int32
    assert atrium.engine.with_options("cones:spheres:sorted", 1, None).accelerated() is other


@pytest.mark.parametrize("plan", ["bsah+single", "bsah+wide"])
def test_samples_where_their_receiver_is_are_seen_at_once(atrium, plan):
    """No triangle lies between two equal points. Float32 cannot decide such segments, so all tests would be exact."""
    light = at.AmbientOcclusion(1e-12)
    frame = at.render(atrium, _small(atrium, 16, 12), light, spp=4, plan=plan, counters=True)
    assert frame.rays > 0 and not frame.bits[0].any()
    assert frame.counters["exact"] < frame.rays
    bits = at.render(atrium, _small(atrium, 16, 12), light, spp=4, plan="bsah+multifrusta").bits
    np.testing.assert_array_equal(frame.bits, bits)


CULLED = [
    dict(),
    dict(gbuffer="rays"),
    dict(adaptive=16, filter=True),
    dict(cull_faces="back", spp=3),
    dict(lights="many"),
]


def _lit(scene, options):
    """The arguments of `render` for one of CULLED, with all kinds of lights."""
    sun, lamp = at.DirectionalLight((0.3, -1, 0.2), intensity=2.0), at.PointLight(scene.cameras[0].position + (0, 1, 0))
    lists = at.PointLights(scene.lights[0].corner + np.random.default_rng(1).normal(size=(40, 3)), interleave=True)
    lights = [*scene.lights, sun, lamp] if "lights" not in options else [lists, at.AmbientOcclusion(0.5), lamp]
    return dict(spp=5) | options | dict(lights=lights)


@pytest.mark.parametrize("options", CULLED, ids=str)
@pytest.mark.parametrize("kind", ["cellar", "city"])
def test_frames_of_a_culled_scene_are_the_same(kind, options):
    scene = at.procedural(kind, triangles=8000)
    options = _lit(scene, options)
    whole = at.render(scene, _small(scene), plan="bsah+multifrusta", **options)
    for plan in ("grid32+bsah+multifrusta", "grid64+bsah+single"):
        culled = at.render(scene, _small(scene), plan=plan, **options)
        np.testing.assert_array_equal(culled.image, whole.image)
        for a, b in zip(culled.bits, whole.bits):
            np.testing.assert_array_equal(a, b)
        assert culled.timings["cull"] > 0.0 == whole.timings["cull"]
    assert whole.image.any()


@pytest.mark.parametrize("options", CULLED, ids=str)
def test_frames_without_a_bvh_are_the_same(options):
    scene = at.procedural("cellar", triangles=4000)
    options = _lit(scene, options)
    plain = at.render(scene, _small(scene), plan="bsah+single", **options)
    for plan in ("cones", "grid32+cones"):
        frame = at.render(scene, _small(scene), plan=plan, **options)
        np.testing.assert_array_equal(frame.image, plain.image)
        for a, b in zip(frame.bits, plain.bits):
            np.testing.assert_array_equal(a, b)
        assert (frame.timings["cull"] > 0.0) == plan.startswith("grid32")
    assert plain.image.any()


@pytest.mark.parametrize("plan", ["grid32+bsah+single", "cones", "grid32+cones"])
def test_points_ask_by_every_kind_of_plan(atrium, plan):
    rng = np.random.default_rng(3)
    points, light = rng.uniform(*atrium.bounds, (300, 3)), at.SphereLight(atrium.bounds.mean(0), 0.5)
    whole, other = (at.visibility(atrium, points, light, plan=p).bits for p in ("bsah+single", plan))
    np.testing.assert_array_equal(other, whole)
    assert 0 < np.bitwise_count(whole).sum() < 300 * 16


@pytest.mark.parametrize("plan", ["lbvh+refit+single", "grid32+lbvh+refit+single", "grid64+tl-lbvh+refit+multifrusta"])
@pytest.mark.parametrize("options", [dict(), dict(gbuffer="rays", adaptive=8)], ids=str)
def test_a_tree_that_is_kept_follows_the_mesh(tmp_path, plan, options):
    rng = np.random.default_rng(4)
    faces = rng.integers(0, 900, (600, 3))
    frames = rng.uniform(-1, 1, (900, 3)) + np.linspace(0, 1, 5)[:, None, None] ** 2 * rng.normal(size=(900, 3))
    np.save(tmp_path / "frames.npy", frames.astype(np.float32))
    np.save(tmp_path / "faces.npy", faces.astype(np.uint32))
    scene = at.load(tmp_path)
    camera, light = at.Camera((0, 1, 4), (0, 0, 0), width=32, height=24), at.SphereLight((0, 4, 0), 0.3)
    gbuffer = {"gbuffer": options.pop("gbuffer")} if "gbuffer" in options else {}
    kept, anew = at.Renderer(scene, plan, **gbuffer), at.Renderer(scene, "lbvh+single")
    for time in np.linspace(0, scene.duration, 6):
        a, b = (r.render(camera, light, spp=4, time=time, **options) for r in (kept, anew))
        np.testing.assert_array_equal(a.bits[0], b.bits[0])
        np.testing.assert_array_equal(a.image, b.image)
    assert b.bits[0].any()
