"""Two results of one kind from one set of units: shards, clusters and resuming split them as if they were one work."""

import warnings
from collections.abc import Callable, Sequence
from typing import TypeAlias, TypeVar

from .executors import Executor, LocalExecutor, UnitCollector, Units

_T = TypeVar("_T")

Study: TypeAlias = Callable[["Executor | None"], _T | None]
"""A study as a function of the executor of its units; it returns None if the executor leaves some to others."""


class _Joint:
    """An executor of two works: it runs the units of the first before those of the second."""

    def __init__(self, executor: Executor, first: Sequence[Units]):
        self.folder, self._executor, self._first = executor.folder, executor, list(first)
        self.work = self._first

    def finish(self, work: Sequence[Units]) -> bool:
        self.work = [*self._first, *work]
        return self._executor.finish(self.work)

    def end(self, work: Sequence[Units]) -> None:
        """No-op: the first work needs its units once more."""


class _Keeping:
    """A local executor that keeps the units of a work, which `both_results` removes when both works are done."""

    def __init__(self, executor: LocalExecutor):
        self.folder, self._executor = executor.folder, executor
        self.work: Sequence[Units] = ()

    def finish(self, work: Sequence[Units]) -> bool:
        self.work = work
        return self._executor.finish(work)

    def end(self, work: Sequence[Units]) -> None:
        """No-op."""


def both_results(first: Study[_T], second: Study[_T], executor: Executor | None) -> tuple[_T, _T] | None:
    """The results of two studies, whose units an executor runs as one work; None if it leaves some to others.

    executor : with a folder; None: studies without units
    """
    if executor is None:
        earlier, later = _silent(first, None), second(None)
        assert earlier is not None and later is not None
        return earlier, later
    assert executor.folder is not None
    if isinstance(executor, LocalExecutor):
        keeping = _Keeping(executor), _Keeping(executor)
        earlier, later = _silent(first, keeping[0]), second(keeping[1])
        assert earlier is not None and later is not None
        executor.end([*keeping[0].work, *keeping[1].work])
        return earlier, later
    collector = UnitCollector(executor.folder)
    _silent(first, collector)
    joint = _Joint(executor, collector.work)
    later = second(joint)
    if later is None:
        return None
    earlier = _silent(first, _Keeping(LocalExecutor(executor.folder)))
    assert earlier is not None
    executor.end(joint.work)
    return earlier, later


def _silent(study: Study[_T], executor: Executor | None) -> _T | None:
    """The result of the first study without its notes, since those of the second are the same."""
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        return study(executor)
