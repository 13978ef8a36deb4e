"""The plan `auto`: its builder follows the rays, kept trees are replaced once, and what is measured is kept."""

import gc
import json
import weakref

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import accelerator, auto_accelerator, calibration, tree_choice
from antumbra.engine.auto import cost_model
from antumbra.engine.auto.cost_model import BEST, GOOD, GUIDED, QUICK
from antumbra.engine.auto.query_features import features_of
from antumbra.engine.auto.strategies import SceneExtent, StrategyMemory, sampled_candidates, suitable_strategies
from antumbra.engine.method_registry import TRACERS
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import triangle_box
from antumbra.techniques.rayhierarchy.cone_tracer import FastestCones
from antumbra.trace.tracer_cost import TreelessCost
from asking import query_of

LAMP = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


def _builds(monkeypatch, good, best=1e6, guided=1e6):
    """Let trees of GOOD, BEST and GUIDED take so many seconds, and one of QUICK none."""
    seconds = {QUICK: 0.0, GOOD: good, BEST: best, GUIDED: guided}
    monkeypatch.setattr(cost_model, "build_seconds", lambda tree, n: seconds[tree])


def _cones_take(monkeypatch, nanoseconds):
    """Let cones be predicted to take this time per ray."""
    monkeypatch.setattr(auto_accelerator, "slowness", lambda tracer: 1.0)  # not as measured on this machine
    monkeypatch.setattr(TRACERS["cones"], "cost", TreelessCost(lambda features: nanoseconds, load=0.0))


@pytest.fixture(autouse=True)
def no_culling(monkeypatch):
    """Let culling and cones cost more than any tree, unless a test says otherwise, and no kernel any time to load."""
    _cones_take(monkeypatch, 1e9)
    monkeypatch.setattr(auto_accelerator, "_loads", auto_accelerator.KernelLoads())
    monkeypatch.setattr(auto_accelerator._loads, "_due", dict.fromkeys(("culling", GUIDED, "cones"), 0.0))
    monkeypatch.setattr(auto_accelerator, "mark_seconds", lambda receivers, lights: 1e9)


def test_the_default_plan_says_what_ran(scene):
    frame = at.render(scene, scene.cameras[0].resized(32, 24), [LAMP, at.AmbientOcclusion(1.0)], spp=4)
    assert len(frame.choices) == 2 and frame.plan.split("+")[0] in (QUICK, GOOD)
    assert [choice.rays for choice in frame.choices] == [frame.rays // 2] * 2
    named = at.render(scene, scene.cameras[0].resized(32, 24), [LAMP], plan="tl-lbvh+wide")
    assert named.plan == "tl-lbvh+wide" and named.choices is None


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
@pytest.mark.parametrize("seconds", [0.0, 1e6])
def test_the_builder_follows_the_predicted_rays(scene, monkeypatch, gbuffer, seconds):
    _builds(monkeypatch, seconds)
    frame = at.render(scene, scene.cameras[0].resized(32, 24), [LAMP], gbuffer=gbuffer)
    assert frame.plan.startswith(QUICK if seconds else GOOD)


def test_a_kept_tree_is_built_again_once_its_rays_have_lost_the_price(scene, monkeypatch):
    _builds(monkeypatch, 1e6)
    renderer, camera = Renderer(scene), scene.cameras[0].resized(32, 24)
    first, second = (renderer.render(camera, [LAMP]) for _ in range(2))
    assert first.plan.startswith(QUICK) and second.plan.startswith(QUICK)
    _, tree = renderer.source.moment(0.0)
    assert tree.chosen.builder == QUICK
    _builds(monkeypatch, 0.0)
    third, fourth = (renderer.render(camera, [LAMP]) for _ in range(2))
    assert third.plan.startswith(GOOD) and renderer.source.moment(0.0)[1] is not tree
    for frame in second, third, fourth:
        np.testing.assert_array_equal(frame.bits[0], first.bits[0])
    assert fourth.timings["build"] < third.timings["build"]


def test_a_kept_tree_is_optimised_once_its_rays_have_lost_the_price(scene, monkeypatch):
    _builds(monkeypatch, 0.0)
    renderer, camera = Renderer(scene), scene.cameras[0].resized(32, 24)
    first, second = (renderer.render(camera, [LAMP]) for _ in range(2))
    assert not any("reinsert" in frame.plan for frame in (first, second))
    _builds(monkeypatch, 0.0, 0.0)
    third, fourth = (renderer.render(camera, [LAMP]) for _ in range(2))
    assert third.plan.startswith(f"{BEST}+") and fourth.plan == third.plan
    assert renderer.source.moment(0.0)[1].chosen.builder == BEST
    for frame in second, third, fourth:
        np.testing.assert_array_equal(frame.bits[0], first.bits[0])


def test_trees_of_animated_scenes_are_refitted_once_it_pays(monkeypatch, tmp_path):
    rng = np.random.default_rng(0)
    still = rng.normal(size=(300, 3))
    np.save(tmp_path / "frames.npy", np.stack([still, still + 0.01 * rng.normal(size=still.shape)]))
    np.save(tmp_path / "faces.npy", np.arange(300).reshape(-1, 3))
    scene = at.load(tmp_path)
    _builds(monkeypatch, 0.0)
    renderer, camera = Renderer(scene), at.Camera((0, 0, 6), (0, 0, 0), width=24, height=20)
    for time in (0.0, 0.5, 1.0):
        frame = renderer.render(camera, [LAMP], time=time)
        named = at.render(scene, camera, [LAMP], time=time, plan="bsah+single")
        np.testing.assert_array_equal(frame.bits[0], named.bits[0])
    memory = renderer.accelerator.memory
    assert memory.updated is not None and frame.plan.startswith(f"{GOOD}+refit+")
    _builds(monkeypatch, 0.0, 0.0)
    optimised = renderer.render(camera, [LAMP], time=0.5)
    updated = memory.updated
    _builds(monkeypatch, 0.0)
    refitted = renderer.render(camera, [LAMP], time=0.75)
    assert optimised.plan.startswith(f"{BEST}+") and refitted.plan == optimised.plan
    assert memory.updated is updated and memory.strategies.in_good == 0.0
    named = at.render(scene, camera, [LAMP], time=0.75, plan="bsah+single")
    np.testing.assert_array_equal(refitted.bits[0], named.bits[0])


def _chosen(scene):
    return scene.engine.accelerated().chosen


def test_points_share_the_scenes_tree_until_it_is_outgrown(scene, monkeypatch):
    _builds(monkeypatch, 1e6)
    points = np.random.default_rng(1).uniform((-6, 0.1, -4), (6, 5, 4), (300, 3))
    seen = at.visibility(scene, points, LAMP)
    kept = _chosen(scene)
    assert kept.builder == QUICK
    at.visibility(scene, points, LAMP)
    assert _chosen(scene) is kept
    _builds(monkeypatch, 0.0)
    np.testing.assert_array_equal(at.visibility(scene, points, LAMP).bits, seen.bits)
    assert _chosen(scene) is not kept and _chosen(scene).builder == GOOD
    _builds(monkeypatch, 0.0, 0.0)
    for _ in range(2):
        np.testing.assert_array_equal(at.visibility(scene, points, LAMP).bits, seen.bits)
        assert _chosen(scene).builder == BEST


@pytest.mark.parametrize("later, builder", [(1000, GOOD), (10**12, BEST)])
def test_a_job_with_many_rays_to_come_gets_the_best_tree_after_its_first_query(monkeypatch, later, builder):
    scene = at.procedural("atrium", triangles=3000)
    _builds(monkeypatch, 0.0, 10.0)
    points = np.random.default_rng(1).uniform((-6, 0.1, -4), (6, 5, 4), (300, 3))
    receivers, samples = at.Receivers.of(points, None, scene.origin), light_samples(LAMP, 16)
    first, second = (scene.engine.shadows(receivers, [LAMP], [samples], later=later)[0].bits for _ in range(2))
    assert _chosen(scene).builder == builder
    np.testing.assert_array_equal(first, second)
    assert first.any()


def test_few_rays_count_towards_a_better_tree(monkeypatch):
    """Many small questions are as many rays as one large one."""
    scene = at.procedural("atrium", triangles=1000)
    _builds(monkeypatch, 1e6)
    at.visibility(scene, (0, 1, 0), at.SphereLight((1, 2, 1), 0.1), spp=1)
    kept = _chosen(scene)
    (choice,) = kept.choices
    assert choice.reason == "few rays" and choice.seconds > 0.0 and kept.builder == QUICK and kept.memory.lost > 0.0
    _builds(monkeypatch, 0.0)
    at.visibility(scene, (0, 1, 0), at.SphereLight((1, 2, 1), 0.1), spp=1)
    assert _chosen(scene).builder == GOOD


def test_what_is_measured_is_kept_and_scales_the_rates(tmp_path, monkeypatch):
    monkeypatch.setattr(cost_model, "machine_rates_file", lambda: tmp_path / "kernels" / "rates.json")
    cost_model.machine_rates.cache_clear()
    try:
        assert cost_model.machine_rates() == cost_model.SHIPPED
        measured = calibration.calibrate(triangles=2000, size=(16, 16))
        calibrated = {name for name in cost_model.strategies() if cost_model.cost_of(name).reference is not None}
        assert set(measured.slower) == calibrated and len(calibrated) > 5
        assert set(measured.builds) == {QUICK, GOOD, GUIDED, BEST}
        assert all(0.0 < x < 1e6 for found in measured for x in found.values())
        assert cost_model.machine_rates() == measured
        (tmp_path / "kernels" / "rates.json").write_text(json.dumps({"of another": "version"}))
        cost_model.machine_rates.cache_clear()
        assert cost_model.machine_rates() == cost_model.SHIPPED
    finally:
        cost_model.machine_rates.cache_clear()


def test_tracers_that_were_not_measured_are_as_slow_as_the_others(monkeypatch):
    """Else those without a tree would be chosen wherever a busy or slow machine was measured."""
    for slower, expected in (({}, 1.0), ({"single": 1.4}, 1.4), ({"single": 1.4, "wide": 1.1, "packet16": 1.2}, 1.2)):
        rates = cost_model.SHIPPED._replace(slower=slower)
        monkeypatch.setattr(cost_model, "machine_rates", lambda rates=rates: rates)
        assert cost_model.slowness("cones") == expected
    assert cost_model.slowness("single") == 1.4


def test_nothing_pays_twice():
    assert cost_model.choose_builder(1000, 0.0, True) == QUICK and cost_model.choose_builder(1000, 1.0, True) == GUIDED
    assert cost_model.choose_builder(1000, 1.0, False) == GOOD
    assert (
        not cost_model.best_pays(0.0, 1000)
        and cost_model.best_pays(1.0, 1000)
        and not cost_model.best_pays(1e9, 1 << 25)
    )


# --- culling and guided trees -----------------------------------------------------------------------------------------


def _cheap_culling(monkeypatch):
    monkeypatch.setattr(auto_accelerator, "mark_seconds", lambda receivers, lights: 0.0)
    monkeypatch.setattr(auto_accelerator, "select_seconds", lambda triangles, share: 0.0)


def corner(scene, size=(48, 40)):
    """A view of a part of the scene, and a lamp beside it."""
    return at.Camera((0, 1.5, 0), (2, 0.5, 1), width=size[0], height=size[1]), at.PointLight((0.5, 1.5, 0.2))


@pytest.mark.parametrize("guided", [0.0, 1e6])
def test_a_first_frame_is_culled_and_later_ones_keep_a_tree_of_everything(scene, monkeypatch, guided):
    _builds(monkeypatch, 1e5, guided=guided)
    monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
    _cheap_culling(monkeypatch)
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    renderer, (camera, light) = Renderer(scene), corner(scene)
    named = at.render(scene, camera, [light], plan="bsah+single", background=False)
    frames = [renderer.render(camera, [light], background=False) for _ in range(3)]
    assert frames[0].plan.startswith("grid32+")
    assert "grid32" not in frames[1].plan + frames[2].plan and frames[2].timings["build"] < frames[1].timings["build"]
    for frame in frames:
        np.testing.assert_array_equal(frame.bits[0], named.bits[0])
        np.testing.assert_array_equal(frame.image, named.image)


def test_an_expected_sequence_keeps_the_tree_of_its_first_frame(scene, monkeypatch):
    _builds(monkeypatch, 1e5)
    monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
    _cheap_culling(monkeypatch)
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    built, build = [], tree_choice.new_tree
    for module in (accelerator, tree_choice):
        monkeypatch.setattr(module, "new_tree", lambda *arguments: built.append(1) or build(*arguments))
    renderer, (camera, light) = Renderer(scene), corner(scene)
    named = at.render(scene, camera, [light], plan="bsah+single", background=False)
    built.clear()
    renderer.expect(2)
    frames = [renderer.render(camera, [light], background=False) for _ in range(3)]
    assert len(built) == 1 and not any("grid32" in frame.plan for frame in frames)
    assert all(np.array_equal(frame.image, named.image) for frame in frames)
    _cones_take(monkeypatch, 0.0)
    assert Renderer(scene).render(camera, [light]).tree.tree == ""
    renderer = Renderer(scene)
    renderer.expect(2)
    assert renderer.render(camera, [light]).tree.tree == QUICK


def test_all_expected_frames_pay_for_the_tree_of_the_first(scene, monkeypatch):
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: False)
    camera, light = corner(scene)
    alone = auto_accelerator.forecast_of
    forecasts = []
    monkeypatch.setattr(auto_accelerator, "forecast_of", lambda *seen: forecasts.append(alone(*seen)) or forecasts[-1])
    Renderer(scene).render(camera, [light])
    _builds(monkeypatch, 50.0 * forecasts[0].lost)
    assert forecasts[0].lost > 0.0
    for frames, builder in ((1, QUICK), (10, QUICK), (1000, GOOD)):
        renderer = Renderer(scene)
        renderer.expect(frames)
        assert renderer.render(camera, [light]).tree.tree == builder


def test_culling_is_abandoned_if_nearly_everything_remains(scene, monkeypatch):
    monkeypatch.setattr(auto_accelerator, "mark_seconds", lambda receivers, lights: 0.0)
    monkeypatch.setattr(auto_accelerator, "select_seconds", lambda triangles, share: 5e-5)
    monkeypatch.setattr(cost_model, "build_seconds", lambda tree, n: 1e-7 * n)
    monkeypatch.setattr(auto_accelerator, "relevant_share", lambda triangles, marking: 0.98)
    frame = Renderer(scene).render(scene.cameras[0].resized(48, 40), [LAMP])
    assert "grid32" not in frame.plan


@pytest.mark.parametrize("options", [{"bounce": 1}, {"adaptive": 64}, {"ground": True}])
def test_frames_with_further_rays_are_not_culled(scene, monkeypatch, options):
    _cheap_culling(monkeypatch)
    camera, light = corner(scene)
    frame = Renderer(scene).render(camera, [light], spp=4, **options)
    assert "grid32" not in frame.plan


def test_first_points_are_culled_and_later_ones_keep_a_tree_of_everything(monkeypatch):
    scene = at.procedural("atrium", triangles=3000)
    _builds(monkeypatch, 1e6)
    monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
    _cheap_culling(monkeypatch)
    points = np.random.default_rng(1).uniform((-1, 0.1, -1), (1, 2, 1), (300, 3))
    light = at.PointLight((0.5, 1.5, 0.2))
    named = at.visibility(scene, points, light, plan="bsah+single")
    np.testing.assert_array_equal(at.visibility(scene, points, light).bits, named.bits)
    assert scene.engine.source.for_points(0.0)[1] is None
    for _ in range(2):
        np.testing.assert_array_equal(at.visibility(scene, points, light).bits, named.bits)
        tree = scene.engine.source.for_points(0.0)[1]
        assert tree is not None and not tree.partial


def test_moving_scenes_are_culled_frame_by_frame(monkeypatch, tmp_path):
    rng = np.random.default_rng(0)
    still = rng.normal(size=(3000, 3))
    np.save(tmp_path / "frames.npy", np.stack([still, still + 0.01 * rng.normal(size=still.shape)]))
    np.save(tmp_path / "faces.npy", np.arange(3000).reshape(-1, 3))
    scene = at.load(tmp_path)
    _builds(monkeypatch, 1e6)
    monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
    _cheap_culling(monkeypatch)
    renderer, camera = Renderer(scene), at.Camera((0, 0, 1), (1, 0, 0), width=24, height=20)
    lamp = at.PointLight((1.0, 0.2, 0.8))
    for time in (0.0, 0.01, 0.02):
        frame = renderer.render(camera, [lamp], time=time)
        named = at.render(scene, camera, [lamp], time=time, plan="bsah+single")
        np.testing.assert_array_equal(frame.bits[0], named.bits[0])
        assert frame.plan.startswith("grid32+"), time


@pytest.mark.parametrize("light", [at.PointLight((0.5, 1.5, 0.2)), at.DirectionalLight((0.3, -1, 0.2), 0.0)])
@pytest.mark.parametrize("culled", [True, False])
def test_cones_answer_a_first_frame_where_they_take_less_time_than_a_tree(scene, monkeypatch, light, culled):
    _cones_take(monkeypatch, 0.0)
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    if culled:  # they are too slow for all triangles
        n = scene.n_triangles
        cost = TreelessCost(lambda features: 1e9 * (features.triangles >= n), load=0.0)
        monkeypatch.setattr(TRACERS["cones"], "cost", cost)
        monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
        _cheap_culling(monkeypatch)
    renderer, (camera, _) = Renderer(scene), corner(scene)
    named = at.render(scene, camera, [light], plan="bsah+single", spp=4)
    frames = [renderer.render(camera, [light], spp=4) for _ in range(2)]
    assert frames[0].plan == ("grid32+cones" if culled else "cones") and "cones" not in frames[1].plan
    assert frames[0].choices[0].strategy == "cones" and frames[0].choices[0].seconds > 0.0
    for frame in frames:
        np.testing.assert_array_equal(frame.bits[0], named.bits[0])


def test_any_tracer_without_a_tree_is_considered_if_it_states_a_cost(scene, monkeypatch):
    class Other(FastestCones):
        cost = TreelessCost(lambda features: 0.0, reason="it is the only one", load=0.0)

    monkeypatch.setitem(TRACERS, "other", Other())
    monkeypatch.setattr(TRACERS["cones"], "cost", None)
    renderer, (camera, light) = Renderer(scene), corner(scene)
    frames = [renderer.render(camera, [light], spp=4) for _ in range(2)]
    assert frames[0].plan == "other" and frames[0].tree.why == "it is the only one"
    assert frames[0].choices[0].strategy == "other" and "other" not in frames[1].plan
    np.testing.assert_array_equal(frames[0].bits[0], frames[1].bits[0])
    soft = Renderer(scene).render(camera, [LAMP], spp=4)
    assert "other" not in soft.plan  # it does not suit lights with an extent


@pytest.mark.parametrize("light", [LAMP, at.AmbientOcclusion(1.0), at.DirectionalLight((0.3, -1, 0.2))])
def test_cones_need_one_apex(scene, monkeypatch, light):
    _cones_take(monkeypatch, 0.0)
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    frame = Renderer(scene).render(corner(scene)[0], [light], spp=1)
    assert frame.choices[0].strategy != "cones"


def test_a_point_light_with_any_number_of_samples_has_one_apex(scene, monkeypatch):
    _cones_take(monkeypatch, 0.0)
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    camera, light = corner(scene)
    frame = Renderer(scene).render(camera, [light], spp=16)
    assert frame.plan == "cones" and frame.choices[0].rays == frame.rays == frame.mask.sum()


def test_cones_are_not_chosen_without_rays_or_where_a_tree_is_faster(scene, monkeypatch):
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    camera, light = corner(scene)
    assert "cones" not in Renderer(scene).render(camera, [light]).plan
    _cones_take(monkeypatch, 0.0)
    away = at.Camera((0, 100, 0), (0, 200, 0), (1, 0, 0), width=48, height=40)
    assert "cones" not in Renderer(scene).render(away, [light]).plan


@pytest.mark.parametrize("by_points", [False, True], ids=["picture", "points"])
def test_a_first_query_without_segments_leaves_no_empty_tree(monkeypatch, by_points):
    """Culling then drops every triangle. Later queries once kept that tree, and saw no shadow."""
    scene = at.procedural("atrium", triangles=3000)
    _builds(monkeypatch, 1e6)
    monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
    _cheap_culling(monkeypatch)
    light = at.PointLight((0.5, 1.5, 0.2))
    if by_points:
        points = np.random.default_rng(1).uniform((-1, 0.1, -1), (1, 2, 1), (300, 3))
        assert at.visibility(scene, np.empty((0, 3)), light).fraction.shape == (0,)
        answers = [at.visibility(scene, points, light, plan=plan).bits for plan in ("auto", "bsah+single")]
    else:
        renderer = Renderer(scene)
        away = at.Camera((0, 100, 0), (0, 200, 0), (1, 0, 0), width=48, height=40)
        assert renderer.render(away, [light]).rays == 0
        view = scene.cameras[0].resized(48, 40)
        answers = [each.render(view, [LAMP]).bits[0] for each in (renderer, Renderer(scene, "bsah+single"))]
    np.testing.assert_array_equal(*answers)
    assert answers[0].any()


def test_queries_are_not_kept_between_calls(monkeypatch):
    scene = at.procedural("atrium", triangles=3000)
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    _builds(monkeypatch, 1e6, guided=0.0)
    points = np.random.default_rng(1).uniform((-6, 0.1, -4), (6, 5, 4), (3000, 3))
    receivers = at.Receivers.of(points, None, scene.origin)
    origins = weakref.ref(receivers.origins)
    scene.engine.visibility(receivers, LAMP)
    del receivers
    gc.collect()
    assert origins() is None and _chosen(scene).builder == GUIDED


@pytest.mark.parametrize("seconds, triangles, counted", [(0.0, 0, True), (1e9, 0, False), (0.0, 1 << 30, False)])
def test_cones_are_not_chosen_where_a_sample_has_many_candidates(scene, monkeypatch, seconds, triangles, counted):
    """They are counted only for long queries and many triangles."""
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    monkeypatch.setattr(auto_accelerator, "_WORTH_SAMPLING", seconds)
    monkeypatch.setattr(auto_accelerator, "_FEW_TRIANGLES", triangles)
    light, camera = at.PointLight((0.5, 1.5, 0.2)), corner(scene)[0]
    named = at.render(scene, camera, [light], plan="bsah+single")
    plans = []
    for nanoseconds in 0.0, 1e9:
        monkeypatch.setattr(
            TRACERS["cones"], "cost", TreelessCost(lambda features: 0.0, candidate=nanoseconds, load=0.0)
        )
        frame = at.render(scene, camera, [light])
        plans.append(frame.plan)
        np.testing.assert_array_equal(frame.bits[0], named.bits[0])
    assert plans[0] == "cones" and ("cones" in plans[1]) == (not counted)


@pytest.mark.parametrize("share", [None, 1.0], ids=["culled", "abandoned"])
def test_cones_are_compared_with_a_culled_tree(scene, monkeypatch, share):
    """They once took its place wherever a tree of all triangles, which would not have been built, takes longer."""
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    _builds(monkeypatch, 1e6)
    monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-3 * triangles)
    _cheap_culling(monkeypatch)
    camera, light = corner(scene)
    named = at.render(scene, camera, [light], plan="bsah+single", background=False)
    _cones_take(monkeypatch, 0.8e6 * scene.n_triangles / named.rays)
    if share is not None:
        monkeypatch.setattr(auto_accelerator, "select_seconds", lambda triangles, share: 0.05 if share == 1.0 else 0.0)
        monkeypatch.setattr(auto_accelerator, "relevant_share", lambda triangles, marking: share)
    frame = at.render(scene, camera, [light], background=False)
    assert ("cones" in frame.plan) == (share is not None) and frame.plan.startswith("grid32+") == (share is None)
    np.testing.assert_array_equal(frame.bits[0], named.bits[0])


@pytest.mark.parametrize("height", [1.5, -50.0])
def test_candidates_of_cones_are_estimated_from_a_sample(scene, height):
    """There are none below a scene whose visible surfaces all face up."""
    floor, table = [(-9, 0, -9), (-9, 0, 9), (9, 0, -9)], [(-1, 1, -1), (-1, 1, 1), (1, 1, -1)]
    hall = at.Scene.from_arrays([floor, table] * 2, up="y")
    triangles, query = query_of(
        hall, at.Camera((-6, 6, -6), (-3, 0, -3), width=96, height=80), at.PointLight((-0.3, height, -0.3)), 1
    )
    features = features_of(query, len(triangles.vertices), triangle_box(triangles))
    found = sampled_candidates(TRACERS["cones"], triangles, query, features)
    assert (found > 0.0) == (height > 0.0)


@pytest.mark.parametrize("conversion", [0.0, 1.0])
def test_forecasts_count_the_conversion_of_a_tree(scene, monkeypatch, conversion):
    """A tracer that needs another form of the tree is expected only where its rays pay for the conversion."""
    triangles, query = query_of(
        scene, at.Camera((0, 2, 6), (0, 2, 0), width=96, height=80), at.PointLight((0, 4, 0)), 1
    )
    extent = SceneExtent(len(triangles.vertices), triangle_box(triangles))
    names = suitable_strategies(query, extent.box)
    fastest = names[0]
    rates = {name: 1e-9 if name == fastest else 2e-9 for name in names}
    monkeypatch.setattr(auto_accelerator, "predicted_rate", lambda name, features: rates[name])
    conversions = dict.fromkeys(names, 0.0) | {fastest: conversion}
    monkeypatch.setattr(auto_accelerator, "form_seconds", lambda name, n: conversions[name])
    forecast = auto_accelerator.forecast_of([query], extent)
    assert (forecast.strategy == fastest) == (conversion == 0.0)
    assert forecast.seconds == pytest.approx((1.0 + conversion) * 1e-9 * forecast.features[0].rays)


@pytest.mark.parametrize("by_points", [False, True], ids=["pictures", "points"])
@pytest.mark.parametrize("plan", ["auto", "lbvh+auto"])
def test_each_frame_and_each_query_of_points_counts_once(monkeypatch, plan, by_points):
    """Frames in a kept tree once counted twice, so measured rates expired after half as many."""
    begun, begin = [], StrategyMemory.begin
    monkeypatch.setattr(StrategyMemory, "begin", lambda memory: begin(memory) or begun.append(memory))
    scene = at.procedural("atrium", triangles=1000)
    renderer, points = Renderer(scene, plan), np.random.default_rng(1).uniform(0.1, 3.0, (300, 3))
    for _ in range(4):
        if by_points:
            at.visibility(scene, points, LAMP, plan=plan)
        else:
            frame = renderer.render(scene.cameras[0].resized(48, 40), [LAMP])
            assert len(frame.choices) == 1
    assert max(map(begun.count, begun)) == 4
