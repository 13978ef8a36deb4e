"""Threads that share work: each piece is done once, and work stops after an error."""

import ast
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.base.errors import InputError
from antumbra.kernels import parallel
from antumbra.kernels.jit import kernel as compiled
from antumbra.kernels.parallel import CHUNK, NEXT, STOP, N, items, new_ticket, run, shares, take, thread_count

# No cache: this file is imported under two names, by pytest and by a separate process.


@compiled
def count_visits(ticket, visits, pieces):
    for first, last in shares(ticket):
        pieces[first // ticket[CHUNK]] += 1
        for i in range(first, last):
            visits[i] += 1


@compiled
def count_items(ticket, visits, pieces):
    for i in items(ticket):
        visits[i] += 1
        if i % ticket[CHUNK] == 0:
            pieces[i // ticket[CHUNK]] += 1


@compiled
def until_first(ticket, wanted, visits):
    """Leave the loop at an item, and stop the other threads."""
    for i in items(ticket):
        visits[i] += 1
        if i == wanted:
            ticket[STOP] = 1
            break
    visits[-1] += 1


@compiled
def all_items(ticket):
    for _ in items(ticket):
        pass


@compiled
def all_shares(ticket):
    for _ in shares(ticket):
        pass


@compiled
def until_stopped(ticket):
    """A worker that only takes. So only `take` itself can make the compiler read the ticket again."""
    while take(ticket) >= 0:
        pass


def endless():
    return new_ticket(2**62, 1)


def wait_until_busy(ticket):
    while ticket[NEXT] < 1000:
        time.sleep(0.001)


# --- thread_count ---------------------------------------------------------------------------------------


def test_thread_count_default_is_the_cores_this_process_may_use():
    expected = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert thread_count(None) == expected >= 1


def test_thread_count_without_affinity(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert thread_count(None) == 1


@pytest.mark.parametrize("threads", [1, 3, np.int32(7)])
def test_thread_count_given(threads):
    assert thread_count(threads) == threads and type(thread_count(threads)) is int


@pytest.mark.parametrize("threads", [0, -1, 2.0, "2", True])
def test_thread_count_rejects(threads):
    with pytest.raises(InputError, match=r"^threads is .*; it must be a whole number from 1 to 1024"):
        thread_count(threads)


# --- all the work, once ---------------------------------------------------------------------------------


@given(st.sampled_from([count_visits, count_items]), st.integers(0, 300), st.integers(1, 400), st.integers(1, 6))
def test_every_item_is_done_exactly_once(worker, n_items, chunk, n_threads):
    visits, pieces = np.zeros(n_items, np.int64), np.zeros(-(-n_items // chunk), np.int64)
    run(worker, n_threads, new_ticket(n_items, chunk), visits, pieces)
    assert np.all(visits == 1) and np.all(pieces == 1)


@pytest.mark.parametrize("chunk", [1, 4, 100])
def test_a_loop_over_items_may_be_left(chunk):
    visits = np.zeros(21, np.int64)
    ticket = new_ticket(20, chunk)
    run(until_first, 1, ticket, 9, visits)
    assert visits.tolist() == [1] * 10 + [0] * 10 + [1]
    assert take(ticket) == -1


def test_threads_that_contend_for_each_item_do_it_once():
    visits = np.zeros(500_000, np.int64)
    run(count_visits, 4, new_ticket(visits.size, 1), visits, np.zeros(visits.size, np.int64))
    assert np.all(visits == 1)


def test_a_chunk_of_nothing_is_one_item():
    visits = np.zeros(5, np.int64)
    run(count_visits, 2, new_ticket(5, 0), visits, np.zeros(5, np.int64))
    assert np.all(visits == 1)


def test_each_thread_runs_the_worker_and_later_runs_reuse_the_threads():
    def rendezvous(ticket, barrier, seen):
        barrier.wait(timeout=30)  # passes only when all threads wait at the same time
        seen.add(threading.get_ident())

    seen = [set(), set()]
    for idents in seen:
        run(rendezvous, 3, new_ticket(3, 1), threading.Barrier(3), idents)
    assert seen[0] == seen[1] and len(seen[0]) == 3 and threading.get_ident() not in seen[0]


def test_one_thread_is_the_callers():
    seen = []
    run(lambda ticket: seen.append(threading.get_ident()), 1, new_ticket(10, 1))
    run(lambda ticket: seen.append(threading.get_ident()), 8, new_ticket(10, 10))  # one piece of work
    assert seen == [threading.get_ident()] * 2


def test_each_thread_has_what_is_its_own():
    def fill(ticket, barrier, seen, own):
        barrier.wait(timeout=30)
        own[:] = threading.get_ident()
        barrier.wait(timeout=30)
        seen.append((int(own[0]), int(own[-1]), threading.get_ident()))

    for n_threads in (1, 3):
        seen = []
        run(fill, n_threads, new_ticket(3, 1), threading.Barrier(n_threads), seen, own=lambda: (np.empty(9, np.int64),))
        assert len(seen) == n_threads == len(set(seen)) and all(len(set(idents)) == 1 for idents in seen)


def test_a_worker_may_run_others():
    def outer(ticket, visits):
        first = take(ticket)
        while first >= 0:
            run(count_visits, 2, new_ticket(visits.shape[1], 3), visits[first], np.zeros(99, np.int64))
            first = take(ticket)

    visits = np.zeros((7, 40), np.int64)
    run(outer, 3, new_ticket(7, 1), visits)
    assert np.all(visits == 1)


def test_arrays_are_let_go_after_the_run():
    visits = np.zeros(10, np.int64)
    before = sys.getrefcount(visits)
    run(count_visits, 2, new_ticket(10, 1), visits, np.zeros(10, np.int64))
    deadline = time.monotonic() + 10
    while sys.getrefcount(visits) > before and time.monotonic() < deadline:
        time.sleep(0.001)  # the threads release the memory just after the run's end
    assert sys.getrefcount(visits) == before


# --- stop, progress, errors -----------------------------------------------------------------------------


def test_nothing_is_taken_once_stop_is_set():
    ticket = new_ticket(10, 4)
    assert [take(ticket) for _ in range(2)] == [0, 4]
    ticket[STOP] = 1
    assert take(ticket) == -1
    ticket[STOP] = 0
    assert [take(ticket) for _ in range(3)] == [8, -1, -1]


@pytest.mark.parametrize("worker", [until_stopped, all_items, all_shares])
def test_compiled_workers_see_stop(worker):
    """The read of STOP is not moved out of the worker's loop."""
    ticket = endless()

    def stop_soon():
        wait_until_busy(ticket)
        ticket[STOP] = 1

    threading.Thread(target=stop_soon).start()
    run(worker, 2, ticket)
    assert 1000 <= ticket[NEXT] < ticket[N]


@pytest.mark.parametrize("n_threads", [1, 2])
def test_progress(n_threads):
    def slow(ticket):
        while take(ticket) >= 0:
            time.sleep(0.08)

    calls = []
    run(slow, n_threads, new_ticket(10, 1), progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (10, 10) and len(calls) > 2
    assert calls == sorted(calls) and {total for _, total in calls} == {10}


@pytest.mark.parametrize("n_threads", [1, 2])
def test_progress_of_work_that_is_done_at_once(n_threads):
    calls = []
    run(
        lambda ticket: [*iter(lambda: take(ticket), -1)],
        n_threads,
        new_ticket(4, 1),
        progress=lambda *c: calls.append(c),
    )
    assert calls[-1] == (4, 4)


def test_an_error_in_progress_stops_the_workers():
    def fail(done, total):
        raise ZeroDivisionError

    ticket = endless()
    with pytest.raises(ZeroDivisionError):
        run(until_stopped, 2, ticket, progress=fail)
    assert_idle(ticket)


def assert_idle(ticket):
    """Check that no thread takes from the ticket any more."""
    taken = ticket[NEXT]
    time.sleep(0.02)
    assert ticket[NEXT] == taken and ticket[STOP] == 1


@pytest.mark.parametrize("n_threads", [1, 2, 4])
def test_a_workers_error_reaches_the_caller_and_stops_the_others(n_threads):
    def worker(ticket):
        first = take(ticket)
        while first >= 0:
            if first == 20:
                raise ValueError("item 20")
            first = take(ticket)

    with pytest.raises(ValueError, match="item 20"):
        run(worker, n_threads, new_ticket(2**62, 1))
    visits = np.zeros(50, np.int64)  # the threads still work
    run(count_visits, n_threads, new_ticket(50, 1), visits, np.zeros(50, np.int64))
    assert np.all(visits == 1)


def test_a_kernels_error_reaches_the_caller():
    @compiled
    def worker(ticket):
        raise OverflowError("from compiled code")

    ticket = new_ticket(4, 1)
    with pytest.raises(RuntimeError, match="worker: error 1 in compiled code"):
        run(worker, 2, ticket)
    assert ticket[STOP] == 1


@pytest.fixture
def ctrl_c():
    """Sends an interrupt to the main thread, and returns when it has been handled there."""
    if not hasattr(signal, "pthread_kill"):
        pytest.skip("this system cannot send a signal to a thread")
    main, handled = threading.main_thread(), []
    assert threading.current_thread() is main

    def handler(signum, frame):
        handled.append(signum)
        raise KeyboardInterrupt

    def send():
        before = len(handled)
        signal.pthread_kill(main.ident, signal.SIGINT)
        while len(handled) == before:
            time.sleep(0.001)

    old = signal.signal(signal.SIGINT, handler)
    yield send
    signal.signal(signal.SIGINT, old)


def test_ctrl_c_stops_the_workers_and_reaches_the_caller(ctrl_c):
    ticket = endless()

    def interrupt():
        wait_until_busy(ticket)
        ctrl_c()

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        run(until_stopped, 2, ticket)
    assert_idle(ticket)


def test_ctrl_c_again_still_waits_for_the_workers(ctrl_c):
    finished, end = [], threading.Event()

    def slow(ticket, both):
        both.wait(timeout=30)
        end.wait(timeout=30)
        finished.append(take(ticket))

    def interrupt(both):
        both.wait(timeout=30)
        ctrl_c()
        ctrl_c()
        end.set()

    both = threading.Barrier(3)
    threading.Thread(target=interrupt, args=(both,)).start()
    with pytest.raises(KeyboardInterrupt):
        run(slow, 2, new_ticket(2, 1), both)
    assert finished == [-1, -1]


FORKED = """
import os, sys
import numpy as np
from test_parallel import count_visits, new_ticket, run

def work():
    visits = np.zeros(100, np.int64)
    run(count_visits, 2, new_ticket(100, 1), visits, np.zeros(100, np.int64))
    return visits.tolist() == [1] * 100

assert work()
child = os.fork()
if child == 0:
    os._exit(0 if work() else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
def test_a_forked_process_starts_threads_of_its_own():
    folder = os.path.dirname(__file__)
    done = subprocess.run([sys.executable, "-c", FORKED], cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


# --- the package's workers --------------------------------------------------------------------------------


def takes_by_hand(tree) -> list[int]:
    """The lines of a module that call `take`."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    return [call.lineno for call in calls if isinstance(call.func, ast.Name) and call.func.id == "take"]


def test_workers_loop_by_items_and_shares():
    home = Path(parallel.__file__)
    found, loops = [], 0
    for path in home.parents[1].rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        loops += text.count(" in items(ticket):") + text.count(" in shares(ticket):")
        imports = "parallel import" in text and re.search(r"\btake\b", text)
        found += [f"{path.name}:{line}" for line in takes_by_hand(ast.parse(text))] if imports and path != home else []
    assert loops > 80 and takes_by_hand(ast.parse("first = take(ticket)")) == [1] and not found, found
