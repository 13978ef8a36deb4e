"""Chunks are read a little ahead of the rays, and further where rays need what was read."""

from concurrent.futures import Future
from functools import partial

import numpy as np
import pytest

import antumbra as at
from antumbra.store import chunk_residency
from antumbra.store.chunk_residency import Residency

GROUP, AHEAD = 2, 4


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store of 40 chunks or more."""
    path = tmp_path_factory.mktemp("stored") / "city.antumbra"
    assert at.build_store(at.procedural("city", triangles=20_000), path, chunk=512).chunks >= 40
    with at.load(path).store as opened:
        yield opened


@pytest.fixture
def residency(store, monkeypatch):
    """All chunks fit."""
    monkeypatch.setattr(chunk_residency, "_GROUP", GROUP)
    monkeypatch.setattr(chunk_residency, "_AHEAD", AHEAD)
    chunks = Residency(store, 1 << 40)
    yield chunks
    chunks.close()


def _all(chunks):
    return np.ones(len(chunks), np.bool_)


def _traced(residency, still=_all):
    """The chunks in the order in which they come."""
    parts = np.arange(len(residency.store), dtype=np.int32)
    return [k for group in residency.groups(parts, still) for k in group.tolist()]


def test_chunks_are_read_further_ahead_where_rays_need_them_all(residency):
    chunks = len(residency.store)
    assert _traced(residency) == list(range(chunks)) and 2 * AHEAD < residency._ahead <= chunks
    assert residency.paging.loaded == chunks and residency.traced.all()


def test_few_chunks_are_read_that_nothing_needs(residency):
    """The first group hides all chunks but the last one."""
    last, first = len(residency.store) - 1, list[int]()

    def still(chunks):
        if not first:
            first.extend(chunks.tolist())
            return _all(chunks)
        return np.isin(chunks, [*first, last])

    assert _traced(residency, still) == [*first, last]
    assert set(np.flatnonzero(residency.traced)) == {*first, last}
    assert GROUP <= len(first) <= AHEAD < residency.paging.loaded <= 3 * AHEAD + 1


class _Later(Future):
    """A chunk that is read when it is waited for, as on a slow disk."""

    def __init__(self, read):
        super().__init__()
        self._read = read

    def done(self):
        return False

    def result(self, timeout=None):
        return self._read()


def test_fewer_chunks_are_read_ahead_than_already_come_once_few_are_needed(residency, monkeypatch):
    """Those that come already, on a slow disk, are more than are read ahead from then on."""
    monkeypatch.setattr(residency._reader, "submit", lambda read, k: _Later(partial(read, k)))
    request, surplus = residency._request, list[int]()

    def requested(missing, coming, mark):
        surplus.append(len(coming) - residency._ahead)
        request(missing, coming, mark)

    monkeypatch.setattr(residency, "_request", requested)
    still = lambda chunks: np.array([k not in residency or k < 3 * GROUP for k in chunks.tolist()])
    assert _traced(residency, still) == list(range(3 * GROUP))
    assert max(surplus) > 0 and residency.pending == 0 and residency.paging.loaded == len(residency.store)


def test_chunks_that_come_twice_in_a_band_are_counted(store):
    residency = Residency(store, Residency(store, 0).min_budget())
    for n in range(2):
        residency.begin_band()
        assert not residency.traced.any() and len(_traced(residency)) == len(store) and residency.returned == 0
        assert residency.paging.loaded > n * len(store) // 2
    assert len(_traced(residency)) == len(store)
    assert residency.returned > residency.budget and residency.used <= residency.budget
    residency.close()
