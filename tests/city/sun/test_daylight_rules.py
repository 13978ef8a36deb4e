"""Daylight rules: what each is made of, and which days and data it accepts."""

from dataclasses import replace

import pytest

import antumbra as at
from antumbra.city.sun.daylight_rules import RULES, Kind, check_rules, rule_named, rules_named
from antumbra.city.sun.sun_options import SunOptions
from antumbra.sun.sun_positions import parse_days


@pytest.mark.parametrize("name", RULES)
def test_a_rule_says_where_it_stands_and_what_it_leaves_out(name):
    rule = rule_named(name)
    assert rule.name == name and rule.citation and rule.text.endswith(".") and rule.notes.endswith(".")
    assert len({each.kind for each in rule.criteria}) == 1 and all(each.least > 0.0 for each in rule.criteria)
    assert (rule.days is None) == (rule.kind is Kind.SKY)
    assert rule.prefix.isidentifier() and all(each.column.isidentifier() for each in rule.criteria)


def test_quantities_of_the_same_name_are_the_same():
    found = {}
    for rule in RULES.values():
        for each in rule.criteria:
            alike = each.kind, each.about, each.period, rule.lowest, rule.period
            assert found.setdefault(each.column, alike) == alike
    assert len(found) < sum(len(rule.criteria) for rule in RULES.values())  # the levels of EN 17037 share theirs


@pytest.mark.parametrize(
    "name, least, kept, best",
    [
        ("br209-vsc", [27.0], 0.8, False),
        ("br209-apsh", [25.0, 5.0], 0.8, False),
        ("br209-amenity", [2.0], 0.8, False),
        ("din5034-winter", [1.0], None, True),
        ("din5034-equinox", [4.0], None, True),
        ("en17037-minimum", [1.5], None, True),
        ("en17037-medium", [3.0], None, True),
        ("en17037-high", [4.0], None, True),
    ],
)
def test_thresholds(name, least, kept, best):
    rule = rule_named(name)
    assert [each.least for each in rule.criteria] == least and (rule.kept, rule.best) == (kept, best)
    assert rule.small_loss == (4.0 if name == "br209-apsh" else None)
    assert rule.area == (0.5 if name == "br209-amenity" else None)


def test_unknown_rules():
    with pytest.raises(
        at.InputError, match="rule 'x' is unknown; use one of br209-vsc, br209-apsh, br209-amenity, din"
    ):
        rule_named("x")
    with pytest.raises(at.InputError, match="rule 'en17037-medum' is unknown; did you mean 'en17037-medium'"):
        rules_named(["br209-vsc", "en17037-medum"])
    with pytest.raises(at.InputError, match="rule must be a str, not int"):
        rules_named(3)


def test_several_rules_are_taken_once_each_in_their_order():
    names = ["din5034-winter", "br209-vsc", "din5034-winter"]
    assert [each.name for each in rules_named(names)] == names[:2]
    assert SunOptions(rule=names).rule == ("din5034-winter", "br209-vsc") and SunOptions(rule="br209-vsc").rules
    assert SunOptions().rules == () and replace(SunOptions(), rule="br209-vsc").rule == ("br209-vsc",)


@pytest.mark.parametrize(
    "name, fine, wrong",
    [
        ("br209-amenity", ["2026-03-21", "2031-03-21"], ["2026-06-21", "2026-03-20:2026-03-22", "year:2026"]),
        ("br209-apsh", ["year:2026", "2026-01-21:2026-12-21:7"], ["2026-03-21", "2026-01-01:2026-11-30"]),
        ("en17037-medium", ["2026-02-01", "2026-03-21"], ["2026-03-22", "2026-01-31", "2026-03-20,2026-03-21"]),
        ("din5034-winter", ["2026-01-17"], ["2026-01-18", "2026-03-21"]),
        ("din5034-equinox", ["2026-03-20", "2026-03-21"], ["2026-01-17", "2026-03-20,2026-03-21"]),
    ],
)
def test_days_that_a_rule_is_not_about_are_refused(name, fine, wrong):
    rules = [rule_named(name)]
    check_rules(rules, None, True, True)
    for text in fine:
        check_rules(rules, parse_days(text), True, True)
    for text in wrong:
        with pytest.raises(at.InputError, match=f"rule {name} is about .*leave the days out"):
            check_rules(rules, parse_days(text), True, True)


def test_every_rule_accepts_its_own_days_and_the_light_of_the_sky_any():
    for rule in RULES.values():
        check_rules([rule], parse_days("2026-06-21") if rule.days is None else rule.days(2026), True, True)


def test_a_rule_without_the_data_that_it_needs_is_refused():
    with pytest.raises(at.InputError, match=r"br209-apsh counts .* give an EPW file, or .* --sunshine JAN/FEB"):
        SunOptions(rule="br209-apsh").check_rules(False)
    SunOptions(rule="br209-apsh", sunshine="/".join(["60"] * 12)).check_rules(False)
    with pytest.raises(at.InputError, match="br209-amenity judges gardens"):
        SunOptions(rule=["en17037-high", "br209-amenity"]).check_rules(False)


@pytest.mark.parametrize(
    "keywords, words",
    [
        ({"sunshine": "60/70"}, "write twelve mean hours of sunshine, JAN/FEB/.../DEC"),
        ({"sunshine": "/".join("abcdefghijkl")}, "its hours must be numbers from 0 to 744"),
        ({"sunshine": [-1.0] * 12}, "its hours must be numbers from 0 to 744"),
        ({"lowest": 90.0}, "lowest"),
        ({"tilt": "100:80"}, "write the smaller angle first"),
        ({"tilt": "80"}, "write FROM:TO in degrees, such as 80:100"),
        ({"tilt": (0, 200)}, "write two numbers from 0 to 180"),
        ({"per": 3}, "it must be"),
    ],
)
def test_options_of_rules_are_checked(keywords, words):
    with pytest.raises(at.InputError, match=words):
        SunOptions(**keywords)
