"""Progress of long work: reported to a listener if there is one, else to standard error."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

Say = Callable[[str, int, int], object]
"""Function of (name of the work, amount done, total amount)."""

Heard = Callable[[int, int], Any]
"""Function of (amount done, total amount)."""

_listeners: list[Say] = []
_shown: list[str] = []  # names of the work that is shown now, on standard error or by a listener
_DELAY = 1.0  # seconds before a bar appears for work that may be short
_EVERY = 0.1  # seconds between two states of a bar
_WIDTH = 24  # characters of a bar


@contextmanager
def heard_by(say: Say) -> Iterator[None]:
    """Within the context, progress goes to `say` instead of standard error."""
    _listeners.append(say)
    try:
        yield
    finally:
        _listeners.remove(say)


@contextmanager
def reported(what: str) -> Iterator[Heard]:
    """Report the begin and the end of work. The context's value is a function that reports (done, total)."""
    with _busy(what):
        if _listeners:
            say = _listeners[-1]
            yield lambda done, total: say(what, done, total)
            return
        start = perf_counter()
        print(f"antumbra: {what} ...", file=sys.stderr, flush=True)
        bar = Bar(what, 0.0) if _watched() else None
        yield bar or (lambda done, total: None)
        if bar:
            bar.clear()
        print(f"antumbra: {what}: {perf_counter() - start:.0f} s", file=sys.stderr, flush=True)


@contextmanager
def shown(what: str) -> Iterator[Heard | None]:
    """Show work that may be short: a bar after a second, in terminals and notebooks.

    The context's value is a function that hears (done, total). It is None if nobody watches, or if the work is part of
    other work that is shown.
    """
    if _listeners or _shown or not _watched():
        yield None
        return
    with _busy(what):
        bar = Bar(what, _DELAY)
        try:
            yield bar
        finally:
            bar.clear()


def in_turn(heard: Heard | None, count: int, index: int = 0, of: int = 1) -> Heard | None:
    """A function of (done, total) for `count` runs, one after the other. `done` restarts in each run.

    All runs together are piece `index` of `of` pieces.
    """
    if heard is None:
        return None
    run, last = 0, -1

    def progress(done: int, total: int) -> None:
        nonlocal run, last
        run, last = (run + 1 if done < last else run), done
        heard((index * count + min(run, count - 1)) * total + done, of * count * total)

    return progress


class Bar:
    """A line on standard error that is written anew again and again; notebooks show it as terminals do.

    what : name of the work
    delay : seconds before the line appears
    """

    def __init__(self, what: str, delay: float):
        self._what, self._start, self._next = what, perf_counter(), delay
        self._length = 0

    def __call__(self, done: int, total: int) -> None:
        passed = perf_counter() - self._start
        if passed < self._next:
            return
        self._next = passed + _EVERY
        share = done / max(total, 1)
        full = round(share * _WIDTH)
        left = f", {passed / share - passed:.0f} s left" if share > 0.0 else ""
        bar = "#" * full + "-" * (_WIDTH - full)
        self._write(f"antumbra: {self._what}: {100.0 * share:3.0f} % [{bar}] {passed:.0f} s{left}")

    def clear(self) -> None:
        """Remove the line."""
        if self._length:
            self._write("")
            print("\r", end="", file=sys.stderr, flush=True)

    def _write(self, line: str) -> None:
        print("\r" + line.ljust(self._length), end="", file=sys.stderr, flush=True)
        self._length = len(line)


@contextmanager
def _busy(what: str) -> Iterator[None]:
    _shown.append(what)
    try:
        yield
    finally:
        _shown.remove(what)


def _watched() -> bool:
    """Whether standard error is a terminal, or the output of a notebook's cell."""
    stream = sys.stderr
    return stream is not None and (stream.isatty() or type(stream).__module__.startswith("ipykernel"))
