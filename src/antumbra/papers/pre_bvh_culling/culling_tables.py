"""Prints the tables of the pre-BVH culling paper, and draws its Figure 7 [Selgrad et al. 2015].

Tables show the paper's results, measured on a GPU, in brackets. Figure 7 shows time to image over samples, relative to
BSAH, with a row per tracer.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...techniques.culling.pre_bvh_culling import STEPS
from ..bench_runner import TableColumn, beside, columns_of, label, ms, percent, plot_sheet, print_table
from .culling_measurements import (
    BUILDERS,
    CONVEX,
    HULLS,
    LINES,
    SAMPLES,
    GridRow,
    TimeToImage,
    break_even,
    mean_rows,
    seconds_a_sample,
)

# --- Published results, in milliseconds on a GPU ----------------------------------------------------------------------


TIME_TO_IMAGE = {
    "Figure 3": {
        "LBVH": (0.0, 3.520, 26.836, 30.356, 271.880, 2687.120),
        "LBVH culled": (1.399, 2.095, 20.955, 24.449, 213.044, 2098.994),
        "TL-LBVH": (0.0, 23.316, 20.776, 44.092, 231.076, 2100.916),
        "TL-LBVH culled": (1.399, 12.065, 17.653, 31.117, 189.994, 1778.764),
        "BSAH": (0.0, 278.500, 14.279, 292.779, 421.290, 1706.400),
    },
    "Figure 4": {
        "LBVH": (0.0, 3.539, 15.872, 19.411, 162.259, 1590.739),
        "LBVH culled": (1.405, 2.428, 12.636, 16.469, 130.193, 1267.433),
        "TL-LBVH": (0.0, 23.408, 11.862, 35.270, 142.028, 1209.608),
        "TL-LBVH culled": (1.405, 15.185, 9.834, 26.424, 114.930, 999.990),
        "BSAH": (0.0, 278.500, 8.428, 286.928, 362.780, 1121.300),
    },
    "Figure 5": {
        "LBVH": (0.0, 3.525, 12.684, 16.209, 130.365, 1271.925),
        "LBVH culled": (1.228, 2.687, 11.004, 14.919, 113.955, 1104.315),
        "TL-LBVH": (0.0, 23.293, 10.349, 33.642, 126.783, 1058.193),
        "TL-LBVH culled": (1.228, 16.678, 9.741, 27.647, 115.316, 992.006),
        "BSAH": (0.0, 278.500, 8.372, 286.872, 362.220, 1115.700),
    },
    "Figure 6": {
        "LBVH": (0.0, 9.902, 18.408, 28.310, 193.982, 1850.702),
        "LBVH culled": (2.374, 1.121, 14.160, 17.655, 145.095, 1419.495),
        "TL-LBVH": (0.0, 68.993, 10.540, 79.533, 174.393, 1122.993),
        "TL-LBVH culled": (2.374, 4.775, 9.329, 16.478, 100.439, 940.049),
        "BSAH": (0.0, 879.400, 9.041, 888.441, 969.810, 1783.500),
    },
}
"""Table 3: view -> method -> times of culling, building and tracing 1 sample, and totals with 1, 10 and 100 samples."""

DETAILS = {
    "Figure 3": (2.158, 0.734, 0.387, 0.122, 0.638, 0.231),
    "Figure 4": (2.897, 0.710, 0.710, 0.128, 0.600, 0.232),
    "Figure 5": (3.035, 1.539, 0.344, 0.133, 0.562, 0.220),
    "Figure 6": (4.554, 1.623, 0.403, 0.126, 1.570, 0.251),
}
"""Tables 1 and 2: view -> times of the G-buffer, the final blit, and the culling steps."""

REMAINING = {"Figure 3": 0.45, "Figure 4": 0.60, "Figure 5": 0.60, "Figure 6": 0.04}
"""Captions of Figures 3 to 6: share of remaining triangles."""

GRIDS = {
    16: (0.34, 0.319, 0.074, 4.323, 4.716, 15.464, 15.430, 95.601, 11.496),
    32: (0.24, 0.463, 0.133, 4.810, 5.406, 11.450, 13.915, 67.056, 10.660),
    64: (0.19, 0.658, 0.704, 5.884, 7.246, 9.809, 13.307, 56.057, 10.354),
    128: (0.17, 0.904, 11.880, 8.515, 21.299, 8.989, 12.889, 49.942, 10.095),
    256: (0.16, 2.995, 534.021, 16.388, 553.404, 8.458, 12.538, 46.145, 9.874),
}
"""Table 4: grid -> (share of remaining triangles, times of sources, marking, triangles and all culling, of building and
tracing with LBVH, and of building and tracing with TL-LBVH)."""

UNCULLED = (42.161, 17.020, 261.186, 12.167)
"""Table 4, without culling: times of building and tracing with LBVH, and with TL-LBVH."""

# --- Tables -----------------------------------------------------------------------------------------------------------


_STEPS = {
    "sources": "G-buffer to grid",
    "mark": "mark cells",
    "triangles": "determine triangles",
    "pack": "scan and pack triangles",
}
"""Culling step -> its name in Tables 1 and 2."""


def print_tables(times: list[TimeToImage], grids: list[GridRow], video: list[GridRow], tracers: Sequence[str]) -> None:
    """Print all tables."""
    _print_details(times, grids)
    _print_times(times)
    _print_regions(grids)
    _print_grids(mean_rows(video), tracers)


def _print_details(times: list[TimeToImage], grids: list[GridRow]) -> None:
    """Print Tables 1 and 2: all steps for each view and tracer."""
    views = list(dict.fromkeys((t.figure, t.tracer) for t in times))
    parts = {view: _details(*view, times, grids) for view in views}
    columns = columns_of({view: ", ".join(view) for view in views}, lambda name, view: parts[view][name])
    title = "All steps with one sample (Tables 1 and 2; in brackets the paper's results on a GPU)"
    print_table(title, [label("ms", str), *columns], parts[views[0]])


def _details(figure: str, tracer: str, times: list[TimeToImage], grids: list[GridRow]) -> dict[str, str]:
    """The column of one view and tracer: row name -> times."""
    methods = {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)}
    grid = next(r for r in grids if r.figure == figure and r.marked == HULLS)
    theirs: Sequence[float | None] = DETAILS.get(figure) or (None,) * 6
    totals: Mapping[str, Sequence[float | None]] = TIME_TO_IMAGE.get(figure, {})
    first = methods["LBVH"]
    rows = {
        "render G-buffer": beside(ms(first.gbuffer), theirs[0]),
        "shading (final blit)": beside(ms(first.shade), theirs[1]),
    }
    for (step, name), published in zip(_STEPS.items(), theirs[2:]):
        rows[name] = beside(ms(grid.steps[step]), published)
    for method, t in methods.items():
        total = totals.get(method, (None,) * 3)
        if t.cull:
            rows[f"{method}: all culling"] = beside(ms(t.cull), total[0])
        rows[f"{method}: build"] = beside(ms(t.build), total[1])
        rows[f"{method}: trace"] = beside(ms(t.trace[SAMPLES[0]]), total[2])
    return rows


def _print_times(times: list[TimeToImage]) -> None:
    """Print Table 3, with the paper's ratios to LBVH in brackets, and the break-even points of Figure 7."""
    by = {(t.figure, t.tracer, t.method): t for t in times}

    def ratio(t: TimeToImage, spp: int) -> str:
        theirs, k = TIME_TO_IMAGE.get(t.figure), SAMPLES.index(spp)
        published = 100 * theirs[t.method][3 + k] / theirs["LBVH"][3 + k] if theirs else None
        return beside(percent(t.total(spp) / by[t.figure, t.tracer, "LBVH"].total(spp)), published, 0)

    def even(t: TimeToImage) -> str:
        last = by[t.figure, t.tracer, "BSAH"]
        return "" if t is last else f"{break_even(last, t):.0f}"

    columns = (
        label("view", "figure"),
        label("tracer", "tracer"),
        label("method", "method"),
        TableColumn("cull", lambda t: ms(t.cull)),
        TableColumn("build", lambda t: ms(t.build)),
        TableColumn("trace 1 spp", lambda t: ms(t.trace[SAMPLES[0]])),
        *columns_of({spp: f"total {spp} spp" for spp in SAMPLES}, lambda t, spp: ms(t.total(spp))),
        *columns_of({spp: f"% of LBVH {spp} spp" for spp in SAMPLES}, ratio),
        TableColumn("BSAH breaks even, spp", even),
    )
    print_table("Time to image, ms (Table 3 and Figure 7; the paper's results in brackets)", columns, times)


def _print_regions(grids: list[GridRow]) -> None:
    """Print the remaining triangles with a convex region and with grids (Figure 2, captions of Figures 3 to 6)."""
    share = {(r.figure, r.marked): 100 * r.remaining for r in grids}
    theirs = {figure: 100 * remaining for figure, remaining in REMAINING.items()}
    columns = (
        label("view", str),
        TableColumn("convex region (Figure 2b)", lambda figure: f"{share[figure, CONVEX]:.1f}"),
        TableColumn("as published (Figure 2d)", lambda view: beside(f"{share[view, LINES]:.1f}", theirs.get(view), 0)),
        TableColumn("hulls (grid32)", lambda figure: f"{share[figure, HULLS]:.1f}"),
    )
    title = "Remaining triangles, %, with 32 cells per axis (the paper's results in brackets)"
    print_table(title, columns, dict.fromkeys(r.figure for r in grids))


_STEPS_OF = {"sources": ("sources",), "mark": ("mark",), "triangles": ("triangles", "pack"), "all culling": STEPS}
"""TableColumn of Table 4 -> its steps of STEPS."""


def _print_grids(rows: list[GridRow], tracers: Sequence[str]) -> None:
    """Print Table 4, with the paper's results in brackets."""

    def culling(r: GridRow, column: str) -> str:
        steps, k = _STEPS_OF[column], 1 + list(_STEPS_OF).index(column)
        return beside(ms(sum(r.steps[step] for step in steps)), GRIDS[r.grid][k]) if r.grid else ""

    def seconds(r: GridRow, column: tuple[str, str]) -> str:
        """Seconds to build a tree (without a tracer) or to trace it."""
        builder, tracer = column
        k = 2 * BUILDERS.index(builder) + bool(tracer)
        times, theirs = r.trace if tracer else r.build, GRIDS[r.grid][5 + k] if r.grid else UNCULLED[k]
        return beside(ms(times[f"{builder}+{tracer or tracers[0]}"]), theirs) if times else ""

    columns = (
        TableColumn("grid", lambda r: str(r.grid or "none")),
        label("marking", "marked"),
        TableColumn(
            "% remaining", lambda r: beside(percent(r.remaining), 100 * GRIDS[r.grid][0] if r.grid else None, 0)
        ),
        *columns_of({column: column for column in _STEPS_OF}, culling),
        *columns_of({(b, t): f"{t}, 1 spp" if t else f"build {b}" for b in BUILDERS for t in ("", *tracers)}, seconds),
    )
    title = "Grids, ms, means over the frames of an animated city"
    print_table(f"{title} (Table 4; in brackets the paper's, for another scene)", columns, rows)


# --- Plot -------------------------------------------------------------------------------------------------------------


def _sums(t: TimeToImage, spp: np.ndarray) -> np.ndarray:
    """Time to image in seconds for any number of samples, by linear interpolation and extrapolation."""
    traced = np.array([t.trace[s] for s in SAMPLES])
    beyond = np.maximum(spp - SAMPLES[-1], 0) * seconds_a_sample(t)
    sums: np.ndarray = t.cull + t.build + np.interp(spp, SAMPLES, traced) + beyond
    return sums


def write_plot(times: list[TimeToImage], path: Path) -> None:
    """Write Figure 7 with a panel per view and tracer. A dot marks where BSAH breaks even with a method."""
    figures, tracers = (list(dict.fromkeys(getattr(t, name) for t in times)) for name in ("figure", "tracer"))
    with plot_sheet(path, 4.2 * len(figures), 3.8 * len(tracers)) as sheet:
        panels = sheet.subplots(len(tracers), len(figures), squeeze=False)
        for row, tracer in zip(panels, tracers):
            for panel, figure in zip(row, figures):
                _draw(panel, {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)})
            row[0].set_ylabel("time to image / BSAH's")
        sheet.axes[0].legend(fontsize=8)


def _draw(panel: Any, methods: dict[str, TimeToImage]) -> None:
    """Draw the curves of one view and one tracer."""
    spp, last = np.geomspace(1, 1000, 200), methods["BSAH"]
    for method, t in methods.items():
        (line,) = panel.plot(spp, _sums(t, spp) / _sums(last, spp), label=method)
        even = break_even(last, t)
        if t is not last and even <= spp[-1]:
            panel.plot(even, 1.0, "o", color=line.get_color())
    title = f"{last.figure}, {last.tracer}"
    panel.set(xscale="log", title=title, xlabel="samples per pixel and light", ylim=(0, None))
    panel.grid(alpha=0.3)
