"""Draws Figures 6 and 7 of the report on ray hierarchies, as measured here."""

from pathlib import Path

from ...output import replacing
from .measure import OURS, PLANS, Cost, PictureRays, of
from .published import FIGURE7, MEASURED

_WIDTH, _MARKERS = 7.0, "osD^vP*X"
_FIGURES = (
    ("Figure 6: spheres, precise test and sorting", (OURS, *MEASURED)),
    ("Figure 7: early accept, two passes", FIGURE7),
)
"""(title, variants) of the rows of the plot."""


def write_plot(seen: list[PictureRays], costs: list[Cost], path: Path) -> None:
    """Write a plot of the nodes and the time of each variant in each picture, a row for each figure."""
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(max(2 * _WIDTH, 0.9 * len(seen)), 10.0), layout="constrained")
    panels = sheet.subplots(len(_FIGURES), 2, sharex=True)
    for (nodes, time), (title, variants) in zip(panels, _FIGURES):
        nodes.set_title(title)
        time.set_title(title)
        _draw_pictures(nodes, seen, costs, variants, ("nodes", "predicted_nodes"), "nodes tested, millions", 1e-6)
        _draw_pictures(time, seen, costs, variants, ("seconds", "predicted"), "trace, ms", 1e3)
        nodes.legend(fontsize=8)
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw_pictures(
    panel, seen: list[PictureRays], costs: list[Cost], variants: tuple[str, ...], fields, label: str, scale: float
) -> None:
    """Draw each variant in a colour. Lines join the frames of an animation.

    A hollow mark shows the predicted value of a variant that was left out.
    """
    field, predicted = fields
    for variant in variants:
        k = list(PLANS).index(variant)
        style = {"color": f"C{k}", "marker": _MARKERS[k % 8], "markersize": 4}
        for x, cost in enumerate(of(costs, s.picture, variant) for s in seen):
            if cost.nodes is None:
                panel.plot(x, scale * getattr(cost, predicted), fillstyle="none", **style)
        for start, end in _runs(seen):
            values = [getattr(of(costs, s.picture, variant), field) for s in seen[start:end]]
            heights = [float("nan") if v is None else scale * v for v in values]
            name = variant if start == 0 else None
            panel.plot(range(start, end), heights, label=name, **style)
    names = [s.picture for s in seen]
    panel.set_xticks(range(len(seen)), names, rotation=40, ha="right", rotation_mode="anchor", fontsize=8)
    panel.set_yscale("log")
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)


def _runs(seen: list[PictureRays]) -> list[tuple[int, int]]:
    """(first, end) of runs of pictures: frames of the same animation, or a single picture."""
    starts = [k for k, s in enumerate(seen) if k == 0 or s.frame is None or s.of != seen[k - 1].of]
    return list(zip(starts, [*starts[1:], len(seen)]))
