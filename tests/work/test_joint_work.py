"""Two results from one set of units: one work for executors, resumed and split as such."""

import numpy as np
import pytest

from antumbra.base.errors import UnavailableError
from antumbra.work.executors import LocalExecutor, ShardExecutor, ShardIndex, traced_share, write_shard_record
from antumbra.work.joint_work import both_results
from antumbra.work.work_parts import Parts, ShardMerge, about_parts


class Counting:
    """A study of ten numbers in four units; it counts the units that it does."""

    def __init__(self, factor):
        self.factor, self.did = factor, []

    def __call__(self, executor):
        folder = None if executor is None else executor.folder
        parts = Parts("numbers", 10, 3, self._part, folder, about_parts("numbers", "scene", self.factor))
        if executor is None:
            return self.factor * np.arange(10)
        if not executor.finish([parts]):
            return None
        total = parts.joined(["x"])["x"]
        executor.end([parts])
        return total

    def _part(self, first, last):
        self.did.append(first)
        return {"x": self.factor * np.arange(first, last)}


def test_studies_without_units_are_run_one_after_the_other():
    first, second = both_results(Counting(2), Counting(3), None)
    assert first.tolist() == (2 * np.arange(10)).tolist() and second.tolist() == (3 * np.arange(10)).tolist()


def test_all_units_are_done_once_and_removed(tmp_path):
    studies = Counting(2), Counting(3)
    first, second = both_results(*studies, LocalExecutor(tmp_path / "parts"))
    assert (second * 2 == first * 3).all() and first[9] == 18
    assert [study.did for study in studies] == [[0, 3, 6, 9]] * 2 and not list(tmp_path.rglob("*.npz"))


def test_an_interrupted_run_continues_in_the_second_study(tmp_path):
    class Failing(Counting):
        def _part(self, first, last):
            if first == 6:
                raise KeyboardInterrupt
            return super()._part(first, last)

    with pytest.raises(KeyboardInterrupt), pytest.warns(UserWarning, match="6 of 8 parts are done; run it again to"):
        both_results(Counting(2), Failing(3), LocalExecutor(tmp_path / "parts"))
    studies = Counting(2), Counting(3)
    both_results(*studies, executor := LocalExecutor(tmp_path / "parts"))
    assert [study.did for study in studies] == [[], [6, 9]] and traced_share(executor) == 2 / 8


def test_shards_share_the_units_of_both_studies_and_merge(tmp_path):
    done = []
    for k in range(3):
        studies = Counting(2), Counting(3)
        executor = ShardExecutor(tmp_path / "a.shards", ShardIndex(k, 3), ["sun"])
        assert both_results(*studies, executor) is None
        done += [len(study.did) for study in studies]
    assert sum(done) == 8
    executor = ShardMerge(tmp_path / "b", [tmp_path / "a.shards"])
    first, second = both_results(Counting(2), Counting(3), executor)
    assert traced_share(executor) == 0.0
    assert (second * 2 == first * 3).all()


def test_a_merge_names_a_shard_that_is_missing(tmp_path):
    both_results(Counting(2), Counting(3), ShardExecutor(tmp_path / "a.shards", ShardIndex(0, 2), ["sun"]))
    write_shard_record(tmp_path / "a.shards", ["sun"], 2)
    with pytest.raises(UnavailableError, match="shard 1/2 is not complete, 4 of 8 parts lack"):
        both_results(Counting(2), Counting(3), ShardMerge(tmp_path / "b", [tmp_path / "a.shards"]))
