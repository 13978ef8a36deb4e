"""Parts of benchmarks: stored as soon as they are measured, resumed, joined, and never mixed with others."""

import json
import math
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np
import pytest
import typer

from antumbra.lab import bench_command, bench_parts
from antumbra.lab.bench_command import BenchResult, BenchRun, benchmark
from antumbra.lab.bench_conditions import record_laps
from antumbra.lab.bench_parts import BenchParts, packed, unpacked


class Row(NamedTuple):
    """A row with a value of each kind."""

    name: str
    size: tuple[int, int]
    trace: dict[int, float]
    bits: bytes
    picture: np.ndarray | None = None


ROW = Row("a", (3, 2), {1: 0.1 + 0.2, 10: math.inf}, b"\x00\xff", np.arange(6, dtype=np.uint8).reshape(2, 3))


def test_values_survive_a_file():
    value = [(ROW, None), {"of": ROW._replace(picture=None), ("a", 1): [True, "text"]}, np.float32(0.25)]
    found = unpacked(json.loads(json.dumps(packed(value))), {"Row": Row})
    (row, nothing), others, number = found
    assert type(row) is Row and row[:4] == ROW[:4] and type(row.size) is tuple and nothing is None and number == 0.25
    np.testing.assert_array_equal(row.picture, ROW.picture)
    assert row.picture.dtype == np.uint8 and others == value[1] and type(others["of"]) is Row


def stored(folder, tables=None, settings=None, **more):
    return BenchParts(settings or {"one": {"size": 5}, "two": {}}, [Row], tables, folder=folder, **more)


class Counted:
    """A measurement that counts how often it was made."""

    def __init__(self):
        self.calls = []

    def __call__(self, name, laps=(0.5, 0.25)):
        self.calls.append(name)
        record_laps(laps)
        return [Row(name, (1, 2), {1: 0.5}, b"")]


def measured(parts, measure, *names, table="one", **settings):
    for name in names:
        parts.add(table, name, lambda name=name: measure(name), **settings)
    return [row.name for row in parts.rows(table)]


def test_stored_parts_are_not_measured_again(tmp_path):
    first, second = Counted(), Counted()
    assert measured(stored(tmp_path), first, "a", "b") == ["a", "b"] == first.calls
    resumed = stored(tmp_path)
    assert measured(resumed, second, "b", "c", "a") == ["b", "c", "a"] and second.calls == ["c"]
    assert (resumed.measured, resumed.resumed) == (1, 2)
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".json"]


def test_fresh_measures_what_is_asked_again_and_keeps_the_other_tables(tmp_path):
    measured(stored(tmp_path), Counted(), "a")
    measured(stored(tmp_path), Counted(), "b", table="two")
    again = Counted()
    parts = stored(tmp_path, ["one"], fresh=True)
    assert measured(parts, again, "a") == ["a"] == again.calls and [row.name for row in parts.rows("two")] == ["b"]


def test_tables_that_are_not_asked_for_are_joined_but_not_measured(tmp_path):
    measured(stored(tmp_path, ["one"]), Counted(), "b", "a")
    parts, count = stored(tmp_path, ["two"]), Counted()
    parts.add("one", "c", lambda: count("c"))
    assert measured(parts, count, "d", table="two") == ["d"] == count.calls
    assert [row.name for row in parts.rows("one")] == ["b", "a"] and "one" in parts and "three" not in parts
    assert parts.wants("one", "two") and not parts.wants("one")


def edit(folder, change):
    """Change the record of each stored part."""
    for path in folder.iterdir():
        record = json.loads(path.read_text())
        change(record)
        path.write_text(json.dumps(record))


CHANGES = {
    "options": lambda r: r["settings"].update(size=6),
    "machine": lambda r: r["machine"].update(processor="another"),
    "version": lambda r: r["machine"].update(antumbra="0.1"),
    "kernel": lambda r: r["conditions"]["kernels"].update({"antumbra.bvh.nodes:no_such_kernel": {"i": "0" * 32}}),
    "row": lambda r: r["value"][0].update(of="AnotherRow"),
    "part": lambda r: r["more"].update(relit=True),
}


@pytest.mark.parametrize("change", CHANGES)
def test_parts_measured_otherwise_are_measured_anew(change, tmp_path):
    measured(stored(tmp_path), Counted(), "a")
    edit(tmp_path, CHANGES[change])
    again = Counted()
    assert measured(stored(tmp_path), again, "a") == ["a"] == again.calls
    assert measured(stored(tmp_path), again, "a") == ["a"] and again.calls == ["a"]


@pytest.mark.parametrize("change", ["options", "machine", "version", "kernel"])
def test_parts_measured_otherwise_are_left_out_of_other_tables_with_a_word(change, tmp_path, capsys):
    measured(stored(tmp_path), Counted(), "a")
    edit(tmp_path, CHANGES[change])
    parts = stored(tmp_path, ["two"])
    assert parts.rows("one") == [] and "one" not in parts
    words = {
        "options": "other options (size)",
        "machine": "(processor)",
        "version": "(antumbra)",
        "kernel": "no_such_k",
    }
    assert f"table one in {tmp_path} is left out" in (said := capsys.readouterr().err) and words[change] in said


def test_a_damaged_file_is_measured_anew(tmp_path):
    measured(stored(tmp_path), Counted(), "a")
    (path,) = tmp_path.iterdir()
    path.write_text(path.read_text()[:-20])
    again = Counted()
    assert measured(stored(tmp_path), again, "a") == ["a"] == again.calls


def test_conditions_of_tables_are_those_of_their_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(bench_parts, "_load", iter([[1.0], [2.5], [0.5], [2.0]]).__next__)
    parts = stored(tmp_path, command="antumbra bench x")
    parts.add("one", "a", lambda: Counted()("a", (1.0, 2.0, 3.0)))
    parts.add("one", "b", lambda: Counted()("b"))
    table = stored(tmp_path, command="another").of_tables()["one"]
    assert table["parts"] == 2 and table["load"] == [0.5, 2.5] and table["rounds"] == [2, 3]
    assert table["commands"] == ["antumbra bench x"] and len(table["dates"]) == 2 and table["seconds"] >= 0


# --- A benchmark that is killed ---------------------------------------------------------------------------------------


class Table(StrEnum):
    """The tables of a benchmark."""

    one = "one"
    two = "two"


class Options(NamedTuple):
    table: Annotated[list[Table] | None, typer.Option()] = None
    size: int = 5


CALLS: list[str] = []
FAILS: set[str] = set()


@benchmark(size=2)
def parted(run: BenchRun, options: Options) -> BenchResult:
    parts = run.parts({Table.one: {"size": options.size}, Table.two: {}}, [Row], options.table)

    def measure(name):
        CALLS.append(name)
        if name in FAILS:
            raise KeyboardInterrupt
        return [Row(name, (1, 1), {}, b"")]

    for table in Table:
        for name in "ab":
            parts.add(table, name, lambda name=f"{table} {name}": measure(name))
    rows = {table.value: [row.name for row in parts.rows(table)] for table in Table if table in parts}
    return BenchResult(rows, lambda: print(rows))


@pytest.fixture
def bench(cli, monkeypatch):
    """Runs the benchmark above."""
    CALLS.clear()
    FAILS.clear()
    entry = type("Point", (), {"load": staticmethod(lambda: parted)})
    monkeypatch.setattr(bench_command, "plugins_of", lambda group: {"parted": entry})
    return lambda *more: cli("bench", "parted", *more)


def results(folder):
    found = json.loads((folder / "parted.json").read_text())
    for table in found["tables"].values():
        table["dates"] = table["seconds"] = table["load"] = None
    return {**found, "about": {**found["about"], "date": None}}


def test_a_killed_benchmark_goes_on_where_it_was(bench, tmp_path):
    assert bench("--output", "whole").code == 0
    CALLS.clear()
    FAILS.add("one b")
    assert bench("--output", "found").code == 130 and CALLS == ["one a", "one b"]
    assert not (tmp_path / "found" / "parted.json").exists()
    CALLS.clear()
    FAILS.clear()
    done = bench("--output", "found")
    assert done.code == 0 and CALLS == ["one b", "two a", "two b"] and "parts measured before: 1;" in done.err
    assert results(tmp_path / "found") == results(tmp_path / "whole")
    assert (tmp_path / "found" / "parted.md").exists()


def test_tables_measured_alone_make_the_results_of_a_whole_run(bench, tmp_path):
    bench("--output", "whole")
    bench("--output", "found", "--table", "two")
    assert "one" not in results(tmp_path / "found")
    CALLS.clear()
    bench("--output", "found", "--table", "one")
    assert CALLS == ["one a", "one b"]
    found, whole = results(tmp_path / "found"), results(tmp_path / "whole")
    assert found["tables"] == whole["tables"] and found["about"]["command"] == "antumbra bench parted"
    assert found.keys() == whole.keys() and all(found[t] == whole[t] for t in ("one", "two"))


def test_another_size_or_quick_is_not_mixed(bench, tmp_path):
    bench("--output", "found")
    CALLS.clear()
    bench("--output", "found", "--size", "6")
    assert CALLS == ["one a", "one b"]  # the second table does not depend on the size
    CALLS.clear()
    bench("--output", "found", "--size", "6", "--quick")
    assert len(CALLS) == 4


def test_without_a_folder_nothing_is_kept(bench, tmp_path):
    assert [bench("--table", "one", "--json").json()["one"] for _ in range(2)] == [["one a", "one b"]] * 2
    assert CALLS == ["one a", "one b"] * 2 and list(tmp_path.iterdir()) == []
