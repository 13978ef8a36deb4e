"""Beams: segments of a query that share one cone hierarchy and one traversal of the triangles.

All segments of a point light meet in it, so it is the common apex of their cones [Olsson and Assarsson 2011, Sec. 4.3].
Other lights have a blurred apex. The samples of a quad lie in a ball, the directions to the sun in a cone, and the ends
of ambient segments in a ball around each receiver. The triangle's planes are tilted or moved by the same amount
(`planes`), so one traversal serves all samples. Alternatively each sample is a point light with its own beam.
"""

from typing import NamedTuple

import numpy as np

from ..query.query_bounds import bounds
from ..scene.light_list import N_SETS
from ..scene.lights import AMBIENT, DIRECTIONAL, FIXED, SPHERE, is_list, tangents

PERSPECTIVE, PARALLEL, AROUND = 0, 1, 2
"""Kinds of `Beam`: ends in a point or ball; ends far away; ends all around each receiver."""

_MORE = 1.0 + 2.0**-18  # exceeds the rounding error of float32 samples and of planes
_NARROW = 1e-3  # least cosine to the middle of a cone of distant lights; others are all around
_WIDE = 1e5  # tangent of an angle: for a wider disk, rounding of the samples loses its distance


class Beam(NamedTuple):
    """The samples and receivers of a beam, and its apex or direction.

    A beam has its own frame. No receiver is farther than 1 away in it, and most are not much nearer. So its numbers fit
    into float32 for every unit of the scene.
    """

    kind: int  # PERSPECTIVE, PARALLEL or AROUND
    first: int  # the first sample
    count: int  # number of samples
    set: int  # the sample set of the beam's receivers; -1: all sets
    common: bool  # all these receivers have the same ends
    apex: np.ndarray  # (3,) float64, recentred frame; PERSPECTIVE: the middle of all ends, a float32 point
    axes: np.ndarray  # (3, 3) float64: rows u, v and, PARALLEL, towards the light
    unit: float  # a power of two: scale factor from the scene to the beam's frame
    # In the beam's frame:
    radius: float  # PERSPECTIVE: largest distance of an end from the apex; PARALLEL: sine of the largest angle of a
    # direction to the third axis; AROUND: largest distance of an end from its receiver
    lower: np.ndarray  # (3,) float64: bounds of the receivers along the axes; unused by PERSPECTIVE
    upper: np.ndarray  # (3,) float64
    scale: float  # largest absolute coordinate of the receivers; unused by PERSPECTIVE


def fixed_points(query) -> np.ndarray:
    """(16, n, 3) float32: the ends of a light that does not move with the receiver, computed as in `sample_point`."""
    light, a = query.light, query.samples
    ends = ((light.base + a[..., :1] * light.u) + a[..., 1:2] * light.v) + a[..., 2:] * light.w
    return ends.astype(np.float32)


def beams_of(query, each_sample: bool = False, threads: int | None = None) -> list[Beam]:
    """The beams of a ShadowQuery; ``each_sample``: one beam for each sample of a light that does not move.

    The lights of a list always have one beam each, because they may be far apart.
    """
    light, n = query.light, query.samples.shape[1]
    if not query.sides.size:
        return []
    low, high = (corner.astype(np.float64) for corner in bounds(query.origins, threads))
    if light.kind == SPHERE:
        return [_ball(0, n, -1, light.base, light.radius, low, high)]
    if light.kind == DIRECTIONAL:
        return [_heavens(query, low, high) if is_list(light) else _distant(light, n, low, high)]
    if light.kind == AMBIENT:
        return [_along(AROUND, n, np.eye(3), light.radius * _MORE, low, high)]
    ends = fixed_points(query)
    if light.kind == FIXED and not each_sample:
        return [_around(ends, 0, n, -1, low, high)]
    same = (ends == ends[:1]).all((0, 2))
    return [
        _around(ends[:, s : s + 1] if which < 0 else ends[which : which + 1, s : s + 1], s, 1, which, low, high)
        for s in range(n)
        for which in ([-1] if same[s] else range(N_SETS))
    ]


def _around(ends: np.ndarray, first: int, count: int, which: int, low: np.ndarray, high: np.ndarray) -> Beam:
    """The beam of these ends."""
    points = ends.reshape(-1, 3).astype(np.float64)
    if (points == points[0]).all():
        return _ball(first, count, which, points[0], 0.0, low, high)._replace(common=True, radius=0.0)
    centre = (points.min(0) + points.max(0)) / 2.0
    common = bool((ends == ends[:1]).all())
    beam = _ball(first, count, which, centre, float(np.linalg.norm(points - centre, axis=1).max()), low, high)
    return beam._replace(common=common)


def _ball(first: int, count: int, which: int, centre: np.ndarray, radius: float, low, high) -> Beam:
    """The beam of ends in a ball, and of receivers in the box from `low` to `high`, (3,) float64 each.

    Its apex is a float32 point, so differences to it are rounded once.
    """
    apex, none = centre.astype(np.float32).astype(np.float64), np.zeros(3)
    radius = (radius + float(np.linalg.norm(centre - apex))) * _MORE + 2.0**-22 * float(np.abs(apex).max() + radius)
    unit = _unit(np.linalg.norm(np.maximum(np.abs(low - apex), np.abs(high - apex))))
    return Beam(PERSPECTIVE, first, count, which, False, apex, np.eye(3), unit, radius * unit, none, none, 0.0)


def _along(kind: int, n: int, axes: np.ndarray, radius: float, low: np.ndarray, high: np.ndarray) -> Beam:
    """The beam without an apex for receivers in the box from `low` to `high`."""
    corners = np.where(np.arange(8)[:, None] >> np.arange(3) & 1, high, low) @ axes.T
    unit = _unit(np.abs(corners).max() * _MORE)
    corners *= unit
    scale = float(np.abs(corners).max()) * _MORE
    if kind == AROUND:
        radius *= unit
    return Beam(kind, 0, n, -1, False, np.zeros(3), axes, unit, radius, corners.min(0), corners.max(0), scale)


def _distant(light, n: int, low: np.ndarray, high: np.ndarray) -> Beam:
    """The beam of a distant disk. Rounding spreads the directions even of a light without extent."""
    distance = float(np.linalg.norm(light.base))
    towards = light.base / distance
    length = float(max(np.linalg.norm(light.u), np.linalg.norm(light.v)))
    if length > _WIDE * distance:
        return _along(AROUND, n, np.eye(3), (distance + length) * _MORE, low, high)
    sine = float(np.sin(np.arctan(length / distance * _MORE))) + 2.0**-20
    return _along(PARALLEL, n, np.stack([*tangents(towards), towards]), min(sine, 1.0), low, high)


def _heavens(query, low: np.ndarray, high: np.ndarray) -> Beam:
    """The beam of a list of distant lights: of the cone around their mean direction, if it is narrow."""
    distance, towards = float(np.linalg.norm(query.light.u)), query.samples.reshape(-1, 3)
    middle = towards.mean(0)
    length = float(np.linalg.norm(middle))
    n = query.samples.shape[1]
    if length > 0.0:
        middle /= length
        cosine = float((towards @ middle).min())
        if cosine > _NARROW:
            sine = float(np.linalg.norm(np.cross(towards, middle), axis=1).max()) * _MORE + 2.0**-20
            return _along(PARALLEL, n, np.stack([*tangents(middle), middle]), min(sine, 1.0), low, high)
    return _along(AROUND, n, np.eye(3), distance * _MORE, low, high)


def _unit(distance: float) -> float:
    """The power of two that scales a distance to between 1 / 2 and 1, limited to exponents that float32 can hold."""
    return 2.0 ** -min(max(int(np.frexp(distance)[1]), -100), 100)
