"""Judges each claim of the papers by the results of our measurements: docs/papers/claims.md, and the papers' pages.

A verdict follows from the numbers, so that a new measurement changes both. `paper_pages.py` writes the page and the
sections; the folder claims/ lists the claims.
"""

import re
from collections import Counter
from typing import Any, NamedTuple

from claims import CLAIMS, CONDITIONS
from claims.claim import Claim, Unmeasured

from antumbra.lab.papers.chc_rt.chcrt_published import ChcrtTable
from antumbra.lab.papers.multi_frusta.frusta_published import FrustaTable
from antumbra.lab.papers.pre_bvh_culling.culling_published import CullingTable
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_published import RayHierarchyTable
from antumbra.lab.papers.srdh.srdh_published import SrdhTable

TABLES = {
    "multi-frusta": tuple(FrustaTable),
    "pre-bvh-culling": tuple(CullingTable),
    "srdh": tuple(SrdhTable),
    "ray-hierarchy": tuple(RayHierarchyTable),
    "chc-rt": tuple(table for table in ChcrtTable if table not in (ChcrtTable.phases, ChcrtTable.queries)),
}
"""Benchmark -> the tables that are measured."""

HOLDS, FAILS, UNTRIED = "holds", "does not hold", "not tried"

INTRODUCTION = """
This page lists what the five papers claim, with their numbers, ours, and a verdict. It is generated: our numbers and
the verdicts are computed from the results in `results/NAME.json`, and follow each new measurement.

Ranges are over our scenes, views or frames. Unless the row says otherwise, the method is the paper's own as
published (such as `multifrusta:paper`), not the one that Antumbra uses, and a claimed range of factors holds if our
median reaches its lower end. The papers measured on other machines, mostly on GPUs, and on other scenes.
*Measured once* marks numbers that are not among the results.
"""


class Judged(NamedTuple):
    """A claim with our numbers as text, a verdict, and an explanation, which may be empty."""

    claim: Claim
    ours: str
    verdict: str
    why: str


def missing_tables(results: dict[str, Any]) -> list[str]:
    """The tables of a benchmark that its results do not have, as far as they say which they have."""
    if "tables" not in results:
        return []
    name = results["about"]["command"].split()[2]
    return [table.value for table in TABLES[name] if table not in results["tables"]]


def judged(claim: Claim, results: dict[str, Any]) -> Judged:
    """A claim, judged by the results of the paper's benchmark.

    Raises
    ------
    LookupError or ValueError
        If the results lack its numbers, though they have all tables.
    """
    try:
        numbers = claim.numbers(results) if claim.numbers else ()
    except Unmeasured:
        return Judged(claim, "", UNTRIED, "would take too long at this size")
    except (LookupError, ValueError):
        if missing := missing_tables(results):
            return Judged(claim, "", UNTRIED, f"not measured at this size (tables {', '.join(missing)})")
        raise
    if claim.holds is None:
        verdict = UNTRIED
    else:
        verdict = HOLDS if claim.holds(*numbers) else FAILS
    why = "; ".join(part for part in ("" if verdict == HOLDS else claim.reason, claim.remark) if part)
    ours = re.sub(r"(?<=\d)%", " %", claim.ours.format(*numbers))
    ours = re.sub(r"(?<![\d.])([\d.]+) to \1(?![\d.]*\d)", r"\1", ours)  # one number is no range
    return Judged(claim, ours, verdict, why)


def all_judged(name: str, results: dict[str, Any]) -> list[Judged]:
    """All claims of a paper."""
    return [judged(claim, results) for claim in CLAIMS[name]]


def conditions(name: str, results: dict[str, Any]) -> list[str]:
    """What to know about the measurements of a paper: sizes, chosen views, and what is compared with what."""
    found = []
    for text in CONDITIONS[name]:
        try:
            found.append(text if isinstance(text, str) else text(results))
        except (LookupError, ValueError):
            if not missing_tables(results):
                raise
    return found


def _bullets(lines: list[str]) -> str:
    return "".join(f"- {line}\n" for line in lines)


def _line(row: Judged) -> str:
    """A claim in a line of text."""
    place = f"Sec. {row.claim.section}" if row.claim.section[0].isdigit() else row.claim.section
    why = f" {row.why[0].upper()}{row.why[1:]}." if row.why else ""
    return f"**{place}**: {row.claim.text}. Here: {row.ours}.{why}"


def section(name: str, title: str, results: dict[str, Any]) -> str:
    """The part of a paper's page about its claims: those that do not hold, and what to know about the measurements."""
    rows = all_judged(name, results)
    count = Counter(row.verdict for row in rows)
    anchor = title.lower().replace("+", "").replace(" ", "-")
    link = f"[All claims of the paper](claims.md#{anchor})"
    summary = f"{link}: {count[HOLDS]} hold, {count[FAILS]} do not, and {count[UNTRIED]} were not tried."
    failed = [_line(row) for row in rows if row.verdict == FAILS]
    return (
        f"## What does not hold here\n\n{summary}\n\n{_bullets(failed)}\n"
        f"Notes on these numbers:\n\n{_bullets(conditions(name, results))}"
    )


def page(titles: dict[str, str], results: dict[str, dict[str, Any]], mark: str) -> str:
    """The overview of all claims.

    titles, results : by paper
    mark : the comment on the first line of a generated page
    """
    parts, total = [], Counter[str]()
    for name, title in titles.items():
        rows = all_judged(name, results[name])
        total.update(row.verdict for row in rows)
        lines = ["| section | claim | here | verdict | why |", "| --- | --- | --- | --- | --- |"]
        lines += [
            f"| {row.claim.section} | {row.claim.text} | {row.ours} | *{row.verdict}* | {row.why} |" for row in rows
        ]
        table = "\n".join(lines)
        know = _bullets(conditions(name, results[name]))
        parts.append(f"## {title}\n\n[Its page]({name}.md) says how we measured.\n\n{table}\n\n{know}")
    count = (
        f"Of {total.total()} claims, {total[HOLDS]} hold, {total[FAILS]} do not, and {total[UNTRIED]} were not tried."
    )
    return f"{mark}\n\n# The papers' claims\n{INTRODUCTION}\n{count}\n\n" + "\n".join(parts)
