"""Options of map sheets: fields of the command line and of Python, and one line about each wrong value."""

import datetime

import pytest

import antumbra as at
from antumbra.city.sheets.sheet_options import checked_sheet, parse_sheet


def test_fields_of_the_command_line_are_those_of_python():
    parsed = parse_sheet(
        [
            "title=A = B",
            "project=River Street 5",
            "author=A. Planner",
            "date=2026-03-21",
            "licence=CC BY 4.0",
            "paper=A3",
        ]
        + ["orientation=Portrait", "scale=1:2,500", "extent=1,2.5,30,40", "labels=none", "pages=sources,map"]
        + ["sources=a.csv", "sources=b.csv"]
    )
    assert parsed == at.Sheet(
        title="A = B", project="River Street 5", author="A. Planner", date=datetime.date(2026, 3, 21),
        licence="CC BY 4.0", paper="a3", orientation="portrait", scale=2500, extent=[1, 2.5, 30, 40], labels="none",
        pages=("map", "sources"), sources=["a.csv", "b.csv"],
    )  # fmt: skip
    assert parsed.denominator == 2500.0 and checked_sheet(None) == at.Sheet()
    assert checked_sheet(parsed, "New").title == "New" and checked_sheet(parsed) is parsed


@pytest.mark.parametrize("text, scale", [("1:500", 500), ("1 : 1_250", 1250), ("500", 500), ("1:62.5", 62.5)])
def test_scales_are_written_with_or_without_the_one(text, scale):
    assert at.Sheet(scale=text).denominator == scale


def test_a_sheet_has_no_date_unless_it_is_given():
    assert at.Sheet().date is None and at.Sheet(date="today").date == datetime.date.today().isoformat()
    assert at.Sheet(date="spring 2026").date == "spring 2026"


@pytest.mark.parametrize(
    "texts, message",
    [
        (["scal=1:500"], "--sheet scal: there is no such field; did you mean 'scale'? the fields are title, project"),
        (["scale"], "--sheet 'scale': write FIELD=VALUE"),
        (["paper=a3", "paper=a4"], "--sheet paper is repeated"),
        (["paper=a5"], "--sheet: paper is 'a5'"),
        (["orientation=up"], "--sheet: orientation is 'up'"),
        (["scale=five"], "--sheet: scale is 'five'; write 1:N, such as 1:500"),
        (["scale=1:0"], "scale"),
        (["extent=1,2,3"], "west, south, east and north"),
        (["extent=1,2,3,x"], "--sheet extent is '1,2,3,x'; write WEST,SOUTH,EAST,NORTH"),
        (["extent=5,0,1,9"], "west < east"),
        (["pages=map,index"], "index"),
        (["project= "], "project is ' '; give one line of text"),
        (["title=" + "x" * 400], "title has 400 characters"),
    ],
)
def test_a_wrong_field_is_one_line(texts, message):
    with pytest.raises(at.InputError) as error:
        parse_sheet(texts)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_wrong_values_of_python_are_named():
    for name, value in dict(labels=3, date=3, extent=7, scale=float("nan"), pages=[]).items():
        with pytest.raises(at.InputError, match=name):
            at.Sheet(**{name: value})
