"""Daylight rules: what suns weigh, and what passes."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sun.daylight_rules import RULES, check_rule, meets_rule, rule_named, weights_of
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import month_days, parse_days, zone_of

LONDON = Place(51.5, -0.1, 0.0, 0.0, "Europe/London")


def suns_for(rule, place=LONDON, bright=None):
    times = at.times_of(rule.days(2026), zone_of(place), rule.step)
    suns = at.suns_of(place, times, "z")
    return suns if bright is None else suns._replace(dni=np.where(bright(suns), 500.0, 100.0))


@pytest.mark.parametrize("name", RULES)
def test_seeing_all_suns_passes_and_seeing_none_fails(name):
    rule = rule_named(name)
    suns = suns_for(rule)
    weights = weights_of(rule, suns)
    assert weights.shape == (len(rule.criteria), len(suns.times)) and rule.text and rule.notes and rule.citation
    seen = np.stack([np.ones(len(suns.times)), np.zeros(len(suns.times))])
    np.testing.assert_array_equal(meets_rule(rule, seen @ weights.T), [True, False])


@pytest.mark.parametrize(
    "name, hours", [("br209-amenity", 2), ("en17037-minimum", 1.5), ("en17037-medium", 3), ("en17037-high", 4)]
)
def test_hours_on_a_day(name, hours):
    rule = rule_named(name)
    suns = suns_for(rule)
    assert set(month_days(suns.local).tolist()) == {321}
    enough = round(hours * 60 / rule.step)
    order = np.arange(len(suns.times))
    seen = np.stack([order < enough, order < enough - 1, (order >= 40) & (order < 40 + enough)]).astype(float)
    np.testing.assert_array_equal(meets_rule(rule, seen @ weights_of(rule, suns).T), [True, False, True])
    assert rule.area == (0.5 if name == "br209-amenity" else None)


def test_probable_sunlight_hours():
    rule = rule_named("br209-windows")
    suns = suns_for(rule)
    days = month_days(suns.local)
    winter = (days >= 921) | (days <= 321)
    annual, cold = weights_of(rule, suns)
    assert annual.sum() == pytest.approx(1.0) and (cold[~winter] == 0).all() and 0.3 < cold.sum() < 0.5
    np.testing.assert_array_equal(cold[winter], annual[winter])
    order = np.random.default_rng(0).permutation(len(days))
    seen = np.zeros((4, len(days)))
    seen[0, order[: int(0.26 * len(days))]] = 1  # spread over the year
    seen[1, order[: int(0.24 * len(days))]] = 1
    seen[2, ~winter] = 1  # much, but none in winter
    seen[3, winter] = 1  # only winter, which is more than a quarter of the year's hours
    np.testing.assert_array_equal(meets_rule(rule, seen @ weights_of(rule, suns).T), [True, False, False, True])


def test_only_bright_hours_are_probable():
    rule = rule_named("br209-windows")
    noon = lambda suns: suns.altitude > 20
    suns = suns_for(rule, bright=noon)
    annual, _ = weights_of(rule, suns)
    assert (annual[~noon(suns)] == 0).all() and annual.sum() == pytest.approx(1.0)
    with pytest.raises(at.InputError, match="no sun is above the horizon"):
        weights_of(rule, suns_for(rule, bright=lambda s: np.zeros(len(s.times), bool)))


def test_unknown_rules():
    with pytest.raises(
        at.InputError, match="rule 'x' is unknown; use one of br209-windows, br209-amenity, en17037-min"
    ):
        rule_named("x")


@pytest.mark.parametrize(
    "name, fine, wrong",
    [
        ("br209-amenity", ["2026-03-21", "2031-03-21"], ["2026-06-21", "2026-03-20:2026-03-22", "year:2026"]),
        ("br209-windows", ["year:2026", "2026-01-21:2026-12-21:7"], ["2026-03-21", "2026-01-01:2026-11-30"]),
        ("en17037-medium", ["2026-02-01", "2026-03-21"], ["2026-03-22", "2026-01-31", "2026-03-20,2026-03-21"]),
    ],
)
def test_days_that_a_rule_is_not_about_are_refused(name, fine, wrong):
    check_rule(name, None, True)
    for text in fine:
        check_rule(name, parse_days(text), True)
    for text in wrong:
        with pytest.raises(at.InputError, match=f"rule {name} is about .*leave the days out"):
            check_rule(name, parse_days(text), True)


def test_every_rule_has_days_of_its_own_that_it_accepts():
    for name, rule in RULES.items():
        check_rule(name, rule.days(2026), True)
