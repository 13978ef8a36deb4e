"""Fields on standard output: the same with and without Rich, folded at the width of the terminal."""

import io
from contextlib import redirect_stdout

import pytest

from antumbra.cli import console

FIELDS = [
    ("picture", "a.png"),
    ("time", "load 571 ms, evaluate 65.3 ms, gbuffer 426 ms, build 196 ms, trace 2.36 s"),
    ("empty", ""),
    ("path", "/folder" * 20),
]


def printed(fields):
    with redirect_stdout(io.StringIO()) as out:
        console.print_fields(fields)
    return [line.rstrip() for line in out.getvalue().splitlines()]


@pytest.mark.parametrize("columns", [30, 60, 80, 200])
def test_plain_fields_are_those_of_rich(columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    plain = printed(FIELDS)
    monkeypatch.setattr(console, "_print_plainly", lambda rows: False)
    assert plain == printed(FIELDS) and max(map(len, plain)) <= columns
    assert (len(plain) > len(FIELDS)) == (columns < 200)


@pytest.mark.parametrize("text", ["wide \u7a93", "two\nlines"])
def test_other_text_is_left_to_rich(text, monkeypatch):
    monkeypatch.setattr(console, "_print_rows", lambda grid, rows: print("by Rich"))
    assert printed([("name", text)]) == ["by Rich"] and printed([("name", "text")]) == ["name  text"]


def test_what_a_job_warns_of_is_a_line_on_standard_error(cli, tmp_path):
    (tmp_path / "roof.obj").write_text("v -1 0 -1\nv 1 0 -1\nv 1 0 1\nf 3 2 1\n")
    words = ("sun", "roof.obj", "--latitude", 1.35, "--longitude", 103.8, "--timezone", "America/New_York")
    words = (*words, "--days", "2026-06-21", "-o", "a.csv")
    outcome = cli(*words)
    assert outcome.code == 0, outcome.err
    noted = [line for line in outcome.err.splitlines() if "note:" in line]
    assert noted == [
        "antumbra: note: noon at the longitude 103.8 is at about 01:00 in the time zone America/New_York; check the "
        "time zone and the place"
    ]
    assert "note:" not in cli(*words, "--quiet").err
