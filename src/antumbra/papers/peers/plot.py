"""Draws the rates of the contenders as bars."""

from pathlib import Path

from ...output import replacing
from .contest import OURS
from .measure import finalists


def write_plot(rows: list[dict], path: Path) -> None:
    """Write a plot with a panel for each scene and number of threads."""
    from matplotlib.figure import Figure

    shown = finalists(rows)
    cases = list(dict.fromkeys((row["scene"], row["threads"]) for row in shown))
    sheet = Figure(figsize=(8.0, 2.4 * len(cases)), layout="constrained")
    for panel, case in zip(sheet.subplots(len(cases), squeeze=False)[:, 0], cases):
        mine = [row for row in shown if (row["scene"], row["threads"]) == case][::-1]
        colours = ["tab:blue" if row["family"] == OURS else "0.7" for row in mine]
        panel.barh([row["contender"] for row in mine], [row["mrays"] for row in mine], color=colours)
        panel.set_title(f"{case[0]}, {case[1]} thread(s)", fontsize=9)
        panel.tick_params(labelsize=8)
        panel.set_xlabel("M rays/s", fontsize=8)
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)
