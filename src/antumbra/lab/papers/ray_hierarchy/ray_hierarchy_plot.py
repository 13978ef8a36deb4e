"""Draws the report's claims and its Table 2 beside ours, and Figures 6 and 7 over the frames of an animation."""

from pathlib import Path
from typing import Any, NamedTuple

from ..bench_runner import plot_sheet
from . import ray_hierarchy_published
from .ray_hierarchy_measurements import OURS, PLANS, Claim, Cost, Measured
from .ray_hierarchy_views import MOMENTS, MUSEUM, ROBOTS

_ROW, _MARKERS = 3.4, "osD^vP*X"  # inches; a symbol per variant
_GREY = "0.55"


def write_plot(measured: Measured, film: Measured, claims: list[Claim], path: Path) -> None:
    """Write the plot: first the comparison with the report, then rows for Figures 6 and 7.

    The curves are those of the first animation, or of the large pictures if there is no animation.
    """
    frames = [s for s in film.pictures if s.of == film.pictures[0].of]
    curves = film._replace(pictures=frames) if frames else measured
    rows = 2 * len(_FIGURES) + 2 * bool(claims)
    with plot_sheet(path, _ROW * rows) as sheet:
        panels = iter(sheet.subplots(rows, 1))
        if claims:
            _draw_claims(next(panels), claims)
            _draw_museum(next(panels), measured)
        for title, variants in _FIGURES:
            for axis in (_NODES, _TIMES):
                panel = next(panels)
                panel.set_title(title)
                _draw_curves(panel, curves, variants, axis)
                panel.legend(ncols=2)


def _draw_claims(panel: Any, claims: list[Claim]) -> None:
    """Draw a line per claim, from the report's ratio to ours."""
    for y, claim in enumerate(claims):
        panel.plot((claim.published, claim.ours), (y, y), color=_GREY, linewidth=1.5, zorder=1)
        panel.plot(claim.published, y, "o", color="black", fillstyle="none", markersize=11, label="report" * (y == 0))
        panel.plot(claim.ours, y, "o", color="C0", markersize=8, label="here" * (y == 0))
        for value, text in ((claim.published, f"{claim.published:,.3g}"), (claim.ours, f"{claim.ours:,.3g}")):
            over = value == claim.ours
            offset = (0, 9 if over else -17)
            panel.annotate(text, (value, y), offset, textcoords="offset points", ha="center", fontsize=8)
    panel.axvline(1.0, color=_GREY, linewidth=0.8)
    panel.set_yticks(range(len(claims)), [claim.text.replace(": ", ":\n") for claim in claims], fontsize=8)
    panel.set_ylim(len(claims) - 0.4, -0.6)
    panel.set_xscale("log")
    panel.set_xlabel("times (1: no gain)")
    panel.set_title("The report's claims: its ratios and ours")
    panel.legend(fontsize=9)
    panel.grid(alpha=0.3, axis="x")


def _draw_museum(panel: Any, measured: Measured) -> None:
    """Draw Table 2: nodes passed in the views of the museum. Hollow: the report's."""
    places = [s.picture for s in measured.pictures if s.of == MUSEUM]
    if not places:
        panel.set_axis_off()
        return
    for k, variant in enumerate(ray_hierarchy_published.MEASURED):
        ours = [measured.of(place, variant).passed for place in places]
        style = {"color": f"C{k + 1}", "marker": _MARKERS[k + 1]}
        panel.plot(
            range(len(places)),
            ray_hierarchy_published.NODES[variant],
            fillstyle="none",
            linestyle="--",
            alpha=0.6,
            **style,
        )
        panel.plot(range(len(places)), [float("nan") if n is None else n for n in ours], label=variant, **style)
    panel.plot([], [], "--o", color=_GREY, fillstyle="none", label="report")
    panel.set_xticks(range(len(places)), places, fontsize=9)
    panel.set_yscale("log")
    panel.set_ylabel("nodes passed")
    panel.set_title("Table 2: nodes in four views of the museum")
    panel.legend(fontsize=9)
    panel.grid(alpha=0.3, axis="y")


# --- Figures 6 and 7 --------------------------------------------------------------------------------------------------


_FIGURES = (
    ("Figure 6: spheres, precise test and sorting", (OURS, *ray_hierarchy_published.MEASURED)),
    ("Figure 7: early accept, two passes", ray_hierarchy_published.FIGURE7),
)
"""(title, variants) of the rows of the plot."""


class _Axis(NamedTuple):
    """A value to draw."""

    field: str  # of `Cost`
    name: str
    scale: float


_NODES = _Axis("nodes", "nodes tested, millions", 1e-6)
_TIMES = _Axis("seconds", "trace, ms", 1e3)


def _draw_curves(panel: Any, curves: Measured, variants: tuple[str, ...], axis: _Axis) -> None:
    """Draw each variant in its own colour: a curve over frame numbers, or markers over the names of pictures."""
    frames = [s.frame for s in curves.pictures if s.frame is not None]
    names = [s.picture for s in curves.pictures]
    for variant in variants:
        k = list(PLANS).index(variant)
        style = {"color": f"C{k}", "label": variant, "marker": _MARKERS[k], "linewidth": 1.0 if frames else 0.0}
        values = [_scaled(curves.of(name, variant), axis) for name in names]
        panel.plot(frames or range(len(names)), values, markersize=4 if len(names) < 50 else 1.5, **style)
    if not frames:
        panel.set_xticks(range(len(names)), names, rotation=40, ha="right", rotation_mode="anchor", fontsize=8)
    else:
        panel.set_xlabel(f"frame of {curves.pictures[0].of}")
        _mark_moments(panel, curves)
    panel.set_yscale("log")
    panel.set_ylabel(axis.name)
    panel.grid(alpha=0.3)


def _mark_moments(panel: Any, curves: Measured) -> None:
    """Mark the frames of the robots that the report's text discusses."""
    if curves.pictures[0].of == ROBOTS and (curves.pictures[-1].frame or 0) > max(MOMENTS.values()):
        for name, frame in MOMENTS.items():
            panel.axvline(frame, color=_GREY, linewidth=0.8, linestyle=":")
            panel.annotate(
                name.removeprefix("robots, "),
                (frame, 0.02),
                xycoords=("data", "axes fraction"),
                rotation=90,
                fontsize=8,
            )


def _scaled(cost: Cost, axis: _Axis) -> float:
    value = getattr(cost, axis.field)
    return float("nan") if value is None else axis.scale * value
