"""Folds the long parts of the papers' pages: how a benchmark was measured, and long tables below their titles."""

import html

from docutils import nodes

LONGEST = 6  # rows of a table that stays open
MEASURED = "how-it-was-measured"


def is_title(node) -> bool:
    """Whether a node is a paragraph in bold, such as the title of a table."""
    shown = [child for child in node.children if child.astext()]  # Markdown has empty texts around it
    return isinstance(node, nodes.paragraph) and [type(child) for child in shown] == [nodes.strong]


def fold(summary: str, content: list[nodes.Node]) -> list[nodes.Node]:
    """Nodes that open with a click on a summary."""
    start = f"<details><summary>{html.escape(summary)}</summary>"
    return [nodes.raw("", start, format="html"), *content, nodes.raw("", "</details>", format="html")]


def fold_tables(section) -> None:
    """Fold the long tables that directly follow their titles."""
    children = []
    for node in section.children:
        is_long = isinstance(node, nodes.table) and sum(1 for _ in node.findall(nodes.row)) > LONGEST
        if is_long and children and is_title(children[-1]):
            children += fold(children.pop().astext(), [node])
        else:
            children.append(node)
    section.children = []
    section += children


def fold_page(app, doctree):
    """Fold the parts of a paper's page."""
    if not app.env.docname.startswith("papers/"):
        return
    for section in list(doctree.findall(nodes.section)):
        if MEASURED in section["ids"]:
            title, *content = section.children
            section.children = []
            section += [title, *fold("Command, machine, dates and load", content)]
        else:
            fold_tables(section)


def setup(app):
    app.connect("doctree-read", fold_page)
    return {"parallel_read_safe": True}
