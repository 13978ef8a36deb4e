"""Fixtures that run the command line within this process, so that kernels are loaded once."""

import json
from typing import NamedTuple

import pytest

from antumbra.cli import main

TRIANGLES = 2000  # triangles of procedural scenes


class Outcome(NamedTuple):
    code: int
    out: str
    err: str

    def json(self) -> dict:
        """The one JSON object on standard output."""
        assert self.code == 0, self.err
        assert self.out.endswith("\n") and self.out.count("\n") == 1
        return json.loads(self.out)

    def refused(self, *words: str) -> None:
        """Check for bad input: exit code 2, one line of standard error with all the words.

        Standard output is empty, or has the same line as JSON.
        """
        told = json.dumps({"error": self.err.removeprefix("antumbra: ").rstrip()}) + "\n"  # with --json
        assert self.code == 2 and self.out in ("", told), self
        assert self.err.startswith("antumbra: ") and self.err.count("\n") == 1, self.err
        for word in words:
            assert word in self.err, (word, self.err)


@pytest.fixture
def cli(capsys, monkeypatch, tmp_path):
    """Runs the command line in its own folder: cli("render", "--spp", "4") -> Outcome."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ANTUMBRA_DEBUG", raising=False)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments) -> Outcome:
        capsys.readouterr()
        code = main([str(a) for a in arguments])
        return Outcome(code, *capsys.readouterr())

    return run


@pytest.fixture
def render(cli):
    """Renders a small picture of a small procedural scene; further arguments are added."""

    def run(*arguments, scene=f"procedural:atrium?triangles={TRIANGLES}", size="32x32") -> Outcome:
        return cli("render", *([scene] if scene else []), "--size", size, *arguments)

    return run


@pytest.fixture
def square_obj(tmp_path):
    """A file with a square floor, 2 wide, at y = 0. It has no cameras and no lights."""
    path = tmp_path / "square.obj"
    path.write_text("v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 3 2 1\nf 4 3 1\n")
    return path
