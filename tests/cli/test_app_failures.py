import json
import os
import signal
import subprocess
import sys

import pytest
import typer

import antumbra as at
from antumbra.cli import scene_commands
from antumbra.cli.console import explained

ANTUMBRA = [sys.executable, "-m", "antumbra"]


@pytest.fixture
def failing(monkeypatch):
    """Makes `antumbra info x` raise an exception."""

    def raise_in_info(error):
        def boom(*_, **__):
            raise error

        monkeypatch.setattr(scene_commands, "open_scene", boom)

    return raise_in_info


@pytest.mark.parametrize(
    "error, code, words",
    [
        (at.InputError("a.glb: no triangles;\nadd some"), 2, "a.glb: no triangles; add some"),
        (MemoryError(), 1, "not enough memory"),
        (ZeroDivisionError("by zero"), 1, "unexpected ZeroDivisionError: by zero; this is a bug, --debug shows where"),
        (RuntimeError("two\nlines"), 1, "two lines"),
        (OSError(5, "Input/output error"), 1, "the system reports: [Errno 5] Input/output error"),
        (KeyError(), 1, "unexpected KeyError;"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (at.InputError("\x1b[31mred\x07.glb: bad"), 2, "?[31mred?.glb: bad"),
    ],
)
def test_an_exception_is_one_line_and_a_code(cli, failing, error, code, words):
    failing(error)
    done = cli("info", "x")
    assert (done.code, done.out) == (code, "")
    assert done.err.startswith("antumbra: ") and words in done.err and done.err.count("\n") == 1


@pytest.mark.parametrize("place", [("--debug", "info", "x"), ("info", "--debug", "x"), ("info", "x", "--debug"), None])
def test_debug_shows_the_traceback(cli, failing, monkeypatch, place):
    failing(ZeroDivisionError("by zero"))
    if place is None:
        monkeypatch.setenv("ANTUMBRA_DEBUG", "1")
        place = ("info", "x")
    with pytest.raises(ZeroDivisionError):
        cli(*place)


def test_debug_can_be_off_and_can_be_a_file(cli, failing, monkeypatch):
    failing(ZeroDivisionError("by zero"))
    monkeypatch.setenv("ANTUMBRA_DEBUG", "0")
    assert cli("info", "x").code == 1
    assert cli("info", "--", "--debug").code == 1


def test_usage_errors_have_a_line_and_a_cure_even_in_debug(cli):
    cli("info").refused("SCENE", "see antumbra info --help")
    cli("--debug", "info").refused("SCENE")
    cli("inof", "x").refused("inof")
    cli("info", "x", "y").refused("y")
    cli("info", "x", "--sped").refused("--sped")


def test_without_arguments_there_is_help(cli):
    done = cli()
    assert done.code == 0 and done.err == ""
    for command in ("render", "info", "scenes", "plans", "warmup"):
        assert command in done.out
        shown = cli(command, "--help")
        assert shown.code == 0 and f"Usage: antumbra {command}" in shown.out and "Examples" in shown.out
    assert cli("-h").out == cli("--help").out == done.out


def test_version(cli):
    assert cli("--version") == (0, f"antumbra {at.__version__}\n", "")


def test_older_typers_abort(cli):
    assert explained(typer.Abort()) == ("interrupted", 130)


def test_the_module_is_the_command():
    done = subprocess.run([*ANTUMBRA, "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"antumbra {at.__version__}\n", "")


def test_streams_and_codes_of_the_process(tmp_path):
    done = subprocess.run([*ANTUMBRA, "render", "--plan"], capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    name = os.fsdecode(b"\xff\xc3\xa9.glb")
    done = subprocess.run([*ANTUMBRA, "info", name], capture_output=True, text=True, cwd=tmp_path, env=env)
    assert (done.returncode, done.stdout) == (2, "") and ".glb" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGPIPE")
@pytest.mark.parametrize("arguments", [["--help"], ["plans", "--json"]])
def test_a_reader_that_left_is_no_error_to_speak_of(arguments):
    with subprocess.Popen([*ANTUMBRA, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_standard_output_that_is_full_or_closed():
    with open("/dev/full", "w") as full:
        done = subprocess.run([*ANTUMBRA, "--version"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert (
        done.returncode == 1
        and done.stderr.startswith("antumbra: the system reports: ")
        and done.stderr.count("\n") == 1
    )
    done = subprocess.run(f'"{sys.executable}" -m antumbra --version >&-', shell=True, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="signals are different on Windows")
def test_control_c(tmp_path):
    # The process sends the signal to itself while it traces rays, so that the test does not depend on its speed.
    script = f"""
import os, signal, sys
from antumbra.cli import main
from antumbra.cli.console import ProgressDisplay
signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored where a shell started this in the background
ProgressDisplay.parts = lambda self, text, count: lambda done, total: os.kill(os.getpid(), {int(signal.SIGINT)})
sys.exit(main(["render", "procedural:atrium?triangles=2000", "--size", "32"]))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 130 and done.stdout == ""
    assert [line for line in done.stderr.splitlines() if "compiling" not in line] == ["antumbra: interrupted"]
    assert os.listdir(tmp_path) == []


def test_with_json_the_error_is_an_object(cli):
    told = cli("info", "no.glb", "--json")
    assert told.code == 2 and json.loads(told.out) == {"error": "no.glb: no such file; check the path"}
    assert told.err == "antumbra: no.glb: no such file; check the path\n"
    assert cli("info", "no.glb").out == ""
