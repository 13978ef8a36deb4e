"""Progress of work that the library does by itself."""

import io
import sys
import time

import pytest

from antumbra.base import progress
from terminal import Terminal


class Cell(io.StringIO):
    """Standard error of a notebook's cell: no terminal."""


Cell.__module__ = "ipykernel.iostream"


@pytest.fixture
def at_once(monkeypatch):
    monkeypatch.setattr(progress, "BAR_DELAY", 0.0)
    monkeypatch.setattr(progress, "UPDATE_PERIOD", 0.0)


def test_a_terminal_shows_a_bar_and_then_nothing(monkeypatch, at_once):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress.show_progress("tracing") as report:
        report(1, 4)
        text = sys.stderr.getvalue()
        report(4, 4)
    assert text.startswith("\rantumbra: tracing:  25 % [######------------------] ")
    lines = sys.stderr.getvalue().split("\r")
    assert "100 %" in lines[2] and not lines[3].strip() and lines[4] == ""


def test_a_notebook_shows_one_bar_that_moves_and_goes_without_a_red_box(monkeypatch, at_once):
    display, shown = pytest.importorskip("IPython.display"), []

    class Handle:
        def update(self, html):
            shown.append(html.data)

    def show(html, display_id):
        assert display_id is True and not shown
        shown.append(html.data)
        return Handle()

    monkeypatch.setattr(display, "display", show)
    monkeypatch.setattr(sys, "stderr", Cell())
    with progress.show_progress("a < b") as report:
        report(1, 4)
        report(4, 4)
    assert shown[0].startswith('a &lt; b <progress value="0.2500"></progress> 25 %, 0 s')
    assert 'value="1.0000"' in shown[1] and shown[2] == "" and sys.stderr.getvalue() == ""


def test_a_bar_appears_although_nothing_is_reported(monkeypatch, at_once):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress.report_progress("unwrapping"):
        assert sys.stderr.written.wait(60.0)
    lines = sys.stderr.getvalue().split("\r")
    assert lines[1].startswith("antumbra: unwrapping:   0 % ") and not lines[2].strip() and lines[3] == ""


def test_work_that_nobody_watches_prints_nothing_and_is_logged(monkeypatch, caplog):
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with caplog.at_level("INFO", "antumbra"), progress.report_progress("unwrapping") as report:
        report(1, 2)
    assert sys.stderr.getvalue() == "" and [m.split(":")[0] for m in caplog.messages] == [
        "unwrapping ...",
        "unwrapping",
    ]


def test_nobody_watches(monkeypatch, at_once):
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with progress.show_progress("tracing") as report:
        assert report is None
    monkeypatch.setattr(sys, "stderr", None)
    with progress.show_progress("tracing") as report:
        assert report is None
    assert progress.split_progress(None, 3) is None


def test_parts_of_shown_work_are_silent(monkeypatch, at_once):
    monkeypatch.setattr(sys, "stderr", Terminal())
    calls = []
    with progress.progress_listener(lambda *what: calls.append(what)), progress.show_progress("a") as report:
        assert report is None
    with progress.report_progress("whole") as whole:
        with progress.show_progress("part") as report:
            assert report is None
        whole(1, 2)
    assert " 50 %" in sys.stderr.getvalue() and calls == []
    with progress.show_progress("afterwards") as report:
        assert report is not None


def test_short_work_shows_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress.show_progress("tracing") as report:
        report(1, 2)
    assert sys.stderr.getvalue() == ""


def test_phases_are_measured_by_the_clock_of_the_block():
    ticks = iter((5.0, 7.0, 8.0))
    with progress.clocked_by(lambda: next(ticks)):
        clock = progress.PhaseClock("build", "trace")
        clock.lap("build")
        clock.lap("shade")
    assert clock.timings() == {"build": 2.0, "trace": 0.0, "shade": 1.0, "total": 3.0}
    assert abs(progress.clock_seconds() - time.perf_counter()) < 60.0


def test_runs_one_after_the_other():
    calls = []
    report = progress.split_progress(lambda done, total: calls.append((done, total)), 2, 1, 3)
    for done in (5, 10, 1, 10):
        report(done, 10)
    assert calls == [(25, 60), (30, 60), (31, 60), (40, 60)]


def test_an_interruption_ends_long_work_between_its_steps():
    class Stop(Exception):
        pass

    calls = []

    def check():
        calls.append(len(calls))
        if len(calls) == 2:
            raise Stop

    clock = progress.PhaseClock("a", "b")
    progress.check_interruption()  # nobody interrupts
    with pytest.raises(Stop), progress.interrupted_by(check):
        clock.lap("a")
        clock.lap("b")
    assert calls == [0, 1] and clock.seconds["b"] == 0.0
    clock.lap("b")
    assert calls == [0, 1]
