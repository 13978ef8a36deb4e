"""Blocks of code side by side, in tabs: a shell block and the Python block directly after it, and adjacent shell blocks
that begin with a comment, which becomes the label of the tab: ``# Clone``.

In plain Markdown, they are blocks in a row. Readers who choose a tab see the same choice on all pages.
"""

import re

from docutils import nodes
from sphinx_design.shared import create_component

SHELL, PYTHON = ("sh", "Command line"), ("python", "Python")
"""The key of a tab, under which the choice is kept, and its label."""

KINDS = {"sh": SHELL, "powershell": SHELL, "python": PYTHON, "py": PYTHON}
_LABEL = re.compile(r"# (.+)\n")


def kind_of(block):
    """The tab of a block of code; None for other languages."""
    return KINDS.get(block.get("language"))


def label_of(block):
    """The comment that begins a shell block; None without one."""
    match = _LABEL.match(block.astext()) if kind_of(block) == SHELL else None
    return match and match[1]


def belongs(block, run):
    """Whether a block is shown beside those before it."""
    if run[-1].next_node(descend=False, siblings=True) is not block:
        return False
    if label_of(block):
        return label_of(run[-1]) is not None
    return len(run) == 1 and not label_of(run[0]) and (kind_of(run[0]), kind_of(block)) == (SHELL, PYTHON)


def tab_of(block):
    """A tab with a block of code, without the comment that is its label."""
    group, (key, text) = "code", kind_of(block)
    if label := label_of(block):
        group, key, text = "ways", label, label
        block.rawsource = block.astext().partition("\n")[2]
        block.children = [nodes.Text(block.rawsource)]
    heading = nodes.rubric(text, text, classes=["sd-tab-label"], sync_id=key, sync_group=group)
    content = create_component("tab-content", children=[block], classes=["sd-tab-content"])
    return create_component("tab-item", children=[heading, content], classes=["sd-tab-item"])


def join_blocks(app, doctree):
    """Replace blocks that belong together by tabs."""
    runs = []
    for block in doctree.findall(nodes.literal_block):
        if runs and belongs(block, runs[-1]):
            runs[-1].append(block)
        else:
            runs.append([block])
    for first, *others in runs:
        if others:
            for block in others:
                first.parent.remove(block)
            tabs = create_component("tab-set", classes=["sd-tab-set"])
            first.replace_self(tabs)
            tabs += map(tab_of, (first, *others))


def setup(app):
    app.connect("doctree-read", join_blocks)
    return {"parallel_read_safe": True}
