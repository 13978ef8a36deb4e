"""Numbers in the documents are those of the results that they name."""

import json
import re

import pytest

from repository import ROOT, tool

numbers = tool(ROOT / "scripts" / "document_numbers.py")

RESULTS = {
    "saved": [
        {"scene": "a", "method": "srdh", "share": 0.424},
        {"scene": "b", "method": "srdh", "share": 0.31},
        {"scene": "a", "method": "bsah", "share": 0.0},
    ],
    "two words": -1234.5,
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A repository with one file of results; returns a function that writes its document."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "x.json").write_text(json.dumps(RESULTS))
    monkeypatch.setattr(numbers, "ROOT", tmp_path)
    monkeypatch.setattr(numbers, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(numbers, "FOLDERS", (tmp_path / "docs",))

    def write(text):
        (tmp_path / "docs" / "page.md").write_text(text)
        return tmp_path / "docs" / "page.md"

    return write


def test_numbers_are_compared_as_written(folder):
    share = 'share = 100 * max(values(saved, "share", method="srdh"))'.partition("= ")[2]
    folder(f"42 %<!-- x: {share} -->, 42.4 %<!-- x: {share} --> and -1,234.5<!-- x: results['two words'] -->.")
    assert numbers.check() == []
    folder(f"from 1 to 43 %<!-- x: {share} -->\n\n2 <!-- x: len(where(saved, method='srdh')) --> scenes")
    (found,) = numbers.check()
    assert found == "docs/page.md:1: 43 is 42 in x.json; run scripts/document_numbers.py"


def test_problems_are_one_line_each(folder):
    folder("1<!-- y: a --> 2<!-- x: nothing --> 3<!-- x: values(saved, 'share', scene='c')[0] -->")
    found = numbers.check()
    assert len(found) == 3 and not [text for text in found if "\n" in text]
    assert "there is no y.json" in found[0] and "nothing" in found[1] and "no rows" in found[2]


def test_update_writes_the_present_values(folder):
    path = folder("From 5<!-- x: 1e6 --> to \u22121.00 s<!-- x: results['two words'] --> and 7<!-- y: a -->.")
    assert len(numbers.update()) == 1  # y.json is missing
    text = path.read_text()
    assert re.findall(r"[\d.,\u2212]+(?=[ s]*<)", text) == ["1,000,000", "\u22121234.50", "7"]
    assert len(numbers.update()) == 1 and path.read_text() == text


@pytest.mark.parametrize("document", numbers.documents(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_numbers_are_those_of_their_results(document):
    found = list(numbers.sources(document))
    missing = {source.file for source in found if numbers.results_file(source.file) is None}
    assert [problem for source in found if source.file not in missing and (problem := numbers.problem(source))] == []
    if missing:
        pytest.skip(
            f"numbers are NOT checked: {', '.join(sorted(missing))} have no results; run scripts/paper_pages.py"
        )


def test_every_source_can_be_read():
    """A comment that looks like a source but is not one, for example with no number before it, is an error."""
    for document in numbers.documents():
        lines = (line for line, is_prose in numbers.prose_lines(document.read_text(encoding="utf-8")) if is_prose)
        comments = [comment for line in lines for comment in re.findall(r"<!-- [\w-]+: .+? -->", line)]
        assert len(comments) == len(list(numbers.sources(document))), document


def test_code_has_no_numbers_to_check(folder):
    path = folder("```\n43<!-- x: 42 -->\n```\n43<!-- x: 42 -->\n")
    assert [problem.partition(":")[2][:2] for problem in numbers.check()] == ["4:"]
    assert numbers.update() == [] and path.read_text() == "```\n43<!-- x: 42 -->\n```\n42<!-- x: 42 -->\n"
