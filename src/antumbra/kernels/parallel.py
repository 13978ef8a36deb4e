"""Threads that share the work of one kernel.

Kernels run without the GIL, so plain Python threads use every core. Work is distributed dynamically: a thread takes the
next `chunk` items from a ticket when its previous ones are done, so no thread waits for a slower one. A worker is a
kernel that loops over `items` or `shares`::

    @kernel
    def worker(ticket, values):
        for i in items(ticket):
            values[i] *= 2

    run(worker, thread_count(None), new_ticket(len(values), 64), values)

Leaving the loop skips the remaining items of the thread's share; set `STOP` to stop all threads. Workers that are not
compiled call `take`.

Kernels allocate no memory except on their stack. `run` calls `own` in each thread to create other scratch memory.

Waking a thread takes about as long as bounding 20,000 triangles. `run_short` therefore works in the calling thread too,
and does not wait for threads that wake up too late.
"""

import numbers
import os
import queue
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.progress import ProgressCallback
from .jit import Intrinsic, kernel
from .simd import atomic_add

__all__ = [
    "CHUNK",
    "DONE",
    "MAX_THREADS",
    "NEXT",
    "STOP",
    "N",
    "Ticket",
    "items",
    "map_in_threads",
    "new_ticket",
    "run",
    "run_short",
    "shares",
    "take",
    "thread_count",
]

Ticket: TypeAlias = NDArray[np.int64]
"""(5,) int64: the fields below."""

NEXT = 0  # first item not yet taken by a thread; exceeds N at the end
STOP = 1  # if nonzero, no more items are handed out
N = 2  # number of items
CHUNK = 3  # items handed out at a time
DONE = 4  # a counter for the worker; starts at 0, not used by this module

_Value = TypeVar("_Value")
_Result = TypeVar("_Result")

MAX_THREADS = 1024
"""Far more threads than processors do not help, and the system may refuse to start them."""

_POLL_SECONDS = 0.1


def thread_count(threads: int | None) -> int:
    """The number of threads to use; None means one per core available to this process.

    Raises
    ------
    InputError
        Unless `threads` is an integer from 1 to `MAX_THREADS`.
    """
    if threads is None:
        if hasattr(os, "sched_getaffinity"):
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1
    whole = type(threads) is int or (isinstance(threads, numbers.Integral) and not isinstance(threads, bool))
    if not (whole and 1 <= threads <= MAX_THREADS):
        value = repr(threads)[:40]
        raise InputError(
            f"threads is {value}; it must be a whole number from 1 to {MAX_THREADS}, or None for all cores"
        )
    return int(threads)


def new_ticket(n_items: int, chunk: int) -> Ticket:
    """A ticket for items 0 to `n_items` - 1, handed out `chunk` (at least 1) at a time. Each run needs a new ticket."""
    return np.array([0, 0, n_items, max(chunk, 1), 0], np.int64)


items: Any = Intrinsic("antumbra.kernels.ticket_loops", "items")
"""In kernels, ``for i in items(ticket):`` loops over the items that this thread takes."""

shares: Any = Intrinsic("antumbra.kernels.ticket_loops", "shares")
"""In kernels, ``for first, last in shares(ticket):`` loops over the shares that this thread takes.

A share is the items from `first` to `last` - 1. Use this loop for workers that need to start or finish something with
each share, such as a row of partial sums.
"""


@kernel
def take(ticket):
    """The first of the next ``ticket[CHUNK]`` items; -1 if none is left or `STOP` is set."""
    # Adding 0 reads STOP from memory each time; LLVM could hoist a plain read out of the worker's loop.
    if atomic_add(ticket, STOP, 0) != 0:
        return -1
    first = atomic_add(ticket, NEXT, ticket[CHUNK])
    return first if first < ticket[N] else -1


class _ParallelRun:
    """One `run`: the worker, its arguments, and the outcome in each thread."""

    def __init__(
        self,
        worker: Callable[..., object],
        ticket: Ticket,
        args: tuple[Any, ...],
        own: Callable[[], Iterable[Any]],
        n_threads: int,
    ) -> None:
        self.worker, self.ticket, self.args, self.own, self.n_threads = worker, ticket, args, own, n_threads
        self.begun: list[None] = []  # one None per thread that has begun; list.append is atomic
        self.called: list[_Thread] = []  # threads that have not begun, if `dismisses`
        self.dismisses = False  # whether threads that have not begun may be dismissed
        self.outcomes: list[BaseException | None] = []  # one per thread that has finished: None, or its exception
        self.wake: queue.SimpleQueue[None] = queue.SimpleQueue()  # receives an item when the last thread has finished

    def work(self) -> BaseException | None:
        """Run the worker in this thread; return its exception, if any."""
        self.begun.append(None)
        try:
            self.worker(self.ticket, *self.args, *self.own())
        except BaseException as error:
            self.ticket[STOP] = 1
            return error
        return None

    def admits(self, thread: "_Thread") -> bool:
        """Whether a thread that was sent this job may begin it."""
        if not self.dismisses:
            return True
        try:
            self.called.remove(thread)  # atomic, like `pop` in `dismiss`
        except ValueError:
            return False
        return True

    def dismiss(self) -> None:
        """Make the threads idle that have not begun. The others are then `n_threads`."""
        while self.called:
            with suppress(IndexError):  # the last of them has just begun
                _idle.append(self.called.pop())
                self.n_threads -= 1

    def finish(self, outcome: BaseException | None) -> None:
        """Store the outcome of this thread, and wake the caller if it is the last."""
        self.outcomes.append(outcome)
        if len(self.outcomes) >= self.n_threads:
            self.wake.put(None)


class _Thread:
    """A thread that waits for jobs. It is in `_idle` while it has none, or none but jobs that it need not begin."""

    def __init__(self) -> None:
        self.inbox: queue.SimpleQueue[_ParallelRun] = queue.SimpleQueue()
        threading.Thread(target=self._serve, name="antumbra", daemon=True).start()

    def _serve(self) -> None:
        while True:
            job = self.inbox.get()
            if not job.admits(self):
                del job
                continue
            outcome = job.work()
            _idle.append(self)  # before the caller wakes, so that its next run finds this thread
            job.finish(outcome)
            del job, outcome  # otherwise the arrays would live until the next job


_idle: list[_Thread] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_idle.clear)  # threads do not survive a fork


def _idle_thread() -> _Thread:
    try:
        return _idle.pop()
    except IndexError:
        return _Thread()


def _wait(job: _ParallelRun, seconds: float) -> None:
    with suppress(queue.Empty):
        job.wake.get(timeout=seconds)


def run(
    worker: Callable[..., object],
    n_threads: int,
    ticket: Ticket,
    *args: Any,
    own: Callable[[], Iterable[Any]] = tuple,
    progress: ProgressCallback | None = None,
) -> None:
    """Call ``worker(ticket, *args, *own())`` in `n_threads` threads at once, and wait until all have returned.

    Parameters
    ----------
    worker : kernel (or any function) that takes its work from `ticket`
        Its result is dropped.
    n_threads : int
        At least 1. At most as many threads are used as there are chunks of items. With one thread and no `progress`,
        the calling thread does the work.
    ticket : from `new_ticket`
    own : function without parameters, optional
        Called in each thread to create per-thread arguments, such as scratch memory.
    progress : function of (items handed out, items), optional
        Called in the calling thread about ten times a second, and once at the end.

    Raises
    ------
    Exception
        The first exception that a worker raised. The other workers stop at their next chunk.
    KeyboardInterrupt
        Raised in the calling thread while it waits. The workers stop at their next chunk, and `run` waits for them
        before it raises. If the calling thread does the work, the interrupt comes afterwards.
    """
    total = int(ticket[N])
    n_threads = max(1, min(n_threads, -(-total // int(ticket[CHUNK]))))
    if n_threads == 1 and progress is None:
        worker(ticket, *args, *own())
        return
    job, started = _ParallelRun(worker, ticket, args, own, n_threads), 0
    try:
        while started < n_threads:
            _idle_thread().inbox.put(job)
            started += 1
        while len(job.outcomes) < n_threads:
            _wait(job, _POLL_SECONDS)
            if progress is not None and len(job.outcomes) < n_threads:
                progress(min(int(ticket[NEXT]), total), total)
        if progress is not None:
            progress(min(int(ticket[NEXT]), total), total)
    except BaseException:
        ticket[STOP] = 1
        # The interrupt may have come after a thread received the job and before it was counted.
        while len(job.outcomes) < max(started, len(job.begun)):
            try:
                _wait(job, _POLL_SECONDS)
            except KeyboardInterrupt:
                continue  # already stopping
        raise
    for outcome in job.outcomes:
        if outcome is not None:
            raise outcome


def run_short(
    worker: Callable[..., object],
    n_threads: int,
    ticket: Ticket,
    *args: Any,
    own: Callable[[], Iterable[Any]] = tuple,
) -> None:
    """`run` for work of milliseconds, in which the calling thread takes part. An interrupt comes afterwards."""
    helpers = min(n_threads, -(-int(ticket[N]) // int(ticket[CHUNK]))) - 1
    if helpers <= 0:
        worker(ticket, *args, *own())
        return
    job = _ParallelRun(worker, ticket, args, own, helpers)
    job.dismisses = True
    try:
        job.called += [_idle_thread() for _ in range(helpers)]
        for thread in job.called.copy():
            thread.inbox.put(job)
        outcome = job.work()
    except BaseException as error:
        ticket[STOP], outcome = 1, error
    job.dismiss()
    while len(job.outcomes) < job.n_threads:
        try:
            _wait(job, _POLL_SECONDS)
        except KeyboardInterrupt as error:
            ticket[STOP], outcome = 1, error
    for each in (outcome, *job.outcomes):
        if each is not None:
            raise each


def map_in_threads(
    function: Callable[[_Value], _Result], values: Iterable[_Value], threads: int | None = None
) -> list[_Result]:
    """The function of each value, in order: for functions that release the GIL, such as NumPy's and decoders of images.

    threads : None: one per core available to this process

    Raises
    ------
    Exception
        The first exception of the function, in the order of the values.
    """
    values = list(values)
    n_threads = min(thread_count(threads), len(values))
    if n_threads <= 1:
        return list(map(function, values))
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(n_threads) as pool:
        return list(pool.map(function, values))
