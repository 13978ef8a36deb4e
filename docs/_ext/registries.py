"""Tables of the program's registries: ``{scene-formats}``, and ``{methods}`` of plans, from ``antumbra ... --json``."""

import json
import subprocess
import sys

from docutils import nodes
from docutils.parsers.rst import Directive


def listed(command: str) -> dict:
    """What ``antumbra COMMAND --json`` prints."""
    done = subprocess.run(
        [sys.executable, "-m", "antumbra", command, "--json"], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def format_rows() -> list[list[str]]:
    """A row for each format of scenes; its extra and its suffixes are code."""
    return [
        [
            each["name"],
            " ".join(f"`{suffix}`" for suffix in each["suffixes"]),
            "read, write" if each["writes"] else "read",
            f"`{each['extra']}`" if each["extra"] else "",
            each["lost"],
        ]
        for each in listed("formats")["formats"]
    ]


def method_rows() -> list[list[str]]:
    """A row for each method of plans."""
    rows = []
    for each in listed("plans")["methods"]:
        paper = each["paper"].partition(", ")[0]
        rows.append([f"`{each['name']}`", each["kind"], each["description"], paper])
    return rows


def table(columns: list[str], rows: list[list[str]]) -> nodes.table:
    """A table; words in backticks are code."""
    group = nodes.tgroup(cols=len(columns))
    group += [nodes.colspec(colwidth=1) for _ in columns]
    group += nodes.thead("", _row(columns))
    group += nodes.tbody("", *map(_row, rows))
    return nodes.table("", group)


def _row(cells: list[str]) -> nodes.row:
    return nodes.row("", *(nodes.entry("", nodes.paragraph("", "", *_inline(cell))) for cell in cells))


def _inline(text: str) -> list[nodes.Node]:
    return [nodes.literal(part, part) if k % 2 else nodes.Text(part) for k, part in enumerate(text.split("`")) if part]


class SceneFormats(Directive):
    """The formats of scenes, and what is lost in them."""

    def run(self):
        return [table(["format", "suffixes", "use", "extra", "what is lost"], format_rows())]


class Methods(Directive):
    """The methods that plans name."""

    def run(self):
        return [table(["name", "kind", "what it does", "paper"], method_rows())]


def setup(app):
    app.add_directive("scene-formats", SceneFormats)
    app.add_directive("methods", Methods)
    return {"parallel_read_safe": True}
