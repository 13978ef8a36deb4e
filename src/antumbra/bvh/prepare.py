"""The first steps of every builder: input checks, bounds of all triangles, and scenes of less than two triangles."""

import math

import numpy as np

from ..errors import InputError
from ..kernels.parallel import new_ticket, run
from .bounds import MAX_COORDINATE, MAX_TRIANGLES, PART, bound_triangles, write_records
from .links import CHILDREN, LINK, bvh_link
from .nodes import EMPTY, MAX_LEAF, Bvh, aligned_empty

CHUNK = 4096  # triangles that a thread bounds at a time
PAIR = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0], [2, 2, 2, 3, 2, 2, 2, 3, 2]], np.float32)
"""Two triangles, the fewest that can be split. Builders compile their kernels for large scenes with them."""

_CORNERS = [0, 1, 2, 4, 5, 6]  # the words of a box that are coordinates


def checked(vertices, max_leaf) -> np.ndarray:
    """The checked vertices as (n, 9) float32."""
    vertices = np.asarray(vertices)
    if vertices.ndim != 3 or vertices.shape[1:] != (3, 3) or vertices.dtype != np.float32:
        raise InputError(f"vertices is {vertices.dtype} {vertices.shape}; it must be float32 (n, 3, 3)")
    if len(vertices) > MAX_TRIANGLES:
        raise InputError(f"vertices has {len(vertices)} triangles; a BVH holds at most {MAX_TRIANGLES}")
    if max_leaf not in range(1, MAX_LEAF + 1):
        raise InputError(f"max_leaf is {max_leaf!r}; it must be a whole number from 1 to {MAX_LEAF}")
    return np.ascontiguousarray(vertices).reshape(-1, 9)


def _bounds(worker, flat, threads, *args):
    """(box, centroid box) of all triangles; `worker` bounds them in chunks."""
    parts = np.empty((-(-len(flat) // CHUNK), PART), np.float32)
    run(worker, threads, new_ticket(len(flat), CHUNK), flat, *args, parts)
    bounds = parts[:, :16].min(axis=0, initial=np.inf)
    if not ((parts[:, 16:] == 0).all() and (bounds[_CORNERS] > -MAX_COORDINATE).all()):
        row = int(np.argmin((np.abs(flat) < MAX_COORDINATE).all(axis=1)))
        raise InputError(f"triangle {row} has a coordinate that is not finite, or not below {MAX_COORDINATE:.1e}")
    return bounds[:8], bounds[8:]


def scene_bounds(flat, threads):
    """(box, centroid box) of all triangles `flat`, (n, 9) float32."""
    return _bounds(bound_triangles, flat, threads)


def make_records(flat, records, threads):
    """Fill `records`, (n, 8) float32, and return (box, centroid box) of all."""
    return _bounds(write_records, flat, threads, records)


def power_of_two_for(box) -> np.float32:
    """A power of two that scales the largest coordinate to about 1."""
    largest = float(np.abs(box[_CORNERS]).max())
    return np.float32(2.0 ** min(126, -math.frexp(largest)[1]))


def scale_of(bvh: Bvh) -> np.float32:
    """`power_of_two_for` the box of a finished BVH."""
    largest = np.abs(bvh.nodes[0, :12].reshape(3, 4)).max(axis=1)
    return power_of_two_for(np.resize(np.append(largest, 0), 8))


def tiny(flat) -> Bvh:
    """The BVH of no triangle or one, (n, 9) float32. Coordinates are checked as in larger scenes."""
    scene_bounds(flat, 1)
    n = len(flat)
    nodes = aligned_empty((1, 16), "f4")
    nodes[0, :12] = [np.inf, np.inf, -np.inf, -np.inf] * 3
    nodes[0, 12:] = 0
    links = nodes.view(np.int32)
    links[0, CHILDREN] = EMPTY
    if n:
        corners = flat.reshape(3, 3)
        nodes[0, [0, 4, 8]], nodes[0, [2, 6, 10]] = corners.min(axis=0), corners.max(axis=0)
        links[0, LINK] = bvh_link(0, 1)
    return Bvh(nodes, links, np.zeros(n, np.int32), flat.copy())
