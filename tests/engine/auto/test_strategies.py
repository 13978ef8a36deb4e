"""The tracer `auto` gives the bits of brute force in every strategy, and says which strategy it took."""

import itertools
import os

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.auto import cost_model, kernel_loads, strategies
from antumbra.engine.auto.cost_model import GOOD, GUIDED, QUICK
from antumbra.engine.method_registry import BUILDERS, TRACERS
from antumbra.engine.plan import parse_plan
from antumbra.picture.renderer import Renderer
from antumbra.trace.counters import as_dict, new_counters
from antumbra.trace.packets.wide_packets import WidePackets
from antumbra.trace.tracer import Form
from antumbra.trace.tracer_cost import Cost
from asking import answer, query_of, true_occlusion, unpack

LAMP = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))
LIGHTS = (
    LAMP, at.PointLight((0, 7, 0)), at.SphereLight((0, 7, 0), 0.5), at.DirectionalLight((0.3, -1, 0.2)),
    at.AmbientOcclusion(2.0), at.PointLights(np.random.default_rng(0).normal((0, 5, 0), 2, (20, 3)), interleave=True),
)  # fmt: skip
SKY = at.DirectionalLights(-np.abs(np.random.default_rng(1).normal(size=(256, 3))), interleave=True)


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


def _forced(monkeypatch, strategy):
    """Make a strategy look far faster than the others."""
    monkeypatch.setattr(strategies, "predicted_rate", lambda name, facts: 1e-12 if name == strategy else 1.0)
    monkeypatch.setattr(strategies, "TRIAL_SHARE", 0.0)


@pytest.mark.parametrize("strategy", cost_model.strategies())
@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: type(light).__name__)
def test_every_strategy_gives_the_bits_of_brute_force(scene, monkeypatch, strategy, light):
    _forced(monkeypatch, strategy)
    triangles, query = query_of(scene, scene.cameras[0].resized(20, 16), light, 4)
    truth, active = true_occlusion(triangles, query)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
    bits, counters = np.zeros((16, 20, -(-query.samples.shape[1] // 64)), np.uint64), new_counters()
    strategies.AutoTracer().trace(auto, query, bits, 2, counters)
    np.testing.assert_array_equal(unpack(bits, query.samples.shape[1])[active], truth[active])
    (choice,) = auto.choices
    predicted = TRACERS[strategy].suits(query, auto.forms.extent.box) and not TRACERS[strategy].cost.load
    assert choice.strategy == strategy or not predicted
    assert choice.seconds > 0.0 and choice.reason == "prediction" and as_dict(counters)["rays"] == truth[active].size


def _measured_fastest(monkeypatch, fastest):
    """Make trials find a strategy fastest, and its kernels loaded. Return the strategies that were tried."""
    tried = []

    def measure(name, *arguments):
        tried.append(name)
        return 1.0 if name == fastest else 1e6

    monkeypatch.setattr(strategies, "_rate_of", measure)
    monkeypatch.setattr(strategies, "KEPT_TRIAL_SHARE", 1e9)
    monkeypatch.setattr(kernel_loads.TRACER_LOADS, "pays", lambda method, gain, load: gain > 0.0)
    return tried


@pytest.mark.parametrize("builder", [None, QUICK, GOOD])
def test_frusta_of_light_samples_are_tried_in_kept_trees(scene, monkeypatch, builder):
    """Their kernels need not be loaded for a QUICK tree, in which they are slow."""
    by_sample = "multifrusta:by-sample"
    tried = _measured_fastest(monkeypatch, by_sample)
    triangles, query = query_of(scene, scene.cameras[0].resized(96, 80), SKY, 16)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2, builder=builder)
    truth, bits = answer(parse_plan("lbvh+single"), triangles, query), np.zeros((80, 96, 1), np.uint64)
    strategies.AutoTracer().trace(auto, query, bits, 2)
    np.testing.assert_array_equal(unpack(bits, 16), truth)
    assert truth.any() and (by_sample in tried) == (builder != QUICK)
    assert (auto.choices[0].strategy == by_sample) == (builder != QUICK)


def test_frusta_of_light_samples_are_not_chosen_without_a_trial(scene, monkeypatch):
    _forced(monkeypatch, "multifrusta:by-sample")
    monkeypatch.setattr(strategies, "KEPT_TRIAL_SHARE", 0.0)
    monkeypatch.setattr(kernel_loads.TRACER_LOADS, "pays", lambda method, gain, load: True)
    triangles, query = query_of(scene, scene.cameras[0].resized(20, 16), SKY, 4)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
    strategies.AutoTracer().trace(auto, query, np.zeros((16, 20, 1), np.uint64), 2)
    assert auto.choices[0].reason == "prediction" and auto.choices[0].strategy != "multifrusta:by-sample"


@pytest.mark.parametrize("once", [False, True])
def test_trials_in_a_tree_that_is_used_once_must_pay_for_themselves(scene, monkeypatch, once):
    """Later frames, which would reuse the result of a longer one, are not expected."""
    tried = _measured_fastest(monkeypatch, "multifrusta:by-sample")
    monkeypatch.setattr(strategies, "TRIAL_SHARE", 0.0)
    triangles, query = query_of(scene, scene.cameras[0].resized(96, 80), SKY, 16)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2, builder=GOOD, once=once)
    strategies.AutoTracer().trace(auto, query, np.zeros((80, 96, 1), np.uint64), 2)
    assert bool(tried) != once and auto.choices[0].reason == ("prediction" if once else "sample")


@pytest.mark.parametrize("cached", [True, False])
def test_a_large_tree_is_read_from_memory_before_strategies_are_compared_in_it(scene, monkeypatch, cached):
    """The first run of a trial in it says little about a strategy; small trees are in the cache anyway."""
    runs = []

    def measure(name, *arguments):
        runs.append(name)
        return {"packet16": 10.0, "packet16:samples": 20.0}.get(name, 1e3) * (6.0 if len(runs) == 1 else 1.0)

    monkeypatch.setattr(strategies, "_rate_of", measure)
    monkeypatch.setattr(strategies, "TRIAL_SHARE", 1e9)
    monkeypatch.setattr(strategies, "_CACHED_TREE", 1_000_000 if cached else 1_000)
    monkeypatch.setattr(strategies, "worth_loading", lambda names, seconds: ["packet16", "packet16:samples"])
    monkeypatch.setattr(strategies, "predicted_rate", lambda name, facts: {"packet16": 1e-7}.get(name, 1.1e-7))
    triangles, query = query_of(scene, scene.cameras[0].resized(96, 80), LAMP, 16)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
    strategies.AutoTracer().trace(auto, query, np.zeros((80, 96, 1), np.uint64), 2)
    assert runs[0] == "packet16"
    assert auto.choices[0].strategy == ("packet16:samples" if cached else "packet16")


def test_strategies_are_tried_again_once_another_is_loaded(scene, monkeypatch):
    """The rates of earlier queries are those of the strategies that were there."""
    tried = _measured_fastest(monkeypatch, "multifrusta:by-sample")
    monkeypatch.setattr(strategies, "TRIAL_SHARE", 1e9)
    triangles, query = query_of(scene, scene.cameras[0].resized(96, 80), SKY, 16)
    memory, chosen = strategies.StrategyMemory(), []
    for builder in QUICK, QUICK, GOOD, GOOD:
        auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2, memory, builder)
        auto.begin()
        strategies.AutoTracer().trace(auto, query, np.zeros((80, 96, 1), np.uint64), 2)
        chosen.append((auto.choices[0].reason, auto.choices[0].strategy == "multifrusta:by-sample"))
    assert chosen == [("sample", False), ("earlier query", False), ("sample", True), ("earlier query", True)]
    assert tried.count("multifrusta:by-sample") == 2  # both runs of one trial


@pytest.mark.parametrize("faster", [True, False])
def test_a_tree_for_packets_gives_way_where_frusta_of_light_samples_are_faster_without_it(scene, monkeypatch, faster):
    """Once queries have missed what another tree costs; it is built once, and kept if a sample is faster in it."""
    triangles, query = query_of(scene, scene.cameras[0].resized(96, 80), SKY, 16)
    built, rates = [], {"packet16": 50.0, "multifrusta:by-sample": 76.0}

    def plain():
        built.append(BUILDERS[GOOD].build(triangles.vertices, 2))
        return built[-1]

    guided = BUILDERS["lbvh"].build(triangles.vertices, 2)
    sampled = lambda strategy, forms, *more: 50.0 if forms.bvh is guided else 40.0 if faster else 60.0
    monkeypatch.setattr(strategies, "sampled_rate", sampled)
    price = cost_model.build_seconds(GOOD, len(triangles.vertices))
    auto = strategies.AutoState(guided, 2, builder=GUIDED, plain=plain)
    for seconds in (1.0 * price, 2.0 * price):  # a fifth of which could be saved: 76 / 1.9 = 40
        auto.reconsider(query, rates, seconds, 2)
        assert auto.forms.bvh is guided and not built
    for _ in range(3):
        auto.reconsider(query, rates, 5.0 * price, 2)
    assert len(built) == 1 and auto.builder == (GOOD if faster else GUIDED)
    assert auto.forms.bvh is (built[0] if faster else guided)


def test_no_other_tree_is_built_where_packets_are_far_ahead(scene):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 20), SKY, 16)
    bvh = BUILDERS["lbvh"].build(triangles.vertices, 2)
    auto = strategies.AutoState(bvh, 2, builder=GUIDED, plain=lambda: pytest.fail("it is built"))
    auto.reconsider(query, {"packet16": 50.0, "multifrusta:by-sample": 100.0}, 1e9, 2)
    auto.reconsider(query, {}, 1e9, 2)
    assert auto.builder == GUIDED


@pytest.mark.parametrize("spp", [1, 70])
def test_scattered_points_are_sorted_and_get_their_own_bits(scene, monkeypatch, spp):
    rng = np.random.default_rng(2)
    points = rng.uniform((-6, 0.1, -4), (6, 5, 4), (3001, 3))
    plain = at.visibility(scene, points, LAMP, spp=spp, plan="bsah+single")
    monkeypatch.setattr(strategies, "SORT_SECONDS", -1.0)
    seen = at.visibility(scene, points, LAMP, spp=spp, plan="auto")
    np.testing.assert_array_equal(seen.bits, plain.bits)
    chosen = scene.engine.accelerated().chosen
    assert [c.sorted for c in chosen.choices] == [True] and 0.1 < plain.fraction.mean() < 0.99


@pytest.mark.skipif("ANTUMBRA_TEST_KERNELS" in os.environ, reason="two samples: rates differ from those of processors")
def test_a_sample_decides_among_likely_strategies_and_the_next_frame_remembers(scene, monkeypatch):
    monkeypatch.setattr(strategies, "TRIAL_SHARE", 1e9)
    monkeypatch.setattr(strategies, "MAX_CONVERSION_SHARE", 1e9)
    monkeypatch.setattr(strategies, "_CHANGE", 1e9)  # on a busy machine, a query may take a multiple of its sample
    monkeypatch.setattr(strategies, "predicted_rate", lambda name, facts: 1e-7)
    renderer, camera = Renderer(scene), scene.cameras[0].resized(160, 120)
    first = renderer.render(camera, [LAMP], spp=16)
    (choice,) = first.choices
    assert choice.tried and set(choice.tried) <= set(cost_model.strategies()) and choice.strategy in choice.tried
    second = renderer.render(camera, [LAMP], spp=16)
    assert not second.choices[0].tried
    assert [frame.choices[0].reason for frame in (first, second)] == ["sample", "earlier query"]
    named = at.render(scene, camera, [LAMP], spp=16, plan="bsah+single")
    for frame in first, second:
        np.testing.assert_array_equal(frame.bits[0], named.bits[0])
        np.testing.assert_array_equal(frame.image, named.image)


def test_the_first_call_of_a_strategy_does_not_count(scene, monkeypatch):
    """It loads kernels. Shafts once looked hopeless for that alone."""
    clock, called = [0.0], []

    def first_takes_long(name):
        def trace_slowly(*arguments):
            clock[0] += 1e-4 if name in called else 100.0
            called.append(name)

        return trace_slowly

    slow = cost_model.strategies()
    for name, tracer in slow.items():
        monkeypatch.setattr(tracer, "trace", first_takes_long(name))
    monkeypatch.setattr(strategies, "LOADED", set())
    monkeypatch.setattr(strategies, "KEPT_TRIAL_SHARE", 1e9)
    monkeypatch.setattr(strategies, "MAX_TRIED", len(slow))
    monkeypatch.setattr(strategies, "process_time", lambda: clock[0])
    triangles, query = query_of(scene, scene.cameras[0].resized(64, 48), LAMP, 4)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
    facts = strategies.features_of(query, auto.forms.triangles, auto.forms.extent.box)
    cost, conversion = dict.fromkeys(slow, 1.0), dict.fromkeys(slow, 0.0)
    found = strategies.try_strategies(query, auto.forms, cost, conversion, facts, 2)
    assert set(found) == set(slow) and max(found.values()) < 1e4


def test_elapsed_time_of_a_device_counts_for_all_threads(scene, monkeypatch):
    """Its own time is none of the processor's: it would seem to trace in no time."""
    uploads = []

    class OnDevice(WidePackets):
        device = "device:0"
        form = Form("on a device", lambda bvh, threads: uploads.append(bvh) or widen(bvh, threads))
        cost = Cost(lambda features: 1e-3)

    monkeypatch.setitem(TRACERS, "on-device", OnDevice())
    elapsed = itertools.count(0.0, 2.5)
    monkeypatch.setattr(strategies, "process_time", lambda: 0.0)
    monkeypatch.setattr(strategies, "perf_counter", lambda: next(elapsed))
    triangles, query = query_of(scene, scene.cameras[0].resized(40, 32), LAMP, 4)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 3)
    answers = []
    for _ in range(2):
        bits = np.zeros((32, 40, 1), np.uint64)
        strategies.AutoTracer().trace(auto, query, bits, 3)
        answers.append(unpack(bits, 4))
    assert [choice.strategy for choice in auto.choices] == ["on-device"] * 2 and len(uploads) == 1
    assert [choice.seconds for choice in auto.choices] == [7.5, 7.5]
    truth, active = true_occlusion(triangles, query)
    for found in answers:
        np.testing.assert_array_equal(found[active], truth[active])


def test_a_kept_tree_is_converted_once_queries_have_taken_long(scene, monkeypatch):
    """A conversion that does not pay for one query pays for many."""
    for limit in "TRIAL_SHARE", "KEPT_TRIAL_SHARE", "MAX_TRIED", "_CHANGE":
        monkeypatch.setattr(strategies, limit, 1 << 30)
    monkeypatch.setattr(kernel_loads.TRACER_LOADS, "pays", lambda method, gain, load: True)
    monkeypatch.setattr(strategies, "predicted_rate", lambda name, facts: 1e-7)
    ticks = itertools.count()
    monkeypatch.setattr(strategies, "_clock", lambda tracer, threads: 2e-3 * next(ticks))  # equally fast at any load
    triangles, query = query_of(scene, scene.cameras[0].resized(96, 80), LAMP, 16)
    auto, tried = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2), []
    seconds = 1e-7 * strategies.features_of(query, *auto.forms.extent).rays  # of a query
    share = strategies.MAX_CONVERSION_SHARE + 2.5 * strategies.KEPT_CONVERSION_SHARE
    conversion = lambda name, n: share * seconds * (TRACERS[name].form.make is not None)
    monkeypatch.setattr(strategies, "form_seconds", conversion)
    for _ in range(4):
        auto.begin()
        strategies.AutoTracer().trace(auto, query, np.zeros((80, 96, 1), np.uint64), 2)
        tried.append((auto.choices[0].reason, {"wide", "multifrusta"} <= set(auto.choices[0].tried)))
    assert tried == [("sample", False), *[("earlier query", False)] * 2, ("sample", True)]


def test_an_unlikely_strategy_is_not_tried(scene, monkeypatch):
    monkeypatch.setattr(strategies, "TRIAL_SHARE", 1e9)
    monkeypatch.setattr(strategies, "MAX_CONVERSION_SHARE", 1e9)
    monkeypatch.setattr(
        strategies, "predicted_rate", lambda name, facts: {"wide": 1e-7, "packet16": 2e-7}.get(name, 1e-6)
    )
    frame = at.render(scene, scene.cameras[0].resized(64, 48), [LAMP], spp=4)
    assert set(frame.choices[0].tried) <= {"wide", "packet16"}


def test_rates_are_forgotten_when_the_rays_change():
    memory, key = strategies.StrategyMemory(), (1, 2)
    measured = strategies.StrategyChoice("wide", 1000, "sample", 1.0, {"wide": 100.0, "packet16": 200.0}, seconds=1e-4)
    memory.learn(key, measured, None)
    assert memory.rates(key) == {"wide": pytest.approx(100.0), "packet16": 200.0}
    memory.learn(key, measured._replace(tried={}, seconds=1.5e-4), None)
    assert memory.rates(key)
    memory.learn(key, measured._replace(tried={}, seconds=1e-3), None)
    assert not memory.rates(key)
    memory.learn(key, measured, None)
    for _ in range(100):
        memory.begin()
    assert not memory.rates(key)


def test_rates_of_an_earlier_frame_serve_a_camera_that_walks():
    """Similar sizes share rates, unless these turn out wrong, or the rates are of the same frame."""
    memory = strategies.StrategyMemory()
    key = lambda *sizes, kind="lamp", more=2: (kind, 1, 18, *sizes, QUICK, 5, more)
    measured = strategies.StrategyChoice("wide", 1000, "sample", 1.0, {"wide": 100.0, "packet16": 200.0}, seconds=1e-4)
    memory.learn(key(4, 8, 2), measured, None)
    assert memory.rates(key(4, 8, 2)) and not memory.rates(key(5, 8, 2))  # another light of this frame
    memory.begin()
    for sizes in ((5, 8, 2), (3, 9, 1), (4, 8, 2)):
        assert memory.rates(key(*sizes)) == {"wide": pytest.approx(100.0), "packet16": 200.0}
    for other in (key(6, 8, 2), key(4, 8, 2, kind="sky"), key(4, 8, 2, more=3), ("few",), ("lamp", 1, 18)):
        assert not memory.rates(other)
    earlier = measured._replace(reason="earlier query", tried={})
    memory.learn(key(5, 8, 2), earlier, None)
    assert memory.rates(key(5, 8, 2)) and memory.rates(key(6, 8, 2)) and not memory.rates(key(7, 8, 2))  # step by step
    memory.learn(key(5, 8, 2), earlier._replace(seconds=1e-3), None)
    assert not memory.rates(key(5, 8, 2)) and memory.rates(key(4, 8, 2))  # tried again with its own rays
    memory.begin()
    memory.learn(key(5, 8, 2), measured._replace(tried={"wide": 900.0, "packet16": 50.0}), None)
    memory.begin()
    assert memory.rates(key(5, 8, 2))["packet16"] == memory.rates(key(6, 8, 2))["packet16"] == 50.0
    for _ in range(100):
        memory.begin()
    assert not memory.rates(key(4, 8, 2)) and not memory.rates(key(5, 8, 2))


def test_no_receivers_and_one_triangle():
    scene = at.Scene.from_arrays(np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([[0, 1, 2]]))
    away = at.Camera((0, 1, 0), (0, 2, 0), (1, 0, 0), width=20, height=12)
    frame = at.render(scene, away, [LAMP], spp=4)
    assert not frame.bits[0].any() and frame.rays == 0
    assert at.visibility(scene, np.empty((0, 3)), LAMP).fraction.shape == (0,)
    below = at.visibility(scene, [[0.2, -1.0, 0.2]], at.PointLight((0.2, 1, 0.2)))
    assert below.fraction.tolist() == [0.0]


def test_the_oracle_agrees_over_all_of_the_plan(scene):
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 20), LAMP, 8)
    truth, active = true_occlusion(triangles, query)
    np.testing.assert_array_equal(answer("auto", triangles, query)[active], truth[active])


@pytest.mark.parametrize("slow, builder", [(1e9, GOOD), (1e-9, QUICK)])
def test_a_query_that_loses_much_builds_a_better_tree_first(scene, monkeypatch, slow, builder):
    monkeypatch.setattr(strategies, "sampled_rate", lambda strategy, forms, query, threads: slow)
    monkeypatch.setattr(strategies, "PREDICTION_ERROR", 1e9)  # predictions are never believed
    triangles, query = query_of(scene, scene.cameras[0].resized(20, 16), LAMP, 4)
    truth, active = true_occlusion(triangles, query)
    better = strategies.TreeUpgrade(lambda query: (BUILDERS[GOOD].build(triangles.vertices, 2), GOOD))
    auto = strategies.AutoState(BUILDERS[QUICK].build(triangles.vertices, 2), 2, None, QUICK, better)
    bits = np.zeros((16, 20, 1), np.uint64)
    strategies.AutoTracer().trace(auto, query, bits, 2)
    np.testing.assert_array_equal(unpack(bits, 4)[active], truth[active])
    assert auto.builder == builder


def test_a_frame_names_the_builder_of_its_better_tree(scene, monkeypatch):
    monkeypatch.setattr(strategies.AutoState, "upgrade_pays", lambda auto, strategy, seconds: True)
    renderer = at.Renderer(scene)
    plans = [renderer.render(scene.cameras[0].resized(20, 16), LAMP, spp=4).plan for _ in range(2)]
    assert all(parse_plan(plan).build in (GOOD, GUIDED) for plan in plans)


def test_queries_too_short_for_a_trial_pay_for_one_together(scene, monkeypatch):
    """Kept frames that repeat: each is shorter than its trial may be, many of them are not."""
    monkeypatch.setattr(strategies, "_rate_of", lambda *arguments: 1.0)
    monkeypatch.setattr(strategies, "predicted_rate", lambda name, facts: 1e-7)
    monkeypatch.setattr(strategies, "form_seconds", lambda name, triangles: 0.0)
    monkeypatch.setattr(strategies, "_clock", lambda tracer, threads: 0.0)
    monkeypatch.setattr(strategies, "worth_loading", lambda names, seconds: ["packet16", "multifrusta"])
    triangles, query = query_of(scene, scene.cameras[0].resized(160, 120), LAMP, 4)
    auto = strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
    reasons = []
    for _ in range(20):
        auto.begin()
        strategies.AutoTracer().trace(auto, query, np.zeros((120, 160, 1), np.uint64), 2)
        reasons.append(auto.choices[0].reason)
    before = reasons.index("sample")
    assert 1 <= before < 15 and set(reasons[:before]) == {"prediction"}
    assert set(reasons[before + 1 :]) == {"earlier query"}


def test_a_conversion_of_the_tree_counts_less_the_more_queries_share_it(scene, monkeypatch):
    monkeypatch.setattr(
        strategies, "predicted_rate", lambda name, facts: {"packet16:blocks": 1e-7, "single": 2e-7}.get(name, 1.0)
    )
    monkeypatch.setattr(strategies, "form_seconds", lambda name, triangles: 0.05 * (name == "packet16:blocks"))
    triangles, query = query_of(scene, scene.cameras[0].resized(160, 120), LAMP, 4)
    forms = strategies.TreeForms(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
    facts = strategies.features_of(query, *forms.extent)
    conversions = forms.conversions(["single", "packet16:blocks"])
    chosen = [
        strategies.choose_strategy(
            query, forms, facts, conversions, 2, {}, strategies.SimilarQueries(0, served)
        ).strategy
        for served in (1, 100)
    ]
    assert chosen == ["single", "packet16:blocks"]


def test_the_frames_of_a_walk_share_the_cost_of_a_conversion(scene, monkeypatch):
    """Their tiles differ in size, so that their strategies are measured apart."""
    served, keys, choose = [], set(), strategies.choose_strategy
    monkeypatch.setattr(strategies, "try_strategies", lambda *arguments: {})

    def recorded(query, forms, features, *rest):
        keys.add(strategies.feature_key(features))
        served.append(rest[-1].served)
        return choose(query, forms, features, *rest)

    monkeypatch.setattr(strategies, "choose_strategy", recorded)
    auto = None
    for distance in (1.0, 1.5, 2.0):
        camera = scene.cameras[0]
        position = camera.target + distance * (np.asarray(camera.position) - camera.target)
        near = at.Camera(position, camera.target, camera.up, camera.vfov, 64, 64)
        triangles, query = query_of(scene, near, LAMP, 4)
        auto = auto or strategies.AutoState(BUILDERS["lbvh"].build(triangles.vertices, 2), 2)
        strategies.AutoTracer().trace(auto, query, np.zeros((64, 64, 1), np.uint64), 2)
    assert served == [1, 2, 3] and len(keys) > 1


def test_strategies_are_tried_in_the_order_of_their_predictions():
    """Shafts, whose predictions may be far off, are tried up to a higher cost, but not before likelier strategies."""
    cost = {"multifrusta": 3.0, "packet16": 1.0, "packet16:blocks": 2.0, "single": 4.0}
    assert strategies.worth_trying(cost, dict.fromkeys(cost, 0.0)) == ["packet16", "packet16:blocks", "multifrusta"]
    converted = {**dict.fromkeys(cost, 0.0), "packet16:blocks": 0.2}
    assert strategies.worth_trying(cost, converted) == ["packet16", "multifrusta"]
