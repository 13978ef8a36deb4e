"""Shows progress on a terminal for operations that take longer than a second."""

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING

from ..kernels.progress import LOG, heard_by, in_turn

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

DELAY = 1.0


class ProgressDisplay:
    """A progress line on standard error while the block runs.

    There is none if the block is fast. If standard error is no terminal, the begin and the end of long work appear as
    lines instead. A timer starts the line, so it appears during a single long call too (reading a file, building a
    BVH). `quiet`: nothing appears.
    """

    def __init__(self, quiet: bool = False, delay: float = DELAY):
        self._lock = threading.Lock()
        self._text, self._done, self._total = "", 0, 0
        self._bar: Progress | None = None
        self._quiet, self._closed = quiet, quiet or not sys.stderr.isatty()
        self._heard: AbstractContextManager[None] | None = None
        self._timer = None if self._closed else threading.Timer(delay, self._start)

    def __enter__(self) -> "ProgressDisplay":
        self._heard = _logged() if self._closed and not self._quiet else heard_by(self.say)
        self._heard.__enter__()
        if self._timer is not None:
            self._timer.daemon = True
            self._timer.start()
        return self

    def __exit__(self, *_) -> None:
        if self._timer is not None:
            self._timer.cancel()
        if self._heard is not None:
            self._heard.__exit__(None, None, None)
        with self._lock:
            self._closed = True
            if self._bar is not None:
                self._bar.stop()

    def say(self, text: str, done: int = 0, total: int = 0) -> None:
        """Show the current operation, and how much of it is done. `total` 0: unknown."""
        self._text, self._done, self._total = text, done, total
        with self._lock:
            if self._bar is not None:
                self._update(self._bar)

    def parts(self, text: str, count: int, index: int = 0, of: int = 1) -> Callable[[int, int], object]:
        """A function ``progress(done, total)`` for `count` runs, one after the other. `done` restarts in each run.

        All runs together are piece `index` of `of` pieces.
        """
        made = in_turn(lambda done, total: self.say(text, done, total), count, index, of)
        assert made is not None
        return made

    def _start(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn()
        with self._lock:
            if not self._closed:
                self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
                self._task: TaskID = self._bar.add_task(self._text)
                self._update(self._bar)
                self._bar.start()

    def _update(self, bar: "Progress") -> None:
        bar.update(self._task, description=self._text, completed=self._done, total=self._total or None)


@contextmanager
def _logged() -> Iterator[None]:
    """Let the progress of the library through to its logger."""
    before = LOG.level
    LOG.setLevel(logging.INFO)
    try:
        yield
    finally:
        LOG.setLevel(before)
