"""Runs the examples in the docs: the README's commands, and the code blocks of any page.

python scripts/snippets.py command README.md pytest   prints the only command line that ends with pytest
python scripts/snippets.py run README.md docs/*.md    runs the Python blocks of each page, as one program
python scripts/snippets.py all docs/tutorials/*.md    runs shell blocks (sh) that need no other files, too, in order
"""

import os
import re
import shlex
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of a language."""
    return [match[2] for match in _BLOCK.finditer(text) if match[1] == language]


def command(path: Path, ending: str) -> str:
    """The only line in the shell blocks of a page that ends with `ending`."""
    lines = [line for block in blocks(path.read_text(), "sh") for line in block.splitlines()]
    matches = [line for line in lines if line.endswith(ending)]
    if len(matches) != 1:
        raise SystemExit(f"{path}: {len(matches)} commands end with {ending!r}, not one")
    return matches[0]


def program(text: str) -> str:
    """The Python blocks of a page at their original lines, so that tracebacks have the right line numbers."""
    lines = []
    position = 0
    for match in _BLOCK.finditer(text):
        if match[1] == "python":
            lines.append("\n" * text.count("\n", position, match.start(2)) + match[2])
            position = match.end(2)
    return "".join(lines)


def run(paths: list[Path]) -> None:
    """Run each page in an empty folder."""
    for path in paths:
        source = program(path.read_text())
        if source.strip():
            print(f"-- {path}", flush=True)
            code = compile(source, str(path), "exec")
            with empty_folder():
                exec(code, {"__name__": "__main__"})


def run_all(paths: list[Path]) -> None:
    """Run the Python and shell blocks of each page in their order, in an empty folder."""
    for path in paths:
        print(f"-- {path}", flush=True)
        text, names = path.read_text(), {"__name__": "__main__"}
        with empty_folder():
            for match in _BLOCK.finditer(text):
                if match[1] == "python":
                    source = "\n" * text.count("\n", 0, match.start(2)) + match[2]
                    exec(compile(source, str(path), "exec"), names)
                elif match[1] == "sh" and is_alone(match[2]):
                    run_shell(match[2], Path.cwd())


def is_alone(text: str) -> bool:
    """Whether shell commands need no file of the reader: their scenes come with the package, or exist by then."""
    made = set[str]()
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words[:1] != ["antumbra"] or words[1] == "view":
            return False
        scene = next((word for word in words[2:] if not word.startswith("-")), "")
        in_package = words[1] == "scenes" or scene.startswith(("procedural:", "example:"))
        if not (in_package or scene in made or Path(scene).exists()):
            return False
        made |= {after for word, after in pairwise(words) if word in ("-o", "--output")}
    return True


def run_shell(text: str, folder: Path, **options) -> None:
    """Run shell commands in a folder, with this process's antumbra and Python."""
    tools = {"antumbra": "-m antumbra ", "python": ""}
    head = "".join(f'{name}() {{ "{sys.executable}" {first}"$@"; }}\n' for name, first in tools.items())
    subprocess.run(["bash", "-euc", head + text], cwd=folder, check=True, **options)


@contextmanager
def empty_folder():
    """A new, empty current folder."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            yield Path(folder)
        finally:
            os.chdir(before)


def main(action: str, *arguments: str) -> None:
    if action == "command":
        print(command(Path(arguments[0]), arguments[1]))
    elif action == "run":
        run([Path(a).resolve() for a in arguments])
    elif action == "all":
        run_all([Path(a).resolve() for a in arguments])
    else:
        raise SystemExit(__doc__)


if __name__ == "__main__":
    main(*sys.argv[1:])
