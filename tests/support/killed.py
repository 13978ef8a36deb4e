"""Runs the command line in a process that kills itself while it writes a picture."""

import signal
import subprocess
import sys
from pathlib import Path

_SCRIPT = """
import os, signal, sys
from antumbra.cli import main
from antumbra.picture import image_files as save

write, seen = save.{writer}, 0

def killed(*arguments):
    # The process sends the signal to itself, so that nothing depends on how fast it is.
    global seen
    write(*arguments)
    seen += 1
    if seen == 2:
        os.kill(os.getpid(), signal.SIGKILL)

save.{writer} = killed
sys.exit(main(sys.argv[1:]))
"""


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """The command line in its own process, in a folder."""
    return _python(folder, "-m", "antumbra", *arguments)


def run_killed(folder: Path, writer: str, *arguments: str) -> None:
    """As `run`, but killed when `writer` of `picture.image_files` has written its second temporary file."""
    assert _python(folder, "-c", _SCRIPT.format(writer=writer), *arguments).returncode == -signal.SIGKILL


def _python(folder: Path, *words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, cwd=folder)
