"""scripts/guard.py: its plans cover the registries, and it reports each kind of difference."""

import pytest

from antumbra.engine.method_registry import KINDS, own_methods
from antumbra.engine.plan import parse_plan
from repository import ROOT, tool

guard = tool(ROOT / "scripts" / "guard.py")


@pytest.mark.parametrize("field", KINDS)
def test_plans_use_every_method(field):
    assert {getattr(parse_plan(plan), field) for plan in guard.plans()} >= set(own_methods(field))


def test_differences_are_reported():
    old = {"a, bits": {"auto": "1"}, "b, bits": {"auto": "1"}, "a, picture": {"auto": "5"}}
    new = {
        "a, bits": {"auto": "1", "bsah+wide": "1"},
        "b, bits": {"auto": "2", "bsah+wide": "3"},
        "a, picture": {"auto": "5"},
        "c, bits": {"auto": "4"},
    }
    assert guard.differences(old, old) == []
    assert guard.differences(old, new) == ["b, bits: bsah+wide disagree with auto", "b, bits: CHANGED", "c, bits: new"]


def test_benchmarks_run(monkeypatch):
    import antumbra as at

    scene = at.procedural("atrium", triangles=2_000)
    view = "atrium", scene, scene.default_camera(16, 12), guard.standard_lights(scene)
    monkeypatch.setattr(guard, "scenes", lambda: iter([view]))
    calls = dict(guard.benchmarks())
    assert len(calls) == 8
    assert calls["atrium: occluded, 100 rays"]().shape == (100,)
