"""Draws Figures 5 to 7 of the multi-frusta paper: pictures of each scene, and curves over the light's size."""

from pathlib import Path

from ...output import replacing
from .measure import FIGURE6
from .quality import Quality

_STYLES = dict(zip(FIGURE6, ("-", "--")))
_PANELS = (("triangles", "triangles accessed"), ("triangle_tests", "tests of a triangle and 16 rays"))


def write_plot(found: dict[str, tuple[dict, Quality]], path: Path) -> None:
    """Write a plot: Figure 6 at the top, and below a row for each scene with Figures 5 and 7.

    found : name of the scene -> (its tables, its quality)
    """
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(14.0, 4.5 + 3.7 * len(found)), layout="constrained")
    above, below = sheet.subfigures(2, 1, height_ratios=[4.5, 3.7 * len(found)])
    for panel, (counter, label) in zip(above.subplots(1, 2), _PANELS):
        _draw_sizes(panel, {name: tables["figure 6"] for name, (tables, _) in found.items()}, counter, label)
    panels = below.subplots(len(found), 4, squeeze=False)
    for row, (name, (_, quality)) in zip(panels, found.items()):
        for panel, (title, picture) in zip(row, quality.pictures.items()):
            panel.imshow(picture, interpolation="nearest")
            panel.set_title(f"{name}: {title}", fontsize=9)
            panel.set_axis_off()
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw_sizes(panel, scenes: dict[str, dict], counter: str, label: str) -> None:
    """Draw a counter over the light's size: a colour for each scene, a style for each tracer."""
    for k, (name, sizes) in enumerate(scenes.items()):
        edges = [float(size) for size in sizes]
        for tracer, style in _STYLES.items():
            millions = [rows[tracer][counter] / 1e6 for rows in sizes.values()]
            panel.plot(edges, millions, style, marker=".", color=f"C{k}", label=f"{name}, {tracer}")
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    panel.set_xticks(edges, [f"{edge:g}" for edge in edges])
    panel.set(xlabel="edge of the light / the usual one (Fig. 6)", ylabel=f"{label}, millions")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
