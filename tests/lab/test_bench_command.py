"""The options --quick and --output of benches, the files of their results, and what is kept as Markdown."""

import json
import sys
from contextlib import redirect_stdout
from typing import NamedTuple

import pytest
import typer

from antumbra.base.errors import InputError
from antumbra.cli import console, installation_commands
from antumbra.cli.console import Record
from antumbra.cli.options import Json
from antumbra.lab import bench_command
from antumbra.lab.bench_command import BenchResult, BenchRun, benchmark


class Point:
    """An entry point."""

    def __init__(self, command):
        self.load = lambda: command


class Options(NamedTuple):
    rounds: int = 5
    scene: list[str] | None = None


@benchmark(rounds=1)
def good(run: BenchRun, options: Options) -> BenchResult:
    def print_tables():
        print(f"Rounds of {options.scene}")
        console.print_table(("what", "n"), [("rounds | *all*", str(options.rounds))], right=(1,))
        console.print_fields([("bits", "the same")])

    return BenchResult({"rounds": options.rounds}, print_tables)


@benchmark(rounds=1)
def bad(run: BenchRun, options: Options) -> BenchResult:
    raise InputError("nothing to measure; name a scene")


def plain(json: Json = False):
    """A bench without --quick, --output and --quiet."""
    print("plain")


@benchmark()
def interrupted(run: BenchRun, options: Options) -> BenchResult:
    raise KeyboardInterrupt


@pytest.fixture
def benches(monkeypatch):
    """Announces some of the benches above instead of the real ones."""

    def announce(**commands):
        points = {name: Point(command) for name, command in commands.items()}
        monkeypatch.setattr(bench_command, "plugins_of", lambda group: points)

    announce(bad=bad, good=good, plain=plain)
    return announce


def test_files_of_results(cli, benches, tmp_path):
    done = cli("bench", "good", "--output", "found", "--scene", "a b", "--scene", "c")
    assert done.code == 0 and "rounds | *all*" in done.out and "the same" in done.out
    written = json.loads((tmp_path / "found" / "good.json").read_text())
    header = written["about"]
    assert written["rounds"] == 5 and header["command"] == "antumbra bench good --scene 'a b' --scene c"
    assert {"date", "antumbra", "python", "numpy", "numba", "system", "processor", "cores"} <= set(header)
    assert header["quick"] is False and written["spread"] == {} and isinstance(written["kernels"], dict)
    text = (tmp_path / "found" / "good.md").read_text()
    assert text.startswith("# antumbra bench good\n\n- **command**: antumbra bench good --scene 'a b' --scene c\n")
    table = "| what | n |\n| --- | ---: |\n| rounds \\| \\*all\\* | 5 |"
    assert text.endswith(f"**Rounds of \\['a b', 'c'\\]**\n\n{table}\n\n- **bits**: the same\n")
    assert not list((tmp_path / "found").glob(".*"))


def test_files_are_the_same_whatever_is_printed(cli, benches, tmp_path):
    told = cli("bench", "good", "--output", "a", "--json").json()
    assert set(told) == {"about", "spread", "rounds", "kernels"} and (tmp_path / "a" / "good.md").exists()
    assert told == json.loads((tmp_path / "a" / "good.json").read_text())
    assert cli("bench", "good", "--output", "a", "--quiet").out == ""
    assert "| rounds" in (tmp_path / "a" / "good.md").read_text()


def test_quick_values_give_way_to_those_of_the_user(cli, benches):
    for more, rounds in ((), 1), (("--rounds", "5"), 5):
        told = cli("bench", "good", "--quick", *more, "--json").json()
        assert told["rounds"] == rounds and told["about"]["quick"] is True
    assert "--rounds 1" in cli("bench", "good", "--help").out


def test_an_output_that_cannot_be_written(cli, benches, tmp_path):
    (tmp_path / "file").write_text("")
    cli("bench", "good", "--output", "file").refused("file")
    cli("bench", "good", "--output", "no/such").refused("no/such", "make it first")
    cli("bench", "bad", "--output", "new").refused("nothing to measure")
    cli("bench", "all", "--output", "file").refused("file")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_all_continues_after_a_failure(cli, benches, tmp_path):
    done = cli("bench", "all", "--quick", "--output", "found")
    assert done.code == 1
    assert done.err.count("\n") - done.err.count("no plots") == 1
    assert "antumbra bench bad failed: nothing to measure; name a scene" in done.err
    headings = [line for line in done.out.splitlines() if line.startswith("== ")]
    assert headings == [f"== antumbra bench {name} ({k} of 3)" for k, name in enumerate(("bad", "good", "plain"), 1)]
    assert "failed after" in done.out and json.loads((tmp_path / "found" / "good.json").read_text())["rounds"] == 1


def test_all_succeeds(cli, benches):
    benches(good=good, plain=plain)
    done = cli("bench", "all")
    assert done.code == 0 and done.err == "" and "(2 of 2)" in done.out
    benches(good=good)
    assert cli("bench", "all", "--quiet") == (0, "", "")


def test_all_keeps_what_is_finished_when_it_is_interrupted(cli, benches, tmp_path):
    benches(good=good, interrupted=interrupted, later=good)
    done = cli("bench", "all", "--output", "found")
    assert done.code == 130 and "interrupted" in done.err
    assert (tmp_path / "found" / "good.md").exists() and "(3 of 3)" not in done.out
    assert done.out.splitlines()[-1].startswith("good ")


def test_a_name_that_nobody_announces(cli, benches):
    cli("bench", "magic").refused("magic")


def test_the_list_of_commands_has_whole_summaries(cli):
    """Click would end them at the full stop of "et al."."""
    listed = " ".join(cli("bench", "--help").out.split())
    assert "build and trace times [Feltman et al. 2012]." in listed and "all Run all other benchmarks" in listed


def test_text_outside_tables_is_kept():
    record = Record(None)
    with redirect_stdout(record):
        print("One line\n\n  and <another>")
        console.print_fields([("a", "b")])
        print("the end")
    assert record.markdown() == "One line\n\nand \\<another\\>\n\n- **a**: b\n\nthe end\n"
    assert not record.isatty() and not isinstance(sys.stdout, Record)


def test_the_commit_is_known_only_in_a_checkout(tmp_path, monkeypatch):
    assert installation_commands.about().keys() - {"commit", "memory"} == {
        "antumbra", "python", "numpy", "numba", "system", "processor", "cores"
    }  # fmt: skip
    (tmp_path / "about.py").write_text("")
    monkeypatch.setattr(installation_commands, "__file__", str(tmp_path / "about.py"))
    assert "commit" not in installation_commands.about()


def test_typer_sees_the_types_of_the_parameters():
    assert good.__annotations__["context"] is typer.Context and "options" not in good.__annotations__
