"""``{paper-code} FOLDER``: which code implements which section of a paper, from its README.md in lab/papers/.

Names of code become links to their lines in the repository, in the revision of the package's version.
"""

import ast
import re
from functools import cache
from pathlib import Path

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
PAPERS = ROOT / "src" / "antumbra" / "lab" / "papers"
SOURCE = "https://github.com/antumbra/antumbra/blob/main"
OUTSIDE = "benchmarks", "tests", "docs", "scripts"
"""Folders at the root of the repository; all other paths are relative to src/antumbra."""
_CODE = re.compile(r"`([\w/-]+\.(?:py|md|toml))(?:: ([\w., ]+))?`")
_LINK = re.compile(r"\]\((?:\.\./)+docs/(\S+?)\)")


@cache
def lines_of(path: Path) -> dict[str, tuple[int, int]]:
    """First and last line of each function, class, method and global name of a module."""
    found: dict[str, tuple[int, int]] = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        span = node.lineno, node.end_lineno or node.lineno
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name] = span
            for member in node.body if isinstance(node, ast.ClassDef) else ():
                place = getattr(member, "target", None) or getattr(member, "targets", [None])[0]
                name = getattr(member, "name", None) or getattr(place, "id", None)
                if name is not None:
                    found[f"{node.name}.{name}"] = member.lineno, member.end_lineno or member.lineno
        else:
            names = (each for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store))
            found.update({each.id: span for each in names})
    return found


def link(file: str, name: str = "") -> str:
    """A Markdown link to a name in a file, or to the file."""
    place = file if file.partition("/")[0] in OUTSIDE or "/" not in file else f"src/antumbra/{file}"
    if not name:
        return f"[`{file}`]({SOURCE}/{place})"
    first, last = lines_of(ROOT / place).get(name, (0, 0))
    return f"[`{name}`]({SOURCE}/{place}" + (f"#L{first}-L{last})" if first else ")")


def linked(text: str) -> str:
    """A text in which code such as `trace/tile.py: move_light, coherent_part` links to its lines."""

    def links(match: re.Match[str]) -> str:
        file, names = match.groups()
        return ", ".join(link(file, name) for name in names.split(", ")) if names else link(file)

    return _CODE.sub(links, text)


def sections(folder: str) -> str:
    """The sections of a paper's README, as Markdown for a page in docs/papers/: its headings become lines in bold."""
    text = (PAPERS / folder / "README.md").read_text(encoding="utf-8")
    text = text[text.index("\n## ") + 1 :]
    text = re.sub(r"^#+ (.*)$", r"**\1**", text, flags=re.MULTILINE)
    return linked(_LINK.sub(r"](../\1)", text))


class PaperCode(SphinxDirective):
    """The sections of a paper beside the code, folded."""

    required_arguments = 1

    def run(self):
        (folder,) = self.arguments
        self.env.note_dependency(str(PAPERS / folder / "README.md"))
        body = nodes.container()
        self.state.nested_parse(StringList(sections(folder).splitlines(), source=folder), 0, body)
        start = "<details><summary>Each section of the paper, its code, and how they differ</summary>"
        html = (nodes.raw("", each, format="html") for each in (start, "</details>"))
        return [next(html), *body.children, next(html)]


def setup(app):
    app.add_directive("paper-code", PaperCode)
    return {"parallel_read_safe": True}
