"""Plans consist of names from the registries."""

import pytest

from antumbra.base.errors import InputError
from antumbra.engine.method_registry import BUILDERS, KINDS, OPTIMISERS, TRACERS, own_methods, register
from antumbra.engine.plan import DEFAULT_PLAN, TREE, Plan, all_plans, covering_plans, parse_plan
from antumbra.lab.papers.published_methods import ORDERS


def test_the_instrument_has_few_methods():
    counts = {field: len(own_methods(field)) for field in KINDS}
    assert counts["trace"] <= 12 and counts["build"] <= 7 and len(all_plans()) < len(all_plans(papers=True)) / 3


def test_a_taken_name_is_refused():
    for name in "bsah", "wide", "a+b":
        with pytest.raises(ValueError, match="cannot be the name of a builder"):
            register("build", name, BUILDERS["bsah"])
    assert len(BUILDERS) == len(set(BUILDERS))


@pytest.mark.parametrize("papers", [False, True])
def test_every_plan_reads_as_it_is_written(papers):
    plans = all_plans(papers)
    assert Plan() in plans and len(set(plans)) == len(plans)
    for plan in plans:
        assert parse_plan(str(plan)) == plan == parse_plan(plan)


def test_auto_chooses_the_rest_of_its_plan_or_has_a_builder():
    auto = parse_plan("auto")
    assert auto.chooses and auto.build is None and str(auto) == DEFAULT_PLAN == "auto" and parse_plan(auto) == auto
    assert not parse_plan("lbvh+auto").chooses and parse_plan("auto+lbvh") == Plan(build="lbvh", trace="auto")
    assert parse_plan("auto").tree != parse_plan("cones").tree
    for plan in ("grid32+auto", "auto+refit", "auto+reinsert"):
        with pytest.raises(InputError, match="'auto' chooses the rest of the plan"):
            parse_plan(plan)


def test_order_does_not_matter():
    assert parse_plan("single+bsah") == Plan(None, "bsah", "single")
    assert parse_plan("cones+grid32") == Plan(cull="grid32", trace="cones")


def test_a_builder_is_there_unless_the_tracer_walks_no_bvh():
    assert str(Plan()) == "bsah+multifrusta" and Plan(trace="cones").build is None
    assert str(Plan(trace="cones")) == "cones" and str(Plan("grid32", trace="cones")) == "grid32+cones"
    plans = all_plans(papers=True)
    assert {plan.tracer.builds for plan in plans} == {True, False}
    for plan in plans:
        assert (plan.build is not None or plan.chooses) == plan.tracer.builds == TRACERS[plan.trace].builds
        assert plan.tracer.builds or plan.optimise is plan.update is None


@pytest.mark.parametrize("field", TREE)
def test_nothing_that_makes_a_bvh_goes_with_a_tracer_that_walks_none(field):
    kind, names = KINDS[field]
    for name in names:
        says = f"plan '{name}\\+cones': 'cones' needs no {kind}; leave '{name}' out"
        with pytest.raises(InputError, match=says):
            parse_plan(f"{name}+cones")
    with pytest.raises(InputError, match="needs no builder"):
        parse_plan(Plan(build="bsah", trace="cones:spheres:sorted"))


def test_options_of_cones_combine_in_any_order():
    for text in ("cones:spheres:sorted", "cones:sorted:spheres"):
        assert parse_plan(text) == Plan(trace="cones:spheres:sorted")
    every = [name.removeprefix("cones:") for name in TRACERS if name.startswith("cones:") and name.islower()]
    every = [word for word in every if word not in ("spheres", "precise")]  # these exclude others
    assert str(parse_plan(":".join(["cones", *reversed(every)]))) == ":".join(["cones", *every])
    assert len(every) > 3 and "cones:precise:sorted" not in {plan.trace for plan in all_plans(papers=True)}


def test_options_that_exclude_each_other():
    with pytest.raises(InputError, match=r"'spheres' and 'precise' exclude each other"):
        parse_plan("cones:spheres:sorted:precise")


@pytest.mark.parametrize("papers", [False, True])
def test_a_few_plans_have_every_method(papers):
    plans = covering_plans(papers)
    assert len(set(plans)) == len(plans) and set(plans) <= set(all_plans(papers))
    for field, (_, registry) in KINDS.items():
        assert {getattr(plan, field) for plan in plans} >= set(registry if papers else own_methods(field))


def test_an_updater_goes_with_a_culler():
    for update in own_methods("update"):
        plan = parse_plan(f"grid32+bsah+{update}+single")
        assert (plan.cull, plan.update) == ("grid32", update) and plan in all_plans() and plan in covering_plans()


@pytest.mark.parametrize(
    "text",
    ["", "+", "bsah+", "bsah+singel", "bsah", "single", "bsah+single+single", "autos", "grid32", "cones+cones",
     "cones:", "cones:magic", "cones:sorted:sorted", "cones+single", "spheres"],
)  # fmt: skip
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
        assert plan.wants_rays == ((plan.build or "").startswith("srdh") or plan.optimise == "srdh-order")


def test_orders_have_a_part_each():
    """Orders change the tracer `single` only, so one plan of each is enough."""
    plans = covering_plans(papers=True)
    for name in ORDERS:
        assert [p for p in plans if p.trace == f"single:{name}"] == [Plan(trace=f"single:{name}")]


@pytest.mark.parametrize(
    "make, words",
    [
        (
            lambda: Plan("bsah+wide"),
            r"it takes cull=.* one by one; write a whole plan as a string, as in plan='bsah\+wide'",
        ),
        (lambda: Plan(trace="bsah"), "Plan has no tracer 'bsah': it takes cull="),
        (lambda: Plan(build="bsha"), "Plan has no builder 'bsha'; did you mean 'bsah'"),
        (lambda: parse_plan("bsah+multifrustra"), "unknown part 'multifrustra'; did you mean 'multifrusta'"),
    ],
)
def test_wrong_names_fail_at_once_with_the_cure(make, words):
    with pytest.raises(InputError, match=words):
        make()
