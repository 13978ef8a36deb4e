"""Whether points are inside bodies: crossings of a ray, or the votes of several where surfaces are open.

With closed surfaces, one ray decides, exactly. With open edges, rays disagree: those through a hole cross one surface
less. Points outside the scene's bounds are then outside, and others are inside if most rays along the axes and space
diagonals cross surfaces an odd number of times. Opposite rays from a point beside an open sheet never both cross it, so
sheets contain nothing. Of scenes in memory, all rays but the first are traced through caps (`trace.rays.inside_votes`),
and once many points have come, most need only a look into their cell (`trace.rays.cell_verdicts`).
"""

import numpy as np
from numpy.typing import NDArray

from ..base.wording import counted
from ..query.cap_columns import AXES, all_directions
from ..query.ray_list import RayArguments, rays_along
from ..trace.rays.all_hits import ON_SURFACE
from ..trace.rays.inside_votes import MOST, ON_CAP, WITHIN, Caps, Election
from .sources.source_protocols import Bodies

_FEW = 64  # points whose rays are traced by one call
_THREADS_PAY = 1 << 11  # points whose cells do not decide, from which on several threads trace their rays

_NOTE = "contains: "


def inside_of(bodies: Bodies, rays: RayArguments, threads: int) -> NDArray[np.bool_]:
    """(n,) bool: whether the origins of rays along an axis are inside bodies, or on a surface."""
    found = None if bodies.cells is None else bodies.cells.of(rays, threads)
    if found is None:
        return _by_rays(bodies, rays, bodies.crossings(rays, threads), threads)
    if len(found.places):
        along, unknown = _direction(rays), found.unknown
        threads = threads if len(found.places) >= _THREADS_PAY else 1
        if unknown:
            first = rays_along(found.points[:unknown], along, time=rays.time)
            found.crossings[:unknown] = bodies.crossings(first, threads)
        others = rays_along(found.points, along, time=rays.time)
        found.inside[found.places] = _by_rays(bodies, others, found.crossings, threads)
    return found.inside


def _by_rays(bodies: Bodies, rays: RayArguments, counts: NDArray[np.int64], threads: int) -> NDArray[np.bool_]:
    """`inside_of`, by the crossings of the rays; or of scenes with caps, as in an `Election`."""
    if bodies.open_edges == 0:
        return np.asarray((counts & 1 != 0) | (counts >= ON_SURFACE))
    if bodies.caps is not None:
        return _by_caps(bodies, bodies.caps, rays, counts, threads)
    on_surface, inside = counts >= ON_SURFACE, counts & 1 != 0
    points, (lower, upper) = rays.arrays().local()[0], bodies.box
    within = ((points >= lower) & (points <= upper)).all(axis=1)
    inside &= within
    if bodies.open_edges is not None:
        uncertain = np.flatnonzero(within & ~on_surface)
        inside[uncertain] = _by_votes(bodies, points[uncertain], _direction(rays), inside[uncertain], threads)
    return np.asarray(on_surface | inside)


def _direction(rays: RayArguments) -> NDArray[np.float32]:
    """(3,): that of all rays."""
    direction: NDArray[np.float32] = np.asarray(rays.directions, np.float32).reshape(-1, 3)[0]
    return direction


def _by_caps(
    bodies: Bodies, caps: Caps, rays: RayArguments, crossings: NDArray[np.int64], threads: int
) -> NDArray[np.bool_]:
    """`inside_of` by the votes of rays through caps."""
    verdicts = caps.verdicts(rays, Election(crossings, bodies.box), threads)
    inside = verdicts == WITHIN
    if len(undecided := np.flatnonzero(verdicts == ON_CAP)):
        points, first = rays.arrays().part(undecided).local()[0], crossings[undecided] & 1 != 0
        inside[undecided] = _by_votes(bodies, points, _direction(rays), first, threads)
    return np.asarray(inside)


def _by_votes(
    bodies: Bodies, points: NDArray[np.float32], axis: NDArray[np.float32], first: NDArray[np.bool_], threads: int
) -> NDArray[np.bool_]:
    """(m,) bool: whether most rays from points in the frame cross surfaces an odd number of times.

    Rays that no longer matter are not traced: the diagonals of points whose axes agree, or whose majority is certain.

    axis, first : a direction along an axis, and (m,) bool, whether the ray along it crosses an odd number of surfaces
    """

    def is_odd(origins: NDArray[np.float32], along: NDArray[np.float32]) -> NDArray[np.bool_]:
        return (bodies.crossings(rays_along(origins, along, time=bodies.time), threads) & 1).astype(np.bool_)

    others = all_directions(axis)[1:]
    axes, diagonals = others[: AXES - 1], others[AXES - 1 :]
    if len(points) <= _FEW:  # calls take longer than rays
        odd = is_odd(np.repeat(points, len(others), axis=0), np.tile(others, (len(points), 1))).reshape(-1, len(others))
        votes = first + odd[:, : len(axes)].sum(axis=1)
        agree = (votes == 0) | (votes == AXES)
        return np.asarray(np.where(agree, votes > 0, first + odd.sum(axis=1) >= MOST))
    votes = first.astype(np.int8)
    for along in axes:
        votes += is_odd(points, along)
    inside = votes == AXES
    divided = np.flatnonzero((votes > 0) & ~inside)
    votes, points = votes[divided], points[divided]
    for left, along in zip(reversed(range(len(diagonals))), diagonals):
        votes += is_odd(points, along)
        inside[divided] = votes >= MOST
        open_ = np.flatnonzero((votes < MOST) & (votes + left >= MOST))
        divided, votes, points = divided[open_], votes[open_], points[open_]
    return np.asarray(inside)


def with_note(notes: tuple[str, ...], name: str, open_edges: int | None) -> tuple[str, ...]:
    """The notes of a scene, with one about its open edges instead of an earlier one."""
    others = tuple(note for note in notes if not note.startswith(f"{name}: {_NOTE}"))
    if not open_edges:
        return others
    edges = counted(open_edges, "edge", "are")
    return (
        *others,
        f"{name}: {_NOTE}{edges} open, so inside is where most of 14 rays cross surfaces an odd number of times; "
        "close the surfaces for exact answers",
    )
