"""Progress of long work: reported to a listener if there is one, else to standard error."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

Say = Callable[[str, int, int], None]
"""Function of (name of the work, amount done, total amount)."""

_listeners: list[Say] = []


@contextmanager
def heard_by(say: Say) -> Iterator[None]:
    """Within the context, progress goes to `say` instead of standard error."""
    _listeners.append(say)
    try:
        yield
    finally:
        _listeners.remove(say)


@contextmanager
def reported(what: str) -> Iterator[Callable[[int, int], None]]:
    """Report the begin and the end of work. The context's value is a function that reports (done, total)."""
    if _listeners:
        say = _listeners[-1]
        yield lambda done, total: say(what, done, total)
        return
    start = perf_counter()
    print(f"antumbra: {what} ...", file=sys.stderr, flush=True)
    yield _counting if sys.stderr.isatty() else lambda done, total: None
    print(f"antumbra: {what}: {perf_counter() - start:.0f} s", file=sys.stderr, flush=True)


def _counting(done: int, total: int) -> None:
    print(f"\r  {done} of {total}", end="\n" if done == total else "", file=sys.stderr, flush=True)
