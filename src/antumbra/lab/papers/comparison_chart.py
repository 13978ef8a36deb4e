"""The chart at the top of each paper's page: the paper's values and ours, side by side.

A benchmark lists what it compares in a few `ComparisonPanel`s, which `comparison_writer` draws for its `BenchResult`.
Values that depend on the scene are ranges, drawn as bars from the smallest to the largest.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from .bench_runner import plot_sheet

Range = tuple[float, float]
"""The smallest and the largest value."""

PAPER_COLOUR, OUR_COLOUR = "#adb5bd", "#d9480f"
_ROW, _FRAME = 0.42, 1.1  # inches: a pair of bars, and title and axis together


class ComparedValue(NamedTuple):
    """A value of the paper beside ours, in the unit of its panel."""

    name: str
    paper: float | Range | None  # None: the paper has no such value
    ours: float | Range | None  # None: not measured


class ComparisonPanel(NamedTuple):
    """Values that share an axis."""

    title: str
    unit: str  # label of the axis
    values: Sequence[ComparedValue]
    log: bool = False  # whether the axis is logarithmic


def range_of(values: Iterable[float]) -> float | Range | None:
    """The range of several values; the value itself if there is only one, and None if there is none."""
    sequence = list(values)
    if not sequence:
        return None
    return (min(sequence), max(sequence)) if len(sequence) > 1 else sequence[0]


def comparison_writer(panels: Sequence[ComparisonPanel]) -> Callable[[Path], None]:
    """A function that draws the panels to a .png file."""
    return partial(write_comparison, panels)


def write_comparison(panels: Sequence[ComparisonPanel], path: Path) -> None:
    """Draw the panels to a .png file, one below the other."""
    heights = [_FRAME + _ROW * len(panel.values) for panel in panels]
    with plot_sheet(path, sum(heights)) as sheet:
        places = sheet.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for place, panel in zip(places, panels):
            draw_comparison(place, panel)
        places[0].legend(handles=_legend(), loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)


def draw_comparison(place: Any, panel: ComparisonPanel) -> None:
    """Draw the pairs of bars of a panel, the first at the top.

    place : Matplotlib axes
    """
    for k, value in enumerate(panel.values):
        _draw_bar(place, k - 0.2, value.paper, PAPER_COLOUR, panel.log)
        _draw_bar(place, k + 0.2, value.ours, OUR_COLOUR, panel.log)
    place.set_yticks(range(len(panel.values)), [value.name for value in panel.values])
    place.set_ylim(len(panel.values) - 0.5, -0.5)
    place.set(title=panel.title, xlabel=panel.unit)
    place.margins(x=0.15)
    place.grid(visible=False, axis="y")
    if panel.log:
        place.set_xscale("log", subs=())
        place.xaxis.get_major_locator().set_params(subs=(1.0, 2.0, 3.0, 5.0))
        place.xaxis.set_major_formatter("{x:g}")
    else:
        place.axvline(0.0, color="black", linewidth=0.8)


def _draw_bar(place: Any, at: float, value: float | Range | None, colour: str, log: bool) -> None:
    """Draw a value as a bar from 0 and a range as a bar between its ends; in a logarithmic panel, a value is a dot."""
    if value is None:
        return
    low, high = value if isinstance(value, tuple) else (value, value)
    if isinstance(value, tuple):
        place.barh(at, high - low, 0.34, low, color=colour)
    elif log:
        place.plot(value, at, "o", color=colour)
    else:
        place.barh(at, value, 0.34, color=colour)
    place.annotate(
        f"{low:.3g} to {high:.3g}" if isinstance(value, tuple) else f"{value:.3g}",
        (max(high, 0.0) if not log else high, at), (4, 0), textcoords="offset points", va="center", fontsize=8,
    )  # fmt: skip


def _legend() -> list[Any]:
    from matplotlib.patches import Patch

    return [Patch(color=PAPER_COLOUR, label="the paper"), Patch(color=OUR_COLOUR, label="Antumbra")]
