"""Plans: names from the registries, and nothing else."""

import pytest

from antumbra.errors import InputError
from antumbra.plan import KINDS, Plan, all_plans, covering_plans, parse_plan


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
