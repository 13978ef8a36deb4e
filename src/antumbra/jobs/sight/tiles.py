"""Tiles of a visibility matrix: all sightlines between two strips of points, by few large queries.

A strip of targets becomes lists of point lights, which all points of the other strip ask. Both strips are in the order
of a space-filling curve, so that their sightlines form thin bundles.
"""

import numpy as np

from ...engine.scene import AnyScene
from ...query.receivers import Receivers
from ...query.shadow_query import below_horizon
from ...scene.light_lists import PointLights
from ...scene.lights import MAX_SPP
from .bitrows import ones, transposed, words_of

STRIP = 4096
"""Points of a strip: a multiple of MAX_SPP. A tile has 2 MiB of bits."""


class Tracing:
    """A scene at one time, ready for tiles.

    sightlines : int
        About so many in all.
    """

    def __init__(self, scene: AnyScene, plan, time: float, threads: int | None, sightlines: int):
        self._engine, self._time, self._sightlines = scene.engine.with_options(plan, threads, None), time, sightlines

    def visible(self, rows: Receivers, columns: Receivers) -> np.ndarray:
        """(n, words of m) uint64: bit j of row i is set where points i and j see each other."""
        blocked = np.empty((rows.n, words_of(columns.n)), np.uint64)
        for first, light in self._lists(columns):
            ((_, bits),) = self._engine.shadows(
                rows, [light], [_samples(light)], time=self._time, later=self._sightlines
            )
            blocked[:, first : first + bits.shape[2]] = bits[0]
        if columns.normals.size:
            blocked |= transposed(self._below(columns, rows), rows.n)
        return ~blocked & ones(columns.n)

    def _below(self, ends: Receivers, others: Receivers) -> np.ndarray:
        """(n, words of m) uint64: bit j of row i is set where the surface of end i hides point j."""
        found = []
        for _, light in self._lists(others):
            (query,) = self._engine.queries(ends, [light], [_samples(light)], time=self._time)
            found.append(below_horizon(query, self._engine.threads)[0])
        return np.hstack(found)

    def _lists(self, ends: Receivers):
        """Yield (first word, lights) of lists of at most MAX_SPP of the ends."""
        for first in range(0, ends.n, MAX_SPP):
            yield words_of(first), _Recentred(ends.origins[0, first : first + MAX_SPP])


class _Recentred(PointLights):
    """Point lights whose positions are in the recentred frame: they are float32, and stay what they are."""

    def patch(self, origin, reach):
        return super().patch(np.zeros(3), reach)


def _samples(light: PointLights) -> np.ndarray:
    """(16, k, 3) float64: each receiver asks all lights."""
    return np.ascontiguousarray(light.points[light.sets])
