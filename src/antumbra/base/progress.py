"""Progress of long work. The library prints nothing except a bar in a terminal or a notebook.

- A listener set by the caller (`progress_listener`, `with_progress`) receives all progress; False turns it off.
- Otherwise terminals and notebooks show a bar after a second.
- Start and end of long work are logged to ``antumbra`` at level INFO, as are warnings at their level.
"""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from functools import wraps
from html import escape
from importlib import import_module
from threading import Lock, Timer
from time import perf_counter
from typing import Any, ParamSpec, TypeVar

from .errors import InputError

ProgressListener = Callable[[str, int, int], object]
"""Function of (name of the work, amount done, total amount)."""

ProgressCallback = Callable[[int, int], Any]
"""Function of (amount done, total amount)."""

Progress = ProgressListener | bool | None
"""Values of the keyword ``progress``, see `with_progress`."""

LOG = logging.getLogger("antumbra")

BAR_DELAY = 1.0
"""Seconds before a bar appears."""

UPDATE_PERIOD = 0.1
"""Seconds between updates of a bar."""

_P = ParamSpec("_P")
_R = TypeVar("_R")

_listener: ContextVar[ProgressListener | None] = ContextVar("listener", default=None)
_active: list[str] = []  # names of the work currently shown by a bar or a listener
_WIDTH = 24  # characters of a bar


@contextmanager
def progress_listener(listener: ProgressListener) -> Iterator[None]:
    """Within the context, progress goes to `listener`, and no bar appears."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def ignore_progress(what: str, done: int, total: int) -> None:
    """A listener that ignores all progress, which is not logged either."""


def with_progress(job: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorator of a function with a keyword ``progress``, which it need not read itself.

    A function of (text, done, total) receives the progress of everything within. False shows nothing. None or True
    shows a bar in terminals and notebooks.
    """

    @wraps(job)
    def run(*args: _P.args, **options: _P.kwargs) -> _R:
        progress: Any = _checked_progress(options.get("progress"))
        if progress is None:
            return job(*args, **options)
        with progress_listener(progress or ignore_progress):
            return job(*args, **options)

    return run


def with_quiet_progress(job: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorator of a function whose keyword ``progress`` is a function of (done, total) or None.

    It also allows False, which shows nothing, not even from functions called within. True is the same as None.
    """

    @wraps(job)
    def run(*args: _P.args, **options: _P.kwargs) -> _R:
        options["progress"] = progress = _checked_progress(options.get("progress"))
        if progress is not False:  # without a context: a job may take microseconds
            return job(*args, **options)
        with progress_listener(ignore_progress):
            return job(*args, **options)

    return run


def _checked_progress(progress: Any) -> Any:
    """`progress`, with True replaced by None; InputError unless it is a function, a bool or None."""
    if progress is None or isinstance(progress, bool):
        return None if progress else progress
    if not callable(progress):
        raise InputError(f"progress is {progress!r}; it must be a function, True, False or None")
    return progress


@contextmanager
def report_progress(what: str) -> Iterator[ProgressCallback]:
    """Log the start and end of work. The context's value is a function that reports (done, total)."""
    start, listener = perf_counter(), _listener.get()
    log = (lambda *words: None) if listener is ignore_progress else LOG.info
    log("%s ...", what)
    with _active_work(what):
        if listener:
            yield lambda done, total: listener(what, done, total)
        elif _is_interactive():
            bar = ProgressBar(what, BAR_DELAY)
            with bar.visible():
                yield bar
        else:
            yield lambda done, total: None
    log("%s: %.0f s", what, perf_counter() - start)


def show_progress(
    what: str, progress: ProgressCallback | bool | None = None
) -> AbstractContextManager[ProgressCallback | None]:
    """Show the progress of work that may be short and is not worth logging.

    progress : the keyword of a `with_quiet_progress` function; if it is a function, it is the context's value

    Otherwise the context's value is a function of (done, total), or None if output is not interactive or the work is
    part of other work that is shown.
    """
    if callable(progress):
        return nullcontext(progress)
    return nullcontext() if _listener.get() or _active or not _is_interactive() else _short_work(what)


@contextmanager
def _short_work(what: str) -> Iterator[ProgressCallback]:
    """Show a bar for work that may be short."""
    with _active_work(what):
        bar = ProgressBar(what, BAR_DELAY)
        try:
            yield bar
        finally:
            bar.clear()


def split_progress(report: ProgressCallback | None, count: int, index: int = 0, of: int = 1) -> ProgressCallback | None:
    """A function of (done, total) for `count` consecutive runs, in each of which `done` starts again.

    All runs together are piece `index` of `of` pieces.
    """
    if report is None:
        return None
    run, last = 0, -1

    def progress(done: int, total: int) -> None:
        nonlocal run, last
        run, last = (run + 1 if done < last else run), done
        report((index * count + min(run, count - 1)) * total + done, of * count * total)

    return progress


_clock: ContextVar[Callable[[], float]] = ContextVar("clock", default=perf_counter)


def clock_seconds() -> float:
    """Seconds on the clock of measurements, by default elapsed time."""
    return _clock.get()()


@contextmanager
def clocked_by(clock: Callable[[], float]) -> Iterator[None]:
    """Within the block, `clock_seconds` and `PhaseClock` read another clock, such as `time.process_time`."""
    token = _clock.set(clock)
    try:
        yield
    finally:
        _clock.reset(token)


_check: ContextVar[Callable[[], object] | None] = ContextVar("check", default=None)


@contextmanager
def interrupted_by(check: Callable[[], object]) -> Iterator[None]:
    """Within the block, long work calls `check` between its steps, which ends the work by an exception."""
    token = _check.set(check)
    try:
        yield
    finally:
        _check.reset(token)


def check_interruption() -> None:
    """Call the function given to `interrupted_by`, if any."""
    if (check := _check.get()) is not None:
        check()


class PhaseClock:
    """Adds up the seconds of each phase, 0 for `phases` that do not occur."""

    def __init__(self, *phases: str) -> None:
        self.seconds = dict.fromkeys(phases, 0.0)
        self._start = self._last = clock_seconds()

    def lap(self, phase: str) -> None:
        """Add the time since the last lap to a phase. An `interrupted_by` may end the work here."""
        check_interruption()
        now = clock_seconds()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._last
        self._last = now

    def timings(self) -> dict[str, float]:
        """Seconds of each phase, and "total" up to the last lap."""
        return {**self.seconds, "total": self._last - self._start}


class ProgressBar:
    """A progress line that is updated in place: on standard error in terminals, and below the cell in notebooks.

    what : name of the work
    delay : seconds before the line appears
    """

    def __init__(self, what: str, delay: float) -> None:
        self._what, self._start, self._next = what, perf_counter(), delay
        self._length, self._share, self._lock = 0, 0.0, Lock()
        self._cell: Any = None  # the handle of the bar in a notebook

    def __call__(self, done: int, total: int) -> None:
        self._share = done / max(total, 1)
        if perf_counter() - self._start >= self._next:
            self._draw()

    @contextmanager
    def visible(self) -> Iterator[None]:
        """Within the context, the line appears after the delay even without reports; it is removed on exit."""
        timer = Timer(self._next, self._draw)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
            timer.join()
            self.clear()

    def clear(self) -> None:
        """Remove the line."""
        with self._lock:
            if self._cell is not None:
                self._show("")
            elif self._length:
                self._write("")
                print("\r", end="", file=sys.stderr, flush=True)

    def _draw(self) -> None:
        elapsed, share = perf_counter() - self._start, self._share
        self._next = elapsed + UPDATE_PERIOD
        full = round(share * _WIDTH)
        remaining = f", {elapsed / share - elapsed:.0f} s left" if share > 0.0 else ""
        bar = "#" * full + "-" * (_WIDTH - full)
        with self._lock:
            if _is_notebook():
                times = f"{100.0 * share:.0f} %, {elapsed:.0f} s{remaining}"
                self._show(f'{escape(self._what)} <progress value="{share:.4f}"></progress> {times}')
            else:
                self._write(f"antumbra: {self._what}: {100.0 * share:3.0f} % [{bar}] {elapsed:.0f} s{remaining}")

    def _show(self, text: str) -> None:
        """Show HTML below the cell, where standard error would have a red background."""
        display = import_module("IPython.display")
        if self._cell is None:
            self._cell = display.display(display.HTML(text), display_id=True)
        else:
            self._cell.update(display.HTML(text))

    def _write(self, line: str) -> None:
        print("\r" + line.ljust(self._length), end="", file=sys.stderr, flush=True)
        self._length = len(line)


@contextmanager
def _active_work(what: str) -> Iterator[None]:
    _active.append(what)
    try:
        yield
    finally:
        _active.remove(what)


def _is_interactive() -> bool:
    """Whether standard error is a terminal or the output of a notebook cell."""
    return sys.stderr is not None and (sys.stderr.isatty() or _is_notebook())


def _is_notebook() -> bool:
    return type(sys.stderr).__module__.startswith("ipykernel")
