"""Bands of a picture's rows. The rays of a band meet few chunks, so its camera and shadow rays read each chunk once.

A flight over a large city sees more chunks than memory holds. If all camera rays come before all shadow rays, both read
all chunks. The chunks of a band fit in memory, and its shadow rays find them there [Mattausch et al. 2015, Sec. 5.4].
"""

from collections.abc import Iterator

_LEAST = 16  # rows of a band: a region
_FIRST = 64  # rows of the first band
_FULL = 0.5  # the share of memory that the chunks of a band's camera rays may fill
_FEW = 0.1  # the share of memory that shadow rays may read in any case
_PAUSE = 16  # frames in one piece after bands have not helped


class Bands:
    """Chooses the bands of each frame by what was read for the bands before."""

    def __init__(self):
        self._kept: dict[int, int] = {}  # first row -> rows, of the last frame's bands whose chunks were in memory
        self._rows = _FIRST
        self._pause = 0

    def of_frame(self, height: int, needed: bool) -> Iterator[slice]:
        """Yield the rows of each band, top down. The caller calls `read` after each.

        needed : whether the chunks of the whole picture far exceed the memory; otherwise there is one band
        """
        self._pause -= 1
        banded = needed and self._pause <= 0
        first, kept, self._kept = 0, self._kept if banded else {}, {}
        self._rows = _FIRST if banded else height
        while first < height:
            rows = self._rows = min(kept.get(first, self._rows), height - first)
            yield slice(first, first + rows)
            if self._fit:
                self._kept[first] = rows
            first += rows

    def read(self, looked: int, again: int, budget: int) -> None:
        """Choose the rows of the next band.

        looked, again : bytes that the last band's camera rays read, and its shadow rays
        budget : bytes of chunks that memory holds
        """
        best = self._rows * _FULL * budget / max(looked, 1)
        self._fit = again <= max(looked / 2, _FEW * budget)
        if self._fit:
            self._rows = _regions(min(2 * self._rows, best))
        elif self._rows > _LEAST:
            self._rows = _regions(min(self._rows / 2, best))
        else:  # the rays of the smallest band meet more than memory holds
            self._rows, self._pause = 1 << 30, _PAUSE


def _regions(rows: float) -> int:
    """At most so many rows of whole regions, at least one."""
    return max(int(rows) // _LEAST, 1) * _LEAST
