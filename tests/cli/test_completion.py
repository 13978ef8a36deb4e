"""What the shell completes: commands, options, and the names of values."""

import os
import subprocess
import sys

import pytest
import typer

from antumbra.base.command_registry import COMMANDS
from antumbra.cli.app import program, run

PROGRAM = typer.main.get_command(program())


def completed(line: str, monkeypatch, capsys) -> list[str]:
    """What bash is offered for the last word of a line."""
    monkeypatch.setenv("_ANTUMBRA_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"antumbra {line}")
    monkeypatch.setenv("COMP_CWORD", str(len(line.split())))
    with pytest.raises(SystemExit):
        run([])
    return capsys.readouterr().out.split()


@pytest.mark.parametrize("name", COMMANDS)
def test_the_options_of_each_command(name, monkeypatch, capsys):
    params = [param for param in PROGRAM.commands[name].params if not getattr(param, "hidden", False)]
    options = {option for param in params for option in param.opts if option.startswith("--")}
    assert options <= set(completed(f"{name} --", monkeypatch, capsys))


@pytest.mark.parametrize(
    "line, first",
    [
        ("do", "doctor"),
        ("render --preset d", "draft"),
        ("render example:t", "example:temple"),
        ("view proc", "procedural:atrium"),
        ("sun city.json --rule br209-v", "br209-vsc"),
        ("render --plan bsah+multifrusta", "bsah+multifrusta"),
        ("warmup --plan srd", "srdh"),
        ("render --light q", "quad:"),
        ("compare --camera pan", "panorama"),
        ("sun city.json --sensors gr", "grid:"),
    ],
)
def test_names_of_values(line, first, monkeypatch, capsys):
    assert completed(line, monkeypatch, capsys)[0] == first


def test_files_are_left_to_the_shell(monkeypatch, capsys):
    assert completed("render sponz", monkeypatch, capsys) == []


def test_a_process_that_completes_prints_nothing_else(tmp_path):
    asks = {"_ANTUMBRA_COMPLETE": "complete_bash", "COMP_WORDS": "antumbra do", "COMP_CWORD": "1"}
    told = subprocess.run(
        [sys.executable, "-m", "antumbra"], env={**os.environ, **asks}, capture_output=True, text=True, cwd=tmp_path
    )
    assert told.stdout.split() == ["doctor"] and told.stderr == ""
