"""Charts and pictures of the pre-BVH culling paper [Selgrad et al. 2015, Fig. 2 to 7].

The chart shows the paper's results and ours side by side, above Figure 7: time to image over samples, relative to BSAH,
with a row per tracer. Pictures show the marked cells (Fig. 2d), and the views with 15 samples (Fig. 3 to 6).
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....picture.frame import Frame
from ....techniques.culling.culling_grid import tiles_of
from ....techniques.culling.pre_bvh_culling import mark_segments
from ..bench_runner import plot_sheet
from .cell_marking import LINES, source_cells
from .culling_measurements import (
    OURS,
    PUBLISHED,
    CullingRows,
    TimeToImage,
    break_even,
    queries_of,
    seconds_a_sample,
)
from .culling_published import REMAINING, TIME_TO_IMAGE, published_total
from .culling_views import CullingView
from .light_cells import light_cells

_PAPER, _LINES, _HULLS = "0.55", "tab:blue", "tab:orange"
_BAR_ROW, _CURVE_ROW = 3.6, 2.8  # heights in inches
_LEGEND = {_PAPER: "paper (GPU)", _LINES: "as published, here", _HULLS: "grid32, here"}


def write_charts(rows: CullingRows, path: Path) -> None:
    """Write what is left and the times to image, the paper's beside ours, and Figure 7 below them."""
    figures, tracers = (list(dict.fromkeys(getattr(t, name) for t in rows.times)) for name in ("figure", "tracer"))
    heights = 2 * _BAR_ROW, _CURVE_ROW * len(figures)
    with plot_sheet(path, sum(heights)) as sheet:
        top, below = sheet.subfigures(2, 1, height_ratios=heights)
        first, second = top.subplots(2, 1)
        _draw_remaining(first, rows)
        _draw_ratios(second, [t for t in rows.times if t.tracer == tracers[0]], figures)
        panels = below.subplots(len(figures), len(tracers), squeeze=False)
        for row, figure in zip(panels, figures):
            for panel, tracer in zip(row, tracers):
                _draw_curves(panel, {t.method: t for t in rows.times if (t.figure, t.tracer) == (figure, tracer)})
            row[0].set_ylabel("time to image / BSAH's")
        handles, names = below.axes[0].get_legend_handles_labels()
        below.legend(handles, names, loc="outside upper center", ncols=3, title="dashed: the paper's (GPU)")


# --- The paper's results beside ours ----------------------------------------------------------------------------------


def _bars(panel: Any, groups: Sequence[str], series: dict[str, Sequence[float | None]], width: float = 0.27) -> None:
    """Draw bars in groups, with their values; `series` maps colours to a value per group, None where there is none."""
    for k, (colour, values) in enumerate(series.items()):
        there = [(i + (k - 1) * width, value) for i, value in enumerate(values) if value is not None]
        bars = panel.bar(*zip(*there), width, color=colour, label=_LEGEND[colour]) if there else ()
        panel.bar_label(bars, fmt="%.0f", fontsize=8) if there else None
    panel.set_xticks(range(len(groups)), groups, fontsize=8)
    panel.grid(axis="y", alpha=0.3)


def _draw_remaining(panel: Any, rows: CullingRows) -> None:
    """Draw the shares of remaining triangles; whiskers span the quartiles of random cameras."""
    shares = {(r.figure, r.marked): 100 * r.remaining for r in rows.grids}
    spread = {(r.part, r.marked): 100 * np.array(r.quartiles) for r in rows.shares}
    shares |= {key: float(quartiles[1]) for key, quartiles in spread.items()}
    views = list(dict.fromkeys(view for view, _ in shares))
    theirs = [100 * REMAINING[view] if view in REMAINING else None for view in views]
    ours = {colour: [shares[v, marked] for v in views] for colour, marked in ((_LINES, PUBLISHED), (_HULLS, OURS))}
    names = [f"{view},\nrandom" if (view, OURS) in spread else _short(view) for view in views]
    _bars(panel, names, {_PAPER: theirs, **ours})
    for (view, marked), (low, middle, high) in spread.items():
        if marked in (PUBLISHED, OURS):
            x = views.index(view) + 0.27 * (marked == OURS)
            panel.errorbar(x, middle, [[middle - low], [high - middle]], color="black", capsize=3, linewidth=1)
    panel.set(title="Triangles left, % (random: median, quartiles)", ylim=(0, 100))
    panel.legend(fontsize=8)


def _short(figure: str) -> str:
    return figure.replace("Figure", "Fig.")


def _draw_ratios(panel: Any, times: list[TimeToImage], figures: Sequence[str]) -> None:
    """Draw the times to image with one sample in per cent of LBVH's: LBVH and TL-LBVH culled, in each view."""
    totals = {(t.figure, t.method): t.cull + t.build + t.trace[1] for t in times}
    groups = [(figure, builder) for figure in figures for builder in ("LBVH", "TL-LBVH")]
    ours = {
        colour: [100 * totals[figure, f"{builder}{suffix}"] / totals[figure, "LBVH"] for figure, builder in groups]
        for colour, suffix in ((_LINES, " culled"), (_HULLS, ", grid32"))
    }
    theirs = [_published_ratio(figure, f"{builder} culled") for figure, builder in groups]
    _bars(panel, [f"{_short(figure)}\n{builder}" for figure, builder in groups], {_PAPER: theirs, **ours})
    panel.axhline(100, color="black", linewidth=1)
    panel.set_title(f"Time to image of culled trees, % of LBVH without culling, 1 sample, {times[0].tracer}")


def _published_ratio(figure: str, method: str) -> float | None:
    if figure not in TIME_TO_IMAGE:
        return None
    return 100 * published_total(figure, method, 1) / published_total(figure, "LBVH", 1)


# --- Figure 7 ---------------------------------------------------------------------------------------------------------


def _sums(t: TimeToImage, spp: NDArray[np.float64]) -> NDArray[np.float64]:
    """Time to image in seconds for any number of samples, by linear interpolation and extrapolation."""
    samples, traced = list(t.trace), list(t.trace.values())
    beyond = np.maximum(spp - samples[-1], 0) * seconds_a_sample(t)
    sums: NDArray[np.float64] = t.cull + t.build + np.interp(spp, samples, traced) + beyond
    return sums


def _draw_curves(panel: Any, methods: dict[str, TimeToImage]) -> None:
    """Draw the curves of one view and one tracer, the paper's dashed. Dots mark where BSAH breaks even."""
    spp, last = np.geomspace(1, 1000, 200), methods["BSAH"]
    published = TIME_TO_IMAGE.get(last.figure, {})
    for k, (method, t) in enumerate(methods.items()):
        if method.startswith("BSAH") and method != "BSAH":
            continue
        (line,) = panel.plot(spp, _sums(t, spp) / _sums(last, spp), color=f"C{k}", label=method)
        even = break_even(last, t)
        if t is not last and even <= spp[-1]:
            panel.plot(even, 1.0, "o", color=line.get_color())
        if method in published and method != "BSAH":
            theirs = [published_total(last.figure, method, s) / published_total(last.figure, "BSAH", s) for s in spp]
            panel.plot(spp, theirs, "--", color=line.get_color(), linewidth=0.8)
    panel.set(xscale="log", title=f"{last.figure}, {last.tracer}", xlabel="samples per pixel and light", ylim=(0, None))
    panel.grid(alpha=0.3)


# --- Pictures ---------------------------------------------------------------------------------------------------------


def picture_writer(folder: Path | None) -> Callable[[CullingView, Frame], None]:
    """A function that writes the frame of one of Figures 3 to 6 to a folder; None: nowhere."""

    def write(view: CullingView, frame: Frame) -> None:
        if folder is not None:
            frame.save(folder / f"pre-bvh-culling-{view.figure.lower().replace(' ', '')}.png")

    return write


def cells_file(folder: Path) -> Path:
    """The file of Figure 2d."""
    return folder / "pre-bvh-culling-cells.png"


def write_cells(path: Path, views: Sequence[CullingView], threads: int) -> None:
    """Write Figure 2d for the views of Figures 3 to 6."""
    with plot_sheet(path, 2.6 * len(views)) as sheet:
        panels = sheet.subplots(len(views), 2, squeeze=False)
        for row, view in zip(panels, views):
            _draw_cells(row, view, threads)


def _draw_cells(panels: Sequence[Any], view: CullingView, threads: int) -> None:
    """Draw the cells of a view from above and from the side.

    Marked cells are green, the darker the more of them lie behind each other; cells of receivers are blue, and cells
    of lights are orange, as in Fig. 2.
    """
    triangles, queries = queries_of(view, threads)
    marking = mark_segments(triangles, queries, threads, method=LINES)
    assert marking is not None  # `times_to_image` has found receivers
    grid, marked = marking.grid, marking.cells.cells
    sources = source_cells(tiles_of(queries[0], threads), grid, threads)
    ends = np.concatenate([light_cells(query, grid) for query in queries])
    low, high = grid.bounds[:, :3]
    middles = (triangles.vertices.mean(1) - low) / (high - low) * grid.n
    for panel, (across, up, along) in zip(panels, ((0, 2, 1), (0, 1, 2))):
        density = np.histogram2d(middles[:, up], middles[:, across], bins=8 * grid.n, range=[[0, grid.n]] * 2)[0]
        depth = marked.sum(along).T
        image = 1.0 - (depth / max(depth.max(), 1))[..., None] ** 0.5 * (0.75, 0.25, 0.75)
        for cells, colour in (sources, (0.25, 0.45, 1.0)), (ends, (1.0, 0.6, 0.1)):
            image[cells[:, up], cells[:, across]] = colour
        extent = (0, grid.n, 0, grid.n)
        panel.imshow(image, origin="lower", extent=extent, interpolation="nearest")
        panel.imshow(np.where(density > 0, 0.0, np.nan), origin="lower", extent=extent, cmap="gray", alpha=0.25)
        panel.set(xticks=[], yticks=[], aspect=float((high - low)[up] / (high - low)[across]))
    share = 100 * marked.mean()
    panels[0].set_title(f"{view.figure}, from above: {share:.0f} % of the cells marked", fontsize=9)
    panels[1].set_title("from the side", fontsize=9)
