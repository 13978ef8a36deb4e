"""Whether points are inside bodies: crossings of a ray, or the votes of several where surfaces are open.

With closed surfaces, one ray decides, exactly. With open edges, rays disagree: those through a hole cross one surface
less. Points outside the scene's bounds are then outside, and others are inside if most rays along the axes and space
diagonals cross surfaces an odd number of times. Opposite rays from a point beside an open sheet never both cross it, so
sheets contain nothing.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..query.ray_list import RayArguments
from ..trace.rays.all_hits import ON_SURFACE
from .sources.source_protocols import Bodies

_AXES = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
_DIAGONALS = np.array(list(product((-1.0, 1.0), repeat=3)), np.float32)

_NOTE = "contains: "


def inside_of(bodies: Bodies, rays: RayArguments, threads: int) -> NDArray[np.bool_]:
    """(n,) bool: whether the origins of rays along an axis are inside bodies, or on a surface."""
    counts = bodies.crossings(rays, threads)
    on_surface, inside = counts >= ON_SURFACE, counts % 2 == 1
    if bodies.open_edges != 0:
        points, (lower, upper) = rays.arrays().local()[0], bodies.box
        within = ((points >= lower) & (points <= upper)).all(axis=1)
        inside &= within
        if bodies.open_edges is not None:
            uncertain = np.flatnonzero(within & ~on_surface)
            inside[uncertain] = _by_votes(bodies, points[uncertain], threads)
    return np.asarray(on_surface | inside)


def _by_votes(bodies: Bodies, points: NDArray[np.float32], threads: int) -> NDArray[np.bool_]:
    """(m,) bool: whether most rays from points in the frame cross surfaces an odd number of times."""

    def odd_rays(places: NDArray[np.int64], directions: NDArray[np.float32]) -> NDArray[np.int64]:
        odd, frame = np.zeros(len(places), np.int64), (0.0, 0.0, 0.0)
        for along in directions:
            rays = RayArguments(points[places], along, 0.0, np.inf, -1.0, (len(places),), 0, False, frame, bodies.time)
            odd += bodies.crossings(rays, threads) % 2
        return odd

    votes = odd_rays(np.arange(len(points)), _AXES)
    inside = votes == len(_AXES)
    divided = np.flatnonzero((votes > 0) & ~inside)
    votes[divided] += odd_rays(divided, _DIAGONALS)
    inside[divided] = 2 * votes[divided] > len(_AXES) + len(_DIAGONALS)
    return np.asarray(inside)


def with_note(notes: tuple[str, ...], name: str, open_edges: int | None) -> tuple[str, ...]:
    """The notes of a scene, with one about its open edges instead of an earlier one."""
    others = tuple(note for note in notes if not note.startswith(f"{name}: {_NOTE}"))
    if not open_edges:
        return others
    edges = "1 edge is" if open_edges == 1 else f"{open_edges:,} edges are"
    return (
        *others,
        f"{name}: {_NOTE}{edges} open, so inside is where most of 14 rays cross surfaces an odd number of times; "
        "close the surfaces for exact answers",
    )
