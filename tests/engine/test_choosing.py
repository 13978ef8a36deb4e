"""The plan `auto`: its builder follows the rays, kept trees are replaced once, and what is measured is kept."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import calibration
from antumbra.engine.auto import cost_model as rates
from antumbra.engine.auto.cost_model import BEST, GOOD, QUICK
from antumbra.engine.auto.strategies import STRATEGIES
from antumbra.engine.plan import parse_plan
from antumbra.picture.renderer import Renderer

LAMP = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


def _builds(monkeypatch, good, best=1e6):
    """Let trees of GOOD and of BEST take so many seconds, and one of QUICK none."""
    monkeypatch.setattr(rates, "build_seconds", lambda tree, n: {QUICK: 0.0, GOOD: good, BEST: best}[tree])


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
    kept = renderer.source._last
    assert kept.chosen.builder == QUICK and renderer.source.moment(0.0)[1] is kept
    _builds(monkeypatch, 0.0)
    third, fourth = (renderer.render(camera, [LAMP]) for _ in range(2))
    assert third.plan.startswith(GOOD) and renderer.source._last is not kept
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
    kept = renderer.source._last
    assert kept.chosen.builder == BEST and renderer.source.moment(0.0)[1] is kept
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
    assert renderer.accelerator._updater is not None and frame.plan.startswith(f"{GOOD}+")
    _builds(monkeypatch, 0.0, 0.0)
    optimised = renderer.render(camera, [LAMP], time=0.5)
    kept, memory = renderer.accelerator._updater, renderer.accelerator.memory
    _builds(monkeypatch, 0.0)
    refitted = renderer.render(camera, [LAMP], time=0.75)
    assert optimised.plan.startswith(f"{BEST}+") and refitted.plan == optimised.plan
    assert renderer.accelerator._updater is kept and memory.in_good == 0.0
    named = at.render(scene, camera, [LAMP], time=0.75, plan="bsah+single")
    np.testing.assert_array_equal(refitted.bits[0], named.bits[0])


def _chosen(scene):
    return scene.engine._trees._accelerated[parse_plan("auto")].chosen


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


def test_few_rays_count_towards_a_better_tree(monkeypatch):
    """Many small questions are as many rays as one large one."""
    scene = at.procedural("atrium", triangles=1000)
    _builds(monkeypatch, 1e6)
    at.visibility(scene, (0, 1, 0), at.PointLight((1, 2, 1)), spp=1)
    kept = _chosen(scene)
    (choice,) = kept.choices
    assert choice.reason == "few rays" and choice.seconds > 0.0 and kept.builder == QUICK and kept.memory.lost > 0.0
    _builds(monkeypatch, 0.0)
    at.visibility(scene, (0, 1, 0), at.PointLight((1, 2, 1)), spp=1)
    assert _chosen(scene).builder == GOOD


def test_what_is_measured_is_kept_and_scales_the_rates(tmp_path, monkeypatch):
    monkeypatch.setattr(rates, "machine_rates_file", lambda: tmp_path / "kernels" / "rates.json")
    monkeypatch.setattr(calibration, "_TRIANGLES", 2000)
    monkeypatch.setattr(calibration, "_SIZE", (16, 16))
    rates.machine_rates.cache_clear()
    try:
        assert rates.machine_rates() == rates.SHIPPED
        measured = calibration.calibrate()
        assert set(measured.slower) == set(STRATEGIES) == set(rates.reference())
        assert set(measured.builds) == {QUICK, GOOD, BEST}
        assert all(0.0 < x < 1e6 for found in measured for x in found.values())
        assert rates.machine_rates() == measured
        (tmp_path / "kernels" / "rates.json").write_text(json.dumps({"of another": "version"}))
        rates.machine_rates.cache_clear()
        assert rates.machine_rates() == rates.SHIPPED
    finally:
        rates.machine_rates.cache_clear()


def test_nothing_pays_twice():
    assert not rates.good_pays(0.0, 1000) and rates.good_pays(1.0, 1000)
    assert not rates.best_pays(0.0, 1000) and rates.best_pays(1.0, 1000) and not rates.best_pays(1e9, 1 << 25)
