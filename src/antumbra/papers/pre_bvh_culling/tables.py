"""Prints the tables of the pre-BVH culling paper for people, with the paper's figures in brackets."""

from ...cli import console as report
from . import published as paper
from .measure import BUILDERS, CONVEX, HULLS, LINES, SAMPLES, GridRow, TimeToImage, break_even

_WIDTH = 150  # width of the tables, in characters
_STEPS = {
    "sources": "G-buffer to grid",
    "mark": "mark cells",
    "triangles": "determine triangles",
    "pack": "scan and pack triangles",
}
"""Step of culling -> its name in Tables 1 and 2."""


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f}"


def _beside(ours: str, theirs: float | None, digits: int = 1) -> str:
    """Our figure, with the paper's in brackets if there is one."""
    return ours if theirs is None else f"{ours} ({theirs:.{digits}f})"


def print_details(times: list[TimeToImage], grids: list[GridRow]) -> None:
    """Print Tables 1 and 2: every step of every view, by each tracer."""
    columns = list(dict.fromkeys((t.figure, t.tracer) for t in times))
    parts = [_details(*column, times, grids) for column in columns]
    table = [(name, *(part[name] for part in parts)) for name in parts[0]]
    head = ("ms", *(f"{figure}, {tracer}" for figure, tracer in columns))
    print("Every step with one sample (Tables 1 and 2; the paper's figures, of a GPU, in brackets)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _details(figure: str, tracer: str, times, grids) -> dict[str, str]:
    """The column of one view and tracer: name of a row -> times."""
    own = {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)}
    grid = next(r for r in grids if r.figure == figure and r.marked == HULLS)
    theirs, totals = paper.DETAILS.get(figure, (None,) * 6), paper.TIME_TO_IMAGE.get(figure, {})
    first = own["LBVH"]
    rows = {
        "render G-buffer": _beside(_ms(first.gbuffer), theirs[0]),
        "shading (final blit)": _beside(_ms(first.shade), theirs[1]),
    }
    for (step, name), ms in zip(_STEPS.items(), theirs[2:]):
        rows[name] = _beside(_ms(grid.steps[step]), ms)
    for method, t in own.items():
        ms = totals.get(method, (None,) * 3)
        if t.cull:
            rows[f"{method}: all culling"] = _beside(_ms(t.cull), ms[0])
        rows[f"{method}: build"] = _beside(_ms(t.build), ms[1])
        rows[f"{method}: trace"] = _beside(_ms(t.trace[SAMPLES[0]]), ms[2])
    return rows


def print_times(times: list[TimeToImage]) -> None:
    """Print Table 3, with the paper's ratios to LBVH in brackets, and the break-even points of Figure 7."""
    rows = []
    for t in times:
        same = {o.method: o for o in times if (o.figure, o.tracer) == (t.figure, t.tracer)}
        first, last, theirs = same["LBVH"], same["BSAH"], paper.TIME_TO_IMAGE.get(t.figure)
        ratios = []
        for k, spp in enumerate(SAMPLES):
            ratio = 100 * theirs[t.method][3 + k] / theirs["LBVH"][3 + k] if theirs else None
            ratios.append(_beside(f"{100 * t.total(spp) / first.total(spp):.0f}", ratio, 0))
        caught = "" if t is last else f"{break_even(last, t):.0f}"
        seconds = t.cull, t.build, t.trace[SAMPLES[0]], *(t.total(spp) for spp in SAMPLES)
        rows.append((t.figure, t.tracer, t.method, *map(_ms, seconds), *ratios, caught))
    sums, ratios = ([f"{name} {spp} spp" for spp in SAMPLES] for name in ("sum", "% of LBVH"))
    head = ("view", "tracer", "method", "cull", "build", "trace 1 spp", *sums, *ratios, "BSAH even at")
    print("Time to image, ms (Table 3 and Figure 7; the paper's figures in brackets)")
    report.print_table(head, rows, right=range(3, len(head)), width=_WIDTH)


def print_regions(grids: list[GridRow]) -> None:
    """Print the triangles that are left in a convex region, and by a grid (Figure 2, captions of Figures 3 to 6)."""
    figures, table = list(dict.fromkeys(r.figure for r in grids)), []
    for figure in figures:
        left = {r.marked: f"{100 * r.remaining:.1f}" for r in grids if r.figure == figure}
        theirs = paper.REMAINING.get(figure)
        published = _beside(left[LINES], None if theirs is None else 100 * theirs, 0)
        table.append((figure, left[CONVEX], published, left[HULLS]))
    head = ("view", "convex region (Figure 2b)", "as published (Figure 2d)", "hulls (grid32)")
    print("Triangles that are left, in percent, with 32 cells an axis (the paper's figures in brackets)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_grids(rows: list[GridRow], tracers: list[str]) -> None:
    """Print Table 4, with the paper's figures in brackets."""
    table = []
    for r in rows:
        theirs = paper.GRIDS[r.grid] if r.grid else (None, None, None, None, None, *paper.WHOLE)
        share = _beside(f"{100 * r.remaining:.0f}", 100 * theirs[0] if r.grid else None, 0)
        steps = ["", "", ""]
        if r.grid:
            parts = r.steps["sources"], r.steps["mark"], r.steps["triangles"] + r.steps["pack"]
            steps = [_beside(_ms(part), ms) for part, ms in zip(parts, theirs[1:4])]
        total = _beside(_ms(sum(r.steps.values())), theirs[4]) if r.grid else ""
        built = []
        for builder, ms in zip(BUILDERS, (theirs[5:7], theirs[7:9])):
            plans = [f"{builder}+{tracer}" for tracer in tracers]
            built.append(_beside(_ms(r.build[plans[0]]), ms[0]) if r.build else "")
            built += [_beside(_ms(r.trace[plan]), ms[1]) if r.trace else "" for plan in plans]
        table.append((str(r.grid or "none"), r.marked, share, *steps, total, *built))
    names = [name for b in BUILDERS for name in (f"build {b}", *(f"{t}, 1 spp" for t in tracers))]
    head = ("grid", "marked by", "% left", "sources", "mark", "triangles", "all culling", *names)
    print("Grids, ms, means over the frames of an animated city (Table 4; the paper's, of another scene, in brackets)")
    report.print_table(head, table, right=(0, *range(2, len(head))), width=_WIDTH)
