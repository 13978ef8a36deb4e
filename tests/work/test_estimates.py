"""Estimates of long work: judged by a sample or by one unit, told once, and refused where there is no room."""

import shutil
from collections import namedtuple
from itertools import chain, repeat

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.work import estimates, executors, work_parts
from antumbra.work.executors import LocalExecutor, ShardExecutor, ShardIndex
from antumbra.work.work_parts import Parts


@pytest.fixture
def clock(monkeypatch):
    """A clock in which the first part takes 100 s, and each other one 7 s."""
    times = chain([0.0, 100.0], repeat(107.0))
    monkeypatch.setattr(executors, "perf_counter", lambda: next(times))


def parts(count, folder):
    return Parts("suns", count, 1, lambda first, last: {"a": np.zeros(1000)}, folder, {"of": "a test"})


def told(work, executor):
    lines = []
    with estimates.telling(lines.append):
        executor.finish([work])
    return lines


def test_the_second_part_tells_what_the_rest_takes(clock, tmp_path):
    (line,) = told(parts(20, tmp_path), LocalExecutor(tmp_path))
    size = (tmp_path / parts(20, tmp_path).files(1)[0]).stat().st_size
    assert line.startswith("suns: 18 more parts take about 126.00 s, ")
    assert line.endswith(f" of memory, {18 * size / 1e3:.1f} kB on disk (estimated from one part)")


def test_parts_in_memory_have_no_size_on_disk(clock):
    (line,) = told(parts(20, None), LocalExecutor(None))
    assert "on disk" not in line and "of memory (estimated" in line


def test_a_shard_tells_of_its_own_parts(clock, tmp_path):
    (line,) = told(parts(24, tmp_path), ShardExecutor(tmp_path, ShardIndex(1, 2), ["sun"]))
    assert line.startswith("suns: 10 more parts take about 70.00 s, ")


def test_short_work_tells_nothing(clock, tmp_path):
    assert not told(parts(10, tmp_path), LocalExecutor(tmp_path))


def test_parts_that_do_not_fit_on_the_disk_are_refused_before_they_are_made(clock, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(0, 0, 20_000))
    work = parts(20, tmp_path)
    with pytest.raises(
        InputError, match=r"18 more parts of the suns take about 1\d\d\.\d kB, and its disk has 20\.0 kB"
    ):
        told(work, LocalExecutor(tmp_path))
    assert [work.done(k) for k in range(4)] == [True, True, False, False]


# --- Samples ----------------------------------------------------------------------------------------------------------


def many(folder, count=40, log=None, row=64):
    """Parts of 1,024 rows, whose ranges are logged."""

    def work(first, last):
        assert 0 <= first < last <= 1024 * count - 5
        if log is not None:
            log.append((first, last))
        return {"a": np.zeros((last - first, row // 8))}

    return Parts("suns", 1024 * count - 5, 1024, work, folder, {"of": "a test"})


def test_a_sample_tells_before_the_first_part_what_all_take(tmp_path, monkeypatch):
    monkeypatch.setattr(estimates, "_LONG", 0.0)
    log, lines = [], []
    with estimates.telling(lambda line: lines.append((line, len(list(tmp_path.rglob("*.npz")))))):
        LocalExecutor(tmp_path).finish([many(tmp_path, log=log)])
    ((line, made),) = lines
    assert made == 0 and line.startswith("suns: 40 more parts take about ")
    assert line.endswith("on disk (estimated from a sample of 128)")
    ranges = [each for each in log if each[1] - each[0] < 1000]
    assert len(log) == 40 + len(ranges) and sum(last - first for first, last in ranges) < 1024 / 4
    starts = sorted({first for first, _ in ranges})
    assert len(starts) == 4 and starts[0] > 1024 and starts[-1] > 30 * 1024, "evenly spread"


def test_the_bytes_of_a_sample_are_those_of_parts_with_what_any_part_takes(tmp_path):
    work = many(tmp_path)
    unit = work.estimate(40)
    work.do(3)
    size = (tmp_path / work.files(3)[0]).stat().st_size
    assert abs(unit.size - size) < 0.01 * size


def test_a_few_or_small_parts_are_not_sampled(tmp_path):
    assert many(tmp_path).estimate(15) is None and many(None).estimate(40) is None
    assert many(tmp_path).estimate(16) is not None
    assert parts(40, tmp_path).estimate(40) is None
    assert Parts("none", 0, 1024, lambda first, last: {}, tmp_path).estimate(40) is None


def test_what_does_not_fit_on_the_disk_is_refused_before_the_first_part(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage(0, 0, 200_000))
    with pytest.raises(InputError, match=r"40 more parts of the suns take about 2\.6 MB, and its disk has 200\.0 kB"):
        LocalExecutor(tmp_path / "new").finish([many(tmp_path / "new")])
    assert not list(tmp_path.iterdir())


def test_what_does_not_fit_in_memory_is_refused_before_the_first_part(tmp_path, monkeypatch):
    monkeypatch.setattr(estimates, "available_memory", lambda: 1_000_000)
    with pytest.raises(InputError, match=r"a part takes about .* of memory, and 1\.0 MB are left; run fewer processes"):
        LocalExecutor(tmp_path).finish([many(tmp_path)])
    assert not list(tmp_path.iterdir())


def test_memory_of_wide_results_is_part_of_the_estimate(tmp_path):
    narrow, wide = many(tmp_path).estimate(40), many(tmp_path, row=8000).estimate(40)
    assert wide.more > narrow.more + 1024 * 8000 and wide.memory >= wide.more > 4 * 1024 * 8000


def test_memory_of_former_work_is_not_counted_again(tmp_path, monkeypatch):
    monkeypatch.setattr(work_parts, "resident_memory", lambda: 100 << 20)
    monkeypatch.setattr(work_parts, "peak_resident_memory", lambda: 900 << 20)
    unit = many(tmp_path).estimate(40)
    assert unit.memory == 900 << 20 and unit.more < 50 << 20


def test_work_without_a_name_is_told_without_one(caplog):
    with caplog.at_level("INFO", "antumbra"):
        estimates.tell_estimate("", None, estimates.Estimate(60.0, 0.0, 1e6, 0.0, "one part"), 10)
    assert caplog.messages == ["10 more parts take about 10 min, 1.0 MB of memory (estimated from one part)"]
