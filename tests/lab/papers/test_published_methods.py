"""Every plan with a method of the papers against the brute-force oracle: not one bit may differ."""

from itertools import product

import numpy as np
import pytest

from antumbra.engine.plan import Plan, covering_plans
from asking import answer
from truths import LIGHTS, asked_of, case_of

PLANS = [plan for plan in covering_plans(papers=True) if plan not in covering_plans()]
TRACERS = (
    *("multifrusta:paper", "multifrusta:full", "packet16:paper", "packet256"),
    *("cones:SpheresSorted", "cones:PreciseSEATP"),
)
TRACING = [Plan(trace=name) for name in TRACERS]  # tracers: each handles lights and samples in its own way
LIT = [*TRACING, Plan(cull="grid32:paper", trace="single")]


def check(plan, triangles, query, truth):
    np.testing.assert_array_equal(answer(plan, triangles, query), truth)


def test_all_methods_are_here():
    assert len(PLANS) > 30 and set(LIT) <= set(PLANS)


@pytest.fixture(scope="module")
def case(request):
    return case_of(request.param, (48, 34))


@pytest.mark.parametrize(
    "case, plan", [*product(["soup"], PLANS), *product(["cellar"], LIT)], indirect=["case"], ids=str
)
def test_no_bit_differs_from_the_oracle(case, plan):
    check(plan, *case)


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("plan", LIT, ids=str)
def test_every_light_shape(plan, name):
    check(plan, *asked_of(7, (24, 20), LIGHTS[name], 5)[:3])


@pytest.mark.parametrize("spp", [1, 65])
@pytest.mark.parametrize("plan", TRACING, ids=str)
def test_numbers_of_samples(plan, spp):
    check(plan, *asked_of(9, (12, 9), LIGHTS["quad"], spp)[:3])


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("plan", LIT, ids=str)
def test_scales(plan, scale):
    check(plan, *asked_of(11, (24, 20), None, 8, scale)[:3])


@pytest.mark.parametrize("plan", LIT, ids=str)
def test_threads_do_not_matter(plan):
    triangles, query, truth, _ = asked_of(9, (45, 37), LIGHTS["quad"], 4)
    for threads in 1, 3:
        np.testing.assert_array_equal(answer(plan, triangles, query, threads), truth)
