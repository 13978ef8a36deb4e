"""One thread that traces for all that ask: what matters most first, and of work with one name only the latest."""

import threading
from collections.abc import Callable
from time import monotonic
from typing import NamedTuple

CLICK, PICTURE, MESH, FINE = range(4)
"""Ranks of work; the lower ones come first."""


class Interrupted(Exception):
    """Raised within work that has become void, or that something of a lower rank overtakes."""


class _Job(NamedTuple):
    name: str
    rank: int
    due: float  # seconds of `monotonic`
    work: Callable[[Callable[..., None]], None]


class Worker:
    """A thread that does work, one piece after the other.

    failed : function of an exception, called in the thread when work raises one
    """

    def __init__(self, failed: Callable[[Exception], None] = lambda error: None):
        self._jobs: dict[str, _Job] = {}
        self._changed, self._failed = threading.Condition(), failed
        self._running: _Job | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name="antumbra view", daemon=True)
        self._thread.start()

    def ask(self, name: str, rank: int, work: Callable[[Callable[..., None]], None], after: float = 0.0) -> None:
        """Ask for work; earlier work of this name is void, also if it is under way.

        work : function of `check`, which it calls often; work that something overtakes is called again later
        after : seconds to wait first
        """
        with self._changed:
            self._jobs[name] = _Job(name, rank, monotonic() + after, work)
            self._changed.notify_all()

    def has(self, name: str) -> bool:
        """Whether work of this name waits or is under way."""
        return name in self._jobs

    def drop(self, name: str) -> None:
        """Forget the work of this name."""
        with self._changed:
            self._jobs.pop(name, None)
            self._changed.notify_all()

    def wait(self, timeout: float = 60.0) -> bool:
        """Wait until nothing is left to do; False: it took too long. Tests use it."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._jobs and self._running is None, timeout)

    def close(self) -> None:
        """End the thread. Work under way ends at its next check."""
        with self._changed:
            self._jobs.clear()
            self._closed = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=10.0)

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._running = None
                self._changed.notify_all()
                while not self._closed and self._next() is None:
                    self._changed.wait(self._seconds())
                if self._closed:
                    return
                job = self._running = self._next()
            assert job is not None
            try:
                job.work(lambda *_, job=job: self._check(job))
            except Interrupted:
                continue
            except Exception as error:
                self._failed(error)
            with self._changed:
                if self._jobs.get(job.name) is job:
                    del self._jobs[job.name]

    def _check(self, job: _Job) -> None:
        with self._changed:
            first = self._next()
            if self._jobs.get(job.name) is not job or (first is not None and first.rank < job.rank):
                raise Interrupted

    def _next(self) -> _Job | None:
        """The work that is due, of the lowest rank and asked first."""
        now = monotonic()
        return min((job for job in self._jobs.values() if job.due <= now), key=lambda job: job.rank, default=None)

    def _seconds(self) -> float | None:
        """Until the next work is due."""
        due = min((job.due for job in self._jobs.values()), default=None)
        return None if due is None else max(due - monotonic(), 0.0)
