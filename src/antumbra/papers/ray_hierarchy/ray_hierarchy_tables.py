"""Prints the tables of the report on ray hierarchies with its results, and draws Figures 6 and 7."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from ...cli.console import duration
from ..bench_runner import TableColumn, beside, columns_of, label, ms, plot_sheet, print_notes, print_table
from . import ray_hierarchy_measurements as paper
from .ray_hierarchy_measurements import (
    BEST,
    FIGURE7,
    MEASURED,
    MUSEUM_NAME,
    OURS,
    PLANS,
    ROBOTS,
    STILL_CAMERA,
    Cost,
    PictureRays,
    RelativeCost,
    Spread,
    of,
)

# --- Tables -----------------------------------------------------------------------------------------------------------


def print_tables(
    pictures: list[PictureRays], costs: list[Cost], relative: list[RelativeCost], spreads: list[Spread]
) -> None:
    """Print all tables."""
    _print_pictures(pictures, costs)
    _print_museum(costs)
    _print_figure7(relative)
    _print_claims(pictures, costs, spreads)
    _print_spreads(spreads)


def _millions(count: float | None) -> str:
    return "" if count is None else f"{count / 1e6:,.3f}"


def _print_pictures(pictures: list[PictureRays], costs: list[Cost]) -> None:
    """Print Figures 6 and 7 as tables."""
    sizes = (
        label("picture", "picture"),
        TableColumn("triangles", lambda s: f"{s.triangles:,}"),
        TableColumn("rays", lambda s: f"{s.rays:,}"),
        TableColumn("% blocked", lambda s: f"{100 * s.blocked / s.rays:.0f}"),
    )
    print_table("Pictures: one point light, one shadow ray per visible surface point", sizes, pictures)
    if any(s.of == ROBOTS for s in pictures):
        print(f"{STILL_CAMERA}\n")

    def print_variants(title: str, cell: Callable[[Cost], str]) -> None:
        variants = columns_of({name: name for name in PLANS}, lambda s, name: cell(of(costs, s.picture, name)))
        print_table(title, [label("picture", "picture"), *variants], pictures)

    skipped = "skipped: about "
    print_variants(
        "Nodes tested, millions (Figures 6 and 7)",
        lambda c: _millions(c.nodes) or skipped + _millions(c.predicted_nodes),
    )
    print_variants("Nodes passed, millions (Figures 6 and 7)", lambda c: _millions(c.passed) or "skipped")
    print_variants("Ray tests of up to 16 rays, millions", lambda c: _millions(c.tests) or "skipped")
    print_variants("Shadows, ms (Figures 6 and 7)", lambda c: ms(c.seconds) or skipped + duration(c.predicted))


def _print_museum(costs: list[Cost]) -> None:
    """Print Table 2, with the report's values in brackets. The report does not say whether it counts nodes passed."""
    places = [name for name in dict.fromkeys(c.picture for c in costs) if name.startswith(f"{MUSEUM_NAME}, ")]
    if not places:
        return

    heads = {k: place.removeprefix(f"{MUSEUM_NAME}, ") for k, place in enumerate(places)}

    def print_places(title: str, cell: Callable[[Cost, int], str]) -> None:
        columns = columns_of(heads, lambda variant, k: cell(of(costs, places[k], variant), k))
        title = f"{title}: subdivided museum (Table 2; in brackets the report's, for other views on a GPU)"
        print_table(title, [label("variant", str), *columns], MEASURED)

    def nodes(cost: Cost, k: int) -> str:
        tested = _millions(cost.nodes) or f"about {_millions(cost.predicted_nodes)}"
        return beside(f"{tested}, {_millions(cost.passed) or '?'}", paper.NODES[cost.variant][k] / 1e6, 2)

    def times(cost: Cost, k: int) -> str:
        return beside(ms(cost.seconds) or f"about {ms(cost.predicted)}", paper.MILLISECONDS[cost.variant][k])

    print_places("Nodes tested and passed, millions", nodes)
    print_places("Shadows, ms", times)


def _print_figure7(rows: list[RelativeCost]) -> None:
    """Print Figure 7 as a table: early accept and two passes."""
    columns = (
        label("scene", "of"),
        label("variant", "variant"),
        TableColumn("pictures", lambda b: f"{b.pictures}"),
        TableColumn("nodes tested", lambda b: f"{b.nodes:.2f}"),
        TableColumn("nodes passed", lambda b: f"{b.passed:.2f}"),
        TableColumn("time", lambda b: f"{b.seconds:.2f}"),
    )
    title = f"Early accept and two passes relative to {BEST} (Figure 7; in the report, nodes fall and time rises)"
    print_table(title, columns, [b for b in rows if b.variant != BEST])


def _print_claims(pictures: list[PictureRays], costs: list[Cost], spreads: list[Spread]) -> None:
    """Print our results for the claims in the report's text."""
    rows = []
    for kind in ("Spheres", "Precise"):
        for what, fields, table in (
            ("nodes", ("nodes", "predicted_nodes"), paper.NODES),
            ("time", ("seconds", "predicted"), paper.MILLISECONDS),
        ):
            times, picture, measured = paper.cut(costs, kind, f"{kind}Sorted", fields)
            if picture:
                theirs = f"the report's {paper.published_cut(kind, f'{kind}Sorted', table):,.0f}"
                text = f"cuts {what} {'' if measured else 'about '}{times:,.1f} times in {picture} ({theirs})"
                rows.append((f"sorting, {kind}", text))
    for title, among in (
        ("of Figure 6", MEASURED),
        ("of Table 1", paper.VARIANTS),
        ("of all", tuple(PLANS)),
    ):
        best = [paper.fewest(costs, s.picture, among) for s in pictures]
        wins = ", ".join(f"{name or 'none measured'} {best.count(name)}" for name in dict.fromkeys(best))
        rows.append((f"fewest nodes {title}", f"in {len(best)} pictures: {wins}"))
    for name in dict.fromkeys(s.of for s in spreads):
        least = min((s for s in spreads if s.of == name), key=lambda s: s.deviation)
        text = f"{least.variant}, standard deviation {100 * least.deviation:.0f} % of the mean"
        rows.append((f"steadiest in {name}", text))
    print_notes(rows)


def _print_spreads(spreads: list[Spread]) -> None:
    """Print the variation of the times in Figure 6(b)."""
    if not spreads:
        print("No animated scene, so no variation of times over frames (Figure 6b)\n")
        return
    columns = (
        label("animation", "of"),
        label("variant", "variant"),
        TableColumn("frames", lambda s: f"{s.frames} of {s.frames + s.missing}" if s.missing else f"{s.frames}"),
        TableColumn("median, ms", lambda s: ms(s.median)),
        TableColumn("longest / shortest", lambda s: f"{s.ratio:.2f}"),
        TableColumn("interquartile range, ms", lambda s: ms(s.quartiles)),
        TableColumn("deviation, % of mean", lambda s: f"{100 * s.deviation:.0f}"),
    )
    print_table("Shadow times over the frames of an animation (Figure 6b)", columns, spreads)


# --- Plot -------------------------------------------------------------------------------------------------------------


_WIDTH, _MARKERS = 7.0, "osD^vP*X"
_FIGURES = (
    ("Figure 6: spheres, precise test and sorting", (OURS, *MEASURED)),
    ("Figure 7: early accept, two passes", FIGURE7),
)
"""(title, variants) of the rows of the plot."""


def write_plot(pictures: list[PictureRays], costs: list[Cost], path: Path) -> None:
    """Write a plot of each variant's nodes and time in each picture, with a row per figure."""
    with plot_sheet(path, max(2 * _WIDTH, 0.9 * len(pictures)), 10.0) as sheet:
        panels = sheet.subplots(len(_FIGURES), 2, sharex=True)
        for (nodes, time), (title, variants) in zip(panels, _FIGURES):
            nodes.set_title(title)
            time.set_title(title)
            _draw_pictures(nodes, pictures, costs, variants, _NODES)
            _draw_pictures(time, pictures, costs, variants, _TIMES)
            nodes.legend(fontsize=8)


class _Axis(NamedTuple):
    """A value to draw."""

    field: str  # of `Cost`
    predicted: str  # the field with its prediction
    name: str
    scale: float


_NODES = _Axis("nodes", "predicted_nodes", "nodes tested, millions", 1e-6)
_TIMES = _Axis("seconds", "predicted", "trace, ms", 1e3)


def _draw_pictures(
    panel: Any, pictures: list[PictureRays], costs: list[Cost], variants: tuple[str, ...], axis: _Axis
) -> None:
    """Draw each variant in its own colour. Lines connect the frames of an animation.

    Hollow markers show the predicted values of skipped variants.
    """
    for variant in variants:
        k = list(PLANS).index(variant)
        style = {"color": f"C{k}", "marker": _MARKERS[k % 8], "markersize": 4}
        for x, cost in enumerate(of(costs, s.picture, variant) for s in pictures):
            if cost.nodes is None:
                panel.plot(x, axis.scale * getattr(cost, axis.predicted), fillstyle="none", **style)
        for start, end in _runs(pictures):
            values = [getattr(of(costs, s.picture, variant), axis.field) for s in pictures[start:end]]
            heights = [float("nan") if v is None else axis.scale * v for v in values]
            name = variant if start == 0 else None
            panel.plot(range(start, end), heights, label=name, **style)
    names = [s.picture for s in pictures]
    panel.set_xticks(range(len(pictures)), names, rotation=40, ha="right", rotation_mode="anchor", fontsize=8)
    panel.set_yscale("log")
    panel.set_ylabel(axis.name)
    panel.grid(alpha=0.3)


def _runs(pictures: list[PictureRays]) -> list[tuple[int, int]]:
    """(first, end) of runs of pictures: the frames of an animation, or a single picture."""
    starts = [k for k, s in enumerate(pictures) if k == 0 or s.frame is None or s.of != pictures[k - 1].of]
    return list(zip(starts, [*starts[1:], len(pictures)]))
