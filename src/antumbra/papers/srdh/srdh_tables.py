"""Prints the tables of the SRDH paper with the published results, and draws its Figures 2 and 4."""

from pathlib import Path
from typing import Any

import numpy as np

from ...cli import console as report
from ...files import atomic_output
from ...trace.rays.single_rays import FALSE, PATH, UNOCCLUDED
from . import srdh_measurements as bench
from .srdh_measurements import (
    BUILD_PIXELS,
    BUILDS,
    OURS,
    PIXELS,
    PUBLISHED,
    SAH_ORDERS,
    SPP,
    TRACERS,
    BoxTests,
    BuildTimes,
    RenderTimes,
    RtsahCheck,
    of,
    relative,
    scenes_of,
)

# --- Published results for the paper's five scenes [Feltman et al. 2012, Sec. 4, Table 1] -----------------------------


REDUCTION = (0.22, 0.56)
"""Sec. 1, 5: minimum and maximum share of box tests that SRDH saves relative to random order, with all rays as
representative rays."""

WITHIN = 0.06
"""Sec. 4.2: largest extra cost of trees for the rays of 16 x 16 pixels, relative to trees for all rays."""

PUBLISHED_UNOCCLUDED = {"SPONZA": 0.19, "ARCADE": 0.24}
"""Sec. 4.1: share of box tests of unoccluded rays that SRDH saves."""

BEDROOM = {"random": 0.56, "back-to-front": 0.41, "rtsah": 0.44}
"""Sec. 4.1: share of box tests that SRDH saves relative to orders of the SAH tree, for light through blinds."""

PUBLISHED_BUILDS = {
    "MADSCI": (80_149, 1.7, {16: (5_505, 3.0), 32: (22_477, 6.2)}),
    "BEDROOM": (361_754, 7.7, {16: (4_864, 10.1), 32: (19_198, 12.2)}),
    "FAIRY": (174_117, 3.6, {16: (366, 4.6), 32: (1_451, 4.7)}),
    "SPONZA": (66_444, 1.2, {16: (416, 1.6), 32: (1_648, 1.8)}),
    "ARCADE": (66_444, 1.2, {16: (774, 1.7), 32: (3_110, 2.1)}),
}
"""Table 1: scene -> (triangles, seconds of SAH, width of the pre-render -> (rays, seconds of SRDH)); one thread."""


def both_over_sah(pixels: int) -> float:
    """The time to build both trees relative to SAH alone, as mean over the scenes."""
    ratios = [(sah + pre_renders[pixels][1]) / sah for _, sah, pre_renders in PUBLISHED_BUILDS.values()]
    return sum(ratios) / len(ratios)


# --- Tables -----------------------------------------------------------------------------------------------------------


_WIDTH = 150  # width of the tables, in characters


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f}"


def print_orders(rows: list[BoxTests]) -> None:
    """Print ray counts, and Figure 2 as a table."""

    counts, table = [], []
    for name in bench.scenes_of(rows):
        base = bench.of(rows, name, bench.BASE)
        counts.append((name, f"{base.triangles:,}", f"{base.rays:,}", _percent(base.blocked / base.rays)))
        for method in (*bench.SAH_ORDERS, bench.PUBLISHED, bench.OURS):
            r = bench.of(rows, name, method)
            parts = [_percent(part / base.total) for part in (r.total, *r.boxes)]
            table.append((name, method, *parts, f"{r.total / r.rays:.1f}", f"{r.tested / r.rays:.2f}"))
    print("Counted shadow rays")
    report.print_table(("scene", "triangles", "rays", "% blocked"), counts, right=range(1, 4), width=_WIDTH)
    classes = "path to the hit", "false hits", "unoccluded"
    head = ("scene", "method", "all", *classes, "boxes per ray", "triangles per ray")
    print("Box tests, % of random order; SRDH with all rays as representative rays (Figure 2)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def print_saved(rows: list[BoxTests]) -> None:
    """Print the savings that the paper's text derives from Figure 2."""

    table = []
    for name in bench.scenes_of(rows):
        r = bench.of(rows, name, bench.PUBLISHED)
        shares = [bench.saved(rows, r, order) for order in bench.SAH_ORDERS]
        table.append((name, *map(_percent, shares), _percent(bench.saved_unoccluded(rows, r))))
    blinds = (_percent(BEDROOM[order]) if order in BEDROOM else "" for order in bench.SAH_ORDERS)
    table.append(("(paper: BEDROOM)", *blinds, ""))
    table += [(f"(paper: {name})", *[""] * 4, _percent(share)) for name, share in PUBLISHED_UNOCCLUDED.items()]
    least, most = map(_percent, REDUCTION)
    table.append(("(paper: all scenes)", f"{least} to {most}", *[""] * 4))
    head = ("scene", *(f"vs. {order}" for order in bench.SAH_ORDERS), "unoccluded rays")
    print("Box tests saved by SRDH, as published with all rays as representative rays, % (Section 4.1)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_rtsah(rows: list[RtsahCheck]) -> None:
    """Print RTSAH with the lines that it assumes and with shadow rays."""
    bedroom = (1 - BEDROOM["random"]) / (1 - BEDROOM["rtsah"])
    table = [(r.scene, *map(_percent, r[1:])) for r in rows] + [("(paper: BEDROOM)", "", "", _percent(bedroom), "")]
    head = ("scene", "uniform lines", "reversed", "shadow rays", "reversed")
    print("Box tests with RTSAH and with the opposite order, % of random order")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_pixels(rows: list[BoxTests]) -> None:
    """Print Figure 4 as a table."""

    table, beyond = [], dict[str, list[float]]()
    for name in bench.scenes_of(rows):
        for method in (bench.PUBLISHED, bench.OURS):
            pre_renders = [bench.of(rows, name, method, k) for k in (*bench.PIXELS, None)]
            sixteen = bench.beyond_all(rows, bench.of(rows, name, method, 16))
            beyond.setdefault(method, []).append(sixteen)
            cells = [f"{100 * bench.relative(rows, r):.1f}" for r in pre_renders]
            table.append((name, method, *cells, f"{100 * sixteen:+.1f} %"))
    head = ("scene", "method", *(f"{k} x {k}" for k in bench.PIXELS), "all", "16 x 16 vs. all")
    print("Box tests, % of random order, by size of the pre-render (Figure 4)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
    most = {method: f"16 x 16 at most {100 * max(shares):.1f} % above all rays" for method, shares in beyond.items()}
    report.print_fields([*most.items(), ("the paper's", f"at most {_percent(WITHIN)} %")])
    print()


def print_kernels(rows: list[BoxTests]) -> None:
    """Print Figure 5 as a table."""

    methods = (bench.CONSTANT, bench.DISTANCE, bench.PUBLISHED)
    table = []
    for name in bench.scenes_of(rows):
        kernel_rows = [bench.of(rows, name, method) for method in methods]
        table.append((name, *(f"{100 * bench.relative(rows, r):.1f}" for r in kernel_rows)))
    head = ("scene", *methods[:2], "all kernels")
    print("Box tests, % of random order, by available kernels, with all rays as representative rays (Figure 5)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_builds(times: list[BuildTimes]) -> None:
    """Print Table 1 with the paper's rows, and the build times of a renderer without another tree."""
    table: list[tuple[str, ...]] = []
    for t in times:
        published = _ms(t.sah_single), _ms(t.rays_by_sah), _ms(t.published), f"{t.both:.2f}"
        ours = _ms(t.sah), _ms(t.rays_by_lbvh), _ms(t.srdh), f"{t.instead:.2f}"
        size = f"{t.pixels} x {t.pixels}"
        table.append((t.scene, f"{t.triangles:,}", size, f"{t.rays:,}", f"{t.hits:,}", *published, *ours))
    for name, (triangles, sah, pre_renders) in PUBLISHED_BUILDS.items():
        for k, (rays, srdh) in pre_renders.items():
            theirs = _ms(sah), "", _ms(srdh), f"{(sah + srdh) / sah:.2f}"
            table.append((f"(paper: {name})", f"{triangles:,}", f"{k} x {k}", f"{rays:,}", "", *theirs, *[""] * 4))
    published = "SAH", "its rays", "SRDH", "both / SAH"
    ours = "bsah", "lbvh, rays", "srdh", "srdh only / bsah"
    head = ("scene", "triangles", "pixels", "rays", "hits", *published, *ours)
    print("Build times, ms: as published, with one triangle per leaf on one thread; then in a renderer (Table 1)")
    report.print_table(head, table, right=(1, *range(3, len(head))), width=_WIDTH)
    means = []
    for k in BUILD_PIXELS:
        same_size = [t for t in times if t.pixels == k]
        both, instead = (sum(getattr(t, name) for t in same_size) / len(same_size) for name in ("both", "instead"))
        their_both = both_over_sah(k)
        text = f"both / SAH {both:.2f} (the paper's {their_both:.2f}), srdh only / bsah {instead:.2f}"
        means.append((f"{k} x {k}", text))
    report.print_fields(means)
    print()


def print_renders(times: list[RenderTimes]) -> None:
    """Print the gain of each tracer."""

    table = []
    for name in dict.fromkeys(t.scene for t in times):
        for tracer in TRACERS:
            sah, ours = (next(t for t in times if t[:3] == (name, build, tracer)) for build in BUILDS)
            ms = (f"{1e3 * t:.0f}" for t in (sah.built, ours.built, sah.traced, ours.traced))
            all_ = (ours.built + ours.traced) / (sah.built + sah.traced)
            rate = f"{ours.rays / ours.traced / 1e6:.1f}"
            table.append((name, tracer, *ms, f"{ours.traced / sah.traced:.2f}", f"{all_:.2f}", rate))
    head = ("scene", "tracer", "build bsah", "srdh", "trace bsah", "srdh", "trace ratio", "total ratio", "M rays/s")
    print(f"Direct light on visible surfaces, {SPP} samples, ms: srdh and bsah")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


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
    from matplotlib.figure import Figure

    scenes = scenes_of(rows)
    sheet = Figure(figsize=(max(7.0, 2.2 * len(scenes)), 8.0), layout="constrained")
    above, below = sheet.subplots(2, 1)
    _draw_bars(above, rows, scenes)
    _draw_curves(below, rows, scenes)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


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
            label = scene if method == PUBLISHED else None
            panel.plot([*PIXELS, last], ratios, style, marker=".", color=f"C{k}", label=label)
    panel.plot([], [], "k-", label=PUBLISHED)
    panel.plot([], [], "k--", label=OURS)
    panel.set_xscale("log", base=2)
    panel.set_xticks([*PIXELS, last], [*(f"{k} x {k}" for k in PIXELS), "all"])
    panel.set(ylim=(0, None), xlabel="pixels of the pre-render", ylabel="box tests relative to random order")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, ncols=2, loc="lower left")
