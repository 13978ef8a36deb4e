"""Triangle setup: interpolate, recentre, round and gather the pieces of a scene in parallel; find degenerate triangles.

Kernels take addresses instead of arrays, so the same compiled kernels serve read-only, memory-mapped, float32 and
float64 arrays, and no compilation happens while a frame is timed.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.exact.filters import has_area
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run, shares, thread_count
from ..kernels.simd import (
    absolute,
    bits,
    f32_at,
    f64_at,
    get,
    i32_at,
    load4,
    load8,
    load16x3,
    lowest_bit,
    mask_from_bits4,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    shuffle,
    splat16,
    stack_f32,
    store,
)
from ..kernels.transposition import transposed8
from .alpha_masks import without_panes
from .mesh import Piece
from .scene_bounds import MAX_EXTENT, NEAREST
from .triangles import Triangles

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

# --- Interpolation, recentring and gathering --------------------------------------------------------------------------


_AT_A_TIME = 8192  # vertices, or faces
_IN_CACHE = 1024  # faces: their corners stay in a first-level cache until their areas are found
_SURE, _TINY = np.float32(2.0**-20), np.float32(1e-37)  # bounds of an error: relative, and from underflow
_LIMIT, _NEAREST, _ZERO, _INF = np.float32(MAX_EXTENT), np.float32(NEAREST), np.float32(0.0), np.float32(np.inf)


@inlined
def _recentre_rows(first, last, a, b, share, origin, out):
    """Write (1 - share) a + share b - origin, computed in float64 and rounded once. Coordinates below NEAREST become 0.

    Returns whether all coordinates are finite and within MAX_EXTENT, and whether adding the origin restores them all.
    """
    share_of_a, fine, exact = 1.0 - share, True, True
    for i in range(3 * first, 3 * last, 3):
        for k in range(3):
            world = share_of_a * np.float64(get(a, i + k)) + share * np.float64(get(b, i + k))
            local = np.float32(world - origin[k])
            local = _ZERO if abs(local) < _NEAREST else local
            put(out, i + k, local)
            fine &= abs(local) <= _LIMIT  # type: ignore[assignment]
            exact &= np.float64(local) + origin[k] == world
    return fine, exact


@kernel
def _recentre(ticket, single, a, b, share, origin, out, faults):
    """Worker: recentre rows of vertices."""
    # In: a, b, addresses of (n, 3) vertices at two moments, float32 if `single`, else float64
    # In: share, weight of b, float64; origin, (3,) float64
    # Out: out, address of (n, 3) float32; faults, (2,) bool, set if a vertex is not finite or too far away; is rounded
    zero, p = (origin[0], origin[1], origin[2]), f32_at(out)
    for first, last in shares(ticket):
        if single:
            fine, exact = _recentre_rows(first, last, f32_at(a), f32_at(b), share, zero, p)
        else:
            fine, exact = _recentre_rows(first, last, f64_at(a), f64_at(b), share, zero, p)
        if not fine:
            faults[0] = True
        if not exact:
            faults[1] = True


class FacesOfCopies(NamedTuple):
    """The faces of all copies of a mesh: addresses of numbers, and counts per copy."""

    positions: int  # of (copies * n_vertices, 3) float32
    n_vertices: int
    indices: int  # of (n_faces, 3) int32
    n_faces: int


@inlined
def write_corners(positions, a, b, c, row):
    """Write three vertices to a row of nine numbers. Memory behind the last vertex is read."""
    v1, v2 = load4(positions, 3 * b), load4(positions, 3 * c)
    store(row, 0, load4(positions, 3 * a))
    store(row, 3, v1)
    store(row, 5, select(mask_from_bits4(1), shuffle(v1, 2, 2, 2, 2), shuffle(v2, 3, 0, 1, 2)))


@inlined
def _gather_rows(faces, first, last, rows, padded):
    """Write the corners of faces of a `FacesOfCopies`; padded: whether a number follows the last vertex."""
    positions, indices, n = f32_at(faces.positions), i32_at(faces.indices), faces.n_faces
    copy, face = first // n, first % n
    for i in range(first, last):
        start, at = copy * faces.n_vertices, 3 * face
        if padded:
            a, b, c = start + get(indices, at), start + get(indices, at + 1), start + get(indices, at + 2)
            write_corners(positions, a, b, c, ptr_at(rows, 9 * i))
        else:
            for corner in range(3):
                vertex = start + get(indices, at + corner)
                for k in range(3):
                    put(rows, 9 * i + 3 * corner + k, get(positions, 3 * vertex + k))
        face += 1
        if face == n:
            copy, face = copy + 1, 0


@kernel
def _gather(ticket, faces, out):
    """Worker: write the corners of the faces of a `FacesOfCopies`; `out`: an address."""
    for first, last in shares(ticket):
        _gather_rows(faces, first, last, f32_at(out), False)


class Gathered(NamedTuple):
    """What `gather` has written."""

    count: int  # type: ignore[assignment]  # triangles; hides tuple.count
    exact: bool  # whether the vertices plus the origin are those of the piece


class _FacesInFrame(NamedTuple):
    """The faces of a piece, whose arrays a `FacesOfCopies` does not keep alive."""

    vertices: NDArray[np.float32]  # (k, v, 3), in the frame
    indices: NDArray[np.int32]  # (m, 3)
    exact: bool  # as in `Gathered`

    def of_copies(self) -> FacesOfCopies:
        n_vertices, n_faces = self.vertices.shape[1], len(self.indices)
        return FacesOfCopies(self.vertices.ctypes.data, n_vertices, self.indices.ctypes.data, n_faces)


def _faces_in_frame(piece: Piece, origin: np.ndarray, threads: int) -> _FacesInFrame:
    """The faces of a piece that has any, with its vertices in the frame at `origin`."""
    local = np.empty(piece.vertices.size + 1, np.float32)[:-1].reshape(piece.vertices.shape)  # padded
    exact = recentre(piece, origin, local, threads)
    return _FacesInFrame(local, np.ascontiguousarray(piece.faces, np.int32), exact)


def gather(piece: Piece, origin: np.ndarray, out: np.ndarray, threads: int) -> Gathered:
    """Write the triangles of a piece to the front of `out` ((m, 3, 3) float32).

    Raises
    ------
    InputError
        If vertices are not finite, or too far away from `origin`.
    """
    copies, n_vertices = piece.vertices.shape[:2]
    if piece.faces is None:
        count = copies * n_vertices // 3
        return Gathered(count, recentre(piece, origin, out[:count].reshape(copies, n_vertices, 3), threads))
    faces = _faces_in_frame(piece, origin, threads)
    count = copies * len(faces.indices)
    run(_gather, threads, new_ticket(count, _AT_A_TIME), faces.of_copies(), out.ctypes.data)
    return Gathered(count, faces.exact)


def face_rows(table: NDArray[np.float32], index: NDArray[np.int32], threads: int | None = None) -> NDArray[np.float32]:
    """(n, 3) float32: rows of a table, (m + 1, 3), whose first row is for the index -1, and row k + 1 for the index k.

    index : (n,) int32, contiguous
    """
    out, triples = np.empty((len(index), 3), np.float32), len(index) // 3
    if triples > _AT_A_TIME:
        rows = FacesOfCopies(table[1:].ctypes.data, 0, index.ctypes.data, triples)
        run(_gather, thread_count(threads), new_ticket(triples, _AT_A_TIME), rows, out.ctypes.data)
        out[3 * triples :] = table[index[3 * triples :] + 1]
        return out
    return table.take(index + 1, axis=0, out=out, mode="clip")


def recentre(piece: Piece, origin: np.ndarray, out: np.ndarray, threads: int) -> bool:
    """Write the vertices of a piece ((k, v, 3)) as float32 in the frame at `origin`; return whether it holds them.

    Raises
    ------
    InputError
        As for `gather`.
    """
    dtype = np.dtype(np.float32 if piece.vertices.dtype == np.float32 else np.float64)
    a = np.ascontiguousarray(piece.vertices, dtype)
    b = a if piece.towards is None else np.ascontiguousarray(piece.towards, dtype)
    faults, ticket = np.zeros(2, np.bool_), new_ticket(out.size // 3, _AT_A_TIME)
    addresses = a.ctypes.data, b.ctypes.data
    run(_recentre, threads, ticket, dtype == np.float32, *addresses, piece.share, origin, out.ctypes.data, faults)
    if faults[0]:
        raise InputError(
            f"{piece.where}: vertices are not finite or over {MAX_EXTENT:g} units apart; scale the scene down"
        )
    return not faults[1]


# --- Transforms -------------------------------------------------------------------------------------------------------


@inlined
def _transform_rows(first, last, a, matrix, out):
    """Write matrix * (a, 1) in float64, added from left to right."""
    for i in range(3 * first, 3 * last, 3):
        x, y, z = np.float64(get(a, i)), np.float64(get(a, i + 1)), np.float64(get(a, i + 2))
        for k in range(3):
            put(out, i + k, matrix[k, 0] * x + matrix[k, 1] * y + matrix[k, 2] * z + matrix[k, 3])


@kernel
def _transform(ticket, single, a, matrix, out):
    """Worker: transform points; a, address of (n, 3) float32 if `single`, else float64; out, of (n, 3) float64."""
    for first, last in shares(ticket):
        if single:
            _transform_rows(first, last, f32_at(a), matrix, f64_at(out))
        else:
            _transform_rows(first, last, f64_at(a), matrix, f64_at(out))


def transformed(points: np.ndarray, matrix: NDArray[np.float64], threads: int) -> NDArray[np.float64]:
    """(n, 3) float64: points, (n, 3), transformed by an affine (4, 4) float64 matrix."""
    dtype = np.dtype(np.float32 if points.dtype == np.float32 else np.float64)
    a, out = np.ascontiguousarray(points, dtype), np.empty(points.shape)
    matrix = np.ascontiguousarray(matrix)
    ticket = new_ticket(len(a), _AT_A_TIME)
    run(_transform, threads, ticket, dtype == np.float32, a.ctypes.data, matrix, out.ctypes.data)
    return out


# --- Degenerate triangles: no ray hits them, so trees omit them (docs/design/exactness.md) ----------------------------


@inlined
def _corners_at(v, i, last):
    """The first eight numbers of triangle i, or of the `last` one if i is beyond it."""
    return load8(v, 9 * min(i, last))


@inlined
def _load_eight(v, i, last, ninth):
    """The corners (x, y, z, x1, ..., z2) of triangles i .. i + 7, one per lane; `ninth` is scratch memory."""
    for lane in range(8):
        put(ninth, lane, get(v, 9 * min(i + lane, last) + 8))
    x, y, z, x1, y1, z1, x2, y2 = transposed8(
        _corners_at(v, i, last), _corners_at(v, i + 1, last), _corners_at(v, i + 2, last), _corners_at(v, i + 3, last),
        _corners_at(v, i + 4, last), _corners_at(v, i + 5, last), _corners_at(v, i + 6, last),
        _corners_at(v, i + 7, last),
    )  # fmt: skip
    return (x, y, z), (x1, y1, z1), (x2, y2, load8(ninth, 0))


@inlined
def _largest(a):
    """The largest magnitude of three components, per lane."""
    return maximum(maximum(absolute(a[0]), absolute(a[1])), absolute(a[2]))


@inlined
def surely_have_area(v0, v1, v2):
    """The lanes whose triangles surely have an area.

    With u = 2^-24 and L the largest component of an edge, rounding the edges, their products and the differences of
    these changes a component of the normal by less than 9 u L^2, and underflow by less than _TINY.
    """
    a, b = (v1[0] - v0[0], v1[1] - v0[1], v1[2] - v0[2]), (v2[0] - v0[0], v2[1] - v0[1], v2[2] - v0[2])
    n = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    length = maximum(_largest(a), _largest(b))
    return _largest(n) > length * length * _SURE + _TINY


@inlined
def _find_in_rows(v, first, last, ninth, has_areas):
    """Clear `has_areas` of triangles without area. Return whether all have an area."""
    all_have = True
    for i in range(first, last, 8):
        a, b, c = _load_eight(v, i, last - 1, ninth)
        unsure = ~bits(surely_have_area(a, b, c)) & ((1 << min(8, last - i)) - 1)
        while unsure != 0:
            triangle = i + lowest_bit(unsure)
            if not has_area(v, triangle):
                has_areas[triangle] = all_have = False
            unsure &= unsure - 1
    return all_have


@kernel
def _find_areas(ticket, corners, has_areas, faults):
    """Worker: whether each triangle has nonzero area."""
    # In and out: has_areas, (n,) bool, all set; faults, (1,) bool, set if a triangle has none
    v, ninth = ptr(corners), stack_f32(8)
    for first, last in shares(ticket):
        if not _find_in_rows(v, first, last, ninth, has_areas):
            faults[0] = True


@kernel
def _gather_and_find(ticket, faces, corners, has_areas, faults):
    """Worker: gather the corners of faces, and find their areas while they are in the cache."""
    # In: faces, `FacesOfCopies`, padded. Out: corners, (n, 9) float32. In and out: as in `_find_areas`
    v, ninth = ptr(corners), stack_f32(8)
    for first, last in shares(ticket):
        _gather_rows(faces, first, last, v, True)
        if not _find_in_rows(v, first, last, ninth, has_areas):
            faults[0] = True


def rows_with_area(vertices: NDArray[np.float32], threads: int) -> NDArray[np.int32] | None:
    """(k,) int32, ascending: the triangles with nonzero area, in exact arithmetic; None: all triangles.

    vertices : (n, 3, 3) float32
    """
    has_areas, faults = np.ones(len(vertices), np.bool_), np.zeros(1, np.bool_)
    run(_find_areas, threads, new_ticket(len(vertices), _AT_A_TIME), vertices.reshape(-1, 9), has_areas, faults)
    return np.flatnonzero(has_areas).astype(np.int32) if faults[0] else None


def gather_faces(
    positions: NDArray[np.float32], faces: NDArray[np.int32], out: NDArray[np.float32], threads: int
) -> NDArray[np.int32] | None:
    """Write the corners of faces to `out`, (n, 3, 3) float32, and return their `rows_with_area`.

    positions : (v, 3) float32; the memory of one more number follows
    faces : (n, 3) int32
    """
    of_copies = FacesOfCopies(positions.ctypes.data, 0, faces.ctypes.data, len(faces))
    has_areas, faults, ticket = np.ones(len(out), np.bool_), np.zeros(1, np.bool_), new_ticket(len(out), _IN_CACHE)
    run(_gather_and_find, threads, ticket, of_copies, out.reshape(-1, 9), has_areas, faults)
    return np.flatnonzero(has_areas).astype(np.int32) if faults[0] else None


# --- Bounds -----------------------------------------------------------------------------------------------------------


@kernel
def _bound_rows(ticket, positions, limits):
    """Worker: the lower and upper corner of each share of the rows. Each has 16 rows or more."""
    # In: positions, (n, 3) float32. Out: limits, (shares, 2, 3) float32
    v, n = ptr(positions), len(positions)
    for first, last in shares(ticket):
        lower = splat16(_INF), splat16(_INF), splat16(_INF)
        upper = splat16(-_INF), splat16(-_INF), splat16(-_INF)
        for i in range(first, last, 16):
            x, y, z = load16x3(v, 3 * min(i, n - 16))
            lower = minimum(lower[0], x), minimum(lower[1], y), minimum(lower[2], z)
            upper = maximum(upper[0], x), maximum(upper[1], y), maximum(upper[2], z)
        share = first // ticket[CHUNK]
        limits[share, 0, 0], limits[share, 1, 0] = reduce_min(lower[0]), reduce_max(upper[0])
        limits[share, 0, 1], limits[share, 1, 1] = reduce_min(lower[1]), reduce_max(upper[1])
        limits[share, 0, 2], limits[share, 1, 2] = reduce_min(lower[2]), reduce_max(upper[2])


def bounds_of_rows(positions: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
    """(2, 3) float32: the lower and upper corner of points, (n, 3) float32, n >= 1."""
    if len(positions) < 16:
        return np.stack([positions.min(0), positions.max(0)])
    limits = np.empty((-(-len(positions) // _AT_A_TIME), 2, 3), np.float32)
    run(_bound_rows, threads, new_ticket(len(positions), _AT_A_TIME), positions, limits)
    return np.stack([limits[:, 0].min(0), limits[:, 1].max(0)])


class TriangleSurvey(NamedTuple):
    """What there is to know of triangles before they are traced."""

    with_area: NDArray[np.int32] | None  # see `rows_with_area`
    bounds: NDArray[np.float32]  # (2, 3) float32: lower and upper corner


def survey(vertices: NDArray[np.float32], threads: int) -> TriangleSurvey:
    """The triangles with area, and the bounds, of (n, 3, 3) float32, n >= 1."""
    return TriangleSurvey(rows_with_area(vertices, threads), bounds_of_rows(vertices.reshape(-1, 3), threads))


# --- Rows of chosen triangles -----------------------------------------------------------------------------------------


@kernel
def _copy_rows(ticket, corners, rows, out):
    """Worker: copy the corners of the triangles `rows` to the front of `out`."""
    source, target = ptr(corners), ptr(out)
    for i in items(ticket):
        row = np.int64(rows[i]) * 9
        store(target, i * 9, load8(source, row))
        put(target, i * 9 + 8, get(source, row + 8))


def solid_vertices(triangles: Triangles, threads: int | None) -> NDArray[np.float32]:
    """(k, 3, 3) float32: the triangles with nonzero area and without holes; not copied if these are all triangles."""
    if triangles.solid is None:
        return triangles.vertices
    out = np.empty((len(triangles.solid), 9), np.float32)
    ticket = new_ticket(len(out), _AT_A_TIME)
    run(_copy_rows, thread_count(threads), ticket, triangles.vertices.reshape(-1, 9), triangles.solid, out)
    return out.reshape(-1, 3, 3)


def solid_faces(with_area: NDArray[np.int32] | None, uncut: NDArray[np.int32] | None) -> NDArray[np.int32] | None:
    """(k,) int32, ascending: the faces with nonzero area and without holes; None: all faces.

    with_area, uncut : (m,) int32, ascending: the faces with area, and those without holes; None: all faces
    """
    if with_area is None or uncut is None:
        return uncut if with_area is None else with_area
    return np.intersect1d(with_area, uncut, assume_unique=True)


def met_by_rays(triangles: Triangles, threads: int) -> Triangles:
    """Triangles as rays meet them, which have no colour: panes without holes are solid. The same ones if none are."""
    if triangles.cutouts is None:
        return triangles
    cutouts = without_panes(triangles.cutouts)
    panes = np.setdiff1d(cutouts.solid, triangles.cutouts.solid, assume_unique=True)
    if not len(panes):
        return triangles
    with_area = rows_with_area(triangles.vertices[panes], threads)
    before = triangles.cutouts.solid if triangles.solid is None else triangles.solid
    solid = np.sort(np.concatenate([before, panes if with_area is None else panes[with_area]]))
    return triangles._replace(cutouts=cutouts if len(cutouts.faces) else None, solid=solid)
