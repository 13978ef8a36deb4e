"""`Page`: its frame in notebooks, and the moment of its first picture."""

from datetime import date, datetime

import pytest

import antumbra as at
from antumbra.web.scene_page import NOON, Page, local_time


def test_a_frame_holds_the_whole_page_and_cannot_reach_the_notebook():
    shown = Page('<p class="a">1 < 2</p>', 1)._repr_html_()
    assert 'srcdoc="&lt;p class=&quot;a&quot;&gt;1 &lt; 2&lt;/p&gt;"' in shown and 'sandbox="allow-scripts' in shown
    assert "allow-same-origin" not in shown


def test_a_large_page_is_left_out_with_the_remedy():
    assert "give page() a path" in Page("a" * 30_000_000, 1)._repr_html_()


@pytest.mark.parametrize("when", ["2026-06-21", date(2026, 6, 21), datetime.combine(date(2026, 6, 21), NOON)])
def test_a_day_is_shown_in_the_afternoon(when):
    assert local_time(when, "when") == datetime(2026, 6, 21, 14)


@pytest.mark.parametrize("when", ["June", "2026-06-21T12:00+02:00", "1492-10-12", 3])
def test_other_moments_are_refused(when):
    with pytest.raises(at.InputError, match="write 2026-06-21, or 2026-06-21T15:30 in local time"):
        local_time(when, "--date")
