"""Work in parts: joined, kept in a folder, and gone on with after an interruption or damage."""

import numpy as np
import pytest

import antumbra as at
from antumbra.work.executors import LocalExecutor
from antumbra.work.work_parts import Parts, settings_digest
from mutations import mutated


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
NAMES = "squares", "rows"
SQUARES = [k * k for k in range(10)]


def parts(folder, work, name="a"):
    return Parts("work", 10, 4, work, folder, {"what": name})


def finished(made):
    LocalExecutor().finish([made])
    return made.joined(NAMES)


@pytest.mark.parametrize("kept", [True, False])
def test_parts_are_joined_in_order(tmp_path, kept):
    work = Work()
    made = finished(parts(tmp_path if kept else None, work))
    assert work.asked == RANGES
    assert made["squares"].tolist() == SQUARES and made["rows"].shape == (10, 2)


def test_work_goes_on(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        finished(parts(tmp_path, Work(stop=8)))
    work = Work()
    assert finished(parts(tmp_path, work))["squares"].tolist() == SQUARES and work.asked == RANGES[2:]
    other = Work()
    finished(parts(tmp_path, other, "b"))
    assert other.asked == RANGES  # of other settings


def test_damaged_parts_are_done_again(tmp_path):
    made = parts(tmp_path, Work())
    finished(made)
    files = [tmp_path / made.files(k)[0] for k in range(3)]
    files[0].write_bytes(files[0].read_bytes()[:40])
    files[1].write_bytes(b"")
    work = Work()
    assert finished(parts(tmp_path, work))["squares"].tolist() == SQUARES
    assert work.asked == RANGES[:2]


def test_mutated_parts_are_whole_or_not_there(tmp_path):
    made = parts(tmp_path, Work())
    finished(made)
    file, rng, whole = tmp_path / made.files(0)[0], np.random.default_rng(0), []
    data = file.read_bytes()
    for _ in range(200):
        file.write_bytes(mutated(data, rng))
        whole.append(made.done(0))
    assert any(whole) and not all(whole)


def test_files_of_other_parts_are_not_taken(tmp_path):
    made, other = parts(tmp_path, Work()), parts(tmp_path, Work(), "b")
    finished(made)
    finished(other)
    own = [tmp_path / made.files(k)[0] for k in range(3)]
    own[0].write_bytes(own[1].read_bytes())
    own[1].write_bytes((tmp_path / other.files(1)[0]).read_bytes())
    assert [made.done(k) for k in range(3)] == [False, False, True]


def test_single_parts_and_missing_ones(tmp_path):
    made = parts(tmp_path, Work())
    with pytest.raises(at.InputError, match="part 1 is missing"):
        made[1]
    finished(made)
    assert made[1]["squares"].tolist() == [16, 25, 36, 49]


def test_clear_removes_only_its_own(tmp_path):
    folder = tmp_path / "kept"
    first, second = (parts(folder, Work(), name) for name in "ab")
    for made in first, second:
        finished(made)
    first.clear()
    assert [path.name for path in folder.iterdir()] == [second.name]
    second.clear()
    assert not folder.exists()


def test_digests_tell_settings_apart():
    a = np.arange(6.0)
    names = [
        settings_digest(a),
        settings_digest(a.reshape(2, 3)),
        settings_digest(a.astype(np.float32)),
        settings_digest(a, "x"),
        settings_digest(a, None),
        settings_digest(),
    ]
    assert len(set(names)) == len(names)
    assert settings_digest(a, {"b": 1, "a": 2}) == settings_digest(a.copy(), {"a": 2, "b": 1})
