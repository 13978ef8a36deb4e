"""Choices of trees: one call returns the tree with its methods and the reason, and what is learned outlives it."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import auto_accelerator
from antumbra.engine.auto import cost_model
from antumbra.engine.auto.cost_model import BEST, GOOD, GUIDED, QUICK
from antumbra.engine.auto_accelerator import CULLER, accelerator_of
from antumbra.engine.method_registry import TRACERS
from antumbra.engine.plan import covering_plans, parse_plan
from antumbra.engine.tree_choice import NO_RAYS, ExpectedRays, LearnedTrees, UpdatedTree
from antumbra.picture.renderer import Renderer
from antumbra.trace.tracer_cost import TreelessCost
from support.asking import query_of

LAMP = at.PointLight((0.5, 1.5, 0.2))
VIEW = at.Camera((0, 1.5, 0), (0, 0, 1), width=40, height=32)


@pytest.fixture(scope="module")
def asked():
    return query_of(at.procedural("atrium", triangles=3000), VIEW, LAMP, 4)


@pytest.fixture
def costs(monkeypatch):
    """Set the seconds that culling, trees and cones cost; at first, culling costs more than any tree."""
    monkeypatch.setattr(auto_accelerator, "_loads", auto_accelerator.KernelLoads())
    monkeypatch.setattr(auto_accelerator._loads, "_due", dict.fromkeys(("culling", GUIDED, "cones"), 0.0))
    monkeypatch.setattr(auto_accelerator, "is_compiled", lambda job: True)
    cones = TRACERS["cones"]

    def set_costs(good=1e6, best=1e6, guided=1e6, culling=1e9, cones_take=lambda features: 1e9):
        seconds = {QUICK: 0.0, GOOD: good, BEST: best, GUIDED: guided}
        monkeypatch.setattr(cost_model, "build_seconds", lambda tree, n: seconds[tree])
        monkeypatch.setattr(cost_model, "form_seconds", lambda strategy, triangles: 1e-6 * triangles)
        monkeypatch.setattr(auto_accelerator, "mark_seconds", lambda receivers, lights: culling)
        monkeypatch.setattr(auto_accelerator, "select_seconds", lambda triangles, share: 0.0)
        monkeypatch.setattr(cones, "cost", TreelessCost(cones_take, load=0.0))

    set_costs()
    return set_costs


@pytest.mark.parametrize("plan", [plan for plan in covering_plans() if not plan.chooses], ids=str)
def test_a_named_plan_is_its_own_choice(asked, plan):
    triangles, query = asked
    choice = accelerator_of(plan, 2).tree_for(triangles, [query]).choice
    assert str(choice) == str(plan) and choice.why == "named by the plan"
    assert (choice.culler, choice.builder, choice.optimiser) == (plan.cull, plan.build, plan.optimise)


def _slow_for_all(features):
    """Nanoseconds per ray of cones that are too slow for all triangles of the scene."""
    return 1e9 * (features.triangles > 2500)


CHOICES = {
    "few rays": ({}, QUICK, None, "too few rays for a better tree"),
    "many rays": ({"good": 0.0}, GOOD, None, "rays would lose more than it costs"),
    "guided": ({"guided": 0.0}, GUIDED, None, "rays would lose more than it costs"),
    "culled": ({"culling": 0.0}, QUICK, CULLER, "used once; "),
    "cones": ({"cones_take": lambda features: 0.0}, "", None, "faster than a tree for its rays"),
    "culled cones": ({"culling": 0.0, "cones_take": _slow_for_all}, "", CULLER, "faster than a tree for its rays"),
}


@pytest.mark.parametrize("name", CHOICES)
def test_auto_states_what_it_builds_and_why(asked, costs, name):
    seconds, tree, culler, why = CHOICES[name]
    costs(**seconds)
    triangles, query = asked
    accelerator, laps = accelerator_of(parse_plan("auto"), 2), []
    accelerator.begin(query.sides.size * 4)
    ready = accelerator.tree_for(triangles, [query], lap=laps.append)
    choice = ready.choice
    assert (choice.tree, choice.culler, choice.updater) == (tree, culler, None) and choice.why.startswith(why)
    assert (choice.tracer == "cones") == ("cones" in name) == (ready.bvh is None)
    assert laps == ["cull"] * (culler is not None) and ready.partial == (culler is not None or ready.bvh is None)
    bits = accelerator.answer(ready, query)
    named = accelerator_of(parse_plan("bsah+single"), 2)
    np.testing.assert_array_equal(bits, named.answer(named.tree_for(triangles, [query]), query))
    assert bits.any()


def test_the_choice_of_a_frame_is_what_ran(costs):
    costs(good=0.0)
    renderer = Renderer(at.procedural("atrium", triangles=3000))
    frame = renderer.render(VIEW, [LAMP])
    assert str(frame.tree) == frame.plan and frame.tree.tree == GOOD
    assert renderer.source.moment(0.0)[1].choice.tree == GOOD
    costs(good=0.0, best=0.0)
    best = renderer.render(VIEW, [LAMP])
    assert best.tree.tree == BEST and best.tree.why == "rays have lost what it costs"
    assert at.render(renderer.scene, VIEW, [LAMP], plan="bsah+wide").tree is None


def test_a_tree_upgraded_while_it_is_used_is_reported_as_such(asked, costs):
    triangles, query = asked
    accelerator = accelerator_of(parse_plan("auto"), 2)
    accelerator.begin(query.sides.size * 4)
    ready = accelerator.tree_for(triangles, [query])
    costs(good=-1.0)
    accelerator.answer(ready, query)
    executed = accelerator.executed(ready)
    assert ready.choice.tree == QUICK and executed.tree == GUIDED and executed.why == "a query would have lost more"
    assert accelerator.memory.builder == GUIDED


def test_accelerators_that_share_a_memory_learn_from_each_other(asked, costs):
    triangles, query = asked
    costs(good=0.0)
    first = accelerator_of(parse_plan("auto"), 2)
    first.begin(query.sides.size * 4)
    assert first.tree_for(triangles, [query]).choice.tree == GOOD
    costs()
    second, third = (type(first)(first.plan, 2, memory) for memory in (first.memory, None))
    assert second.build(triangles).choice.tree == GOOD and third.build(triangles).choice.tree == QUICK


def test_a_memory_starts_frames_and_notes_new_triangles(asked):
    triangles, memory = asked[0], LearnedTrees()
    assert memory.expected == NO_RAYS and memory.first_sight(triangles) and not memory.first_sight(triangles)
    assert not memory.moved(triangles) and not memory.moved(triangles) and memory.moved(triangles._replace())
    memory.patience = 1
    memory.begin(ExpectedRays(5, 7))
    assert memory.expected == (5, 7, 1) and memory.patience == 0


def test_a_refitted_tree_keeps_its_builder_over_a_culled_frame(costs, monkeypatch, tmp_path):
    """The culled tree of the frame in between is a quick one; the refitted tree is still a good one."""
    rng = np.random.default_rng(0)
    still = rng.normal(size=(3000, 3))
    np.save(tmp_path / "frames.npy", np.stack([still, still + 0.01 * rng.normal(size=still.shape)]))
    np.save(tmp_path / "faces.npy", np.arange(3000).reshape(-1, 3))
    renderer, camera = Renderer(at.load(tmp_path)), at.Camera((0, 0, 1), (1, 0, 0), width=24, height=20)
    monkeypatch.setattr(auto_accelerator, "refit_seconds", lambda n, strategy: 1e6)
    lamp, plans = at.PointLight((1.0, 0.2, 0.8)), []
    for time, seconds in ((0.0, {"good": 0.0}), (0.01, {"good": 0.0}), (0.02, {"culling": 0.0}), (0.03, {"good": 0.0})):
        costs(**seconds)
        frame = renderer.render(camera, [lamp], time=time)
        plans.append(frame.plan.rpartition("+")[0])
        assert str(parse_plan(frame.plan)) == str(frame.tree) == frame.plan
        truth = at.render(renderer.scene, camera, [lamp], time=time, plan="bsah+single")
        np.testing.assert_array_equal(frame.bits[0], truth.bits[0])
    assert plans == [GOOD, f"{GOOD}+refit", f"{CULLER}+{QUICK}", f"{GOOD}+refit"]


def test_an_updated_tree_names_the_choice_it_was_built_by(asked):
    """A tree of another choice in between, such as a culled one, does not change what the updated tree is."""
    triangles, _ = asked
    good, quick = (accelerator_of(parse_plan(f"{tree}+wide"), 2).choice for tree in (GOOD, QUICK))
    tree = UpdatedTree("refit")
    first = tree.at(triangles, 2, good)
    assert tree.at(triangles, 2, quick) is first and tree.built is good
    moved = triangles._replace(vertices=triangles.vertices + np.float32(1))
    assert tree.at(moved, 2, quick) is not first and tree.built is good
    assert tree.at(moved._replace(vertices=moved.vertices[:100]), 2, quick) is not first and tree.built is quick
