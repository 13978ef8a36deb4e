"""Time zones from text."""

from datetime import datetime, timedelta

import pytest

import antumbra as at
from antumbra.sun.location import parse_zone


@pytest.mark.parametrize(
    "text, minutes",
    [("+01:00", 60), ("-0330", -210), ("+5", 300), ("+00:00", 0), ("UTC", 0), ("Asia/Kolkata", 330)],
)
def test_zones(text, minutes):
    assert datetime(2026, 1, 1, tzinfo=parse_zone(text)).utcoffset() == timedelta(minutes=minutes)


@pytest.mark.parametrize("text", ["", "Mars/Crater", "+15:00", "+01:75", "../etc/passwd", "CET+1x", "\0", "x" * 999, 3])
def test_zones_that_are_refused(text):
    with pytest.raises(at.InputError, match=r"^timezone .*write a name such as Europe/Amsterdam, or \+01:00$"):
        parse_zone(text)
