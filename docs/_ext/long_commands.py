r"""Long commands continue on further lines, broken by " \" before options: whole on the page, and in a shell."""

import re

from docutils import nodes

WIDEST = 86  # characters of a line of code beside both sidebars

_OPTION = re.compile(r""" (?=--?[a-z])(?=(?:[^"']|"[^"]*"|'[^']*')*$)""")  # the space before one outside quotes


def broken(line: str) -> str:
    """A command in lines of at most `WIDEST` characters, where its options allow; comments keep theirs whole."""
    if len(line) <= WIDEST or "#" in line:
        return line
    first, *options = _OPTION.split(line)
    lines = [first]
    for option in options:
        if len(lines[-1]) + len(option) + 3 > WIDEST:
            lines.append(f"    {option}")
        else:
            lines[-1] += f" {option}"
    return " \\\n".join(lines)


def break_commands(app, doctree):
    """Break the long lines of shell blocks."""
    for block in doctree.findall(nodes.literal_block):
        if block.get("language") in ("sh", "bash"):
            text = "\n".join(map(broken, block.astext().split("\n")))
            block.rawsource = text
            block.children = [nodes.Text(text)]


def setup(app):
    app.connect("doctree-read", break_commands)
    return {"parallel_read_safe": True}
