"""Ray lists: the tree of a moment is optimised once its rays have lost the price, and answers stay."""

import numpy as np
import pytest

import antumbra as at
from antumbra.auto import rates
from antumbra.auto.rates import BEST
from antumbra.engine.ray_lists import PLAN, plan_at
from antumbra.plan import parse_plan

BETTER = parse_plan(f"{BEST}+wide")


@pytest.fixture
def scene():
    return at.procedural("atrium", triangles=3000)


def _rays(n=500):
    rng = np.random.default_rng(2)
    return rng.uniform((-6, 0.1, -4), (6, 5, 4), (n, 3)), rng.normal(size=(n, 3))


def _price(monkeypatch, seconds):
    monkeypatch.setattr(rates, "build_seconds", lambda tree, n: seconds)


@pytest.mark.parametrize("seconds", [0.0, 1e6])
def test_rays_get_a_better_tree_once_it_pays(scene, monkeypatch, seconds):
    _price(monkeypatch, seconds)
    rays = _rays()
    blocked, hit = scene.occluded(*rays), scene.closest_hit(*rays)
    assert 0.1 < blocked.mean() < 1
    plans = scene.__dict__["_accelerated"][1]
    assert set(plans) == ({BETTER} if seconds == 0.0 else {parse_plan(PLAN)})
    tree = next(iter(plans.values())).bvh
    np.testing.assert_array_equal(scene.occluded(*rays), blocked)
    assert next(iter(plans.values())).bvh is tree
    assert (scene.closest_hit(*rays).face == hit.face).all() and (scene.closest_hit(*rays).t == hit.t).all()


def test_another_moment_begins_anew(scene, monkeypatch):
    _price(monkeypatch, 0.0)
    assert plan_at(scene, 0.0) == parse_plan(PLAN)
    scene.occluded(*_rays())
    assert plan_at(scene, 0.0) == BETTER and plan_at(scene, 1.0) == parse_plan(PLAN)


def test_illegal_rays_are_refused_after_the_tree_was_optimised(scene, monkeypatch):
    _price(monkeypatch, 0.0)
    origins, directions = _rays()
    scene.occluded(origins, directions)
    directions[7] = np.nan
    with pytest.raises(at.InputError, match="direction"):
        scene.occluded(origins, directions)
