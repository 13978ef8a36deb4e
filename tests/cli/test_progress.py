import io
import sys
import threading

import pytest

from antumbra.cli.console import ProgressDisplay


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def new_terminal(monkeypatch):
    """Makes standard error a terminal. Call it in the test, because pytest has a standard error for each phase."""
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)

    def make():
        monkeypatch.setattr(sys, "stderr", Terminal())
        return sys.stderr

    return make


def wait_for_bar(display):
    display._timer.join()
    assert display._bar is not None


def test_a_person_who_waits_sees_what_is_being_done(new_terminal):
    terminal = new_terminal()
    with ProgressDisplay(delay=0.0) as display:
        display.say("reading")
        wait_for_bar(display)
        display.say("tracing", 5, 10)
        display._bar.refresh()
        print("a line", file=sys.stderr)
    shown = terminal.getvalue()
    assert "tracing" in shown and "a line\n" in shown
    assert not [t for t in threading.enumerate() if isinstance(t, threading.Timer) and t.is_alive()]


def test_what_is_fast_shows_nothing(new_terminal):
    terminal = new_terminal()
    with ProgressDisplay(delay=60.0) as display:
        display.say("reading")
    display._timer.join()
    assert terminal.getvalue() == "" and display._bar is None


def test_nobody_looking_means_nothing_shown(new_terminal, monkeypatch):
    terminal = new_terminal()
    with ProgressDisplay(quiet=True, delay=0.0) as display:
        display.say("reading")
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with ProgressDisplay(delay=0.0) as other:
        other.say("reading")
    assert terminal.getvalue() == "" == sys.stderr.getvalue()
    assert display._timer is None and other._timer is None


def test_a_bar_is_put_away_after_an_error(new_terminal):
    new_terminal()
    display = ProgressDisplay(delay=0.0)
    with pytest.raises(ValueError), display:
        wait_for_bar(display)
        raise ValueError
    assert display._bar.live.is_started is False


def test_runs_one_after_the_other_are_one_bar():
    display, seen = ProgressDisplay(quiet=True), []
    display.say = lambda text, done, total: seen.append((text, done, total))
    progress = display.parts("tracing", 3)
    for done in (2, 10, 0, 10, 10, 1, 10):
        progress(done, 10)
    assert seen == [("tracing", done, 30) for done in (2, 10, 10, 20, 20, 21, 30)]


def test_a_piece_of_many_is_its_part_of_the_bar():
    display, seen = ProgressDisplay(quiet=True), []
    display.say = lambda text, done, total: seen.append((done, total))
    progress = display.parts("frame 2", 2, index=2, of=4)
    for done in (5, 10, 0, 10):
        progress(done, 10)
    assert seen == [(45, 80), (50, 80), (50, 80), (60, 80)]
