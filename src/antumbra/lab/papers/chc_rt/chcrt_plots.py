"""Plots of ``antumbra bench chc-rt``: our results and the paper's at a glance, and Figures 7 and 8.

[Mattausch et al. 2015, Tables 2 and 3, Figures 7 and 8].
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from ....store.chunk_residency import POLICIES
from ..bench_runner import plot_sheet
from . import chcrt_published
from .walkthrough_timing import PHASES, Turn, later, of, rows_of, speedup, speedups, typical, value_of
from .walkthroughs import FRUSTA, SINGLE

# --- At a glance ------------------------------------------------------------------------------------------------------


_OURS, _SAME, _THEIRS = "tab:blue", "tab:green", "tab:orange"
_PAPER = "the paper"
_TIMES, _SHARES = (
    (0.25, 0.5, 1.0, 2.0, 4.0, 8.0),
    (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0),
)  # where the axes are labelled


def speedup_points(turns: list[Turn]) -> dict[str, tuple[list[float], list[float], list[float]]]:
    """Kind -> the speedups over plain tracing from the root, one per scene and view.

    They are (ours over single rays, ours over frusta, the paper's). CHC+RT shares its kernel with frusta.
    """
    ours, same = speedups(turns), speedups(turns, FRUSTA)
    theirs = dict(zip(chcrt_published.KINDS, map(chcrt_published.speedups, range(len(chcrt_published.KINDS)))))
    return {kind: (ours.get(kind, []), same.get(kind, []), theirs.get(kind, [])) for kind in (ours or theirs)}


def moved_points(turns: list[Turn], sizes: Mapping[str, int]) -> dict[str, tuple[list[float], list[float]]]:
    """Kind -> share of the store read per frame: (ours, the paper's), one per scene and view.

    sizes : scene -> bytes of its store
    """
    paged = [t for t in turns if "bytes" in t.statistics and t.method == POLICIES[0] and t.scene in sizes]
    walks, points = rows_of(paged, "scene", "view"), {}
    for k, kind in enumerate(chcrt_published.KINDS):
        mine = [typical(of(paged, kind=kind, **walk), "bytes") / sizes[walk["scene"]] for walk in walks]
        points[kind] = mine, chcrt_published.moved(k)
    return points


def _draw_overview(sheet: Any, turns: list[Turn], sizes: Mapping[str, int]) -> None:
    """Draw the paper's results and ours side by side: a dot per scene and view, and a line at the median."""
    sheet.suptitle("The paper's results and ours (a dot per scene and view; lines: medians)")
    panels = sheet.subplots(2, 1)
    over = f"ours, over {SINGLE}: frusta against single rays", f"ours, over {FRUSTA}: the same kernel"
    _draw_points(panels[0], speedup_points(turns), dict(zip((*over, _PAPER), (_OURS, _SAME, _THEIRS))))
    panels[0].set_title("in memory: times as fast as tracing from the root", fontsize=10)
    panels[0].set(yscale="log", yticks=_TIMES, yticklabels=[f"{x:g}" for x in _TIMES])
    panels[0].axhline(1.0, color="0.6", lw=0.8)
    panels[0].minorticks_off()
    _draw_points(panels[1], moved_points(turns, sizes), {"ours": _OURS, _PAPER: _THEIRS})
    panels[1].set_title("out of core: % of the store read per frame", fontsize=10)
    panels[1].set_yscale("symlog", linthresh=1e-5)
    panels[1].set(ylim=(-2e-6, None), yticks=_SHARES, yticklabels=[f"{100 * x:g}" for x in _SHARES])
    panels[1].minorticks_off()
    for panel, place in zip(panels, ("upper center", "lower right")):
        panel.legend(loc=place, fontsize=8)


def _draw_points(panel: Any, points: Mapping[str, Sequence[list[float]]], colours: dict[str, str]) -> None:
    """Draw the points of each ray kind, a column per name in `colours`."""
    shifts = 0.27 * (np.arange(len(colours)) - (len(colours) - 1) / 2)
    for i, columns in enumerate(points.values()):
        for values, (name, colour), shift in zip(columns, colours.items(), shifts):
            at = np.full(len(values), i + shift)
            panel.plot(at, values, "o", color=colour, ms=4, alpha=0.6, label=name if i == 0 else None)
            if values:
                panel.plot([i + shift - 0.12, i + shift + 0.12], [median(values)] * 2, "-", color=colour, lw=2.5)
    panel.set_xticks(range(len(points)), list(points), fontsize=8)
    panel.grid(axis="y", alpha=0.3)


# --- Figures 7 and 8: curves over the frames, and bars of the phases --------------------------------------------------


_OVERVIEW, _WALK = 6.4, 4.4  # inches: heights of the overview, and of a walkthrough
_TIME_PARTS = ("before", *PHASES)
_COLOURS = ("0.7", "tab:blue", "tab:orange", "tab:red")


def write_plot(turns: list[Turn], sizes: Mapping[str, int], path: Path) -> None:
    """Write a plot: the overview, then a row per scene and view with bars, and a panel of curves per ray kind.

    sizes : scene -> bytes of its store
    """
    walks, kinds = rows_of(turns, "scene", "view"), rows_of(turns, "kind")
    colours = {row["method"]: f"C{i}" for i, row in enumerate(rows_of(turns, "method"))}
    with plot_sheet(path, _OVERVIEW + _WALK * len(walks)) as whole:
        top, *below = whole.subfigures(1 + len(walks), 1, height_ratios=[_OVERVIEW] + [_WALK] * len(walks))
        _draw_overview(top, turns, sizes)
        for sheet, walk in zip(below, walks):
            mine = of(turns, **walk)
            sheet.suptitle(", ".join(walk.values()), fontsize=10)
            left, right = sheet.subfigures(1, 2, width_ratios=[1.0, 1.8])
            bars = left.subplots()
            _draw_bars(bars, mine)
            left.legend(*bars.get_legend_handles_labels(), loc="outside lower center", ncols=2)
            panels = list(right.subplots(-(-len(kinds) // 2), 2, squeeze=False).flat)
            for panel, kind in zip(panels, kinds):
                _draw_curves(panel, of(mine, **kind), colours)
                panel.set_title(kind["kind"], fontsize=9)
            lines = {line.get_label(): line for panel in panels for line in panel.get_lines()}
            right.legend(lines.values(), lines, loc="outside lower center", ncols=len(lines))


def shares(turns: list[Turn]) -> dict[str, float]:
    """Each phase's share of the time of the frames after the first; the shares add up to 1."""
    after = later(turns)
    return {part: sum(value_of(t, part) for t in after) / sum(t.seconds for t in after) for part in _TIME_PARTS}


def _draw_bars(panel: Any, turns: list[Turn]) -> None:
    """Draw a bar per ray kind and method with phases, next to plain tracing from the root."""
    rows = rows_of([t for t in turns if t.statistics], "kind", "method")
    at, bottom, bars = np.arange(len(rows)), np.zeros(len(rows)), [of(turns, **row) for row in rows]
    root = [of(turns, kind=row["kind"], method=SINGLE) for row in rows]
    width = 0.4 if any(root) else 0.8
    for name, colour in zip(_TIME_PARTS, _COLOURS):
        part = np.array([shares(bar)[name] for bar in bars])
        panel.bar(at, part, width, bottom, color=colour, label=name)
        bottom += part
    if any(root):
        ratios = [speedup(ours, theirs) if theirs else 0.0 for ours, theirs in zip(bars, root)]
        panel.bar(at + width, ratios, width, color="white", edgecolor="black", hatch="//", label=SINGLE)
    several = len({row["method"] for row in rows}) > 1
    names = [", ".join(row.values()) if several else row["kind"] for row in rows]
    middle = at + width / 2 if any(root) else at
    panel.set_xticks(middle, names, fontsize=8, rotation=35, ha="right", rotation_mode="anchor")
    panel.set_ylabel("share of CHC+RT's time", fontsize=8)


def _draw_curves(panel: Any, turns: list[Turn], colours: dict[str, str]) -> None:
    highest = 0.0
    for row in rows_of(turns, "method"):
        some = of(turns, **row)
        name, ms = row["method"], [1e3 * t.seconds for t in some]
        panel.plot([t.frame for t in some], ms, marker=".", color=colours[name], label=name)
        highest = max(highest, *ms)
    panel.set(ylim=(0, 1.08 * highest), xlabel="frame", ylabel="ms")
    panel.xaxis.get_major_locator().set_params(integer=True)
    panel.grid(alpha=0.3)
