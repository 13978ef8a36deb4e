"""``{command-help} render``: what ``antumbra render --help`` prints, so that the page cannot be out of date."""

import os
import subprocess
import sys

from docutils import nodes
from docutils.parsers.rst import Directive


class CommandHelp(Directive):
    """The help text of a command, or of the program itself without an argument."""

    optional_arguments = 2

    def run(self):
        command = [sys.executable, "-m", "antumbra", *self.arguments, "--help"]
        env = {**os.environ, "COLUMNS": "92", "TERMINAL_WIDTH": "92", "NO_COLOR": "1"}
        told = subprocess.run(command, env=env, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        if told.returncode:
            raise self.error(f"{' '.join(command)} failed: {told.stderr}")
        text = "\n".join(line.rstrip() for line in told.stdout.strip("\n").splitlines())
        return [nodes.literal_block(text, text, language="text")]


def setup(app):
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
