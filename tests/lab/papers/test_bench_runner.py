"""What benchmarks share: digests, alternating runs, and tables beside published figures."""

from typing import NamedTuple

import numpy as np

from antumbra.lab.bench_conditions import collected_laps
from antumbra.lab.papers.bench_runner import (
    TableColumn,
    beside,
    columns_of,
    few_rounds,
    interleave,
    label,
    medians,
    print_table,
    records,
)
from antumbra.lab.papers.benchmark_views import agree, digest


def test_every_bit_counts():
    bits = np.zeros((2, 3, 1), np.uint64)
    other = bits.copy()
    other[1, 2, 0] = 1 << 63
    assert digest([bits, bits]) == digest([bits, bits.copy()]) != digest([bits, other])


def test_answers_are_compared_question_by_question():
    found = [("a", b"1"), ("b", b"2"), ("a", b"1")]
    assert agree(found) and agree([])
    assert not agree([*found, ("b", b"1")])


def test_times_of_few_rounds_say_so():
    shown = [few_rounds("1.0", rounds) for rounds in (1, 2, 3, 9)]
    assert shown == ["1.0 (1 round)", "1.0 (2 rounds)", "1.0", "1.0"] and few_rounds("", None) == ""


def test_rounds_are_recorded_where_there_are_several():
    with collected_laps() as laps:
        interleave("ab", 3, lambda case, turn: None if (case, turn) == ("b", 1) else 1.0)
        interleave("a", 1, lambda case, turn: 1.0)
    assert laps.rounds == [3, 2]


def test_cases_take_turns():
    calls = []

    def measure(case, turn):
        calls.append((turn, case))
        return None if (case, turn) == ("b", 1) else {"s": float(turn)}

    laps = interleave("ab", 3, measure, warm_up=1)
    assert calls == [(turn, case) for turn in (-1, 0, 1, 2) for case in "ab"]
    assert laps == {"a": [{"s": 0.0}, {"s": 1.0}, {"s": 2.0}], "b": [{"s": 0.0}, {"s": 2.0}]}
    assert medians(laps["a"]) == {"s": 1.0}


class Row(NamedTuple):
    name: str
    bits: bytes

    @property
    def size(self) -> int:
        return len(self.bits)


def test_a_table_ends_with_the_published_rows(capsys):
    columns = (
        label("name", "name", str),
        TableColumn("size", lambda row: beside(f"{row.size}", 2.5)),
        *columns_of({0: "first", 1: "second"}, lambda row, k: f"{row.bits[k]}", lambda row, k: f"{row}{k}"),
    )
    print_table("A table", columns, [Row("ours", b"ab")], ["paper"])
    title, head, _, ours, theirs = (line for line in capsys.readouterr().out.splitlines() if line.strip())
    assert title == "A table" and head.split() == ["name", "size", "first", "second"]
    assert ours.split() == ["ours", "2", "(2.5)", "97", "98"] and theirs.split() == ["paper", "paper0", "paper1"]


def test_records_are_json():
    assert records([Row("a", b"\x01")], "size") == [{"name": "a", "bits": "01", "size": 1}]
