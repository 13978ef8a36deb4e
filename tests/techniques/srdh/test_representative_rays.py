"""The representative rays of the builder `srdh`. They change no bit."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.plan import parse_plan, with_sample
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import segments
from antumbra.techniques.culling.pre_bvh_culling import solid_count
from antumbra.techniques.srdh.representative_rays import fewer_samples
from asking import query_of

SIZE = (40, 30)
SPP = 4


@pytest.fixture(scope="module")
def scene():
    return at.procedural("cellar", triangles=3000)


@pytest.fixture(scope="module")
def camera(scene):
    return scene.cameras[0].resized(*SIZE)


@pytest.fixture(scope="module")
def plain(scene, camera):
    frame = at.render(scene, camera, scene.lights[0], spp=SPP, plan="bsah+single")
    assert 0 < np.bitwise_count(frame.bits[0]).sum() < SPP * frame.gbuffer.face.size
    return frame


@pytest.fixture
def given(monkeypatch):
    """The builder's input: (vertices, rays) of each build."""
    builds, real = [], BUILDERS["srdh"]

    def build(vertices, threads=None, *, rays, **options):
        builds.append((vertices, rays))
        return real.build(vertices, threads, rays=rays, **options)

    monkeypatch.setitem(BUILDERS, "srdh", real._replace(build=build))
    return builds


def sampled(plan, rays):
    """A plan whose builder is shown these rays."""
    return with_sample([parse_plan(plan)], rays)[0]


def render(scene, camera, plan="srdh+single", srdh_rays=None, **options):
    return at.render(scene, camera, scene.lights[0], **dict(spp=SPP, plan=sampled(plan, srdh_rays)) | options)


def as_matrix(rays, n):
    out = np.zeros((len(rays.origins), n), bool)
    out[np.repeat(np.arange(len(out)), np.diff(rays.first)), rays.prims] = True
    return out


def rows(origins, ends):
    return {o.tobytes() + e.tobytes() for o, e in zip(origins, ends)}


def all_rays(scene, camera, spp=SPP, time=0.0):
    """(origins, ends, skip) of all shadow rays of a picture."""
    _, query = query_of(scene, camera, scene.lights[0], spp, time)
    ends, above = segments(query)
    y, x, _ = np.nonzero(above)
    return query.origins[y, x], ends[above], query.faces[y, x]


# The representative rays


def test_all_rays_are_shown_with_all_they_meet(scene, camera, plain, given):
    frame = render(scene, camera, srdh_rays=at.SrdhRays(size=None))
    ((vertices, rays),) = given
    origins, ends, skip = all_rays(scene, camera)
    np.testing.assert_array_equal(rays.origins, origins)
    np.testing.assert_array_equal(rays.ends, ends)
    some = np.random.default_rng(0).choice(len(origins), 500, replace=False)
    truth = oracle.all_hits(vertices, origins[some], ends[some], skip[some])
    np.testing.assert_array_equal(as_matrix(rays, len(vertices))[some], truth)
    assert truth.any(1).mean() > 0.05 and truth.sum(1).max() > 1
    np.testing.assert_array_equal(frame.bits[0], plain.bits[0])


@pytest.mark.parametrize("asked, spp", [(None, SPP), (at.SrdhRays(), 40), (at.SrdhRays(5, spp=2), SPP)], ids=str)
def test_few_rays_of_all_are_shown(scene, camera, given, asked, spp):
    render(scene, camera, spp=spp, srdh_rays=asked)
    ((_, rays),) = given
    size, most = (asked or at.SrdhRays()).size, (asked or at.SrdhRays()).spp
    assert 0.2 < len(rays.origins) / (size * size * min(spp, most)) <= 1
    here = {o.tobytes() for o in all_rays(scene, camera, spp)[0]}
    assert {o.tobytes() for o in rays.origins} <= here
    assert (len(np.unique(rays.origins, axis=0)) > size * size / 4) and len(np.unique(rays.ends, axis=0)) > 1


def test_fewer_rays_are_shown_where_they_enter_many_boxes(given):
    """The builder's time grows with the boxes that each ray enters. No bit depends on the rays."""
    rng = np.random.default_rng(4)
    points, light = rng.normal(size=(400, 3)), at.QuadLight((0, 9, 0), (1, 0, 0), (0, 0, 1))
    small = rng.normal(size=(1200, 1, 3)) * 4 + rng.normal(size=(1200, 3, 3)) * 0.1
    copies = np.broadcast_to([[-9.0, 4, -9], [9, 4, -9], [0, 4, 9]], (1200, 3, 3))
    shown = []
    for soup in small, copies, copies[:900]:
        scene = at.Scene.from_arrays(soup)
        bits = [at.visibility(scene, points, light, plan=plan).bits for plan in ("srdh+single", "bsah+single")]
        np.testing.assert_array_equal(*bits)
        shown.append(len(given[-1][1].origins))
    assert shown == [1024, 8, 1024]


def test_samples_that_are_left_out_are_others_in_each_set():
    samples = light_samples(at.QuadLight((0, 0, 0), (1, 0, 0), (0, 1, 0)), 16)
    for spp in (1, 5, 16, 99):
        fewer = fewer_samples(samples, spp)
        assert fewer.shape == (16, min(spp, 16), 3) and fewer.flags.c_contiguous
        for few, all_ in zip(fewer, samples):
            assert rows(few, few) <= rows(all_, all_) and len(rows(few, few)) == len(few)
    places = [np.flatnonzero((all_ == few[0]).all(1))[0] for few, all_ in zip(fewer_samples(samples, 1), samples)]
    assert sorted(places) == list(range(16))


def test_segments_of_the_user_are_shown(scene, camera, plain, given):
    rng = np.random.default_rng(2)
    low, high = scene.bounds
    origins, ends = rng.uniform(low, high, (2, 300, 3))
    for plan in ("srdh+single", "grid32+srdh+single"):
        given.clear()
        frame = render(scene, camera, plan, srdh_rays=at.SrdhRays(origins=origins.tolist(), ends=ends))
        ((vertices, rays),) = given
        np.testing.assert_array_equal(rays.origins, (origins - scene.origin).astype(np.float32))
        np.testing.assert_array_equal(rays.ends, (ends - scene.origin).astype(np.float32))
        truth = oracle.all_hits(vertices, rays.origins, rays.ends)
        np.testing.assert_array_equal(as_matrix(rays, len(vertices)), truth)
        np.testing.assert_array_equal(frame.bits[0], plain.bits[0])
        assert truth.any()
    assert len(vertices) < scene.n_triangles


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_of_a_culled_scene_hits_are_counted_in_what_is_left(scene, camera, plain, given, gbuffer):
    frame = render(scene, camera, "grid32+srdh+single", gbuffer=gbuffer, srdh_rays=at.SrdhRays(size=None))
    ((vertices, rays),) = given
    np.testing.assert_array_equal(frame.bits[0], plain.bits[0])
    assert 0 < len(vertices) < scene.n_triangles
    origins, ends, skip = all_rays(scene, camera)
    corners = {v.tobytes(): i for i, v in enumerate(scene.triangles().vertices)}
    kept = np.array([corners[v.tobytes()] for v in vertices])
    some = slice(0, 400)
    truth = oracle.all_hits(scene.triangles().vertices, origins[some], ends[some], skip[some])
    assert truth.any() and not np.delete(truth, kept, axis=1).any()
    np.testing.assert_array_equal(as_matrix(rays, len(vertices))[some], truth[:, kept])


def test_nothing_is_left_of_a_scene(given):
    floor = np.array([[[-9.0, 0, -9], [-9, 0, 9], [9, 0, 9]]])
    scene = at.Scene.from_arrays(floor)
    light, camera = at.PointLight((0, 3, 0)), at.Camera((0, 4, 0.5), (0, 0, 0), width=16, height=16)
    for plan in ("grid32+srdh+single", "srdh+single"):
        assert not at.render(scene, camera, light, plan=plan).bits[0].any()
    away = at.Camera((0, 4, 0.5), (0, 9, 0), width=16, height=16)
    assert not at.render(scene, away, light, plan="srdh:all+single").bits[0].any()
    assert all(len(rays.prims) == 0 for _, rays in given)


# A diffuse bounce


def test_rays_after_a_bounce_are_shown_too(scene, camera, plain, given):
    for bounce in (False, True):
        frame = render(scene, camera, srdh_rays=at.SrdhRays(8, bounce=bounce))
        np.testing.assert_array_equal(frame.bits[0], plain.bits[0])
    (vertices, few), (_, more) = given
    assert len(few.origins) + 30 < len(more.origins) <= 2 * 8 * 8 * SPP
    np.testing.assert_array_equal(more.origins[: len(few.origins)], few.origins)
    others = {o.tobytes() for o in more.origins[len(few.origins) :]}
    assert len(others) > 10 and not others & {o.tobytes() for o in all_rays(scene, camera)[0]}
    truth = oracle.all_hits(vertices, more.origins, more.ends)
    found = as_matrix(more, len(vertices))
    assert (found <= truth).all() and (found != truth).any(1).mean() < 0.05  # only start surfaces differ


def test_a_bounce_of_points_is_refused(scene):
    points = np.random.default_rng(0).uniform(*scene.bounds, (50, 3))
    with pytest.raises(at.InputError, match="srdh_rays requests bounced rays, which only images have"):
        at.visibility(scene, points, scene.lights[0], plan=sampled("srdh+single", at.SrdhRays(bounce=True)))


# From frame to frame


@pytest.fixture
def moving(tmp_path):
    rng = np.random.default_rng(4)
    faces = rng.integers(0, 900, (600, 3))
    frames = rng.uniform(-1, 1, (900, 3)) + np.linspace(0, 1, 5)[:, None, None] ** 2 * rng.normal(size=(900, 3))
    np.save(tmp_path / "frames.npy", frames.astype(np.float32))
    np.save(tmp_path / "faces.npy", faces.astype(np.uint32))
    return at.load(tmp_path)


CAMERA, LIGHT = at.Camera((0, 1, 4), (0, 0, 0), width=32, height=24), at.SphereLight((0, 4, 0), 0.3)


def frames_of(scene, plan, times, **options):
    one = Renderer(scene, plan, **options)
    return [one.render(CAMERA, LIGHT, spp=SPP, time=time) for time in times]


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_the_rays_of_the_last_frame_are_shown_with_what_they_met_then(moving, given, gbuffer):
    times = np.linspace(0, moving.duration, 4)
    asked = at.SrdhRays(size=None, last_frame=True)
    frames = frames_of(moving, sampled("srdh+single", asked), times, gbuffer=gbuffer)
    assert len(given) == 4
    for k, (_, rays) in enumerate(given):
        before = max(k - 1, 0)
        triangles, query = query_of(moving, CAMERA, LIGHT, SPP, times[before])
        ends, above = segments(query)
        y, x, _ = np.nonzero(above)
        np.testing.assert_array_equal(rays.origins, query.origins[y, x])
        np.testing.assert_array_equal(rays.ends, ends[above])
        truth = oracle.all_hits(triangles.vertices, rays.origins[:300], rays.ends[:300], query.faces[y, x][:300])
        assert triangles.solid is not None and not truth[:, np.delete(np.arange(600), triangles.solid)].any()
        np.testing.assert_array_equal(as_matrix(rays, len(triangles.solid))[:300], truth[:, triangles.solid])
        assert truth.any()
    for frame, plain in zip(frames, frames_of(moving, "bsah+single", times)):
        np.testing.assert_array_equal(frame.bits[0], plain.bits[0])


@pytest.mark.parametrize(
    "plan", ["srdh+refit+single", "grid32+srdh+single", "grid32+srdh+refit+single", "srdh:all+refit+multifrusta"]
)
@pytest.mark.parametrize("last_frame", [True, False])
def test_animations_by_other_plans(moving, plan, last_frame):
    times = np.linspace(0, moving.duration, 3)
    frames = frames_of(moving, sampled(plan, at.SrdhRays(last_frame=last_frame, bounce=last_frame)), times)
    for frame, plain in zip(frames, frames_of(moving, "bsah+single", times)):
        np.testing.assert_array_equal(frame.bits[0], plain.bits[0])
        np.testing.assert_array_equal(frame.image, plain.image)
    assert frames[0].bits[0].any()


def test_hits_of_a_frame_of_other_triangles_are_not_shown(scene, moving, given):
    """The number of a renderer's triangles changes from frame to frame, down or up."""
    one = Renderer(scene, sampled("srdh+single", at.SrdhRays(size=None, last_frame=True)))
    cellar, asked = query_of(scene, scene.cameras[0].resized(*SIZE), scene.lights[0], 1)
    soup, other = query_of(moving, CAMERA, LIGHT, 1)
    for triangles, query in ((cellar, asked), (soup, other), (cellar, asked)):
        one.accelerator.tree_for(triangles, [query])
        vertices, rays = given[-1]
        assert len(vertices) == solid_count(triangles) > rays.prims.max() >= 0
        assert rows(rays.origins, rays.ends) <= rows(*_segments(query))
    assert len(soup.vertices) < len(cellar.vertices)


def _segments(query):
    ends, above = segments(query)
    y, x, _ = np.nonzero(above)
    return query.origins[y, x], ends[above]


def test_a_refined_edge_does_not_change_what_the_next_frame_is_shown(given):
    """The tree for edges lacks the blocker: rays of the picture meet it, but rays of edges do not."""
    floor = np.array([[[-12.0, 0, -6], [0, 0, 12], [12, 0, -6]]])
    blocker = np.array([[[-3.0, 4, -3], [-1, 4, -3], [-2, 4, -1]]])
    tent = np.array([[[1.2, 0, 1], [1.6, 0.3, 1.2], [1, 0, 1.5]]])
    above = np.array([[[5, 12, 0], [6, 12, 0], [5, 12, 1.0]]])
    scene = at.Scene.from_arrays(np.concatenate([floor, blocker, tent, above]))
    light, camera = at.PointLight((-2, 8, -2)), at.Camera((0, 3, 0.01), (0, 0, 0), width=40, height=40)
    one = Renderer(scene, sampled("grid128+srdh+single", at.SrdhRays(size=None, last_frame=True)))
    one.render(camera, light, spp=1, adaptive=16)
    blockers = [blocker[0].tobytes() in {(v + scene.origin).tobytes() for v in vertices} for vertices, _ in given]
    assert blockers == [True, False]
    shown = one.accelerator.ray_selector.last
    truth = oracle.all_hits(scene.triangles().vertices, *shown.segments[:3])
    np.testing.assert_array_equal(as_matrix(shown.met, 4), truth)
    assert truth[:, 1].any()


# No bit changes


OPTIONS = [
    dict(gbuffer="rays"),
    dict(adaptive=16, filter=True),
    dict(adaptive=16, filter=True, gbuffer="rays", plan="grid32+srdh+single"),
    dict(cull_faces="back", plan="srdh:distance+single:srdh"),
    dict(plan="srdh:paper+multifrusta"),
    dict(plan=sampled("srdh:all+wide", at.SrdhRays(size=1, spp=1))),
]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_frames_are_the_same(scene, camera, options):
    lights = [*scene.lights, at.DirectionalLight((0.3, -1, 0.2)), at.AmbientOcclusion(0.5, spp=5)]
    options = dict(spp=SPP, plan="srdh+single") | options
    frame, other = (at.render(scene, camera, lights, **options | more) for more in ({}, _without(options)))
    np.testing.assert_array_equal(frame.image, other.image)
    for a, b in zip(frame.bits, other.bits, strict=True):
        np.testing.assert_array_equal(a, b)
    assert frame.image.any() and frame.bits[0].any()


def _without(options):
    return dict(plan="bsah+single", **({"gbuffer": "raster"} if "gbuffer" in options else {}))


def test_points_ask_through_a_tree_that_is_made_for_them(scene, given):
    rng = np.random.default_rng(3)
    points, light = rng.uniform(*scene.bounds, (2000, 3)), at.SphereLight(scene.bounds.mean(0), 0.5)
    plain = at.visibility(scene, points, light, plan="bsah+single").bits
    for plan in ("srdh+single", "grid32+srdh+single"):
        for rays in (None, at.SrdhRays(size=None), at.SrdhRays(origins=points[:9], ends=points[9:18])):
            np.testing.assert_array_equal(at.visibility(scene, points, light, plan=sampled(plan, rays)).bits, plain)
    assert 0 < np.bitwise_count(plain).sum() < 2000 * 16
    assert [len(rays.origins) for _, rays in given] == [256 * 4, 2000 * 4, 9] * 2
    none = at.visibility(scene, np.zeros((0, 3)), light, plan="srdh+single")
    assert none.bits.shape == (0, 1)


# Mistakes


@pytest.mark.parametrize(
    "values, says",
    [
        (dict(size=0), "size is 0; it must be a whole number from 1"),
        (dict(size=2.5), "size is 2.5"),
        (dict(size="16"), "size is '16'"),
        (dict(spp=0), "spp is 0"),
        (dict(spp=1025), "1024"),
        (dict(spp=None), "spp is None"),
        (dict(origins=np.zeros((3, 3))), "origins and ends; give both"),
        (dict(ends=np.zeros((3, 3))), "origins and ends; give both"),
        (dict(origins=np.zeros((3, 3)), ends=np.zeros((2, 3))), r"origins \(3, 3\) and ends \(2, 3\)"),
        (dict(origins=np.zeros(3), ends=np.zeros(3)), r"origins must have shape \(m, 3\), not \(3,\)"),
        (dict(origins=np.zeros((1, 3)), ends=[[0, 0, np.nan]]), "ends hold NaN or infinity"),
        (dict(origins=[[0, 0, 1e38]], ends=np.zeros((1, 3))), r"origins have a coordinate that is not below 4\.3e\+37"),
        (dict(origins=[["x", 0, 0]], ends=np.zeros((1, 3))), "origins must be numbers"),
        (dict(origins=np.zeros((1, 3)), ends=np.ones((1, 3)), bounce=True), "bounce and last_frame say nothing"),
        (dict(origins=np.zeros((1, 3)), ends=np.ones((1, 3)), last_frame=True), "bounce and last_frame say nothing"),
    ],
)
def test_mistakes_are_named(values, says):
    with pytest.raises(at.InputError, match=says) as error:
        at.SrdhRays(**values)
    assert "\n" not in str(error.value)


def test_rays_for_a_plan_that_wants_none(scene, camera):
    with pytest.raises(at.InputError, match=r"srdh_rays is given, but no method in bsah\+multifrusta is ray-guided"):
        render(scene, camera, "bsah+multifrusta", srdh_rays=at.SrdhRays())
    with pytest.raises(at.InputError, match="leave it out, or build by srdh"):
        at.visibility(scene, np.zeros((1, 3)), scene.lights[0], plan=sampled("lbvh+single", at.SrdhRays()))


def test_a_tree_for_nobody_in_particular(scene):
    with pytest.raises(at.InputError, match=r"plan 'srdh\+single': its builder needs sample rays"):
        Renderer(scene, "srdh+single").accelerate()
