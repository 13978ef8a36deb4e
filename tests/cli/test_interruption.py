"""Signals end every command with one line and the conventional exit code, and leave nothing half written."""

import os
import signal
import subprocess
import sys

import pytest

from antumbra.base.command_registry import COMMANDS
from antumbra.cli import interruption, scene_commands
from antumbra.kernels.toolchain import compile_pool
from cli.test_app_keywords import ARGUMENTS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals are different on Windows")

LINES = {signal.SIGINT: "interrupted", signal.SIGTERM: "ended by SIGTERM", signal.SIGHUP: "ended by SIGHUP"}
SIGNALS = list(LINES)
SCENE = "procedural:atrium?triangles=1000"
WORDS = {name: [name, SCENE, *ARGUMENTS.get(name, [])] for name in COMMANDS}
WORDS |= {name: [name] for name in ("formats", "plans", "doctor", "warmup")}
WORDS |= {"scenes": ["scenes", "city", "-o", "a.ply"], "merge": ["merge", "a.shards"]}

AT_IMPORT = """
import os, sys
module, kind = sys.argv[1], int(sys.argv[2])
del sys.argv[1:3]
class Hook:
    def find_spec(self, name, path, target=None):
        if name == module:
            os.kill(os.getpid(), kind)
sys.meta_path.insert(0, Hook())
from antumbra.cli import main
sys.exit(main())
"""


def run(script, folder, *words, **more):
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, words)], capture_output=True, text=True, cwd=folder, **more
    )


@pytest.mark.parametrize("name", [*COMMANDS, "bench"])
def test_while_a_command_is_imported(name, tmp_path):
    kind = SIGNALS[len(name) % len(SIGNALS)]
    module = COMMANDS[name].module if name in COMMANDS else "antumbra.lab.bench_command"
    done = run(AT_IMPORT, tmp_path, module, int(kind), name, "--help")
    assert (done.returncode, done.stdout, done.stderr) == (128 + kind, "", f"antumbra: {LINES[kind]}\n")


@pytest.mark.parametrize("kind", SIGNALS)
@pytest.mark.parametrize("module", ["antumbra.cli.app", "typer", "antumbra.base.errors", "numpy"])
def test_while_other_modules_are_imported(module, kind, tmp_path):
    done = run(AT_IMPORT, tmp_path, module, int(kind), "render", "a.glb")
    assert (done.returncode, done.stdout, done.stderr) == (128 + kind, "", f"antumbra: {LINES[kind]}\n")


@pytest.fixture
def caught(monkeypatch):
    """Handles signals as the process of a command does, and forgets them afterwards."""
    before = {kind: signal.getsignal(kind) for kind in SIGNALS}
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    for kind in SIGNALS:
        signal.signal(kind, signal.SIG_DFL)  # SIGHUP is ignored under nohup
    signal.signal(signal.SIGINT, signal.default_int_handler)  # it is ignored in the background of a shell
    interruption.catch_signals()
    yield
    for kind, handler in before.items():
        signal.signal(kind, handler)
    interruption.set_working(False)
    interruption._state.received.clear()


def signal_after(calls, kind):
    """Sends a signal to this process once a command has made that many calls."""
    left = calls

    def count(frame, event, _):
        nonlocal left
        if event == "call" and interruption._state.is_working:
            left -= 1
            if left == 0:
                sys.setprofile(None)
                os.kill(os.getpid(), kind)

    sys.setprofile(count)


@pytest.mark.parametrize("calls", [60, 600])
@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "view"])
def test_while_a_command_works(name, calls, cli, caught, tmp_path):
    kind = SIGNALS[(len(name) + calls // 60) % len(SIGNALS)]
    interruption.set_working(False)
    signal_after(calls, kind)
    try:
        done = cli(*WORDS[name])
    finally:
        sys.setprofile(None)
    if not interruption._state.received:
        assert calls > 60 and name in ("merge", "formats"), "the command made fewer calls"
        return
    lines = [line for line in done.err.splitlines() if "note:" not in line and "..." not in line]
    assert (done.code, lines) == (128 + kind, [f"antumbra: {LINES[kind]}"]), done
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_an_error_made_of_the_interruption_is_not_a_bug(cli, caught, monkeypatch):
    def load(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("numpy._core failed to import") from None

    monkeypatch.setattr(scene_commands, "open_scene", load)
    assert cli("info", SCENE, "--debug") == (143, "", "antumbra: ended by SIGTERM\n")


TWICE = """
import os, signal, sys
from antumbra.cli import main, scene_commands
from antumbra.base.files import atomic_output

def half(*_, **__):
    with atomic_output("a.ply") as temporary:
        temporary.write_text("half")
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        finally:
            for _ in range(MORE):
                os.kill(os.getpid(), signal.SIGINT)

scene_commands.open_scene = half
sys.argv[1:] = ["info", "a.glb"]
sys.exit(main())
"""


@pytest.mark.parametrize("more, left", [(0, False), (1, False), (2, True)])
def test_a_second_signal_does_not_disturb_the_tidying_up_and_a_third_one_ends_it(more, left, tmp_path):
    done = run(TWICE.replace("MORE", str(more)), tmp_path)
    assert (done.returncode, done.stderr) == (143, "antumbra: ended by SIGTERM\n")
    assert bool(os.listdir(tmp_path)) == left


LOST = """
import os, signal, sys, time
from antumbra.cli import interruption
signal.signal(signal.SIGINT, signal.default_int_handler)
interruption.catch_signals()
interruption.set_working(True)

class Thing:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100):
            pass

try:
    thing = Thing()
    del thing
    time.sleep(20)
except KeyboardInterrupt:
    print(interruption.interruption())
"""


def test_a_signal_that_a_destructor_swallows_is_repeated(tmp_path):
    done = run(LOST, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "('interrupted', 130)\n", "")


def test_signals_that_are_ignored_stay_ignored(tmp_path):
    """As for a command behind nohup."""
    script = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n" + AT_IMPORT
    done = run(script, tmp_path, "typer", int(signal.SIGHUP), "formats", "--json")
    assert done.returncode == 0 and done.stdout and done.stderr == ""


READERS = """
import os, sys
from antumbra.cli import main
from antumbra.base.command_registry import COMMANDS
for name in [*COMMANDS, "bench"]:
    reading, writing = os.pipe()
    os.close(reading)
    os.dup2(writing, 1)
    os.close(writing)
    sys.stdout = os.fdopen(os.dup(1), "w")
    print(name, main([name, "--help"]), file=sys.stderr)
os._exit(0)
"""


def test_a_reader_that_left_ends_every_command_without_a_word(tmp_path):
    done = run(READERS, tmp_path)
    assert done.stderr.splitlines() == [f"{name} 141" for name in [*COMMANDS, "bench"]]


def test_another_pipe_that_breaks_is_an_error(cli, monkeypatch):
    def load(*_, **__):
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr(scene_commands, "open_scene", load)
    assert cli("info", SCENE) == (1, "", "antumbra: the system reports: [Errno 32] Broken pipe\n")


def test_compiling_processes_end_with_the_command(caught, monkeypatch):
    started, begin = [], subprocess.Popen

    def popen(*words, **more):
        started.append(begin(*words, **more))
        return started[-1]

    monkeypatch.setattr(compile_pool.subprocess, "Popen", popen)
    monkeypatch.setattr(compile_pool, "_wait", lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    interruption.set_working(True)
    with pytest.raises(KeyboardInterrupt):
        compile_pool.compile_kernels([compile_pool.KernelRequest("none:a", key) for key in "ab"], processes=2)
    assert [process.poll() for process in started] == [-signal.SIGKILL] * 2
