"""Draws Figure 7 of the pre-BVH culling paper: time to image over samples, relative to BSAH; a row for each tracer."""

from pathlib import Path

import numpy as np

from ...output import replacing
from .measure import SAMPLES, TimeToImage, break_even, seconds_a_sample


def _sums(t: TimeToImage, spp: np.ndarray) -> np.ndarray:
    """Time to image in seconds for any number of samples, by linear interpolation and extrapolation."""
    traced = np.array([t.trace[s] for s in SAMPLES])
    beyond = np.maximum(spp - SAMPLES[-1], 0) * seconds_a_sample(t)
    return t.cull + t.build + np.interp(spp, SAMPLES, traced) + beyond


def write_plot(times: list[TimeToImage], path: Path) -> None:
    """Write a plot with a panel for each view and tracer. A dot marks where BSAH breaks even with a method."""
    from matplotlib.figure import Figure

    figures, tracers = (list(dict.fromkeys(getattr(t, name) for t in times)) for name in ("figure", "tracer"))
    sheet = Figure(figsize=(4.2 * len(figures), 3.8 * len(tracers)), layout="constrained")
    panels = sheet.subplots(len(tracers), len(figures), squeeze=False)
    for row, tracer in zip(panels, tracers):
        for panel, figure in zip(row, figures):
            _draw(panel, {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)})
        row[0].set_ylabel("time to image / BSAH's")
    sheet.axes[0].legend(fontsize=8)
    with replacing(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw(panel, methods: dict[str, TimeToImage]) -> None:
    """Draw the curves of one view and one tracer."""
    spp, last = np.geomspace(1, 1000, 200), methods["BSAH"]
    for method, t in methods.items():
        (line,) = panel.plot(spp, _sums(t, spp) / _sums(last, spp), label=method)
        even = break_even(last, t)
        if t is not last and even <= spp[-1]:
            panel.plot(even, 1.0, "o", color=line.get_color())
    title = f"{last.figure}, {last.tracer}"
    panel.set(xscale="log", title=title, xlabel="samples a pixel and light", ylim=(0, None))
    panel.grid(alpha=0.3)
