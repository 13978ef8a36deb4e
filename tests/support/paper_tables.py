"""The text of the papers in the folder $ANTUMBRA_PAPERS, and the tables in it."""

import os
import re
from pathlib import Path

import pytest

_UNITS = {"K": 1e3, "M": 1e6, "G": 1e9}
_NUMBER = re.compile(r"([-−]?\d[\d,]*(?:\.\d+)?)([KMG](?!B))?")


def paper_text(name: str) -> str:
    """The text of a paper; skips the test without the folder of papers."""
    folder = os.environ.get("ANTUMBRA_PAPERS")
    if not folder:
        pytest.skip(
            "published figures are NOT compared with the papers: set ANTUMBRA_PAPERS to the folder with their text"
        )
    return (Path(folder) / f"{name}.md").read_text(encoding="utf-8")


def section_of(text: str, start: str, end: str) -> str:
    """The part of a text from the first `start` up to the next `end`."""
    first = text.index(start)
    return text[first : text.index(end, first + len(start))]


def rows_of(text: str) -> list[list[str]]:
    """The cells of all table rows in a text, whether tabs or bars separate them; without formatting."""
    lines = [line for line in text.splitlines() if "\t" in line or line.startswith("|")]
    split = [line.strip("|").split("|") if line.startswith("|") else line.split("\t") for line in lines]
    return [[_plain(cell) for cell in row] for row in split]


def _plain(cell: str) -> str:
    return re.sub(r"<[^>]+>|\\|\$", "", cell).strip()


def numbers_in(text: str) -> list[float]:
    """All numbers in a text. K, M and G are factors; MB and GB are not."""
    plain = ((match[1].replace(",", "").replace("−", "-"), match[2]) for match in _NUMBER.finditer(text))
    return [float(number) * _UNITS.get(unit, 1.0) for number, unit in plain]


def number_in(text: str) -> float:
    """The first number in a text."""
    return numbers_in(text)[0]
