"""Draws the plot of ``antumbra bench multi-frusta``: speedups beside the paper's, and Figures 5 to 7."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..bench_runner import plot_sheet
from . import frusta_published
from .frusta_measurements import FIGURE6, MeasuredScene, Rows

_STYLES = dict(zip(FIGURE6[1:], ("-", "--")))
_PANELS = (("triangles", "triangles accessed"), ("triangle_tests", "tests of a triangle with 16 rays"))
_BAR_ROW, _CURVE_ROW, _PICTURE_ROW = 3.2, 3.0, 3.8  # heights in inches
_BARS = {
    "P": ("table 1 primary", ("primary:paper", "multifrusta")),
    "S": ("table 1", ("multifrusta:paper", "multifrusta")),
}
_HEADS = {"P": "primary rays (Table 1, P)", "S": "soft shadows (Table 1, S)"}


def write_plot(scenes: Sequence[MeasuredScene], path: Path) -> None:
    """Write a plot: speedups at the top, then Figure 6, and below them a row per scene with Figures 5 and 7.

    scenes : with all tables
    """
    heights = [2 * _BAR_ROW, 2 * _CURVE_ROW, 2 * _PICTURE_ROW * len(scenes)]
    with plot_sheet(path, sum(heights)) as sheet:
        (first,), (second,), (third,) = sheet.subfigures(3, 1, squeeze=False, height_ratios=heights)
        for panel, kind in zip(first.subplots(2, 1), _BARS):
            _draw_speedups(panel, kind, scenes)
        curves = list(second.subplots(2, 2).flat)
        for panel, ((counter, axis), power) in zip(curves, [(p, e) for p in _PANELS for e in (1, 2)]):
            _draw_sizes(panel, {s.name: s.tables["figure 6"] for s in scenes}, (counter, axis), power)
        lines = curves[0].get_legend_handles_labels()
        second.legend(*lines, loc="outside lower center", ncols=2, title="dotted: linear")
        panels = iter(third.subplots(2 * len(scenes), 2).flat)
        for scene in scenes:
            assert scene.quality is not None
            for (title, picture), panel in zip(scene.quality.pictures.items(), panels):
                panel.imshow(picture, interpolation="nearest")
                panel.set_title(f"{scene.name}: {title}", fontsize=9)
                panel.set_axis_off()


def _draw_speedups(panel: Any, kind: str, scenes: Sequence[MeasuredScene]) -> None:
    """Draw how much faster than the paper's packets frusta are: a bar per scene, the paper's first."""
    theirs = {packets.scene: packets.cycles / frusta.cycles for packets, frusta in frusta_published.pairs(kind)}
    panel.bar(list(theirs), list(theirs.values()), 0.8, color="0.6", label="the paper")
    table, tracers = _BARS[kind]
    for k, tracer in enumerate(tracers):
        at = [len(theirs) + n + 0.4 * (k - 0.5) for n in range(len(scenes))]
        rows = [scene.tables[table] for scene in scenes]
        bars = panel.bar(at, [r["packet16:paper"]["seconds"] / r[tracer]["seconds"] for r in rows], 0.4, label=tracer)
        panel.bar_label(bars, fmt="%.1f", fontsize=8)
    names = [*theirs, *(scene.name for scene in scenes)]
    panel.set_xticks(range(len(names)), names, rotation=20, fontsize=8)
    panel.axhline(1.0, color="black", linewidth=0.8)
    panel.set(title=_HEADS[kind], ylabel="times as fast as packets of 16 rays")
    panel.legend(fontsize=8)


def _draw_sizes(panel: Any, scenes: dict[str, dict[str, Rows]], counted: tuple[str, str], power: int) -> None:
    """Draw a counter over the light's edge (power 1) or area (2): a colour per scene, a line style per tracer."""
    counter, axis = counted
    for k, (name, sizes) in enumerate(scenes.items()):
        extents = [float(size) ** power for size in sizes]
        for tracer, style in _STYLES.items():
            millions = [rows[tracer][counter] / 1e6 for rows in sizes.values()]
            panel.plot(extents, millions, style, marker=".", color=f"C{k}", label=f"{name}, {tracer}")
        panel.plot(extents, [millions[0] * e / extents[0] for e in extents], ":", color=f"C{k}", linewidth=0.8)
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    panel.set(xlabel=f"{'edge' if power == 1 else 'area'} of the light, relative (Fig. 6)", ylabel=f"{axis}, millions")
    panel.grid(alpha=0.3)
