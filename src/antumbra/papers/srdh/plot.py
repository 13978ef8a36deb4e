"""Draws Figures 2 and 4 of the SRDH paper: bars of box tests, and curves over the size of the pre-render."""

from pathlib import Path

import numpy as np

from ...output import replacing
from ...trace.rays.single_rays import FALSE, PATH, UNOCCLUDED
from .measure import OURS, PIXELS, PUBLISHED, SAH_ORDERS, Counted, of, relative, scenes_of

_BARS = (*SAH_ORDERS, PUBLISHED, OURS)
_COLOURS = ("0.55", "tab:blue", "tab:cyan", "tab:green", "tab:red", "tab:orange")
_CLASSES = (
    (UNOCCLUDED, "unoccluded rays", 1.0),
    (FALSE, "false hits of occluded rays", 0.6),
    (PATH, "path to the hit", 0.3),
)
"""(class, label, opacity) of the parts of a bar, from the bottom, as in the paper."""


def write_plot(rows: list[Counted], path: Path) -> None:
    """Write a plot: bars at the top, in a group for each scene; curves at the bottom, in a colour for each scene."""
    from matplotlib.figure import Figure

    scenes = scenes_of(rows)
    sheet = Figure(figsize=(max(7.0, 2.2 * len(scenes)), 8.0), layout="constrained")
    above, below = sheet.subplots(2, 1)
    _draw_bars(above, rows, scenes)
    _draw_curves(below, rows, scenes)
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw_bars(panel, rows: list[Counted], scenes: list[str]) -> None:
    from matplotlib.patches import Patch

    width = 0.85 / len(_BARS)
    for k, (method, colour) in enumerate(zip(_BARS, _COLOURS)):
        found = [of(rows, scene, method) for scene in scenes]
        bases = [of(rows, scene, SAH_ORDERS[0]).total for scene in scenes]
        at, bottom = np.arange(len(scenes)) + (k - (len(_BARS) - 1) / 2) * width, np.zeros(len(scenes))
        for number, _, opaque in _CLASSES:
            part = np.array([r.boxes[number] / base for r, base in zip(found, bases)])
            panel.bar(at, part, 0.92 * width, bottom, color=colour, alpha=opaque, linewidth=0)
            bottom += part
    methods = [Patch(color=colour, label=method) for method, colour in zip(_BARS, _COLOURS)]
    classes = [Patch(facecolor="black", alpha=opaque, label=label) for _, label, opaque in reversed(_CLASSES)]
    panel.legend(handles=methods + classes, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    panel.set_xticks(range(len(scenes)), scenes)
    panel.set_ylabel("box tests / those of random order")
    panel.grid(axis="y", alpha=0.3)
    panel.set_axisbelow(True)


def _draw_curves(panel, rows: list[Counted], scenes: list[str]) -> None:
    last = 2 * PIXELS[-1]  # the abscissa of "all rays"
    for k, scene in enumerate(scenes):
        for method, style in ((PUBLISHED, "-"), (OURS, "--")):
            found = [relative(rows, of(rows, scene, method, pixels)) for pixels in (*PIXELS, None)]
            label = scene if method == PUBLISHED else None
            panel.plot([*PIXELS, last], found, style, marker=".", color=f"C{k}", label=label)
    panel.plot([], [], "k-", label=PUBLISHED)
    panel.plot([], [], "k--", label=OURS)
    panel.set_xscale("log", base=2)
    panel.set_xticks([*PIXELS, last], [*(f"{k} x {k}" for k in PIXELS), "all"])
    panel.set(ylim=(0, None), xlabel="pixels of the pre-render", ylabel="box tests / those of random order")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8, ncols=2, loc="lower left")
