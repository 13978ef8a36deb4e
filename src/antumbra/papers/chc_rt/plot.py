"""Draws Figures 7 and 8 of the CHC+RT paper: curves frame by frame, and bars of the phases."""

from pathlib import Path

import numpy as np

from ...output import replacing
from .measure import PHASES, Turn, of, rows_of, typical

_PARTS = ("before", *PHASES)
_COLOURS = ("0.7", "tab:blue", "tab:orange", "tab:red")


def write_plot(turns: list[Turn], path: Path) -> None:
    """Write a plot with a row for each scene and view: bars on the left, then curves, a panel for each kind of rays."""
    from matplotlib.figure import Figure

    walks, kinds = rows_of(turns, "scene", "view"), rows_of(turns, "kind")
    colours = {row["method"]: f"C{i}" for i, row in enumerate(rows_of(turns, "method"))}
    columns = 1 + len(kinds)
    sheet = Figure(figsize=(4.0 * columns, 2.8 * len(walks)), layout="constrained")
    panels = sheet.subplots(len(walks), columns, squeeze=False)
    for row, walk in zip(panels, walks):
        mine = of(turns, **walk)
        _draw_bars(row[0], mine)
        row[0].set_title(", ".join(walk.values()), fontsize=9)
        for panel, kind in zip(row[1:], kinds):
            _draw_curves(panel, of(mine, **kind), colours)
            panel.set_title(kind["kind"], fontsize=9)
    panels[0, 0].legend(fontsize=7)
    lines = {line.get_label(): line for panel in panels[:, 1:].flat for line in panel.get_lines()}
    sheet.legend(lines.values(), lines, loc="outside lower center", ncols=len(lines), fontsize=8)
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw_bars(panel, turns: list[Turn]) -> None:
    rows = rows_of([t for t in turns if t.told], "kind", "method")
    at, bottom = np.arange(len(rows)), np.zeros(len(rows))
    for name, colour in zip(_PARTS, _COLOURS):
        part = np.array([typical(of(turns, **row), name) / typical(of(turns, **row)) for row in rows])
        panel.bar(at, part, 0.8, bottom, color=colour, label=name)
        bottom += part
    panel.set_xticks(at, ["\n".join(row.values()) for row in rows], fontsize=7, rotation=30)
    panel.set_ylabel("share of the time")


def _draw_curves(panel, turns: list[Turn], colours: dict[str, str]) -> None:
    for row in rows_of(turns, "method"):
        some = of(turns, **row)
        name, ms = row["method"], [1e3 * t.seconds for t in some]
        panel.plot([t.frame for t in some], ms, marker=".", color=colours[name], label=name)
    panel.set(ylim=(0, None), xlabel="frame", ylabel="ms")
    panel.grid(alpha=0.3)
