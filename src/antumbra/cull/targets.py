"""Ends of a query's shadow rays: boxes around the samples of its light.

They are the destination cells of [Selgrad et al. 2015, Sec. 3.1].
"""

from typing import NamedTuple

import numpy as np

from ..scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from .grid import PAD

MOST = 4  # most boxes of one light; twelve cost more time than they saved


class Targets(NamedTuple):
    """Boxes that hold the far ends of a query's segments.

    A light with a position has boxes there. A distant or ambient light has boxes relative to the receiver: a segment
    from o ends in o + box. So a distant light of any angular size is a box of directions, times a length that reaches
    beyond the scene. It needs no destination cells.
    """

    boxes: np.ndarray  # (k, 2, 3) float64: lower, upper
    relative: bool  # whether the boxes are relative to the receiver


def targets_of(query, cell: np.ndarray) -> Targets:
    """The `Targets` of a ShadowQuery; ``cell``: (3,) extent of a cell of about the grid's size.

    They hold the samples that the query asks, not all of the light. If the samples fill a box that is thicker than a
    cell on every axis, they are split into several boxes. Tilted lights and lists have such samples.
    """
    light = query.light
    if light.kind in (SPHERE, AMBIENT):  # tangent disks lie in the sphere
        points = light.base + light.radius * np.array([[-1.0], [1.0]])
        return Targets(_padded(points[None]), light.kind == AMBIENT)
    points = sample_points(query)
    relative = light.kind == DIRECTIONAL
    return Targets(_padded(_boxes(points, cell, 1 if relative else MOST)), relative)


def sample_points(query) -> np.ndarray:
    """(k, 3) float64: all samples of a flat light, a list or a distant light.

    Samples of a distant light are relative to the receiver.
    """
    light = query.light
    return light.base + query.samples.reshape(-1, 3) @ np.stack([light.u, light.v, light.w])


def _boxes(points: np.ndarray, cell: np.ndarray, most: int) -> np.ndarray:
    """At most `most` boxes, (k, 2, 3), each around points that lie together."""
    lower, upper = points.min(0), points.max(0)
    if most == 1 or (upper - lower <= cell).any():
        return np.array([[lower, upper]])
    size = np.maximum(cell, (upper - lower) / 64.0)
    while True:
        key = np.floor((points - lower) / size).astype(np.int64) @ [1 << 20, 1 << 10, 1]
        keys, group = np.unique(key, return_inverse=True)
        if len(keys) <= most:
            break
        size = 2.0 * size
    boxes = np.empty((len(keys), 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    np.minimum.at(boxes[:, 0], group, points)
    np.maximum.at(boxes[:, 1], group, points)
    return boxes


def _padded(boxes: np.ndarray) -> np.ndarray:
    """The boxes, grown by more than the rounding error of the float32 samples in them."""
    pad = PAD * np.abs(boxes).max()
    return boxes + np.array([[-pad], [pad]])
