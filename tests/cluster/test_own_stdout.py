"""Standard output holds what the command prints, and nothing of other threads or libraries."""

import subprocess
import sys

SCRIPT = """
import os, sys, threading
from antumbra.cluster.own_stdout import own_stdout
print("before")
with own_stdout():
    print("answer")
    thread = threading.Thread(target=print, args=("of a thread",))
    thread.start()
    thread.join()
    os.write(1, b"of a library\\n")
    os.system("echo of a process")
print("after")
sys.stdout.flush()
os.write(1, b"end\\n")
"""


def test_only_the_command_prints_on_standard_output():
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["before", "answer", "after", "end"]
    assert sorted(done.stderr.splitlines()) == ["of a library", "of a process", "of a thread"]


def test_a_closed_standard_output_stays_closed():
    script = (
        "import os; os.close(1)\nfrom antumbra.cluster.own_stdout import own_stdout\nwith own_stdout():\n    pass\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
