"""Prints the tables of the SRDH paper with the published results, compares the two, and draws Figures 2 and 4."""

from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from ....trace.rays.single_rays import FALSE, PATH, UNOCCLUDED
from ..bench_runner import TableColumn, columns_of, label, ms, percent, plot_sheet, print_notes, print_table
from ..comparison_chart import ComparedValue, ComparisonPanel, range_of
from . import srdh_measurements
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
    KernelGain,
    RenderTimes,
    RtsahCheck,
    SrdhRows,
    of,
    relative,
    scenes_of,
)
from .srdh_published import (
    BEDROOM,
    BLINDS_DEPTHS,
    GROWTH,
    PUBLISHED_BUILDS,
    PUBLISHED_UNOCCLUDED,
    REDUCTION,
    WITHIN,
    Lighting,
    both_over_sah,
)
from .srdh_trees import TreeMemory, TreeShape
from .srdh_workloads import NAMES

# --- Tables -----------------------------------------------------------------------------------------------------------


def print_tables(rows: SrdhRows) -> None:
    """Print all tables that were measured."""
    if rows.counts:
        _print_orders(rows.counts)
        _print_saved(rows.counts)
        _print_depths(rows.trees)
        _print_memory(rows.memory)
    if rows.rtsah:
        _print_rtsah(rows.rtsah)
    if rows.counts:
        _print_pixels(rows.counts)
        _print_kernels(rows.counts, srdh_measurements.kernel_gains(rows.counts, rows.trees))
    if rows.builds:
        _print_builds(rows.builds)
    if rows.renders:
        _print_renders(rows.renders)


def _print_orders(rows: list[BoxTests]) -> None:
    """Print ray counts, and Figure 2 as a table."""
    base = lambda row: of(rows, row.scene, srdh_measurements.BASE)
    sizes = (
        label("scene", "scene"),
        TableColumn("triangles", lambda r: f"{r.triangles:,}"),
        TableColumn("rays", lambda r: f"{r.rays:,}"),
        TableColumn("% blocked", lambda r: percent(r.blocked / r.rays)),
    )
    title = "Counted shadow rays; further lightings of a scene have a quarter of the pixels"
    print_table(title, sizes, [of(rows, name, srdh_measurements.BASE) for name in scenes_of(rows)])
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
            lambda r, order: percent(srdh_measurements.saved(rows, r, order)),
            lambda p, order: p[1].get(order, ""),
        ),
        TableColumn(
            "unoccluded rays",
            lambda r: percent(srdh_measurements.saved_unoccluded(rows, r)),
            lambda p: p[1].get("", ""),
        ),
    )
    published = (
        ("BEDROOM", {order: percent(share) for order, share in BEDROOM.items()}),
        *((name, {"": percent(share)}) for name, share in PUBLISHED_UNOCCLUDED.items()),
        ("all scenes", {srdh_measurements.BASE: " to ".join(map(percent, REDUCTION))}),
    )
    title = "Box tests saved by SRDH, as published with all rays as representative rays, % (Section 4.1)"
    print_table(title, columns, [of(rows, name, PUBLISHED) for name in scenes_of(rows)], published)


def _print_depths(rows: list[TreeShape]) -> None:
    """Print Figure 3 as a table."""
    columns = (
        label("scene", "scene", lambda _: "(paper: BEDROOM)"),
        label("tree", "method", lambda p: p[0]),
        TableColumn("frequent occluders", lambda r: f"{r.frequent:,}"),
        TableColumn("their subtrees", lambda r: f"{r.roots:,}"),
        TableColumn("depth of a tenth", lambda r: str(r.first)),
        TableColumn("of half", lambda r: str(r.half), lambda p: p[1]),
        TableColumn("of nine tenths", lambda r: str(r.most)),
    )
    published = [(tree, " and ".join(map(str, depths))) for tree, depths in BLINDS_DEPTHS.items()]
    title = "Depths of the subtrees of frequent occluders, which make up half of all intersections (Figure 3)"
    print_table(title, columns, rows, published)


def _print_memory(rows: list[TreeMemory]) -> None:
    """Print the memory of both trees."""
    size = lambda count: f"{count / 2**20:.1f}"
    columns = (
        label("scene", "scene", lambda _: "(paper: all scenes)"),
        TableColumn("triangles", lambda r: f"{r.triangles:,}"),
        TableColumn("SAH", lambda r: size(r.sah)),
        TableColumn("SRDH", lambda r: size(r.srdh)),
        TableColumn("both / SAH", lambda r: f"{r.growth:.2f}", lambda most: f"at most {most:g}"),
        TableColumn("with shared triangles", lambda r: f"{r.growth_shared:.2f}", lambda _: "less"),
        TableColumn("rays while building", lambda r: size(r.rays)),
    )
    print_table("Memory of trees with one triangle per leaf, MiB (Section 5)", columns, rows, [GROWTH])


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
    counted = {(r.scene, r.method, r.pixels): r for r in rows}
    sixteen = lambda r: srdh_measurements.beyond_all(rows, of(rows, r.scene, r.method, 16))

    def share(row: BoxTests, pixels: int | None) -> str:
        sparse = counted.get((row.scene, row.method, pixels))
        return f"{100 * relative(rows, sparse):.1f}" if sparse else ""

    columns = (
        label("scene", "scene"),
        label("method", "method"),
        *columns_of({k: f"{k} x {k}" if k else "all" for k in (*PIXELS, None)}, share),
        TableColumn("16 x 16 vs. all", lambda r: f"{100 * sixteen(r):+.1f} %"),
    )
    table = [of(rows, name, method) for name in scenes_of(rows) for method in (PUBLISHED, OURS)]
    print_table("Box tests, % of random order, by size of the pre-render (Figure 4)", columns, table)
    most = {method: max(sixteen(r) for r in table if r.method == method) for method in (PUBLISHED, OURS)}
    notes = [(method, f"16 x 16 at most {100 * share:.1f} % above all rays") for method, share in most.items()]
    print_notes([*notes, ("the paper's", f"at most {percent(WITHIN)} %")])


def _print_kernels(rows: list[BoxTests], gains: list[KernelGain]) -> None:
    """Print Figure 5 as a table."""
    heads = {
        srdh_measurements.CONSTANT: srdh_measurements.CONSTANT,
        srdh_measurements.DISTANCE: srdh_measurements.DISTANCE,
        PUBLISHED: "all kernels",
    }
    columns = (
        label("scene", "scene"),
        *columns_of(heads, lambda gain, method: f"{100 * relative(rows, of(rows, gain.scene, method)):.1f}"),
        TableColumn("distance vs. constant", lambda gain: f"{100 * gain.distance:+.1f} %"),
        TableColumn("all vs. constant", lambda gain: f"{100 * gain.both:+.1f} %"),
        TableColumn("nodes that choose distance", lambda gain: f"{100 * gain.chosen:.1f} %"),
    )
    title = "Box tests, % of random order, by available kernels, with all rays as representative rays (Figure 5)"
    print_table(title, columns, gains)


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
    """Print the gain of each tracer."""
    by = {(t.scene, t.tracer, t.build): t for t in times}
    time = lambda build, part: lambda gain: f"{1e3 * getattr(by[gain.scene, gain.tracer, build], part):.0f}"
    speed = lambda gain: by[gain.scene, gain.tracer, BUILDS[1]]
    columns = (
        label("scene", "scene"),
        label("tracer", "tracer"),
        TableColumn("build bsah", time(BUILDS[0], "built")),
        TableColumn("srdh", time(BUILDS[1], "built")),
        TableColumn("trace bsah", time(BUILDS[0], "traced")),
        TableColumn("srdh", time(BUILDS[1], "traced")),
        TableColumn("trace ratio", lambda gain: f"{gain.trace:.2f}"),
        TableColumn("total ratio", lambda gain: f"{gain.total:.2f}"),
        TableColumn("M rays/s", lambda gain: f"{speed(gain).rays / speed(gain).traced / 1e6:.1f}"),
    )
    title = f"Direct light on visible surfaces, {SPP} samples, ms: srdh and bsah"
    print_table(title, columns, srdh_measurements.gains(times))


# --- Our values beside the paper's ------------------------------------------------------------------------------------


def comparison(rows: SrdhRows) -> list[ComparisonPanel]:
    """The values of the chart on the paper's page, as published with all rays unless it says otherwise."""
    savings = [row for row in srdh_measurements.savings(rows.counts) if row["method"] == PUBLISHED]
    blinds = [row for row in savings if row["scene"].startswith("blinds")][:1]
    share = lambda values: range_of(100 * value for value in values)
    ours = lambda column, among: share(row[column] for row in among)
    saved = [
        ComparedValue(
            "all scenes, vs. random", (100 * REDUCTION[0], 100 * REDUCTION[1]), ours(srdh_measurements.BASE, savings)
        ),
        *(ComparedValue(f"blinds, vs. {order}", 100 * part, ours(order, blinds)) for order, part in BEDROOM.items()),
        ComparedValue("unoccluded rays", share(PUBLISHED_UNOCCLUDED.values()), ours("unoccluded", savings)),
    ]
    sparse = [ComparedValue("trees for 16 x 16 pixels", (0.0, 100 * WITHIN), ours("beyond_all", savings))]
    kernels = srdh_measurements.kernel_gains(rows.counts, rows.trees)
    opposed = [gain.distance for gain in kernels if NAMES[Lighting.opposed] in gain.scene]
    sparse.append(ComparedValue("all kernels vs. constant", None, share(gain.both for gain in kernels)))
    sparse.append(ComparedValue("distance kernels, opposed lights", None, share(opposed)))
    built = [
        ComparedValue(
            f"{k} x {k} pixels",
            range_of(row.both for row in PUBLISHED_BUILDS if row.pixels == k),
            range_of(row.both for row in rows.builds if row.pixels == k),
        )
        for k in BUILD_PIXELS
    ]
    half = {method: [row.half for row in rows.trees if row.method == method] for method in ("SAH", PUBLISHED)}
    depths = [
        ComparedValue(f"{tree} tree", range_of(BLINDS_DEPTHS[tree]), range_of(half[method]))
        for tree, method in (("SAH", "SAH"), ("SRDH", PUBLISHED))
    ]
    return [
        ComparisonPanel("Box tests saved by SRDH (Section 4.1)", "%", saved),
        ComparisonPanel("More box tests with less information (Figures 4 and 5)", "%", sparse),
        ComparisonPanel("Time to build both trees (Table 1)", "relative to the SAH tree alone", built),
        ComparisonPanel("Depth of frequent occluders (Figure 3)", "depth of the subtrees with half of them", depths),
    ]


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
    with_curves = [scene for scene in scenes if any((r.scene, r.pixels) == (scene, PIXELS[-1]) for r in rows)]
    with plot_sheet(path, 9.0) as sheet:
        above, below = sheet.subplots(2, 1)
        _draw_bars(above, rows, scenes)
        _draw_curves(below, rows, with_curves)


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
    panel.legend(handles=methods + classes, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    slanted: dict[str, Any] = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"}
    panel.set_xticks(range(len(scenes)), [scene.replace(", ", ",\n") for scene in scenes], fontsize=8, **slanted)
    panel.set_ylabel("box tests relative to random order")
    panel.grid(visible=False, axis="x")


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
    panel.legend(ncols=2, loc="lower left")
