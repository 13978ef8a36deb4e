"""Prints the tables of the SRDH paper with the published results, and draws its Figures 2 and 4."""

from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from ...trace.rays.single_rays import FALSE, PATH, UNOCCLUDED
from ..bench_runner import TableColumn, columns_of, label, ms, percent, plot_sheet, print_notes, print_table
from . import srdh_measurements as bench
from .srdh_measurements import (
    BUILD_PIXELS,
    BUILDS,
    OURS,
    PIXELS,
    PUBLISHED,
    SAH_ORDERS,
    SPP,
    BoxTests,
    BuildTimes,
    RenderTimes,
    RtsahCheck,
    of,
    relative,
    scenes_of,
)
from .srdh_published import BEDROOM, PUBLISHED_BUILDS, PUBLISHED_UNOCCLUDED, REDUCTION, WITHIN, both_over_sah

# --- Tables -----------------------------------------------------------------------------------------------------------


class SrdhRows(NamedTuple):
    """All measured rows."""

    counts: list[BoxTests]
    rtsah: list[RtsahCheck]
    builds: list[BuildTimes]
    renders: list[RenderTimes]


def print_tables(rows: SrdhRows) -> None:
    """Print all tables."""
    _print_orders(rows.counts)
    _print_saved(rows.counts)
    _print_rtsah(rows.rtsah)
    _print_pixels(rows.counts)
    _print_kernels(rows.counts)
    _print_builds(rows.builds)
    _print_renders(rows.renders)


def _print_orders(rows: list[BoxTests]) -> None:
    """Print ray counts, and Figure 2 as a table."""
    base = lambda row: of(rows, row.scene, bench.BASE)
    sizes = (
        label("scene", "scene"),
        TableColumn("triangles", lambda r: f"{r.triangles:,}"),
        TableColumn("rays", lambda r: f"{r.rays:,}"),
        TableColumn("% blocked", lambda r: percent(r.blocked / r.rays)),
    )
    print_table("Counted shadow rays", sizes, [of(rows, name, bench.BASE) for name in scenes_of(rows)])
    columns = (
        label("scene", "scene"),
        label("method", "method"),
        TableColumn("all", lambda r: percent(relative(rows, r))),
        *columns_of(
            dict(enumerate(("path to the hit", "false hits", "unoccluded"))),
            lambda r, k: percent(r.boxes[k] / base(r).total),
        ),
        TableColumn("boxes per ray", lambda r: f"{r.total / r.rays:.1f}"),
        TableColumn("triangles per ray", lambda r: f"{r.tested / r.rays:.2f}"),
    )
    methods = (*SAH_ORDERS, PUBLISHED, OURS)
    title = "Box tests, % of random order; SRDH with all rays as representative rays (Figure 2)"
    print_table(title, columns, [of(rows, name, method) for name in scenes_of(rows) for method in methods])


def _print_saved(rows: list[BoxTests]) -> None:
    """Print the savings that the paper's text derives from Figure 2."""
    columns = (
        label("scene", "scene", lambda p: f"(paper: {p[0]})"),
        *columns_of(
            {order: f"vs. {order}" for order in SAH_ORDERS},
            lambda r, order: percent(bench.saved(rows, r, order)),
            lambda p, order: p[1].get(order, ""),
        ),
        TableColumn("unoccluded rays", lambda r: percent(bench.saved_unoccluded(rows, r)), lambda p: p[1].get("", "")),
    )
    published = (
        ("BEDROOM", {order: percent(share) for order, share in BEDROOM.items()}),
        *((name, {"": percent(share)}) for name, share in PUBLISHED_UNOCCLUDED.items()),
        ("all scenes", {bench.BASE: " to ".join(map(percent, REDUCTION))}),
    )
    title = "Box tests saved by SRDH, as published with all rays as representative rays, % (Section 4.1)"
    print_table(title, columns, [of(rows, name, PUBLISHED) for name in scenes_of(rows)], published)


def _print_rtsah(rows: list[RtsahCheck]) -> None:
    """Print RTSAH with the lines that it assumes and with shadow rays."""
    columns = (
        label("scene", "scene", lambda _: "(paper: BEDROOM)"),
        TableColumn("uniform lines", lambda r: percent(r.lines)),
        TableColumn("reversed", lambda r: percent(r.lines_reversed)),
        TableColumn("shadow rays", lambda r: percent(r.rays), lambda b: percent((1 - b["random"]) / (1 - b["rtsah"]))),
        TableColumn("reversed", lambda r: percent(r.rays_reversed)),
    )
    print_table("Box tests with RTSAH and with the opposite order, % of random order", columns, rows, [BEDROOM])


def _print_pixels(rows: list[BoxTests]) -> None:
    """Print Figure 4 as a table. Its rows are those of the trees for all rays."""
    sixteen = lambda r: bench.beyond_all(rows, of(rows, r.scene, r.method, 16))
    columns = (
        label("scene", "scene"),
        label("method", "method"),
        *columns_of(
            {k: f"{k} x {k}" if k else "all" for k in (*PIXELS, None)},
            lambda r, k: f"{100 * relative(rows, of(rows, r.scene, r.method, k)):.1f}",
        ),
        TableColumn("16 x 16 vs. all", lambda r: f"{100 * sixteen(r):+.1f} %"),
    )
    table = [of(rows, name, method) for name in scenes_of(rows) for method in (PUBLISHED, OURS)]
    print_table("Box tests, % of random order, by size of the pre-render (Figure 4)", columns, table)
    most = {method: max(sixteen(r) for r in table if r.method == method) for method in (PUBLISHED, OURS)}
    notes = [(method, f"16 x 16 at most {100 * share:.1f} % above all rays") for method, share in most.items()]
    print_notes([*notes, ("the paper's", f"at most {percent(WITHIN)} %")])


def _print_kernels(rows: list[BoxTests]) -> None:
    """Print Figure 5 as a table."""
    heads = {bench.CONSTANT: bench.CONSTANT, bench.DISTANCE: bench.DISTANCE, PUBLISHED: "all kernels"}
    share = lambda scene, method: f"{100 * relative(rows, of(rows, scene, method)):.1f}"
    title = "Box tests, % of random order, by available kernels, with all rays as representative rays (Figure 5)"
    print_table(title, [label("scene", str), *columns_of(heads, share)], scenes_of(rows))


def _print_builds(times: list[BuildTimes]) -> None:
    """Print Table 1 with the paper's rows, and the build times of a renderer without another tree."""
    size, triangles, rays = lambda t: f"{t.pixels} x {t.pixels}", lambda t: f"{t.triangles:,}", lambda t: f"{t.rays:,}"
    columns = (
        label("scene", "scene", lambda p: f"(paper: {p.scene})"),
        TableColumn("triangles", triangles, triangles),
        label("pixels", size, size),
        TableColumn("rays", rays, rays),
        TableColumn("hits", lambda t: f"{t.hits:,}"),
        TableColumn("SAH", lambda t: ms(t.sah_single), lambda p: ms(p.sah)),
        TableColumn("its rays", lambda t: ms(t.rays_by_sah)),
        TableColumn("SRDH", lambda t: ms(t.published), lambda p: ms(p.srdh)),
        TableColumn("both / SAH", lambda t: f"{t.both:.2f}", lambda p: f"{p.both:.2f}"),
        TableColumn("bsah", lambda t: ms(t.sah)),
        TableColumn("lbvh, rays", lambda t: ms(t.rays_by_lbvh)),
        TableColumn("srdh", lambda t: ms(t.srdh)),
        TableColumn("srdh only / bsah", lambda t: f"{t.instead:.2f}"),
    )
    title = "Build times, ms: as published, with one triangle per leaf on one thread; then in a renderer (Table 1)"
    print_table(title, columns, times, PUBLISHED_BUILDS)
    means = []
    for k in BUILD_PIXELS:
        both, instead = (fmean(getattr(t, name) for t in times if t.pixels == k) for name in ("both", "instead"))
        text = f"both / SAH {both:.2f} (the paper's {both_over_sah(k):.2f}), srdh only / bsah {instead:.2f}"
        means.append((f"{k} x {k}", text))
    print_notes(means)


def _print_renders(times: list[RenderTimes]) -> None:
    """Print the gain of each tracer. Rows are pairs of results with bsah and srdh."""
    by = {(t.scene, t.tracer, t.build): t for t in times}
    pairs = [tuple(by[scene, tracer, build] for build in BUILDS) for scene, tracer, build in by if build == BUILDS[0]]
    rounded = lambda seconds: f"{1e3 * seconds:.0f}"
    columns = (
        label("scene", lambda pair: pair[0].scene),
        label("tracer", lambda pair: pair[0].tracer),
        TableColumn("build bsah", lambda pair: rounded(pair[0].built)),
        TableColumn("srdh", lambda pair: rounded(pair[1].built)),
        TableColumn("trace bsah", lambda pair: rounded(pair[0].traced)),
        TableColumn("srdh", lambda pair: rounded(pair[1].traced)),
        TableColumn("trace ratio", lambda pair: f"{pair[1].traced / pair[0].traced:.2f}"),
        TableColumn("total ratio", lambda pair: f"{pair[1].total / pair[0].total:.2f}"),
        TableColumn("M rays/s", lambda pair: f"{pair[1].rays / pair[1].traced / 1e6:.1f}"),
    )
    print_table(f"Direct light on visible surfaces, {SPP} samples, ms: srdh and bsah", columns, pairs)


# --- Plot -------------------------------------------------------------------------------------------------------------


_BARS = (*SAH_ORDERS, PUBLISHED, OURS)
_COLOURS = ("0.55", "tab:blue", "tab:cyan", "tab:green", "tab:red", "tab:orange")
_CLASSES = (
    (UNOCCLUDED, "unoccluded rays", 1.0),
    (FALSE, "false hits of occluded rays", 0.6),
    (PATH, "path to the hit", 0.3),
)
"""(class, label, opacity) of the parts of a bar, from the bottom, as in the paper."""


def write_plot(rows: list[BoxTests], path: Path) -> None:
    """Write a plot: Figure 2 as bars grouped by scene at the top, Figure 4 as curves coloured by scene below."""
    scenes = scenes_of(rows)
    with plot_sheet(path, max(7.0, 2.2 * len(scenes)), 8.0) as sheet:
        above, below = sheet.subplots(2, 1)
        _draw_bars(above, rows, scenes)
        _draw_curves(below, rows, scenes)


def _draw_bars(panel: Any, rows: list[BoxTests], scenes: list[str]) -> None:
    from matplotlib.patches import Patch

    width = 0.85 / len(_BARS)
    for k, (method, colour) in enumerate(zip(_BARS, _COLOURS)):
        scene_rows = [of(rows, scene, method) for scene in scenes]
        bases = [of(rows, scene, SAH_ORDERS[0]).total for scene in scenes]
        at, bottom = np.arange(len(scenes)) + (k - (len(_BARS) - 1) / 2) * width, np.zeros(len(scenes))
        for number, _, opaque in _CLASSES:
            part = np.array([r.boxes[number] / base for r, base in zip(scene_rows, bases)])
            panel.bar(at, part, 0.92 * width, bottom, color=colour, alpha=opaque, linewidth=0)
            bottom += part
    methods = [Patch(color=colour, label=method) for method, colour in zip(_BARS, _COLOURS)]
    classes = [Patch(facecolor="black", alpha=opaque, label=label) for _, label, opaque in reversed(_CLASSES)]
    panel.legend(handles=methods + classes, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    panel.set_xticks(range(len(scenes)), scenes)
    panel.set_ylabel("box tests relative to random order")
    panel.grid(axis="y", alpha=0.3)
    panel.set_axisbelow(True)


def _draw_curves(panel: Any, rows: list[BoxTests], scenes: list[str]) -> None:
    last = 2 * PIXELS[-1]  # x of "all rays"
    for k, scene in enumerate(scenes):
        for method, style in ((PUBLISHED, "-"), (OURS, "--")):
            ratios = [relative(rows, of(rows, scene, method, pixels)) for pixels in (*PIXELS, None)]
            name = scene if method == PUBLISHED else None
            panel.plot([*PIXELS, last], ratios, style, marker=".", color=f"C{k}", label=name)
    panel.plot([], [], "k-", label=PUBLISHED)
    panel.plot([], [], "k--", label=OURS)
    panel.set_xscale("log", base=2)
    panel.set_xticks([*PIXELS, last], [*(f"{k} x {k}" for k in PIXELS), "all"])
    panel.set(ylim=(0, None), xlabel="pixels of the pre-render", ylabel="box tests relative to random order")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, ncols=2, loc="lower left")
