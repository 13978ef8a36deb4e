"""Commands and the same work in Python side by side: a shell block directly before a Python block becomes two tabs.

In plain Markdown, they are two blocks in a row. Readers who choose a tab see the same language on all pages.
"""

from itertools import pairwise

from docutils import nodes
from sphinx_design.shared import create_component

SHELL, PYTHON = ("sh", "Command line"), ("python", "Python")
"""The key of a tab, under which the choice is kept, and its label."""

KINDS = {"sh": SHELL, "python": PYTHON, "py": PYTHON}


def kind_of(node):
    """The tab of a block of code; None for other nodes and languages."""
    return KINDS.get(node.get("language")) if isinstance(node, nodes.literal_block) else None


def tab_of(block):
    """A tab with a block of code."""
    key, text = kind_of(block)
    label = nodes.rubric(text, text, classes=["sd-tab-label"], sync_id=key, sync_group="code")
    content = create_component("tab-content", children=[block], classes=["sd-tab-content"])
    return create_component("tab-item", children=[label, content], classes=["sd-tab-item"])


def join_blocks(app, doctree):
    """Replace each shell block and the Python block that follows it by tabs."""
    blocks = list(doctree.findall(nodes.literal_block))
    for first, second in pairwise(blocks):
        follows = first.next_node(descend=False, siblings=True) is second
        if follows and kind_of(first) == SHELL and kind_of(second) == PYTHON:
            first.parent.remove(second)
            tabs = create_component("tab-set", classes=["sd-tab-set"])
            first.replace_self(tabs)
            tabs += [tab_of(first), tab_of(second)]


def setup(app):
    app.connect("doctree-read", join_blocks)
    return {"parallel_read_safe": True}
