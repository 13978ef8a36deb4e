"""Work in parts: joined, kept in a folder, and gone on with after an interruption or damage."""

import numpy as np
import pytest

import antumbra as at
from antumbra.jobs.parts import Parts, digest


class Work:
    """Squares of numbers; remembers the ranges that were asked, and stops before one of them."""

    def __init__(self, stop=None):
        self.asked, self.stop = [], stop

    def __call__(self, first, last):
        if first == self.stop:
            raise KeyboardInterrupt
        self.asked.append((first, last))
        return {"squares": np.arange(first, last) ** 2, "rows": np.ones((last - first, 2))}


RANGES = [(0, 4), (4, 8), (8, 10)]


@pytest.mark.parametrize("kept", [True, False])
def test_parts_are_joined_in_order(tmp_path, kept):
    work = Work()
    made = Parts(10, 4, tmp_path if kept else None, "a").run(work, "work")
    assert work.asked == RANGES
    assert made["squares"].tolist() == [k * k for k in range(10)] and made["rows"].shape == (10, 2)


def test_work_goes_on(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        Parts(10, 4, tmp_path, "a").run(Work(stop=8), "work")
    work = Work()
    made = Parts(10, 4, tmp_path, "a").run(work, "work")
    assert work.asked == RANGES[2:] and made["squares"].tolist() == [k * k for k in range(10)]
    other = Work()
    Parts(10, 4, tmp_path, "b").run(other, "work")
    assert other.asked == RANGES  # of other settings


def test_damaged_parts_are_done_again(tmp_path):
    Parts(10, 4, tmp_path, "a").run(Work(), "work")
    files = sorted((tmp_path / "a").iterdir())
    files[0].write_bytes(files[0].read_bytes()[:40])
    files[1].write_bytes(b"")
    work = Work()
    assert Parts(10, 4, tmp_path, "a").run(work, "work")["squares"].tolist() == [k * k for k in range(10)]
    assert work.asked == RANGES[:2]


def test_single_parts_and_missing_ones(tmp_path):
    parts = Parts(10, 4, tmp_path, "a")
    with pytest.raises(at.InputError, match="part 1 is missing"):
        parts[1]
    parts.finish(Work(), "work")
    assert parts[1]["squares"].tolist() == [16, 25, 36, 49]


def test_clear_removes_only_its_own(tmp_path):
    folder = tmp_path / "kept"
    first, second = (Parts(10, 4, folder, name) for name in "ab")
    for parts in first, second:
        parts.run(Work(), "work")
    first.clear()
    assert [path.name for path in folder.iterdir()] == ["b"]
    second.clear()
    assert not folder.exists()


def test_no_items():
    assert Parts(0, 4).run(Work(), "work") == {}


def test_digests_tell_settings_apart():
    a = np.arange(6.0)
    names = [
        digest(a),
        digest(a.reshape(2, 3)),
        digest(a.astype(np.float32)),
        digest(a, "x"),
        digest(a, None),
        digest(),
    ]
    assert len(set(names)) == len(names)
    assert digest(a, {"b": 1, "a": 2}) == digest(a.copy(), {"a": 2, "b": 1})
