"""Writes the package map in CONTRIBUTING.md from the layers in .importlinter and the packages' docstrings.

    python scripts/layout.py [--check]

--check writes nothing, and exits with code 1 if the map is out of date.
"""

import ast
import configparser
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "CONTRIBUTING.md"
BEGIN, END = "<!-- layout -->\n", "<!-- end of layout -->\n"


def layers() -> list[list[str]]:
    """Packages and modules by layer, from the lowest up. Modules in the same layer do not import each other."""
    contracts = configparser.ConfigParser()
    contracts.read(ROOT / ".importlinter")
    lines = contracts["importlinter:contract:floors"]["layers"].split("\n")
    return [[name.strip() for name in line.split("|")] for line in lines if line.strip()][::-1]


def about(name: str) -> tuple[str, str]:
    """(path, first sentence of the docstring) of a package or module."""
    path = ROOT / "src" / name.replace(".", "/")
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    doc = ast.get_docstring(ast.parse(file.read_text())) or ""
    return name.partition(".")[2].replace(".", "/") + ("/" if path.is_dir() else ".py"), doc.split("\n")[0]


def written() -> str:
    """The map, as Markdown."""
    rows = [about(name) for layer in layers() for name in layer]
    return "".join(f"- `{path}`: {text}\n" for path, text in rows)


def main() -> int:
    page = PAGE.read_text()
    before, _, remainder = page.partition(BEGIN)
    _, _, after = remainder.partition(END)
    updated = before + BEGIN + written() + END + after
    if sys.argv[1:] == ["--check"]:
        return updated != page
    PAGE.write_text(updated)
    return 0


if __name__ == "__main__":
    sys.exit(main())
