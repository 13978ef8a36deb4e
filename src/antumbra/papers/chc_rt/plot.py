"""Draws Figures 7 and 8 of the CHC+RT paper: curves frame by frame, and bars of the phases."""

from pathlib import Path

import numpy as np

from ...output import replacing
from .measure import PHASES, Turn, later, of, rows_of, speedup, value_of

_PARTS = ("before", *PHASES)
_COLOURS = ("0.7", "tab:blue", "tab:orange", "tab:red")
_ROOT = "bsah+single"  # stands for GLSL in Fig. 8


def write_plot(turns: list[Turn], path: Path) -> None:
    """Write a plot with a row for each scene and view: bars on the left, then curves, a panel for each kind of rays."""
    from matplotlib.figure import Figure

    walks, kinds = rows_of(turns, "scene", "view"), rows_of(turns, "kind")
    colours = {row["method"]: f"C{i}" for i, row in enumerate(rows_of(turns, "method"))}
    columns, widths = 1 + len(kinds), [1.5] + [1.0] * len(kinds)
    sheet = Figure(figsize=(3.6 * sum(widths), 3.0 * len(walks) + 0.4), layout="constrained")
    panels = sheet.subplots(len(walks), columns, squeeze=False, width_ratios=widths)
    for row, walk in zip(panels, walks):
        mine = of(turns, **walk)
        _draw_bars(row[0], mine)
        row[0].set_title(", ".join(walk.values()), fontsize=9)
        for panel, kind in zip(row[1:], kinds):
            _draw_curves(panel, of(mine, **kind), colours)
            panel.set_title(kind["kind"], fontsize=9)
    bars = panels[0, 0].get_legend_handles_labels()
    sheet.legend(*bars, loc="outside lower left", ncols=len(bars[0]), fontsize=8)
    lines = {line.get_label(): line for panel in panels[:, 1:].flat for line in panel.get_lines()}
    sheet.legend(lines.values(), lines, loc="outside lower right", ncols=len(lines), fontsize=8)
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def shares(turns: list[Turn]) -> dict[str, float]:
    """Phase -> its share of the time of the frames after the first. The shares add up to 1."""
    after = later(turns)
    return {part: sum(value_of(t, part) for t in after) / sum(t.seconds for t in after) for part in _PARTS}


def _draw_bars(panel, turns: list[Turn]) -> None:
    """Draw a bar for each kind of rays and each method with phases, and beside it plain tracing from the root."""
    rows = rows_of([t for t in turns if t.told], "kind", "method")
    at, bottom, bars = np.arange(len(rows)), np.zeros(len(rows)), [of(turns, **row) for row in rows]
    root = [of(turns, kind=row["kind"], method=_ROOT) for row in rows]
    width = 0.4 if any(root) else 0.8
    for name, colour in zip(_PARTS, _COLOURS):
        part = np.array([shares(bar)[name] for bar in bars])
        panel.bar(at, part, width, bottom, color=colour, label=name)
        bottom += part
    if any(root):
        ratios = [speedup(ours, theirs) if theirs else 0.0 for ours, theirs in zip(bars, root)]
        panel.bar(at + width, ratios, width, color="white", edgecolor="black", hatch="//", label=_ROOT)
    several = len({row["method"] for row in rows}) > 1
    names = [", ".join(row.values()) if several else row["kind"] for row in rows]
    middle = at + width / 2 if any(root) else at
    panel.set_xticks(middle, names, fontsize=7, rotation=25, ha="right", rotation_mode="anchor")
    panel.set_ylabel("share of the time of CHC+RT", fontsize=8)


def _draw_curves(panel, turns: list[Turn], colours: dict[str, str]) -> None:
    highest = 0.0
    for row in rows_of(turns, "method"):
        some = of(turns, **row)
        name, ms = row["method"], [1e3 * t.seconds for t in some]
        panel.plot([t.frame for t in some], ms, marker=".", color=colours[name], label=name)
        highest = max(highest, *ms)
    panel.set(ylim=(0, 1.08 * highest), xlabel="frame", ylabel="ms")
    panel.xaxis.get_major_locator().set_params(integer=True)
    panel.grid(alpha=0.3)
