"""`antumbra plans` and `antumbra warmup`."""

import pytest

from antumbra import Plan, warm
from antumbra.plan import KINDS, all_plans, covering_plans, parse_plan


def test_every_method_and_plan_is_listed(cli):
    told = cli("plans", "--json").json()
    for kind, registry in KINDS.values():
        listed = {m["name"]: m for m in told["methods"] if m["kind"] == kind}
        assert listed.keys() == registry.keys()
        assert all(m["description"] and m["paper"] for m in listed.values())
    assert [parse_plan(name) for name in told["plans"]] == all_plans()
    assert told["default"] == str(Plan()) == "bsah+multifrusta"


def test_plans_for_people(cli):
    shown = " ".join(cli("plans").out.split())
    for _, registry in KINDS.values():
        for name, method in registry.items():
            assert name in shown and method.description.split()[0] in shown and method.paper.split()[0] in shown
    assert "culler+builder" in shown and "updater+tracer" in shown and str(Plan()) in shown and "no builder" in shown


@pytest.fixture
def compiled(monkeypatch):
    """What `antumbra warmup` compiles, without compiling it."""
    done: list[str] = []
    monkeypatch.setattr(warm, "warm_up", lambda plan, gbuffer, counters: done.append(f"{plan} {gbuffer} {counters}"))
    monkeypatch.setattr(warm, "warm_up_quality", lambda plan, gbuffer: done.append("filter and refinement"))
    monkeypatch.setattr(warm, "warm_up_indirect", lambda plan, gbuffer: done.append("light that bounces"))
    monkeypatch.setattr(warm, "warm_up_rays", lambda: done.append("ray queries"))
    monkeypatch.setattr(warm, "warm_up_steps", lambda: done.append("counted steps"))
    monkeypatch.setattr(warm, "warm_up_store", lambda: done.append("building stores"))
    monkeypatch.setattr(warm, "warm_up_bounce", lambda: done.append("a diffuse bounce"))
    return done


def test_warmup_compiles_everything_once(cli, compiled):
    done = cli("warmup")
    assert done.code == 0 and f"{len(compiled)} sets of kernels" in done.out
    kinds = [1 + plan.tracer.counts_apart for plan in covering_plans()]  # of kernels: most tracers count in all
    assert len(compiled) == len(set(compiled)) == 6 + 2 * sum(kinds) and set(kinds) == {1, 2}


def test_warmup_of_one_plan(cli, compiled):
    told = cli("warmup", "--plan", "bsah+single", "--plan", "bsah+single", "--json").json()
    assert len(told["kernels"]) == len(compiled) == 9
    assert told["folder"] and told["seconds"] >= 0.0
    assert all("bsah+single" in name or name in compiled[:5] for name in told["kernels"])


def test_warmup_of_a_builder_that_wants_rays(cli, compiled):
    assert cli("warmup", "--plan", "srdh+single", "--plan", "srdh+wide", "--quiet").code == 0
    assert compiled.count("a diffuse bounce") == 1 and len(compiled) == 6 + 4 + 2  # `single` has kernels that count


def test_warmup_quietly(cli, compiled):
    assert cli("warmup", "--quiet") == (0, "", "")


def test_warmup_of_an_unknown_plan(cli, compiled):
    cli("warmup", "--plan", "magic").refused("magic")
    assert compiled == []
