"""Where the shadow rays of a query end: boxes around its light, the paper's destination cells (Sec. 3.1)."""

from typing import NamedTuple

import numpy as np

from ..scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from .grid import PAD

MOST = 4  # boxes of one light, at most: twelve cost more than they spared


class Targets(NamedTuple):
    """Boxes that hold the far ends of a query's segments.

    A light that is somewhere has boxes there. One that moves along with the receiver, as distant and ambient light
    does, has boxes relative to it: a segment from o ends in o + box. So a distant light of any angular size is a box
    of directions, scaled to a length that reaches beyond the scene, and needs no destination cells.
    """

    boxes: np.ndarray  # (k, 2, 3) float64: lower, upper
    relative: bool  # to the receiver


def targets_of(query, cell: np.ndarray) -> Targets:
    """The `Targets` of a ShadowQuery; ``cell``: (3,) extent of a cell of about the grid's size.

    They hold the samples that the query asks, not all of the light. Where these fill a box that is thicker than a
    cell on every axis, as those of tilted lights and of lists do, they are split into several boxes.
    """
    light = query.light
    if light.kind in (SPHERE, AMBIENT):  # tangent disks lie in the sphere
        points = light.base + light.radius * np.array([[-1.0], [1.0]])
        return Targets(_padded(points[None]), light.kind == AMBIENT)
    points = sample_points(query)
    relative = light.kind == DIRECTIONAL
    return Targets(_padded(_boxes(points, cell, 1 if relative else MOST)), relative)


def sample_points(query) -> np.ndarray:
    """(k, 3) float64: all samples of a flat light or a list, of a distant light relative to the receiver."""
    light = query.light
    return light.base + query.samples.reshape(-1, 3) @ np.stack([light.u, light.v, light.w])


def _boxes(points: np.ndarray, cell: np.ndarray, most: int) -> np.ndarray:
    """At most so many boxes, (k, 2, 3), around points that lie together."""
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
    """The boxes, grown by what the float32 samples in them may be off."""
    pad = PAD * np.abs(boxes).max()
    return boxes + np.array([[-pad], [pad]])
