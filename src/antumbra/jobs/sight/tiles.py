"""Tiles of a visibility matrix: all sightlines between two strips of points, by few large queries.

A strip of targets becomes lists of point lights, which all points of the other strip ask. Both strips are in the order
of a space-filling curve, so that their sightlines form thin bundles.
"""

import numpy as np

from ...rendering.memory import points_memory
from ...rendering.points import AskingPoints
from ...rendering.queries import renderer_of
from ...scene.any_scene import AnyScene
from ...scene.lights import MAX_SPP
from ...scene.point_lights import PointLights
from .bitrows import ones, transposed, words_of
from .ends import Ends

STRIP = 4096
"""Points of a strip: a multiple of MAX_SPP. A tile has 2 MiB of bits."""


class Tracing:
    """A scene at one time, ready for tiles.

    sightlines : int
        About so many in all.
    """

    def __init__(self, scene: AnyScene, plan, time: float, threads: int | None, sightlines: int):
        renderer = renderer_of(scene, plan, threads, None, None)
        light = _Recentred(np.zeros((MAX_SPP, 3)))
        self._asking = AskingPoints(renderer, time, sightlines, points_memory(STRIP, light, _samples(light)))

    def visible(self, rows: Ends, columns: Ends) -> np.ndarray:
        """(n, words of m) uint64: bit j of row i is set where points i and j see each other."""
        blocked = np.empty((len(rows), words_of(len(columns))), np.uint64)
        for first, light in self._lists(columns):
            bits = self._asking.bits(rows.at, rows.unit, light, _samples(light))
            blocked[:, first : first + bits.shape[1]] = bits
        if columns.unit is not None:
            blocked |= transposed(self._below(columns, rows), len(rows))
        return ~blocked & ones(len(columns))

    def _below(self, ends: Ends, others: Ends) -> np.ndarray:
        """(n, words of m) uint64: bit j of row i is set where the surface of end i hides point j."""
        assert ends.unit is not None
        found = [self._asking.below(ends.at, ends.unit, light, _samples(light)) for _, light in self._lists(others)]
        return np.hstack(found)

    def _lists(self, ends: Ends):
        """Yield (first word, lights) of lists of at most MAX_SPP of the ends."""
        for first in range(0, len(ends), MAX_SPP):
            yield words_of(first), _Recentred(ends.at[first : first + MAX_SPP])


class _Recentred(PointLights):
    """Point lights whose positions are in the recentred frame: they are float32, and stay what they are."""

    def patch(self, origin, reach):
        return super().patch(np.zeros(3), reach)


def _samples(light: PointLights) -> np.ndarray:
    """(16, k, 3) float64: each receiver asks all lights."""
    return np.ascontiguousarray(light.points[light.sets])
