"""`antumbra plans` and `antumbra warmup`."""

import pytest

from antumbra.engine import precompilation
from antumbra.engine.method_registry import KINDS, own_methods
from antumbra.engine.plan import DEFAULT_PLAN, all_plans, covering_plans, parse_plan
from antumbra.work.warm_ups import all_examples

COMMON = len(all_examples([]))  # examples of all plans; wide lights of `cones`, and the bounce of `srdh`, add one each


@pytest.mark.parametrize("papers", [False, True])
def test_every_method_and_plan_is_listed(cli, papers):
    told = cli("plans", "--json", *["--papers"] * papers).json()
    for field, (kind, registry) in KINDS.items():
        listed = {m["name"]: m for m in told["methods"] if m["kind"] == kind}
        assert list(listed) == (list(registry) if papers else own_methods(field))
        assert all(m["description"] and (m["paper"] or m["name"] == "auto") for m in listed.values())
    assert [parse_plan(name) for name in told["plans"]] == all_plans(papers)
    assert told["default"] == DEFAULT_PLAN == "auto"


def test_plans_for_people(cli):
    shown = " ".join(cli("plans").out.split())
    for field, (_, registry) in KINDS.items():
        for name in own_methods(field):
            method = registry[name]
            assert name in shown and method.description.split()[0] in shown and method.paper.partition(" ")[0] in shown
    assert "multifrusta:paper" not in shown
    assert "culler+builder" in shown and "updater+tracer" in shown and DEFAULT_PLAN in shown and "no builder" in shown


@pytest.fixture
def done(monkeypatch):
    """The examples whose kernels `antumbra warmup` prepares. None is compiled."""
    names: list[str] = []

    def precompile_all(examples):
        names.extend(example.name for example in examples)
        return 3

    monkeypatch.setattr(precompilation, "precompile_all", precompile_all)
    return names


def test_warmup_is_for_every_method(cli, done):
    told = cli("warmup")
    assert told.code == 0 and f"{len(done)} jobs are ready, 3 newly compiled" in told.out.replace("\n", " ")
    kinds = [1 + plan.tracer.counts_apart for plan in covering_plans()]  # of kernels: most tracers count in all
    assert len(done) == len(set(done)) == COMMON + 2 + 2 * sum(kinds) and set(kinds) == {1, 2}


def test_warmup_of_one_plan(cli, done):
    told = cli("warmup", "--plan", "bsah+single", "--plan", "bsah+single", "--json").json()
    assert told["jobs"] == done and told["compiled"] == 3 and told["folder"] and told["seconds"] >= 0.0
    own = sum("bsah+single" in name for name in done)  # `single` has kernels that count
    assert len(done) == COMMON + 4 and own == 4


def test_warmup_of_a_builder_that_wants_rays(cli, done):
    assert cli("warmup", "--plan", "srdh+single", "--plan", "srdh+wide", "--quiet").code == 0
    assert done.count("a diffuse bounce") == 1 and len(done) == COMMON + 7


def test_warmup_quietly(cli, done):
    assert cli("warmup", "--quiet") == (0, "", "")


def test_warmup_of_an_unknown_plan(cli, done):
    cli("warmup", "--plan", "magic").refused("magic")
    assert done == []
