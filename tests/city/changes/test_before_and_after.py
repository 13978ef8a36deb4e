"""Two tables as one: which columns have a loss, and how they are called."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.changes.before_and_after import BEFORE, LOSS

POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])


def table(points=POINTS, about=None, **columns):
    named = {name: at.Column(np.asarray(values), "h", f"the {name}") for name, values in columns.items()}
    return at.Table(at.point_sensors(points), named, about or {})


def test_a_quantity_has_its_loss_first_then_both_states():
    both = at.before_and_after(table(sun_hours=[3.0, 5.0]), table(sun_hours=[1.0, 5.5]))
    assert (
        list(both.columns) == ["sun_hours" + LOSS, "sun_hours" + BEFORE, "sun_hours"]
        and both.shown(None) == "sun_hours_loss"
    )
    assert both["sun_hours_loss"].tolist() == [2.0, -0.5] and both["sun_hours_before"].tolist() == [3.0, 5.0]
    assert both.columns["sun_hours_loss"].unit == "h"


def test_counts_lose_whole_numbers_and_do_not_wrap():
    both = at.before_and_after(table(seen=np.array([1, 9], np.uint8)), table(seen=np.array([2, 4], np.uint8)))
    assert both["seen_loss"].tolist() == [-1, 5] and both["seen_loss"].dtype == np.int64


@pytest.mark.parametrize(
    "values", [[True, False], np.array(["2026-03-21T10:00", "NaT"], "datetime64[s]"), np.array(["a", "b"], object)]
)
def test_times_names_and_verdicts_have_both_states_and_no_loss(values):
    both = at.before_and_after(table(q=values), table(q=values))
    assert list(both.columns) == ["q_before", "q"]


def test_what_describes_the_sensors_stands_once():
    both = at.before_and_after(table(azimuth=[1.0, 2.0], q=[1.0, 2.0]), table(azimuth=[1.0, 2.0], q=[1.0, 2.0]))
    assert list(both.columns) == ["azimuth", "q_loss", "q_before", "q"]


def test_a_missing_value_has_a_missing_loss():
    both = at.before_and_after(table(q=[np.nan, 2.0]), table(q=[1.0, np.nan]))
    assert np.isnan(both["q_loss"]).all()


def test_other_sensors_or_columns_are_refused():
    with pytest.raises(at.InputError, match="before and after have other sensors; give both studies the same Sensors"):
        at.before_and_after(table(q=[1.0, 2.0]), table(POINTS + 1.0, q=[1.0, 2.0]))
    with pytest.raises(at.InputError, match="the column 'r' is in one state only"):
        at.before_and_after(table(q=[1.0, 2.0]), table(r=[1.0, 2.0]))
