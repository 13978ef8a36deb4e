"""The report of a bake."""

from pathlib import Path
from time import perf_counter
from typing import NamedTuple


class Baked(NamedTuple):
    """The report of `antumbra.bake`."""

    path: Path  # the file written
    images: list[Path]  # EXR files beside it
    what: str  # the quantity
    attribute: str | None  # of the vertices; None for a texture
    parts: int  # primitives at nodes
    receivers: int  # vertices or texels measured
    hidden: int  # of them inside solids
    rays: int  # shadow rays traced
    mean: float  # of all measured values; NaN of hidden texels left out
    exposure: float  # factor on light in colours and textures, which hold 0 to 1; not in own attributes and EXR
    seam: float | None  # 99th percentile of the difference of two sides of a seam; None: no texture, or no seams
    seconds: dict[str, float]  # of each phase: read, unwrap, trace, write


class Clock:
    """Adds up the seconds of phases that follow one another."""

    def __init__(self):
        self._last, self.seconds = perf_counter(), {}

    def lap(self, name: str) -> None:
        """The phase `name` ends now."""
        now = perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now
