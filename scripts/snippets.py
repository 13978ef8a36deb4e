"""Runs the examples in the docs: the README's commands, and the code blocks of any page.

python scripts/snippets.py command README.md pytest   prints the only command line that ends with pytest
python scripts/snippets.py run README.md docs/*.md    runs the Python blocks of each page, in order
python scripts/snippets.py all docs/tutorials/*.md    runs shell blocks (sh) that need no other files, too
python scripts/snippets.py store docs/quickstart.md   also writes what blocks print and draw to the page

A block ```text directly below a block shows what that prints, and the picture images/blocks/NAME.webp below it shows
the NAME.png that it writes. `run` and `all` compare them, except times; `run` and `store` also run the shell blocks
that have them.
"""

import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_PRINTED = re.compile(r"\n\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_PICTURE = re.compile(r"\n\n!\[[^]]*\]\(((?:\.\./)*images/blocks/[^)]+)\)")
_VARIES = re.compile(r"[\d.,]+ (?:ms|s|min|million rays/s)\b|auto: \S+")  # and where lines of times break
_MOST = 640, 420  # pixels of a picture


class Block(NamedTuple):
    """A block of code of a page, and what the page shows directly below it."""

    language: str
    code: str
    line: int  # of the page, before the code
    printed: re.Match[str] | None
    picture: re.Match[str] | None
    output: str = ""  # what it printed when it ran


def page_blocks(text: str) -> Iterator[Block]:
    """The fenced blocks of a page."""
    for match in _BLOCK.finditer(text):
        printed = _PRINTED.match(text, match.end())
        picture = _PICTURE.match(text, printed.end() if printed else match.end())
        yield Block(match[1], match[2], text.count("\n", 0, match.start(2)), printed, picture)


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


def run(paths: list[Path], is_chosen: Callable[[Block], bool], store: bool = False) -> list[str]:
    """Run blocks of each page in their order, in an empty folder; return where pages show other results.

    store : write the results to the page, and to its pictures, instead of comparing them
    """
    faults = list[str]()
    for path in paths:
        text, names = path.read_text(encoding="utf-8"), {"__name__": "__main__"}
        chosen = [block for block in page_blocks(text) if is_chosen(block)]
        if not chosen:
            continue
        print(f"-- {path}", flush=True)
        with empty_folder():
            for block in reversed([_ran(block, path, names) for block in chosen]):  # so that positions stay
                faults += [] if store else _stale(block, path)
                if block.printed:
                    text = f"{text[: block.printed.start(1)]}{block.output}{text[block.printed.end(1) :]}"
                if block.picture and store:
                    keep(Path(Path(block.picture[1]).stem + ".png"), path.parent / block.picture[1])
        if store:
            path.write_text(text, encoding="utf-8")
    return faults[::-1]


def _ran(block: Block, path: Path, names: dict[str, object]) -> Block:
    """A block with what it printed, if the page shows that."""
    output = io.StringIO()
    if block.language == "sh":
        done = run_shell(block.code, Path.cwd(), stdout=subprocess.PIPE if block.printed else None, encoding="utf-8")
        return block._replace(output=done.stdout or "")
    code = compile("\n" * block.line + block.code, str(path), "exec")
    with redirect_stdout(output) if block.printed else nullcontext():
        exec(code, names)
    return block._replace(output=output.getvalue())


def _stale(block: Block, path: Path) -> list[str]:
    """What the page shows below a block that ran, and is not its result."""
    faults = list[str]()
    if block.printed and _lasting(block.printed[1]) != _lasting(block.output):
        faults.append(f"{path}:{block.line}: prints\n{block.output}")
    if block.picture:
        drawn, kept = Path(Path(block.picture[1]).stem + ".png"), path.parent / block.picture[1]
        if not kept.is_file() or not alike(drawn, kept):
            faults.append(f"{path}:{block.line}: draws another picture than {block.picture[1]}")
    return faults


def _lasting(text: str) -> str:
    """What is the same in each run."""
    return _VARIES.sub("...", " ".join(text.split()))


def _small(path: Path) -> Any:
    """A picture as pages show it."""
    from PIL import Image  # here, since commands are also read with a bare Python

    picture = Image.open(path).convert("RGB")
    picture.thumbnail(_MOST, Image.Resampling.LANCZOS)
    return picture


def keep(drawn: Path, target: Path) -> None:
    """Write a picture as WebP."""
    target.parent.mkdir(parents=True, exist_ok=True)
    _small(drawn).save(target, quality=82, method=6)


def alike(first: Path, second: Path) -> bool:
    """Whether two pictures have the same size, and tiles of nearly the same mean colours."""
    import numpy as np

    a, b = _small(first), _small(second)
    tiles = [np.asarray(each.reduce(each.width // 8), np.float64) for each in (a, b)]
    return a.size == b.size and bool(np.abs(tiles[0] - tiles[1]).max() < 8.0)


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


def run_shell(text: str, folder: Path, **options: Any) -> subprocess.CompletedProcess:
    """Run shell commands in a folder, with this process's antumbra and Python."""
    tools = {"antumbra": "-m antumbra ", "python": ""}
    head = "".join(f'{name}() {{ "{sys.executable}" {first}"$@"; }}\n' for name, first in tools.items())
    return subprocess.run(["bash", "-euc", head + text], cwd=folder, check=True, **options)


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
    is_python = lambda block: block.language == "python"
    has_result = lambda block: block.language == "sh" and bool(block.printed or block.picture)
    works_alone = lambda block: block.language == "sh" and is_alone(block.code)
    chosen = {
        "run": lambda block: is_python(block) or has_result(block),
        "store": lambda block: is_python(block) or has_result(block),
        "all": lambda block: is_python(block) or works_alone(block),
    }
    if action == "command":
        print(command(Path(arguments[0]), arguments[1]))
    elif action in chosen:
        faults = run([Path(a).resolve() for a in arguments], chosen[action], store=action == "store")
        if faults:
            raise SystemExit("\n".join([*faults, "scripts/snippets.py store PAGE ... writes these results"]))
    else:
        raise SystemExit(__doc__)


if __name__ == "__main__":
    main(*sys.argv[1:])
