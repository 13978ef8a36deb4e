"""Keeps what a command prints as Markdown."""

import io
from collections.abc import Iterable, Sequence
from typing import TextIO

_ESCAPED = str.maketrans({c: f"\\{c}" for c in "\\|*<>`[]"})


class Record(io.TextIOBase):
    """A stream for standard output that also keeps what is printed, as Markdown.

    `report` gives it tables and fields. A line just before a table becomes the table's caption.

    shown : the stream on which all text appears; None: nowhere
    """

    def __init__(self, shown: TextIO | None):
        self.shown = shown
        self._blocks: list[str] = []
        self._text = ""  # printed since the last block

    def write(self, text: str) -> int:
        self._text += text
        if self.shown is not None:
            self.shown.write(text)
        return len(text)

    def flush(self) -> None:
        if self.shown is not None:
            self.shown.flush()

    def isatty(self) -> bool:
        return self.shown is not None and self.shown.isatty()

    def keep_table(self, headers: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[int] = ()) -> None:
        """Keep a table. Columns in `right` hold numbers."""
        self._end_text(caption=True)
        marks = ["---:" if i in right else "---" for i in range(len(headers))]
        lines = [[escaped(h) for h in headers], marks, *([escaped(cell) for cell in row] for row in rows)]
        self._blocks.append("\n".join(f"| {' | '.join(line)} |" for line in lines))

    def keep_fields(self, rows: Iterable[tuple[str, str]]) -> None:
        """Keep names and values as a list."""
        self._end_text()
        self._blocks.append("\n".join(f"- **{escaped(name)}**: {escaped(value)}" for name, value in rows))

    def markdown(self) -> str:
        """All that was kept."""
        self._end_text()
        return "\n\n".join(self._blocks) + "\n"

    def _end_text(self, caption: bool = False) -> None:
        lines = [escaped(line.strip()) for line in self._text.splitlines() if line.strip()]
        self._text = ""
        if caption and lines:
            lines[-1] = f"**{lines[-1]}**"
        self._blocks += lines


def escaped(text: str) -> str:
    """Text for a line of Markdown in which no character has a meaning."""
    return " ".join(text.translate(_ESCAPED).split())
