"""Plans: names from the registries, and nothing else."""

import pytest

from antumbra.bvh import BUILDERS, OPTIMISERS
from antumbra.errors import InputError
from antumbra.plan import KINDS, Plan, all_plans, covering_plans, parse_plan
from antumbra.trace.orders import ORDERS


def test_every_plan_reads_as_it_is_written():
    plans = all_plans()
    assert Plan() in plans and len(set(plans)) == len(plans)
    for plan in plans:
        assert parse_plan(str(plan)) == plan == parse_plan(plan)


def test_order_does_not_matter():
    assert parse_plan("single+bsah") == Plan(None, "bsah", "single")


def test_a_few_plans_have_every_method():
    plans = covering_plans()
    assert len(set(plans)) == len(plans) and set(plans) <= set(all_plans())
    for field, (_, registry) in KINDS.items():
        assert {getattr(plan, field) for plan in plans} >= set(registry)


@pytest.mark.skipif(not KINDS["update"][1], reason="there is no updater")
def test_a_tree_is_not_kept_of_triangles_that_change():
    with pytest.raises(InputError, match="leave one of them out"):
        parse_plan("grid32+bsah+refit+single")


@pytest.mark.parametrize("text", ["", "+", "bsah+", "bsah+singel", "bsah", "single", "bsah+single+single", "auto"])
def test_what_is_not_a_plan_is_refused_with_the_valid_names(text):
    with pytest.raises(InputError, match=r"builders: .*bsah.*tracers: .*single"):
        parse_plan(text)


@pytest.mark.parametrize("build", [name for name, builder in BUILDERS.items() if builder.wants_rays])
@pytest.mark.parametrize("optimise", OPTIMISERS)
def test_no_optimiser_comes_after_a_builder_that_wants_rays(build, optimise):
    with pytest.raises(InputError, match=f"'{optimise}' .* what '{build}' does for shadow rays; leave one of them out"):
        parse_plan(f"{build}+{optimise}+single")
    assert not [p for p in all_plans() if p.build == build and p.optimise]


def test_which_plans_want_rays():
    for plan in all_plans():
        assert plan.wants_rays == (plan.build.startswith("srdh") or plan.optimise == "srdh-order")


def test_orders_have_a_part_each():
    """Orders change the tracer `single` alone, so a plan of each is enough."""
    plans = covering_plans()
    for name in ORDERS:
        assert [p for p in plans if p.trace == f"single:{name}"] == [Plan(trace=f"single:{name}")]
