"""`.ci/run` with programs that only say how they are called: every stage runs, and the first that fails ends it."""

import os
import shutil
import subprocess
import sys

import pytest

from repository import ROOT

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="continuous integration needs Linux: NOT checked")

SAYS = """#!/bin/bash
said="${0##*/} $*"
echo "ran: $said"
case "$said" in *"$FAILING"*) exit 3 ;; esac
"""
"""A program, which fails if its call contains $FAILING."""
PYTHON = f"""#!/bin/bash
if [ "$1 $2" = "-m venv" ]; then
    mkdir -p "$3/bin"
    for name in pip pytest antumbra python; do cp scripts/check "$3/bin/$name"; done
else
    exec "{sys.executable}" "$@"
fi
"""


@pytest.fixture
def run(tmp_path):
    """Run .ci/run in a tree without a package: run(what the calls that fail contain) -> (exit code, lines)."""
    for name in (".ci/run", "scripts/snippets.py", "README.md"):
        (tmp_path / "tree" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / "tree" / name)
    for path, text in ((tmp_path / "tree/scripts/check", SAYS), (tmp_path / "bin/python3", PYTHON)):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)
    (tmp_path / "work").mkdir()

    def of(failing: str) -> tuple[int, list[str]]:
        path = f"{tmp_path / 'bin'}:{os.environ['PATH']}"
        env = {**os.environ, "PATH": path, "TMPDIR": str(tmp_path / "work"), "FAILING": failing}
        done = subprocess.run([tmp_path / "tree/.ci/run"], env=env, capture_output=True, text=True)
        assert not list((tmp_path / "work").iterdir()), "its folder remains"
        return done.returncode, done.stdout.splitlines()

    return of


def test_every_stage_runs(run):
    code, lines = run("nothing fails")
    ran = [line.removeprefix("ran: ").strip() for line in lines if line.startswith("ran: ")]
    assert {"check lint", "check types", "check examples", "check docs"} <= set(ran)
    assert {"pip install .[test]", "pip install .[jit]", "pytest", "pytest --skipped"} <= set(ran)
    assert "pytest -m volume or papers or programs" in ran and any(each.startswith("antumbra render") for each in ran)
    assert code == 0 and lines[-1].startswith("==== all passed")


@pytest.mark.parametrize(
    "failing, stage",
    [
        ("[test]", "README: python3 -m venv"),
        ("check types", "scripts/check types"),
        ("pytest --skipped", "pytest --skipped"),
        ("tests/trace", "pytest, with kernels in WebAssembly"),
        ("check examples", "scripts/check examples"),
        ("python - 1280x800", "README: python3 -m venv .venv && .venv/bin/pip install '.[jit]'"),
    ],
)
def test_a_stage_that_fails_ends_it_and_is_named(run, failing, stage):
    code, lines = run(failing)
    assert code == 3 and lines[-1].startswith(f"==== FAILED: {stage}")
    assert not any("all passed" in line for line in lines)
