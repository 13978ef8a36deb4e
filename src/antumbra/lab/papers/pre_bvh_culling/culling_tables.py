"""Prints the tables of the pre-BVH culling paper, with its results in brackets [Selgrad et al. 2015]."""

from collections.abc import Mapping, Sequence
from math import inf

from ....techniques.culling.pre_bvh_culling import STEPS
from ..bench_runner import TableColumn, beside, columns_of, label, ms, percent, print_notes, print_table
from .culling_measurements import (
    BUILDERS,
    FIGURE_SAMPLES,
    METHODS,
    OURS,
    PUBLISHED,
    REGION,
    SAMPLES,
    CullingRows,
    FigureTime,
    GridRow,
    RandomShares,
    TimeToImage,
    break_even,
    mean_rows,
)
from .culling_published import (
    CONTRADICTIONS,
    DETAILS,
    GRIDS,
    REMAINING,
    TIME_TO_IMAGE,
    UNCULLED,
    published_break_even,
    published_total,
)

_STEPS = {
    "sources": "G-buffer to grid",
    "mark": "mark cells",
    "triangles": "determine triangles",
    "pack": "scan and pack triangles",
}
"""Culling step -> its name in Tables 1 and 2."""


def print_tables(rows: CullingRows, tracers: Sequence[str]) -> None:
    """Print all tables that were measured."""
    if rows.shares or rows.grids:
        _print_remaining(rows)
    if rows.times and rows.grids:
        _print_details(rows.times, rows.grids)
    if rows.times:
        _print_times(rows.times)
    if rows.figures:
        _print_figures(rows.figures)
    if rows.video:
        _print_grids(mean_rows(rows.video), tracers)
    print("Where the paper contradicts itself")
    print_notes(CONTRADICTIONS)


# --- Fig. 2, captions of Fig. 3 to 6 ----------------------------------------------------------------------------------


def _print_remaining(rows: CullingRows) -> None:
    """Print the remaining triangles with each marking, in random views, then in those chosen to be like the paper's."""
    share = {(r.part, r.marked): _quartiles(r) for r in rows.shares}
    share |= {(r.figure, r.marked): percent(r.remaining) for r in rows.grids}
    count = {r.part: len(r.shares) for r in rows.shares}
    theirs = {figure: 100 * remaining for figure, remaining in REMAINING.items()}
    columns = (
        label("view", lambda view: f"{view}, {count[view]} random cameras" if view in count else f"{view}, chosen"),
        TableColumn("as published (grid32:paper, Fig. 2d)", lambda v: beside(share[v, PUBLISHED], theirs.get(v), 0)),
        TableColumn("hulls (grid32)", lambda view: share[view, OURS]),
        TableColumn("convex region (Fig. 2b)", lambda view: share[view, REGION]),
    )
    title = (
        "Remaining triangles, %, with 32 cells per axis (the paper's in brackets; random cameras: median, quartiles)"
    )
    print_table(title, columns, dict.fromkeys(view for view, _ in share))


def _quartiles(row: RandomShares) -> str:
    low, middle, high = map(percent, row.quartiles)
    return f"{middle} ({low} to {high})"


# --- Tables 1 and 2 ---------------------------------------------------------------------------------------------------


def _print_details(times: list[TimeToImage], grids: list[GridRow]) -> None:
    """Print all steps for each view and tracer."""
    marked = {row.figure for row in grids}
    views = list(dict.fromkeys((t.figure, t.tracer) for t in times if t.figure in marked))
    parts = {view: _details(*view, times, grids) for view in views}
    columns = columns_of({view: ", ".join(view) for view in views}, lambda name, view: parts[view][name])
    title = "All steps with one sample (Tables 1 and 2; in brackets the paper's results on a GPU)"
    print_table(title, [label("ms", str), *columns], parts[views[0]])


def _details(figure: str, tracer: str, times: list[TimeToImage], grids: list[GridRow]) -> dict[str, str]:
    """The column of one view and tracer: row name -> times."""
    methods = {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)}
    theirs: Sequence[float | None] = DETAILS.get(figure) or (None,) * 7
    totals: Mapping[str, Sequence[float | None]] = TIME_TO_IMAGE.get(figure, {})
    first = methods["LBVH"]
    rows = {
        "render G-buffer": beside(ms(first.gbuffer), theirs[0]),
        "shading (final blit)": beside(ms(first.shade), theirs[1]),
    }
    for marked in PUBLISHED, OURS:
        grid = next(r for r in grids if (r.figure, r.marked) == (figure, marked))
        for (step, name), published in zip(_STEPS.items(), theirs[2:]):
            rows[f"{name}, {marked}"] = beside(ms(grid.steps[step]), published if marked == PUBLISHED else None)
    for method, t in methods.items():
        published_times = totals.get(method, (None,) * 3)
        if t.cull:
            rows[f"{method}: all culling"] = beside(ms(t.cull), theirs[6] if method in totals else None)
        rows[f"{method}: build"] = beside(ms(t.build), published_times[1])
        rows[f"{method}: trace"] = beside(ms(t.trace[1]), published_times[2])
    return rows


# --- Table 3, Fig. 3 to 7 ---------------------------------------------------------------------------------------------


def _of_lbvh(figure: str, method: str, spp: int, total: float | None, lbvh: float | None) -> str:
    """A time to image in per cent of LBVH's, with the paper's in brackets."""
    if total is None or lbvh is None:
        return ""
    published = None
    if method in TIME_TO_IMAGE.get(figure, {}):
        published = 100 * published_total(figure, method, spp) / published_total(figure, "LBVH", spp)
    return beside(percent(total / lbvh), published, 0)


def _even(last: TimeToImage, t: TimeToImage) -> str:
    """The number of samples from which BSAH without culling is as fast, with the paper's in brackets."""
    if t is last:
        return ""
    known, even = t.method in TIME_TO_IMAGE.get(t.figure, {}), break_even(last, t)
    note = ", extrapolated" if max(t.trace.keys() & last.trace.keys()) < even < inf else ""
    return beside(f"{even:.0f}{note}", published_break_even(t.figure, t.method) if known else None, 0)


_NAMES = (
    label("view", "figure"),
    label("tracer", "tracer"),
    label("method", "method"),
    label("culler and builder", lambda t: METHODS[t.method]),
)


def _print_times(times: list[TimeToImage]) -> None:
    """Print Table 3, with the paper's ratios to LBVH in brackets, and the break-even points of Figure 7."""
    by = {(t.figure, t.tracer, t.method): t for t in times}

    def ratio(t: TimeToImage, spp: int) -> str:
        return _of_lbvh(t.figure, t.method, spp, t.total(spp), by[t.figure, t.tracer, "LBVH"].total(spp))

    columns = (
        *_NAMES,
        TableColumn("cull", lambda t: ms(t.cull)),
        TableColumn("build", lambda t: ms(t.build)),
        TableColumn("trace 1 spp", lambda t: ms(t.trace[SAMPLES[0]])),
        *columns_of({spp: f"total {spp} spp" for spp in SAMPLES}, lambda t, spp: ms(t.total(spp))),
        *columns_of({spp: f"% of LBVH {spp} spp" for spp in SAMPLES}, ratio),
        TableColumn("BSAH breaks even, spp", lambda t: _even(by[t.figure, t.tracer, "BSAH"], t)),
    )
    print_table("Time to image, ms (Table 3 and Figure 7; the paper's results in brackets)", columns, times)


def _print_figures(times: list[FigureTime]) -> None:
    """Print the times of Figures 3 to 6 with their 15 samples; the paper shows only the images."""
    by = {(t.figure, t.method): t.total for t in times}
    columns = (
        *_NAMES,
        TableColumn("cull", lambda t: ms(t.cull)),
        TableColumn("build", lambda t: ms(t.build)),
        TableColumn("trace", lambda t: ms(t.trace)),
        TableColumn("total", lambda t: ms(t.total)),
        TableColumn("% of LBVH", lambda t: _of_lbvh(t.figure, t.method, FIGURE_SAMPLES, t.total, by[t.figure, "LBVH"])),
    )
    title = "Figures 3 to 6 with 15 samples, ms (in brackets the paper's, computed from its times as in Table 3)"
    print_table(title, columns, times)


# --- Table 4 ----------------------------------------------------------------------------------------------------------

_STEPS_OF = {"sources": ("sources",), "mark": ("mark",), "triangles": ("triangles", "pack"), "all culling": STEPS}
"""Column of Table 4 -> its steps of STEPS."""


def _print_grids(rows: list[GridRow], tracers: Sequence[str]) -> None:
    """Print Table 4, with the paper's results in brackets."""

    def published(r: GridRow, k: int) -> float | None:
        return GRIDS[r.grid][k] if r.marked == PUBLISHED else None

    def culling(r: GridRow, column: str) -> str:
        steps, k = _STEPS_OF[column], 1 + list(_STEPS_OF).index(column)
        return beside(ms(sum(r.steps[step] for step in steps)), published(r, k)) if r.grid else ""

    def seconds(r: GridRow, column: tuple[str, str]) -> str:
        """Time to build a tree (without a tracer) or to trace it."""
        builder, tracer = column
        k = 2 * BUILDERS.index(builder) + bool(tracer)
        times = r.trace if tracer else r.build
        return beside(ms(times[f"{builder}+{tracer or tracers[0]}"]), published(r, 5 + k) if r.grid else UNCULLED[k])

    def left(r: GridRow) -> str:
        share = published(r, 0)
        return beside(percent(r.remaining), None if share is None else 100 * share, 0)

    columns = (
        TableColumn("grid", lambda r: str(r.grid or "none")),
        label("marking", "marked"),
        TableColumn("frames", lambda r: str(r.views)),
        TableColumn("% remaining", left),
        *columns_of({column: column for column in _STEPS_OF}, culling),
        *columns_of({(b, t): f"{t}, 1 spp" if t else f"build {b}" for b in BUILDERS for t in ("", *tracers)}, seconds),
    )
    title = "Grids, ms, means over the frames of an animated city"
    print_table(f"{title} (Table 4; in brackets the paper's, for another scene)", columns, rows)
