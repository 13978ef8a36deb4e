"""Verdicts: what suns score, what passes now and compared with a former state, and one verdict for several windows."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensors import Zone
from antumbra.city.sun.daylight_rules import RULES, Kind, rule_named
from antumbra.city.sun.rule_verdicts import grouped_verdicts, rates_of, verdict_of, with_verdicts
from antumbra.city.tables.result_table import Column, Table
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import month_days, months_of, parse_days, zone_of

LONDON = Place(51.5, -0.1, 0.0, 0.0, "Europe/London")
SUNSHINE = np.array([62.0, 78, 115, 169, 199, 204, 212, 205, 149, 117, 73, 52])
SUN_RULES = [name for name, rule in RULES.items() if rule.kind is not Kind.SKY]


def suns_for(rule, bright=None):
    times = at.times_of(rule.days(2026), zone_of(LONDON), rule.step)
    suns = at.suns_of(LONDON, times, "z", lowest=rule.lowest or 0.0)
    return suns if bright is None else suns._replace(dni=np.where(bright(suns), 500.0, 100.0))


def scores(rule, suns, seen, sunshine=SUNSHINE):
    """(criteria, n): of sensors that see some suns, (n, k)."""
    return list((seen * suns.hours @ rates_of(rule.criteria, suns, sunshine).T).T)


# --- Scores -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SUN_RULES)
def test_seeing_all_suns_passes_and_seeing_none_fails(name):
    rule = rule_named(name)
    suns = suns_for(rule)
    seen = np.stack([np.ones(len(suns.times)), np.zeros(len(suns.times))])
    assert verdict_of(rule, scores(rule, suns, seen)).passes.tolist() == [True, False]


@pytest.mark.parametrize("name", [name for name in SUN_RULES if rule_named(name).kind is Kind.HOURS])
def test_hours_on_a_day(name):
    rule = rule_named(name)
    suns, hours = suns_for(rule), rule.criteria[0].least
    assert len(set(month_days(suns.local).tolist())) == 1
    enough = round(hours * 60 / rule.step)
    order = np.arange(len(suns.times))
    seen = np.stack([order < enough, order < enough - 1, (order >= 10) & (order < 10 + enough)]).astype(float)
    assert verdict_of(rule, scores(rule, suns, seen)).passes.tolist() == [True, False, True]


def test_hours_of_sunshine_spread_over_the_hours_of_each_month():
    rule = rule_named("br209-apsh")
    suns = suns_for(rule)
    annual, winter = rates_of(rule.criteria, suns, SUNSHINE)
    months, days = months_of(suns.local), month_days(suns.local)
    assert (annual * suns.hours).sum() == pytest.approx(100.0)
    for month in range(12):  # by hand: the share of each month is that of its hours of sunshine
        inside = months == month
        share = 100.0 * SUNSHINE[month] / SUNSHINE.sum()
        assert (annual * suns.hours)[inside].sum() == pytest.approx(share) and np.ptp(annual[inside]) == 0.0
    cold = (days >= 921) | (days <= 321)
    assert (winter[~cold] == 0.0).all() and (winter[cold] == annual[cold]).all() and cold.any() and not cold.all()
    assert 20.0 < (winter * suns.hours).sum() < 35.0


def test_only_bright_hours_of_weather_are_probable():
    rule = rule_named("br209-apsh")
    noon = lambda suns: suns.altitude > 20
    suns = suns_for(rule, bright=noon)
    annual, _ = rates_of(rule.criteria, suns)
    assert (annual[~noon(suns)] == 0).all() and (annual * suns.hours).sum() == pytest.approx(100.0)
    with pytest.raises(at.InputError, match="no sun of these days is probable"):
        rates_of(rule.criteria, suns_for(rule, bright=lambda s: np.zeros(len(s.times), bool)))


def test_more_sunshine_than_hours_of_sun_is_refused():
    rule = rule_named("br209-apsh")
    with pytest.raises(at.InputError, match=r"sunshine is 400 h in dec, and the sun is above the horizon for 24. h"):
        rates_of(rule.criteria, suns_for(rule), np.append(SUNSHINE[:11], 400.0))


def test_every_seventh_day_stands_for_its_month():
    rule = rule_named("br209-apsh")
    days = parse_days("2026-01-03:2026-12-31:7")
    suns = at.suns_of(LONDON, at.times_of(days, zone_of(LONDON), 60), "z")
    annual, _ = rates_of(rule.criteria, suns, SUNSHINE)
    june = months_of(suns.local) == 5
    assert (annual * suns.hours)[june].sum() == pytest.approx(100.0 * SUNSHINE[5] / SUNSHINE.sum())
    with pytest.raises(at.InputError, match=r"sunshine is 600 h in jun, .* for (48|49|50)\d h"):
        rates_of(rule.criteria, suns, np.where(np.arange(12) == 5, 600.0, SUNSHINE))


# --- Verdicts ---------------------------------------------------------------------------------------------------------


def test_a_vertical_sky_component_passes_by_itself_or_by_what_remains():
    rule = rule_named("br209-vsc")
    after, before = np.array([27.0, 26.9, 20.0, 19.9, 0.0, 30.0]), np.array([39.6, 39.6, 25.0, 25.0, 0.0, 30.0])
    assert verdict_of(rule, [after]).passes.tolist() == [True, False, False, False, False, True]
    compared = verdict_of(rule, [after], [before])
    assert compared.passes.tolist() == [True, False, True, False, True, True]
    np.testing.assert_allclose(compared.ratio, [27 / 39.6, 26.9 / 39.6, 0.8, 19.9 / 25, np.nan, 1.0])


def test_probable_hours_fail_only_if_they_are_few_and_fewer_than_before_and_the_loss_is_large():
    rule = rule_named("br209-apsh")
    cases = [  # annual and winter, before and after
        ((60, 20), (25, 5), True),  # enough
        ((60, 20), (25, 4.9), False),  # too little in winter, and less than 0.8
        ((24, 5), (19.2, 4), True),  # 0.8 of both
        ((24, 5), (19.1, 4), False),  # a loss of 4.9, and less than 0.8
        ((24, 1), (21, 0), True),  # none is left in winter, but the loss is at most 4
        ((24, 3), (19.9, 3), True),  # more than 0.8
        ((40, 20), (24, 3), False),
    ]
    before, after = (np.array([case[k] for case in cases], float).T for k in (0, 1))
    judged = verdict_of(rule, list(after), list(before))
    assert judged.passes.tolist() == [case[2] for case in cases]
    np.testing.assert_allclose(judged.ratio, np.min(after / before, axis=0))
    assert verdict_of(rule, list(after)).passes.tolist() == [True, *[False] * 6]


def test_hours_of_a_standard_do_not_depend_on_the_former_state():
    for name in ("en17037-medium", "din5034-equinox"):
        rule, few = rule_named(name), np.array([2.9])
        assert verdict_of(rule, [few], [few]).passes.tolist() == verdict_of(rule, [few]).passes.tolist() == [False]


# --- Tables -----------------------------------------------------------------------------------------------------------


def table_of(columns, **about):
    n = len(next(iter(columns.values())))
    points = at.point_sensors(np.arange(3 * n, dtype=float).reshape(n, 3))
    return Table(points, {name: Column(np.array(values), "%", name) for name, values in columns.items()}, about)


def test_verdicts_come_first_and_follow_from_the_names_of_columns():
    table = table_of({"sun_hours": [1.0, 2.0], "br209_vsc": [26.0, 30.0]})
    now = with_verdicts(table, [rule_named("br209-vsc")])
    assert list(now.columns) == ["br209_vsc_passes", "sun_hours", "br209_vsc"] and now.shown(None) == "br209_vsc_passes"
    assert now["br209_vsc_passes"].tolist() == [False, True]
    table.columns["br209_vsc_before"] = Column(np.array([27.0, 60.0]), "%", "before")
    compared = with_verdicts(table, [rule_named("br209-vsc")])
    assert list(compared.columns)[:2] == ["br209_vsc_passes", "br209_vsc_ratio"]
    assert compared["br209_vsc_passes"].tolist() == [True, True]
    assert list(with_verdicts(compared, [rule_named("br209-vsc")]).columns) == list(compared.columns)
    with pytest.raises(at.InputError, match="rule en17037-high judges the column en17037_hours, which the table lacks"):
        with_verdicts(table, [rule_named("en17037-high")])


def joined(rule, columns, row, weights=None):
    table = with_verdicts(table_of(columns), [rule])
    weights = np.ones(len(row)) if weights is None else np.array(weights)
    return {k: v.values.tolist() for k, v in grouped_verdicts([rule])(table.columns, np.array(row), weights).items()}


def test_the_best_window_decides_for_a_dwelling_by_en_17037():
    found = joined(rule_named("en17037-minimum"), {"en17037_hours": [0.0, 2.0, 1.0, 1.2]}, [0, 0, 1, 1])
    assert found["en17037_minimum_passes"] == [True, False] and found["en17037_hours"] == [2.0, 1.2]
    assert found["en17037_minimum_share"] == [0.5, 0.0]


def test_every_window_decides_by_br_209():
    after, before = np.array([30.0, 20.0, 10.0, 28.0]), np.array([40.0, 21.0, 20.0, 28.0])
    columns = {"br209_vsc": after, "br209_vsc_before": before, "br209_vsc_loss": before - after}
    found = joined(rule_named("br209-vsc"), columns, [0, 0, 1, 1], [1.0, 1.0, 1.0, 3.0])
    assert found["br209_vsc_passes"] == [True, False]  # 30 by itself, 20 by what remains
    assert found["br209_vsc"] == [20.0, 10.0] and found["br209_vsc_before"] == [21.0, 20.0]
    assert found["br209_vsc_loss"] == [1.0, 10.0] and found["br209_vsc_share"] == [1.0, 0.75]
    assert found["br209_vsc_ratio"] == [0.75, 0.5]


def test_an_area_passes_by_half_of_it_or_by_what_remains():
    rule, zones = rule_named("br209-amenity"), (Zone("lawn", 4, 0),)
    points = np.zeros((4, 3))
    sensors = at.Sensors(points, None, None, None, "points", zone=np.zeros(4, int), zones=zones)

    def judged(after, before=None):
        columns = {"br209_amenity_hours": Column(np.array(after, float), "h", "")}
        columns |= {} if before is None else {"br209_amenity_hours_before": Column(np.array(before, float), "h", "")}
        (record,) = with_verdicts(Table(sensors, columns), [rule]).about["areas"]
        return record

    assert judged([2, 2, 0, 0])["passes"] and not judged([2, 1.9, 0, 0])["passes"]
    assert judged([2, 0, 0, 0], [2, 0, 0, 0])["passes"] and not judged([2, 0, 0, 0], [2, 2, 0, 0])["passes"]
    assert judged([2, 0, 0, 0], [2, 2, 0, 0])["share_before"] == 0.5
    assert judged([2, 2, 2, 2])["sun_hours"] == 2.0
