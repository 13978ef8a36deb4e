"""``{raised}`` with lines "CODE | cure": the error that each call raises, so that no message is out of date."""

import registries
from docutils.parsers.rst import Directive

LONGEST = 150  # characters of a message


def message(code: str) -> str:
    """The message of the `InputError` that an expression of ``at``, ``np`` and ``scene`` raises, shortened.

    Raises
    ------
    ValueError
        If it raises no InputError.
    """
    import numpy as np

    import antumbra as at

    try:
        eval(code, {"at": at, "np": np, "scene": at.procedural("atrium", triangles=2_000)})
    except at.InputError as error:
        text = str(error)
        return text if len(text) <= LONGEST else text[:LONGEST].rpartition(" ")[0] + " ..."
    raise ValueError(f"{code} raises no InputError")


def rows_of(lines: list[str]) -> list[list[str]]:
    """A row of message and cure for each line with text."""
    parts = [line.rpartition(" | ") for line in lines if line.strip()]
    return [[f"`{code.strip()}`", message(code.strip()), cure.strip()] for code, _, cure in parts]


class Raised(Directive):
    """A table of calls, their errors and their cures."""

    has_content = True

    def run(self):
        return [registries.table(["call", "error", "fix"], rows_of(list(self.content)))]


def setup(app):
    app.add_directive("raised", Raised)
    return {"parallel_read_safe": True}
