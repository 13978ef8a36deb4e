"""Short runs: the calling thread works too, and threads that wake up too late are dismissed."""

import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from antumbra.kernels import parallel
from antumbra.kernels.jit import kernel as compiled
from antumbra.kernels.parallel import CHUNK, STOP, new_ticket, run, run_short, shares, take


@compiled
def count_visits(ticket, visits, pieces):
    for first, last in shares(ticket):
        pieces[first // ticket[CHUNK]] += 1
        for i in range(first, last):
            visits[i] += 1


@settings(deadline=None)  # the first example compiles
@given(st.integers(0, 300), st.integers(1, 400), st.integers(1, 6))
def test_every_item_is_done_exactly_once(n_items, chunk, n_threads):
    visits, pieces = np.zeros(n_items, np.int64), np.zeros(-(-n_items // chunk), np.int64)
    run_short(count_visits, n_threads, new_ticket(n_items, chunk), visits, pieces)
    assert np.all(visits == 1) and np.all(pieces == 1)


def test_the_calling_thread_is_one_of_the_threads():
    def rendezvous(ticket, barrier, seen):
        barrier.wait(timeout=30)  # passes only when all threads wait at the same time
        seen.add(threading.get_ident())

    seen = set()
    run_short(rendezvous, 3, new_ticket(3, 1), threading.Barrier(3), seen)
    assert len(seen) == 3 and threading.get_ident() in seen


def test_it_does_not_wait_for_threads_that_have_not_begun(monkeypatch):
    class Asleep:
        def __init__(self):
            self.jobs = []
            self.inbox = self

        def put(self, job):
            self.jobs.append(job)

    asleep = Asleep()
    monkeypatch.setattr(parallel, "_idle", [asleep])
    visits = np.zeros(10, np.int64)
    run_short(count_visits, 2, new_ticket(10, 1), visits, np.zeros(10, np.int64))
    assert np.all(visits == 1)
    assert parallel._idle == [asleep] and not asleep.jobs[0].admits(asleep)  # idle again; the job is over


def test_many_short_runs_start_no_more_threads_than_they_use():
    run(lambda ticket, barrier: barrier.wait(timeout=30), 3, new_ticket(3, 1), threading.Barrier(3))
    before = threading.active_count()
    for _ in range(200):
        run_short(count_visits, 3, new_ticket(3, 1), np.zeros(3, np.int64), np.zeros(3, np.int64))
    assert threading.active_count() == before


@pytest.mark.parametrize("n_threads", [1, 2, 4])
def test_a_workers_error_reaches_the_caller_and_stops_the_others(n_threads):
    def worker(ticket):
        first = take(ticket)
        while first >= 0:
            if first == 20:
                raise ValueError("item 20")
            first = take(ticket)

    ticket = new_ticket(2**62, 1)
    with pytest.raises(ValueError, match="item 20"):
        run_short(worker, n_threads, ticket)
    assert n_threads == 1 or ticket[STOP] == 1
    visits = np.zeros(50, np.int64)  # the threads still work
    run(count_visits, n_threads, new_ticket(50, 1), visits, np.zeros(50, np.int64))
    assert np.all(visits == 1)


def test_an_error_in_a_helper_reaches_the_caller():
    caller = threading.get_ident()

    def worker(ticket, barrier):
        barrier.wait(timeout=30)
        if threading.get_ident() != caller:
            raise ValueError("in a helper")

    with pytest.raises(ValueError, match="in a helper"):
        run_short(worker, 2, new_ticket(2, 1), threading.Barrier(2))


def test_arrays_are_let_go_after_the_run():
    visits = np.zeros(10, np.int64)
    before = sys.getrefcount(visits)
    run_short(count_visits, 2, new_ticket(10, 1), visits, np.zeros(10, np.int64))
    deadline = time.monotonic() + 10
    while sys.getrefcount(visits) > before and time.monotonic() < deadline:
        time.sleep(0.001)  # dismissed threads release the memory when they wake up
    assert sys.getrefcount(visits) == before
