import io
import sys
import threading

import pytest

from antumbra.cli.console import ProgressDisplay
from terminal import Terminal


@pytest.fixture
def new_terminal(monkeypatch):
    """Makes standard error a terminal. Call it in the test, because pytest has a standard error for each phase."""
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)

    def make():
        monkeypatch.setattr(sys, "stderr", Terminal())
        return sys.stderr

    return make


def timers():
    return [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]


def assert_no_timer_runs():
    for timer in timers():
        timer.join(30.0)
    assert not timers()


def test_a_person_who_waits_sees_what_is_being_done(new_terminal):
    terminal = new_terminal()
    with ProgressDisplay(delay=0.0) as display:
        display.say("reading")
        assert terminal.written.wait(30.0)
        display.say("tracing", 5, 10)
        print("a line", file=sys.stderr)
    assert "tracing" in terminal.getvalue() and "a line\n" in terminal.getvalue()
    assert_no_timer_runs()


def test_what_is_fast_shows_nothing(new_terminal):
    terminal = new_terminal()
    with ProgressDisplay(delay=60.0) as display:
        display.say("reading")
    assert_no_timer_runs()
    assert terminal.getvalue() == ""


def test_nobody_looking_means_nothing_shown(new_terminal, monkeypatch):
    terminal = new_terminal()
    with ProgressDisplay(quiet=True, delay=30.0) as display:
        display.say("reading")
        assert not timers()
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with ProgressDisplay(delay=30.0) as display:
        display.say("reading")
        assert not timers()
    assert terminal.getvalue() == "" == sys.stderr.getvalue()


def test_a_bar_is_put_away_after_an_error(new_terminal):
    terminal = new_terminal()
    with pytest.raises(ZeroDivisionError), ProgressDisplay(delay=0.0):
        assert terminal.written.wait(30.0)
        raise ZeroDivisionError
    assert sys.stderr is terminal and "\x1b[?25h" in terminal.getvalue()  # the cursor is visible again


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
