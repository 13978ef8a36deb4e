"""The pages of the papers: which results make a page, its form, and its results beside it."""

import json
import re
import sys

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.kernels.jit import recorded_calls
from antumbra.lab.bench_conditions import kernel_digests
from repository import ROOT, tool

sys.path.append(str(ROOT / "scripts"))  # paper_pages imports document_numbers
pages = tool(ROOT / "scripts" / "paper_pages.py")
claims = tool(ROOT / "scripts" / "paper_claims.py")
spread = sys.modules["claims.claim"].spread
diagrams = tool(ROOT / "scripts" / "paper_diagrams.py")

KERNELS = {"antumbra.bvh.nodes:no_such_kernel": {"i": "0" * 32}}
PYTHON = f"{sys.version_info[0]}.{sys.version_info[1]}.0"


def table_of(rounds=(3, 3), command="antumbra bench srdh", load=(0.5, 2.0)):
    dates = ["2026-01-01 10:00 UTC", "2026-01-01 11:00 UTC"]
    measured = {"parts": 4, "commands": [command], "commits": ["0123"], "dates": dates, "seconds": 240.0}
    return {**measured, "load": list(load), "rounds": list(rounds)}


def results_of(quick=False, rounds=3, kernels=None, python=PYTHON, **more):
    about = {"command": "antumbra bench srdh", "quick": quick, "python": python, "commit": "0123", "processor": "a Zen"}
    return {"about": about, "rounds": rounds, "kernels": kernels or {}, **more}


@pytest.fixture
def present():
    """The digests of the kernels of a builder, as they are now."""
    with recorded_calls() as calls:
        binned_sah.build(np.random.default_rng(0).normal(size=(40, 3, 3)).astype(np.float32), 1)
    return kernel_digests(calls)


@pytest.mark.parametrize(
    "results, words",
    [
        (results_of(quick=True), "measured with --quick"),
        ({"about": {"command": "antumbra bench srdh --quick"}}, "measured with --quick"),  # before results recorded it
        (results_of(rounds=2), "only 2 rounds"),
        (results_of(tables={"renders": table_of(rounds=[1, 2])}), "only 2 rounds of table renders were measured"),
        (results_of(rounds=None, frames=1), "only 1 frames"),
        (results_of(), "do not record the kernels"),
        (results_of(python="3.8.1", kernels=KERNELS), "Python 3.8"),
        (results_of(kernels=KERNELS), "older than 1 of its kernels, such as antumbra.bvh.nodes:no_such_kernel"),
    ],
)
def test_results_that_make_no_page(results, words):
    reason = pages.objection("srdh", results)
    assert words in reason and reason.startswith("srdh: ") and "\n" not in reason


def test_whole_results_of_present_kernels_make_a_page(present):
    assert pages.objection("srdh", results_of(kernels=present)) is None
    assert pages.objection("chc-rt", results_of(rounds=None, frames=60, kernels=present)) is None


def test_a_page_is_written_from_results(present, tmp_path, monkeypatch):
    spread = {"timings": 1234, "median": 0.031, "ninth_decile": 0.12}
    results = results_of(kernels=present, size=[1024, 768], spread=spread)
    (tmp_path / "srdh.json").write_text(json.dumps(results))
    (tmp_path / "srdh.md").write_text("# antumbra bench srdh\n\n- **command**: c\n\n**T**\n\n| a |\n")
    for name in ("srdh", "srdh-comparison", "srdh-trees"):
        (tmp_path / f"{name}.png").write_bytes(b"")
    place = tmp_path / "papers"
    monkeypatch.setattr(pages, "PAGES", place)
    monkeypatch.setattr(pages, "RESULTS", place / "results")
    assert pages.make_page("srdh", tmp_path) is None
    text = (place / "srdh.md").read_text()
    assert text.startswith(pages.front("srdh")) and text.endswith("```\n\n**T**\n\n| a |\n")
    for line in (
        "- **command**: antumbra bench srdh",
        "- **size**: 1024 x 768",
        "- **rounds**: 3",
        "- **spread**: the rounds differ by 3 % (median of 1,234 timings), and by less than 12 % for nine out of ten",
        "- **commit**: 0123",
        "- **processor**: a Zen",
    ):
        assert f"\n{line}\n" in text, line
    assert re.findall(r"\{image\} (.+)", text) == ["srdh-comparison.png", "srdh.png", "srdh-trees.png"]
    assert json.loads((place / "results" / "srdh.json").read_text()) == results
    (place / "srdh-old.png").write_bytes(b"")
    pages.remove_unused_pictures()
    assert {path.name for path in place.glob("*.png")} == {"srdh-comparison.png", "srdh.png", "srdh-trees.png"}
    assert pages.make_page("chc-rt", tmp_path) == f"chc-rt: no results in {tmp_path}"


@pytest.mark.parametrize("name", pages.PAPERS)
def test_pages_explain_the_paper_with_a_diagram(name):
    idea = (pages.PAGES / "ideas" / f"{name}.md").read_text(encoding="utf-8")
    first, second, *more = re.findall(r"^## (.+)$", idea, re.MULTILINE)
    assert (first, second) == ("The idea", "What changed, and why")
    assert more in ([], ["What was tried and left out"])
    assert re.findall(r"!\[.{40,}\]\((.+)\)", idea) == [f"../{name}.svg"] and idea.count("\n- **") >= 4


def test_diagrams_are_those_of_the_script():
    assert set(diagrams.DIAGRAMS) == set(pages.PAPERS) and diagrams.differing() == [], "run scripts/paper_diagrams.py"


def test_diagrams_show_what_they_say():
    low, high = [(0.0, 0.0), (0.0, 0.0)], [(200.0, 0.0), (300.0, 0.0)]
    assert diagrams.meets_node(low, high, 0.0) and not diagrams.meets_node(low, high, 360.0)
    assert diagrams.visits(("b", ("a", "c")), "b") == (2, True) and diagrams.visits((("a", "c"), "b"), "b") == (5, True)
    marked = diagrams.marked_cells()
    assert marked > {*diagrams.SOURCES, *diagrams.TARGETS} and (0, 0) not in marked
    assert (0, "A") in diagrams.visible_pairs() and not [pair for pair in diagrams.visible_pairs() if pair[1] == "B"]


@pytest.mark.parametrize("name", pages.PAPERS)
def test_code_of_papers_links_to_its_lines(name, monkeypatch):
    pytest.importorskip("docutils", reason="no docutils: the links to code are NOT checked")
    monkeypatch.setattr(sys, "path", [str(ROOT / "docs" / "_ext"), *sys.path])
    code = tool(ROOT / "docs" / "_ext" / "paper_code.py")
    text = code.sections(name.replace("-", "_"))
    places = re.findall(r"\[`([\w.]+)`\]\(\S+?/blob/main/(\S+?)#L(\d+)-L(\d+)\)", text)
    assert len(places) > 50 and "](../../" not in text
    for what, file, first, last in places:
        lines = (ROOT / file).read_text(encoding="utf-8").splitlines()[int(first) - 1 : int(last)]
        assert any(re.search(rf"\b{what.rpartition('.')[2]}\b", line) for line in lines), (what, file)
    assert len(re.findall(r"\.py\)", text)) <= 3  # names without lines


@pytest.mark.parametrize("name", pages.PAPERS)
def test_pages_have_the_form_of_the_script(name):
    text = (pages.PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert text.startswith(f"{pages.front(name)}## How it was measured\n\n- **command**: antumbra bench {name}")
    header, _, results = text.partition("\n\n## Results\n\n")
    assert all(f"\n- **{field}**: " in header for field in ("date", "antumbra", "numpy", "numba", "processor"))
    pictures = re.findall(r"^```\{image\} (.+)$", results, re.MULTILINE)
    assert all((pages.PAGES / picture).is_file() for picture in pictures)
    tables = re.findall(r"(?:^\|.*\|\n)+", results, re.MULTILINE)
    assert tables
    for lines in map(str.splitlines, tables):
        assert set(lines[1]) <= set("|-: ") and len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1


@pytest.mark.parametrize("name", pages.PAPERS)
def test_pages_show_the_conditions_of_their_results(name):
    file = pages.RESULTS / f"{name}.json"
    if not file.is_file():
        pytest.skip(f"the page {name} is NOT checked: {file.relative_to(ROOT)} is missing; run scripts/paper_pages.py")
    results, text = json.loads(file.read_text()), (pages.PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert not results["about"]["quick"] and (results.get("rounds") or results["frames"]) >= pages.ROUNDS
    for field, value in pages.conditions(results).items():
        assert f"\n- **{field}**: {pages.escaped(value)}\n" in text


def test_each_table_states_when_and_how_often_it_was_measured(present):
    tables = {
        "boxes": table_of(rounds=()),
        "renders": table_of((1, 3), "antumbra bench srdh --rounds 5", (2.5, 2.5)),
    }
    results = results_of(kernels=present, tables=tables)
    assert pages.objection("srdh", results) is None
    text = pages.header(results)
    assert "\n- **not measured**: tables builds, rtsah\n" in text
    dates = "2026-01-01 10:00 UTC to 2026-01-01 11:00 UTC"
    assert f"\n| boxes | 4 | {dates} | 4.0 | 0.5 to 2.0 |  | 0123 |\n" in text
    assert f"\n| renders | 4 | {dates} | 4.0 | 2.5 | 1 to 3 | 0123 |\n" in text and "**commit**" not in text
    assert (
        "- **command**: antumbra bench srdh; antumbra bench srdh --rounds 5\n" in text and f"**date**: {dates}" in text
    )


def test_frames_are_those_that_were_measured():
    turn = {"scene": "city", "view": "near", "kind": "AO", "method": "chcrt"}
    times = [{**turn, "frame": k} for k in range(3)] + [{**turn, "view": "far", "frame": k} for k in range(2)]
    shown = lambda **results: pages.conditions(results_of(rounds=None, **results))["frames"]
    assert shown(frames=60, times=times) == "2 to 3 measured per row, of at most 60; fewer than 3 in 1 of 2 rows"
    assert shown(frames=60, times=times[:3]) == "3 measured per row, of at most 60"
    assert shown(frames=3, times=times[:3]) == "3"
    assert shown(frames=200) == "200"
    video = [{"figure": "video", "grid": grid, "marked": "hulls"} for grid in (16, 16, 32)]
    assert shown(frames=2, video=video) == "1 to 2 measured per row, of at most 2; fewer than 3 in 2 of 2 rows"


# --- The papers' claims -----------------------------------------------------------------------------------------------


def test_the_overview_of_claims_is_the_generated_one():
    assert pages.CLAIMS.read_text(encoding="utf-8") == pages.claims_page(), "run scripts/paper_pages.py --fronts"
    assert "\nclaims\n" in (pages.PAGES / "index.md").read_text(encoding="utf-8")


def test_verdicts_follow_the_numbers():
    claim = claims.Claim("1", "at least 2", "{:.1f}, {:.0f}%", lambda r: r["pair"], lambda a, b: a >= 2, "slow", "once")
    assert claims.judged(claim, {"pair": (2.0, 7)})[1:] == ("2.0, 7 %", claims.HOLDS, "once")
    assert claims.judged(claim, {"pair": (1.9, 7)})[1:] == ("1.9, 7 %", claims.FAILS, "slow; once")
    assert claims.judged(claim._replace(holds=None), {"pair": (2.0, 7)}).verdict == claims.UNTRIED
    span = claim._replace(ours="{:.1f} to {:.1f} times")
    assert [claims.judged(span, {"pair": pair}).ours for pair in ((2.0, 2.04), (2.0, 2.5), (2.0, 20))] == [
        "2.0 times", "2.0 to 2.5 times", "2.0 to 20.0 times",
    ]  # fmt: skip
    with pytest.raises(KeyError):  # results without the number
        claims.judged(claim, {})
    judged = claims.judged(claim, results_of(tables={"boxes": table_of()}))
    assert (
        judged.verdict == claims.UNTRIED and judged.why == "not measured at this size (tables builds, rtsah, renders)"
    )
    slow = claim._replace(numbers=lambda r: spread(r["pair"]))
    assert claims.judged(slow, {"pair": ()})[2:] == (claims.UNTRIED, "would take too long at this size")
    with pytest.raises(KeyError):  # though all tables were measured
        claims.judged(claim, results_of(tables=dict.fromkeys(claims.TABLES["srdh"])))


@pytest.mark.parametrize("name", pages.PAPERS)
def test_claims_have_a_verdict_and_a_reason_if_they_do_not_hold(name):
    rows = claims.all_judged(name, pages.present_results(name))
    assert len(rows) >= 18 and {row.verdict for row in rows} >= {claims.HOLDS, claims.FAILS}
    for row in rows:
        assert row.claim.section and row.claim.text and "|" not in "".join((row.claim.text, row.ours, row.why))
        assert row.ours or row.verdict == claims.UNTRIED
        untried = row.verdict == claims.UNTRIED and row.why
        assert row.claim.reason or row.verdict == claims.HOLDS or untried, row.claim.text
    text = (pages.PAGES / f"{name}.md").read_text(encoding="utf-8")
    for row in rows:
        assert (f": {row.claim.text}. Here: " in text) == (row.verdict == claims.FAILS), row.claim.text


@pytest.mark.parametrize("name, paper", pages.PAPERS.items())
def test_pages_link_to_their_claims(name, paper):
    text = (pages.PAGES / f"{name}.md").read_text(encoding="utf-8")
    (anchor,) = re.findall(r"\(claims\.md#([\w-]+)\)", text)
    headings = re.findall(r"^## (.+)$", pages.claims_page(), re.MULTILINE)
    assert paper.title in headings and anchor == re.sub(r"[^\w -]", "", paper.title.lower()).replace(" ", "-")
