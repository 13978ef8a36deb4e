"""Numbers in the documents that are read from results of measurements.

    python scripts/document_numbers.py
    python scripts/document_numbers.py --check

A number in a Markdown file that comes from a measurement is followed by a comment with its source, the name of a file
of results and an expression:

    `srdh` saves 42 %<!-- srdh: 100 * max(values(saved, "random")) --> of the box tests

The files are docs/papers/results/NAME.json, from ``antumbra bench`` (see `paper_pages.py`), and docs/results/NAME.json,
from the option --json of the scripts in benchmarks/. Expressions are Python, with the fields of the JSON object as
variables, the object itself as `results`, and the functions of `FUNCTIONS`.

Without options, the script writes the present values into the documents, each with as many decimals as its predecessor.
--check lists the numbers that differ, and exits with code 1 if there are any.
"""

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import geometric_mean, median
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
FOLDERS = DOCS / "papers" / "results", DOCS / "results"
"""The folders with results."""

SOURCED = re.compile(
    r"(?P<number>[-+\u2212]?\d[\d,]*(?:\.\d+)?)(?P<unit>[^\d<|\n]{0,20})<!-- (?P<file>[\w-]+): (?P<expression>.+?) -->"
)


def title_of(page: Path) -> str:
    """The title of a page."""
    heading = re.search(r"^# (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert heading is not None, page
    return heading[1]


class Source(NamedTuple):
    """A number in a document, and where it comes from."""

    document: Path
    line: int  # from 1
    text: str  # the number as written
    file: str  # name of the file with the results, without its suffix
    expression: str


def where(table: list[dict[str, Any]], **fields: Any) -> list[dict[str, Any]]:
    """The rows of a table with these values of fields.

    Raises
    ------
    LookupError
        If there are none.
    """
    found = [row for row in table if all(row.get(name) == value for name, value in fields.items())]
    if not found:
        raise LookupError(f"no rows with {fields}")
    return found


def values(table: list[dict[str, Any]], field: str, **fields: Any) -> list[Any]:
    """A field of the rows of a table with these values of other fields."""
    return [row[field] for row in where(table, **fields)]


FUNCTIONS: dict[str, Callable[..., Any]] = {
    each.__name__: each for each in (where, values, geometric_mean, median, len, max, min, sum)
}


def documents() -> list[Path]:
    """The Markdown files that may have numbers with sources."""
    pages = [*ROOT.glob("*.md"), *(path for path in sorted(DOCS.rglob("*.md")) if "_build" not in path.parts)]
    return [path for path in pages if "<!-- " in path.read_text(encoding="utf-8")]


def prose_lines(text: str) -> Iterator[tuple[str, bool]]:
    """The lines of a document with their ends, and whether each is prose rather than in a fenced block of code."""
    fenced = False
    for line in text.splitlines(keepends=True):
        at_fence = line.lstrip().startswith("```")
        yield line, not (fenced or at_fence)
        fenced ^= at_fence


def sources(document: Path) -> Iterator[Source]:
    """The numbers with sources in the prose of a document."""
    for number, (line, is_prose) in enumerate(prose_lines(document.read_text(encoding="utf-8")), 1):
        for match in SOURCED.finditer(line) if is_prose else ():
            yield Source(document, number, match["number"], match["file"], match["expression"])


def results_file(name: str) -> Path | None:
    """The file of results of this name; None if there is none."""
    return next((path for folder in FOLDERS if (path := folder / f"{name}.json").is_file()), None)


def value_of(file: Path, expression: str) -> float:
    """The value of an expression over a file of results.

    Raises
    ------
    Exception
        If the expression does not fit the file.
    """
    results = json.loads(file.read_text(encoding="utf-8"))
    named = {name: value for name, value in results.items() if name.isidentifier()}
    return float(eval(expression, {"__builtins__": {}, **FUNCTIONS, **named, "results": results}))


def written_like(text: str, value: float) -> str:
    """A value with the sign, the separators and the decimals of another number."""
    decimals = len(text.partition(".")[2])
    sign = "+" if text.startswith("+") else ""
    separator = "," if "," in text or abs(value) >= 10_000 else ""
    new = f"{value:{sign}{separator}.{decimals}f}"
    return new.replace("-", "\u2212") if text.startswith("\u2212") else new


def problem(source: Source) -> str | None:
    """What is wrong with a number, in one line; None if it is right."""
    where = f"{source.document.relative_to(ROOT)}:{source.line}: {source.text}"
    file = results_file(source.file)
    if file is None:
        return f"{where}: there is no {source.file}.json in {' or '.join(str(f.relative_to(ROOT)) for f in FOLDERS)}"
    try:
        new = written_like(source.text, value_of(file, source.expression))
    except Exception as error:  # the expression may do anything
        return f"{where}: {source.expression} in {source.file}.json: {error!r}"
    return None if new == source.text else f"{where} is {new} in {source.file}.json; run scripts/document_numbers.py"


def update() -> list[str]:
    """Write the present values into the documents; return the problems that remain."""
    for document in documents():
        text = document.read_text(encoding="utf-8")
        new = "".join(SOURCED.sub(_replaced, line) if is_prose else line for line, is_prose in prose_lines(text))
        if new != text:
            document.write_text(new, encoding="utf-8")
    return check()


def _replaced(match: re.Match[str]) -> str:
    file = results_file(match["file"])
    try:
        number = written_like(match["number"], value_of(file, match["expression"])) if file else match["number"]
    except Exception:  # `check` reports it
        number = match["number"]
    return number + match[0][len(match["number"]) :]


def check() -> list[str]:
    """The problems of all numbers in the documents."""
    found = [problem(source) for document in documents() for source in sources(document)]
    return [each for each in found if each is not None]


if __name__ == "__main__":
    problems = check() if "--check" in sys.argv[1:] else update()
    print("\n".join(problems) or "all numbers are those of the results")
    sys.exit(bool(problems))
