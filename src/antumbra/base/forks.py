"""Forked processes: locks and caches that work in the child too.

A forked child has only the thread that forked. A lock that another thread held stays locked there forever, and what it
guarded may be half changed. Two remedies:

- `hold_during_fork`: the fork waits until the lock is free. For locks that are held briefly, or guard what no one can
  make again, such as machine code that is being linked.
- `renew_after_fork`: in the child, an object replaces its lock, and drops what the lock guarded. For locks that are
  held while a query runs.
"""

import os
from threading import Lock
from typing import Protocol
from weakref import WeakSet


class AnyLock(Protocol):
    """A `threading.Lock` or `RLock`."""

    def acquire(self, blocking: bool = True) -> bool: ...

    def release(self) -> None: ...


class ForkedObject(Protocol):
    """An object with a lock of its own."""

    def _after_fork(self) -> None:
        """Called in a forked child. `is_stuck` tells whether another thread held the lock."""


_objects: WeakSet[ForkedObject] = WeakSet()


def renew_after_fork(owner: ForkedObject) -> None:
    """Call ``owner._after_fork()`` in each forked child, as long as the owner exists."""
    _objects.add(owner)


def hold_during_fork(lock: AnyLock) -> None:
    """Let forks wait until no other thread holds a lock. No other lock may be taken while it is held."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=lock.acquire, after_in_parent=lock.release, after_in_child=lock.release)


def is_stuck(lock: AnyLock) -> bool:
    """In a forked child: whether the lock is held by a thread that has not survived the fork."""
    if not lock.acquire(blocking=False):
        return True
    lock.release()
    return False


def free_lock(lock: Lock) -> Lock:
    """In a forked child: the lock, or a new one if it is stuck."""
    return Lock() if is_stuck(lock) else lock


def _renew() -> None:
    for owner in list(_objects):
        owner._after_fork()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
