"""Scratch memory that is reused."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from antumbra.techniques.rayhierarchy import ray_leaves
from antumbra.techniques.rayhierarchy.ray_leaves import borrowed


@pytest.fixture(autouse=True)
def nothing_spare(monkeypatch):
    monkeypatch.setattr(ray_leaves, "spare_buffers", [])


def test_the_next_call_gets_the_same_memory():
    with borrowed() as empty:
        a, b = empty(1000, np.float32), empty(10, np.int64)
        assert (a.shape, a.dtype, b.shape, b.dtype) == ((1000,), np.float32, (10,), np.int64)
        a[:] = 7
    with borrowed() as empty:
        c = empty(900, np.float32)
        assert np.shares_memory(a, c) and (c == 7).all()
        assert not np.shares_memory(empty(900, np.float32), a)


def test_who_holds_memory_has_it_alone():
    with borrowed() as outer:
        kept = [outer(100, np.int32) for _ in range(5)]
        with borrowed() as inner:
            kept += [inner(100, np.int32) for _ in range(5)]
            for i, a in enumerate(kept):
                a[:] = i
            assert all((a == i).all() for i, a in enumerate(kept))


def test_what_is_far_too_large_waits_for_others():
    with borrowed() as empty:
        large = empty(1000, np.uint8)
    with borrowed() as empty:
        assert not np.shares_memory(empty(499, np.uint8), large)
        assert np.shares_memory(empty(500, np.uint8), large)


def test_the_best_fit_is_taken():
    with borrowed() as empty:
        some = {n: empty(n, np.uint8) for n in (1500, 1000, 1200)}
    with borrowed() as empty:
        assert np.shares_memory(empty(1000, np.uint8), some[1000])
        assert np.shares_memory(empty(1000, np.uint8), some[1200])


def test_no_more_is_kept_than_may_be_and_the_last_used_first(monkeypatch):
    monkeypatch.setattr(ray_leaves, "KEPT", 2500)
    with borrowed() as empty:
        old = empty(2000, np.uint8)
    with borrowed() as empty:
        new = empty(600, np.uint8)
    assert sum(map(len, ray_leaves.spare_buffers)) <= 2500
    with borrowed() as empty:
        assert np.shares_memory(empty(600, np.uint8), new) and not np.shares_memory(empty(2000, np.uint8), old)
    with borrowed() as empty:
        empty(10_000, np.uint8)
    assert all(len(spare) < 10_000 for spare in ray_leaves.spare_buffers)


def test_an_error_gives_memory_back():
    with pytest.raises(KeyError), borrowed() as empty:
        empty(100, np.uint8)
        raise KeyError
    assert len(ray_leaves.spare_buffers) == 1


def test_threads_never_share():
    def work(k):
        for _ in range(200):
            with borrowed() as empty:
                a, b = empty(5000, np.int32), empty(3000, np.int32)
                a[:], b[:] = k, -k
                assert (a == k).all() and (b == -k).all()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(1, 9)))
