"""Labels of points on a map: none overlaps another, nor a mark; those without room have a line to their point."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .map_frame import MapFit
from .page_text import MM_PER_POINT, text_width

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE = 7.0
"""Points, of the letters."""

MOST = 300
"""Labels on a map."""

_LONGEST = 24  # letters
_DISTANCES = 1.0, 3.0, 6.0, 10.0, 15.0, 21.0  # millimetres between a mark and its label
_DIRECTIONS = np.radians([45.0, 135.0, 315.0, 225.0, 90.0, 270.0, 0.0, 180.0, 20.0, 160.0, 200.0, 340.0])
_JOINED = 0.3  # millimetres: points closer than this share a label
_PAD = 0.35


class Label(NamedTuple):
    """A label on a map, in millimetres from the lower left corner of its frame."""

    text: str
    point: tuple[float, float]  # which it belongs to
    left: float
    bottom: float
    width: float
    height: float

    @property
    def far(self) -> bool:
        """Whether it needs a line to its point."""
        x = min(max(self.point[0], self.left), self.left + self.width)
        y = min(max(self.point[1], self.bottom), self.bottom + self.height)
        return bool(np.hypot(x - self.point[0], y - self.point[1]) > _DISTANCES[1] - 0.1)


def joined_texts(points: NDArray[np.float64], texts: Sequence[str]) -> tuple[NDArray[np.float64], list[str]]:
    """Points, in millimetres, and their labels; one for all points at the same place, such as windows on storeys."""
    keys = np.round(points / _JOINED).astype(np.int64)
    _, first, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    groups = [[texts[k] for k in np.flatnonzero(which.ravel() == group).tolist()] for group in order.tolist()]
    names = [", ".join(dict.fromkeys(group)) for group in groups]
    return points[first[order]], [name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…" for name in names]


def spread_points(
    points: NDArray[np.float64], heights: NDArray[np.float64], outward: NDArray[np.float64], step: float
) -> NDArray[np.bool_]:
    """Move points that lie at the same place, such as windows above each other, apart; in place.

    The lowest one stays, and the others follow outwards by height.

    points : (n, 2) float64, millimetres
    heights : (n,) float64
    outward : (n, 2) float64, unit vectors
    step : millimetres between points of a place

    Returns
    -------
    (n,) bool
        Which of them share their place with others.
    """
    keys = np.round(points / _JOINED).astype(np.int64)
    _, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    order = np.lexsort((heights, which))
    first = np.searchsorted(which[order], np.arange(len(count)))
    rank = np.empty(len(points))
    rank[order] = np.arange(len(points)) - first[which[order]]
    points += (step * rank)[:, None] * outward
    return np.asarray(count[which] > 1)


def placed_labels(
    points: NDArray[np.float64], texts: Sequence[str], width: float, height: float, radius: float,
    taken: Sequence[tuple[float, float, float, float]] = (), centred: bool = False,
) -> tuple[list[Label], list[str]]:  # fmt: skip
    """Place labels in a frame, first come, first served; the texts for which no room is left are returned, too.

    Parameters
    ----------
    points : (n, 2) float64
        Millimetres from the lower left corner of the frame.
    texts : sequence of str
    width, height : float
        Of the frame.
    radius : float
        Of the marks of points.
    taken : sequence of (left, bottom, width, height)
        Rectangles to stay clear of.
    centred : bool
        Whether labels lie on their points where they can, since these have no marks.
    """
    marks = np.concatenate([points - radius, points + radius], 1)[: 0 if centred else None]
    boxes = np.concatenate([marks, [(x, y, x + w, y + h) for x, y, w, h in taken]]) if len(taken) else marks
    labels, left_out = list[Label](), list[str]()
    tall = SIZE * MM_PER_POINT
    for (x, y), text in zip(points.tolist(), texts, strict=True):
        wide = text_width(text, SIZE)
        found = None
        middle = [(x - wide / 2.0, y - tall / 2.0)] if centred else []
        for place in (*middle, *_places(x, y, wide, tall, radius)):
            low, high = np.subtract(place, _PAD), np.add(place, (wide, tall)) + _PAD
            if (low < 0.0).any() or high[0] > width or high[1] > height:
                continue
            if not ((boxes[:, :2] < high) & (boxes[:, 2:] > low)).all(1).any():
                found = Label(text, (x, y), place[0], place[1], wide, tall)
                boxes = np.concatenate([boxes, [[*low, *high]]])
                break
        if found is None:
            left_out.append(text)
        else:
            labels.append(found)
    return labels, left_out


def _places(x: float, y: float, wide: float, tall: float, radius: float) -> Iterator[tuple[float, float]]:
    """Yield places of a label, nearest first, by its lower left corner."""
    for distance in _DISTANCES:
        for angle in _DIRECTIONS.tolist():
            dx, dy = float(np.cos(angle)), float(np.sin(angle))
            at = x + (radius + distance) * dx, y + (radius + distance) * dy
            left = at[0] - (0.0 if dx > 0.3 else wide if dx < -0.3 else wide / 2.0)
            yield left, at[1] - (0.0 if dy > 0.3 else tall if dy < -0.3 else tall / 2.0)


def draw_labels(
    axes: "Axes", fit: MapFit, points: NDArray[np.float64], texts: Sequence[str], radius: float, centred: bool = False
) -> list[str]:
    """Draw labels of points, (n, 2) easting and northing, on a map; return those for which no room was left.

    radius : millimetres, of the marks
    centred : whether there are none, and labels lie on their points
    """
    frame, extent = fit.layout.map, fit.extent
    per_unit = frame.width / extent.width
    low, high = np.array([[extent.west, extent.south], [extent.east, extent.north]])
    inside = np.asarray((points >= low).all(1) & (points <= high).all(1))
    shown = (points[inside] - low) * per_unit
    if not len(shown):
        return []
    places, names = joined_texts(shown, [text for text, here in zip(texts, inside.tolist()) if here])
    arrow = frame.width - 14.0, frame.height - 14.0, 14.0, 14.0
    labels, left_out = placed_labels(places, names, frame.width, frame.height, radius, [arrow], centred)
    for label in labels:
        if label.far:
            end = (
                min(max(label.point[0], label.left), label.left + label.width),
                min(max(label.point[1], label.bottom), label.bottom + label.height),
            )
            line = np.array([label.point, end]) / per_unit + low
            axes.plot(*line.T, color="#202124", linewidth=0.4, zorder=6)
        x, y = np.array([label.left, label.bottom + 0.22 * label.height]) / per_unit + low
        style: dict[str, Any] = {"fontsize": SIZE, "color": "#202124", "va": "baseline", "ha": "left", "zorder": 8}
        style["bbox"] = {"facecolor": "white", "alpha": 0.75, "linewidth": 0.0, "pad": 0.6}
        axes.text(x, y, label.text, parse_math=False, clip_on=True, **style)
    return left_out
