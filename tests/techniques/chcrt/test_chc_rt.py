"""CHC+RT gives the answers of all other plans in any state. Closest hits equal those of the rasteriser."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh.block_tree import block_tree
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.plan import parse_plan
from antumbra.picture.renderer import Renderer
from antumbra.query.rasteriser import rasterise
from antumbra.query.ray_passes import RayPass
from antumbra.techniques.chcrt.chc_rt import ChcRtState, camera_hits, nearest_hits
from antumbra.techniques.chcrt.tree_parts import parts_of
from antumbra.techniques.tracer_options import ChcRtOptions
from antumbra.trace.rays.ray_hits import nearest_hits as one_by_one
from antumbra.trace.tree_list import Hits
from asking import answer, query_of

LIGHTS = {
    "quad": at.QuadLight((-2, 9, -2), (4, 0, 0), (0, 0, 4)),
    "sun": at.DirectionalLight((0.3, -1, 0.2)),
    "sphere": at.SphereLight((2, 6, 1), 0.7),
    "point": at.PointLight((1, 5, 2)),
    "sky": at.AmbientOcclusion(3.0),
    "many": at.PointLights([(x, 5, z) for x in range(-3, 4) for z in range(-3, 4)]),
    "huge": at.QuadLight((-60, 30, -60), (120, 0, 0), (0, 0, 120)),
}


OPTIONS = {}, {"tile": 64, "triangles": 1}, {"height": 2}, {"weight": 100.0}, {"batch": 1}


@pytest.fixture(scope="module")
def atrium():
    scene = at.procedural("atrium", triangles=6000)
    return scene, scene.cameras[0].resized(100, 72)


def _scheduled(triangles, /, **options):
    """CHC+RT with many small parts and tiles."""
    options = ChcRtOptions(**{"tile": 32, "triangles": 64, "every": 2} | options)
    return ChcRtState(parts_of(block_tree(BUILDERS["bsah"].build(triangles.vertices, 2), 2), options), options)


def _ask(scheduled, query, spp):
    bits = np.zeros((*query.sides.shape, -(-spp // 64)), np.uint64)
    parse_plan("bsah+chcrt").tracer.trace(scheduled, query, bits, 2, None, None)
    return (bits[..., np.arange(spp) // 64] >> (np.arange(spp) % 64).astype(np.uint64) & np.uint64(1)).astype(bool)


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("spp", [16, 20])
def test_every_light_from_frame_to_frame(atrium, light, spp):
    scene, camera = atrium
    triangles, query = query_of(scene, camera, LIGHTS[light], spp)
    truth = answer(parse_plan("bsah+single"), triangles, query)
    assert 0.01 < truth.mean() < 0.999
    scheduled = _scheduled(triangles)
    assert len(scheduled.parts.trees) > 50
    for _ in range(4):
        scheduled.begin()
        np.testing.assert_array_equal(_ask(scheduled, query, query.samples.shape[1]), truth)
    assert scheduled.statistics[0]["queries"] > 0


def test_a_camera_that_moves(atrium):
    """The visible set of the last frame is only a guess."""
    scene, camera = atrium
    triangles = scene.triangles()
    scheduled, traced = _scheduled(triangles), []
    for k in range(6):
        turned = at.Camera(camera.position, camera.target + [3.0 * k, 0.4 * k, 0], width=100, height=72)
        _, query = query_of(scene, turned, LIGHTS["quad"], 4)
        scheduled.begin()
        np.testing.assert_array_equal(_ask(scheduled, query, 4), answer(parse_plan("bsah+single"), triangles, query))
        hits, (face, t) = (
            _camera(scheduled, turned, triangles),
            rasterise(triangles.vertices.reshape(-1, 9), turned.rays(triangles.origin), 2),
        )
        np.testing.assert_array_equal(hits.face, face)
        np.testing.assert_array_equal(hits.t, t)
        traced.append([entry["traced pairs"] for entry in scheduled.statistics])
    assert len({tuple(n) for n in traced}) > 1


def _camera(scheduled, camera, triangles) -> Hits:
    return camera_hits(scheduled, camera.rays(triangles.origin), 2)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_options_and_threads_change_nothing(atrium, options, threads):
    scene, camera = atrium
    triangles, query = query_of(scene, camera, LIGHTS["quad"], 4)
    scheduled = _scheduled(triangles, **options)
    face, t = rasterise(triangles.vertices.reshape(-1, 9), camera.rays(triangles.origin), 2)
    truth = answer(parse_plan("bsah+single"), triangles, query)
    for _ in range(2):
        scheduled.begin()
        hits = camera_hits(scheduled, camera.rays(triangles.origin), threads)
        np.testing.assert_array_equal(hits.face, face)
        np.testing.assert_array_equal(hits.t, t)
        np.testing.assert_array_equal(_ask(scheduled, query, 4), truth)


def test_passes_of_rays_that_point_anywhere():
    """Many triangles in one place, some of them twice: the lowest index wins, and own triangles are skipped."""
    rng = np.random.default_rng(5)
    soup = (rng.normal(size=(3000, 1, 3)) + rng.normal(size=(3000, 3, 3)) * 0.2).astype(np.float32)
    soup[1000:1500] = soup[:500]
    scene = at.Scene.from_arrays(soup)
    triangles, shape = scene.triangles(), (40, 52)
    m = shape[0] * shape[1]
    directions = rng.normal(size=(m, 3)).astype(np.float32) * (10.0 ** rng.uniform(-6, 6, (m, 1))).astype(np.float32)
    directions[rng.random(m) < 0.1] = 0.0
    directions[rng.random((m, 3)) < 0.1] = 0.0
    rays = RayPass(rng.normal(size=(m, 3)).astype(np.float32), directions, rng.integers(-1, 3000, m).astype(np.int32))
    face, t = one_by_one(BUILDERS["bsah"].build(triangles.vertices, 2), *rays, 2)
    assert (
        (face >= 0).mean() > 0.5
        and ((face < 500) & (face >= 0)).any()
        and not ((face >= 1000) & (face < 1500)).sum() > 20
    )
    scheduled = _scheduled(triangles)
    for _ in range(2):
        scheduled.begin()
        (hits,) = nearest_hits(scheduled, [rays], shape, 2)
        np.testing.assert_array_equal(hits.face.reshape(-1), face)
        np.testing.assert_array_equal(hits.t.reshape(-1), t)


def test_points_in_a_row(atrium):
    scene, _ = atrium
    rng = np.random.default_rng(1)
    low, high = scene.bounds
    points = rng.uniform(low, high, (3000, 3))
    light = at.SphereLight((low + high) / 2, 0.3)
    one, other = (at.visibility(scene, points, light, spp=4, plan=p) for p in ("bsah+chcrt", "bsah+single"))
    np.testing.assert_array_equal(one.bits, other.bits)
    assert 0.05 < one.fraction.mean() < 0.95


def test_aggressive_mode_leaves_out_what_few_rays_meet(atrium):
    scene, camera = atrium
    triangles, query = query_of(scene, camera, LIGHTS["quad"], 4)
    truth = answer(parse_plan("bsah+single"), triangles, query)
    wrong = []
    for threshold in (0, 20, 100, 4000):
        scheduled = _scheduled(triangles, threshold=threshold)
        found = _ask(scheduled, query, 4)
        assert not (found & ~truth).any()  # blockers may be missed, but none is invented
        wrong.append(int((found != truth).sum()))
    assert wrong[0] == 0 and wrong == sorted(wrong) and wrong[-1] > 0


def test_state_of_a_renderer(atrium):
    """The tree and its visible set stay from frame to frame. Other plans give the same pictures."""
    scene, camera = atrium
    renderer = Renderer(scene, "bsah+chcrt", 2, gbuffer="rays")
    expected = at.render(scene, camera, LIGHTS["quad"], spp=4, plan="bsah+single", threads=2)
    frames = [renderer.render(camera, LIGHTS["quad"], spp=4) for _ in range(3)]
    for frame in frames:
        np.testing.assert_array_equal(frame.bits[0], expected.bits[0])
        np.testing.assert_array_equal(frame.gbuffer.face, expected.gbuffer.face)
        np.testing.assert_array_equal(frame.image, expected.image)
        assert len(frame.scheduled) == 2
    first, last = frames[0].scheduled, frames[-1].scheduled
    assert frames[-1].timings["build"] < frames[0].timings["build"]
    assert all(a["queries"] > b["queries"] for a, b in zip(first, last))


def test_light_that_bounces(atrium):
    scene, camera = atrium
    small, options = camera.resized(40, 30), {"spp": 2, "bounce": 2, "threads": 2}
    one, other = (at.render(scene, small, LIGHTS["quad"], plan=p, **options) for p in ("bsah+chcrt", "bsah+single"))
    np.testing.assert_array_equal(one.indirect, other.indirect)
    assert one.indirect.any()


@pytest.mark.parametrize("plan", ["chcrt", "bsah+chcrt:21", "bsah+chcrt:0"])
def test_plans_that_do_not_exist(plan):
    with pytest.raises(at.InputError, match=r"names no builder|unknown part"):
        parse_plan(plan)
