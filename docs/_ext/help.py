"""``{command-help} render``: what ``antumbra render --help`` prints, so that the page cannot be out of date.

Each option has an anchor and a link to itself, such as cli/render.html#spp.
"""

import os
import re
import subprocess
import sys
from functools import cache

from docutils import nodes
from docutils.parsers.rst import Directive

_OPTION = re.compile(r"(?<=\n  )(?:-\w, )?--([\w-]+)")


@cache
def help_text(*command: str) -> str:
    """What ``antumbra COMMAND --help`` prints."""
    words = [sys.executable, "-m", "antumbra", *command, "--help"]
    env = {**os.environ, "COLUMNS": "92", "TERMINAL_WIDTH": "92", "NO_COLOR": "1"}
    done = subprocess.run(words, env=env, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        raise ValueError(f"{' '.join(words)} failed: {done.stderr}")
    return "\n".join(line.rstrip() for line in done.stdout.strip("\n").splitlines())


class CommandHelp(Directive):
    """The help text of a command, or of the program itself without an argument."""

    optional_arguments = 2

    def run(self):
        try:
            text = help_text(*self.arguments)
        except ValueError as error:
            raise self.error(str(error)) from None
        return [nodes.literal_block("", "", *_linked(text), classes=["command-help"])]


def _linked(text: str) -> list[nodes.Node]:
    """A text whose options link to themselves."""
    parts, end = list[nodes.Node](), 0
    for match in _OPTION.finditer(text):
        parts.append(nodes.Text(text[end : match.start()]))
        parts.append(nodes.reference("", match[0], refuri=f"#{match[1]}", ids=[match[1]]))
        end = match.end()
    return [*parts, nodes.Text(text[end:])]


def setup(app):
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
