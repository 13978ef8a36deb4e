"""The thread that traces."""

import threading

import pytest

from antumbra.viewer.progressive_pictures import CLICK, FINE, PICTURE, Interrupted, TaskQueue


@pytest.fixture
def worker():
    made = TaskQueue()
    yield made
    made.close()


def until(event):
    assert event.wait(20.0)


def test_the_latest_of_one_name_replaces_earlier_ones(worker):
    hold, begun, done = threading.Event(), threading.Event(), []

    def first(check):
        begun.set()
        until(hold)

    worker.submit("other", PICTURE, first)
    until(begun)
    for k in range(5):
        worker.submit("x", PICTURE, lambda check, k=k: done.append(k))
    hold.set()
    assert worker.wait(20.0) and done == [4]


def test_work_that_became_void_ends_at_its_check(worker):
    begun, again, ended = threading.Event(), threading.Event(), []

    def void(check):
        begun.set()
        until(again)
        try:
            check()
        except Interrupted:
            ended.append("void")
            raise

    worker.submit("x", PICTURE, void)
    until(begun)
    worker.submit("x", PICTURE, lambda check: ended.append("new"))
    again.set()
    assert worker.wait(20.0) and ended == ["void", "new"]


def test_a_click_overtakes_and_the_rest_goes_on(worker):
    begun, clicked, order, left = threading.Event(), threading.Event(), [], [1, 2, 3]

    def fine(check):
        begun.set()
        while left:
            if len(left) == 2:
                until(clicked)
            check()
            order.append(left.pop(0))

    worker.submit("x", FINE, fine)
    until(begun)
    worker.submit("click", CLICK, lambda check: order.append("click"))
    clicked.set()
    assert worker.wait(20.0) and order.count("click") == 1 and [k for k in order if k != "click"] == [1, 2, 3]
    assert order.index("click") <= 2


def test_errors_are_told_and_the_thread_lives(worker):
    errors, done = [], threading.Event()
    failing = TaskQueue(errors.append)
    error = ValueError("no")

    def fail(check):
        raise error

    failing.submit("x", PICTURE, fail)
    failing.submit("y", FINE, lambda check: done.set())
    until(done)
    failing.close()
    assert errors == [error] and not failing.has("x")


def test_work_waits_until_it_is_due(worker):
    done = []
    worker.submit("x", PICTURE, lambda check: done.append("late"), after=0.3)
    worker.submit("y", FINE, lambda check: done.append("soon"))
    assert worker.wait(20.0) and done == ["soon", "late"]


def test_closing_drops_what_waits():
    worker, done = TaskQueue(), []
    worker.submit("x", PICTURE, lambda check: done.append(1), after=1000.0)
    worker.drop("y")
    assert worker.has("x")
    worker.close()
    assert not done and not worker.has("x")
