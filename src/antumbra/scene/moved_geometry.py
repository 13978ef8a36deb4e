"""Geometry that users move between queries: new vertices, and transforms of objects.

The faces of the scene stay, and so do its frame, colours, textures and cut-outs. `MovableMeshes` computes the moved
triangles, and `MovedMeshes` is the source of the scene that they form.
"""

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, quoted, whole_number
from ..base.errors import InputError
from ..kernels.array_pool import ArrayPool
from .indexed_triangles import IndexedTriangles, IndexedVertices, padded_rows
from .materials import MeshAppearance
from .mesh import WHITE, ObjectInfo, Piece, Source, check_finite
from .scene_bounds import faces_of
from .triangle_setup import gather, recentre, transformed
from .triangles import Triangles

_MOST_NAMES = 12  # in errors

ObjectChoice: TypeAlias = "str | int | ObjectInfo | Iterable[str | int | ObjectInfo] | None"
"""Objects of a scene: patterns of names, indices in `Scene.objects`, or entries of it; None: all objects."""


# --- The source of a scene whose geometry has moved -------------------------------------------------------------------


class MovedMeshes:
    """The meshes of a static source at new places: each copy of a mesh has three vertices of its own per face.

    Parameters
    ----------
    loaded : Source
        As the scene was loaded.
    triangles : Triangles
        The moved ones.
    """

    duration = 0.0

    def __init__(self, loaded: Source, triangles: Triangles):
        self._loaded, self._triangles = loaded, triangles
        self.file, self.meshes, self.objects = loaded.file, loaded.meshes, loaded.objects

    def __getstate__(self) -> dict[str, Any]:
        vertices, origin = self._triangles.vertices, self._triangles.origin
        bare = Triangles(vertices, origin, np.empty(0, np.int32), np.empty((0, 3), np.float32))
        return vars(self) | {"_triangles": bare}

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for piece, rows in _rows_of(self._loaded.pieces(0.0)):
            yield at_corners(piece, self._triangles.vertices[rows] + self._triangles.origin, look_of_corners(piece))

    def cameras(self, time: float) -> list[Any]:
        return self._loaded.cameras(time)

    def lights(self, time: float) -> list[Any]:
        return self._loaded.lights(time)


def _rows_of(pieces: Iterable[Piece]) -> Iterator[tuple[Piece, slice]]:
    """Each piece with the rows of its triangles in the scene."""
    first = 0
    for piece in pieces:
        last = first + len(piece.vertices) * faces_of(piece)
        yield piece, slice(first, last)
        first = last


def at_corners(piece: Piece, corners: NDArray[Any], look: MeshAppearance | None) -> Piece:
    """A piece with three vertices of its own per face, the corners, (m, 3, 3) world, of the faces of all copies."""
    vertices = corners.reshape(len(piece.vertices), -1, 3)
    return piece._replace(vertices=vertices, faces=None, look=look, towards=None, share=0.0)


def look_of_corners(piece: Piece) -> MeshAppearance | None:
    """The look of a piece with a row for each corner of its faces."""
    look, faces = piece.look, piece.faces
    if look is None or faces is None:
        return look
    names = "uv", "colours", "normals", "rest_positions", "tangents", "second_uv"
    changes: dict[str, Any] = {
        name: values[faces.reshape(-1)] for name in names if (values := getattr(look, name)) is not None
    }
    return look._replace(**changes)


# --- New vertices and transforms --------------------------------------------------------------------------------------


class Placement(NamedTuple):
    """Objects with the transforms that place them."""

    objects: list[int]  # k distinct indices in `Scene.objects`
    transforms: NDArray[np.float64]  # (k, 4, 4) float64, world to world


class ReplacedVertices(NamedTuple):
    """The new vertices of a scene."""

    indexed: IndexedVertices
    exact: bool  # whether the frame holds the vertices in the precision in which they were given


class MovableMeshes:
    """Moves the geometry of a static source within a fixed frame.

    Transforms apply to the *rest geometry*: the meshes as they were loaded, or the latest vertices that replaced them,
    in the precision in which they were given.

    loaded : Source
    origin : (3,) float64, world
    n_triangles : int
    name : str, of the scene in errors
    """

    def __init__(self, loaded: Source, origin: NDArray[np.float64], n_triangles: int, name: str):
        self.loaded, self.name = loaded, name
        self._origin, self._n_triangles = origin, n_triangles
        self._rest: list[Piece] | None = None  # pieces of the rest geometry; None: not needed so far
        self._own_rest = False  # whether they are not those of the rest source
        self._rest_source: Source | None = loaded  # None: lost, since a device had finer vertices than the frame
        self._corners: NDArray[np.int32] | None = None
        self._shared: NDArray[np.int32] | None = None  # see `_shared_faces`; without rows: some vertices are unused
        self._pool = ArrayPool()

    def indexed(self, vertices: IndexedVertices, triangles: Triangles, threads: int) -> IndexedTriangles:
        """Triangles with these vertices, and everything else of `triangles`."""
        return IndexedTriangles.of(vertices, triangles, self._pool, threads)

    def source_of(self, triangles: Triangles) -> MovedMeshes:
        """The source of moved triangles."""
        return MovedMeshes(self.loaded, triangles)

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | ({} if self._own_rest else {"_rest": None})

    def rest_on(self, given: NDArray[Any], triangles: Triangles, exact: bool) -> None:
        """Make these triangles, which have the `given` vertices, the rest geometry.

        The given vertices are copied unless they can be restored from those in the frame, which is then `exact`.
        """
        if exact:
            self.rest_in_frame(triangles, True)
        else:
            self._rest = [piece._replace(look=None) for piece in self._with_vertices(np.array(given))]
            self._own_rest = True

    def rest_in_frame(self, triangles: Triangles, exact: bool) -> None:
        """Make these triangles the rest geometry.

        exact : whether the frame holds their vertices in the precision in which they were given; otherwise nothing can
            be placed from now on
        """
        self._rest_source, self._rest, self._own_rest = self.source_of(triangles) if exact else None, None, False

    def given(self, vertices: "ArrayLike") -> NDArray[Any]:
        """New vertices as an array: (n, 3, 3), or (v, 3) for the vertices from which the scene was made; world.

        Raises
        ------
        InputError
            If the shape is wrong.
        """
        points = as_array(vertices, f"{self.name}: vertices")
        self._check_shape(points.shape)
        return points

    def _check_shape(self, shape: tuple[int, ...]) -> None:
        if shape == (self._n_triangles, 3, 3):
            return
        count = sum(_n_given(piece) for piece in self.loaded.pieces(0.0))
        if shape != (count, 3):
            raise InputError(
                f"{self.name}: vertices have shape {shape}; give ({self._n_triangles}, 3, 3), the corners of "
                f"the triangles, or ({count}, 3), the vertices in the order of the arrays or of the scene's mesh"
            )

    def corners_of(self, shape: tuple[int, ...]) -> NDArray[np.int32] | None:
        """(3 n,) int32: the vertex of each corner, for vertices of a shape, as for `given`; None: they are the corners.

        Raises
        ------
        InputError
            If the shape is wrong.
        """
        self._check_shape(shape)
        if len(shape) == 3:
            return None
        if self._corners is None:
            numbers = np.repeat(np.arange(shape[0], dtype=np.int32)[:, None], 3, 1)
            parts = [_corners(piece)[..., 0].reshape(-1) for piece in self._with_vertices(numbers)]
            self._corners = np.concatenate(parts)
        return self._corners

    def replaced(self, points: NDArray[Any], threads: int) -> ReplacedVertices:
        """New vertices in the frame, as from `given`.

        Raises
        ------
        InputError
            If a vertex is NaN, infinite, or too far from the frame.
        """
        is_soup = points.shape == (self._n_triangles, 3, 3)
        whole = [Piece(points.reshape(1, -1, 3), None, WHITE, self.name)]  # many small pieces would take longer
        pieces = whole if is_soup else self._with_vertices(points)
        faces = None if is_soup else self._shared_faces(pieces)
        if is_soup or faces is not None:
            out = padded_rows(pieces[0].vertices.size // 3, self._pool)
            with _checked(pieces[0]):
                exact = recentre(pieces[0], self._origin, out, threads)
            return ReplacedVertices(IndexedVertices(out, faces), exact)
        out = padded_rows(3 * self._n_triangles, self._pool)
        exact = self._gather(pieces, out.reshape(-1, 3, 3), threads)
        return ReplacedVertices(IndexedVertices(out, None), exact)

    def _shared_faces(self, pieces: list[Piece]) -> NDArray[np.int32] | None:
        """(n, 3) int32: the faces of a scene that is one copy of a mesh and uses all its vertices; None: it is not."""
        if len(pieces) != 1 or len(pieces[0].vertices) != 1 or pieces[0].faces is None:
            return None
        if self._shared is None:
            faces, used = (
                np.ascontiguousarray(pieces[0].faces, np.int32),
                np.zeros(pieces[0].vertices.shape[1], np.bool_),
            )
            used[faces] = True
            self._shared = faces if used.all() else faces[:0]
        return self._shared if len(self._shared) else None

    def _with_vertices(self, points: NDArray[Any]) -> list[Piece]:
        """The pieces of the scene with new vertices, as from `given`."""
        pieces = list(self.loaded.pieces(0.0))
        if points.shape == (self._n_triangles, 3, 3):
            return [at_corners(piece, points[rows], None) for piece, rows in _rows_of(pieces)]
        parts = np.split(points, np.cumsum([_n_given(piece) for piece in pieces])[:-1])
        return [_with_vertices(piece, part) for piece, part in zip(pieces, parts)]

    def placed(self, vertices: NDArray[np.float32], placement: Placement, threads: int) -> NDArray[np.float32]:
        """(n, 3, 3) float32, in the frame: triangles in which some objects have moved to new places.

        vertices : (n, 3, 3) float32, in the frame: the triangles before
        """
        if self._rest is None:
            if self._rest_source is None:
                raise InputError(
                    f"{self.name}: its latest vertices came from a device, in more digits than its frame has; give the "
                    "vertices from the host before a transform"
                )
            self._rest = list(self._rest_source.pieces(0.0))
        out = padded_rows(3 * self._n_triangles, self._pool).reshape(vertices.shape)
        np.copyto(out, vertices)
        transform_of = dict(zip(placement.objects, placement.transforms))
        for piece, rows in _rows_of(self._rest):
            if piece.owners is not None:
                self._place_owned(piece, transform_of, out[rows], threads)
                continue
            n = faces_of(piece)
            for copy, positions in enumerate(piece.vertices):
                matrix = transform_of.get(piece.first + copy)
                if matrix is not None:
                    moved = piece._replace(vertices=transformed(positions, matrix, threads)[None])
                    self._gather([moved], out[rows][copy * n : (copy + 1) * n], threads)
        return out

    def _place_owned(
        self, piece: Piece, transform_of: dict[int, NDArray[np.float64]], out: NDArray[np.float32], threads: int
    ) -> None:
        """Place the objects of a piece that has several; `out`: its triangles."""
        assert piece.owners is not None
        for number in np.intersect1d(piece.owners, list(transform_of)).tolist():
            chosen = np.flatnonzero(piece.owners == number)
            corners = chosen[:, None] * 3 + np.arange(3) if piece.faces is None else piece.faces[chosen]
            positions = transformed(piece.vertices[0, corners.reshape(-1)], transform_of[number], threads)
            moved = np.empty((len(chosen), 3, 3), np.float32)
            self._gather([Piece(positions[None], None, WHITE, piece.where)], moved, threads)
            out[chosen] = moved

    def _gather(self, pieces: Sequence[Piece], out: NDArray[np.float32], threads: int) -> bool:
        """Write the triangles of pieces, and return whether the frame holds their vertices exactly."""
        start, exact = 0, True
        for piece in pieces:
            with _checked(piece):
                gathered = gather(piece, self._origin, out[start:], threads)
            start, exact = start + gathered.count, exact and gathered.exact
        return exact


@contextmanager
def _checked(piece: Piece) -> Iterator[None]:
    """Name a vertex of the piece that is not finite in the error of `gather`."""
    try:
        with np.errstate(all="ignore"):
            yield
    except InputError:
        check_finite(piece.vertices.reshape(-1, 3), piece.where)
        raise


def _n_given(piece: Piece) -> int:
    """The number of vertices in the file or array, of all copies of a piece."""
    copies, n = piece.vertices.shape[:2]
    count: int = copies * (n if piece.used is None else len(piece.used))
    return count


def _with_vertices(piece: Piece, vertices: np.ndarray) -> Piece:
    """A piece with new vertices, in the order of the file or array."""
    positions = vertices.reshape(len(piece.vertices), -1, 3)
    return piece._replace(vertices=positions if piece.used is None else positions[:, piece.used])


def _corners(piece: Piece) -> np.ndarray:
    """(k, m, 3): the vertices at the corners of all faces of each copy."""
    return piece.vertices if piece.faces is None else piece.vertices[:, piece.faces.reshape(-1)]


# --- Choices of objects -----------------------------------------------------------------------------------------------


def placement_of(objects: Sequence[ObjectInfo], choice: ObjectChoice, transform: "ArrayLike", name: str) -> Placement:
    """The checked objects and transforms of an update; `name`: of the scene in errors."""
    chosen = _chosen(objects, choice, name)
    matrices = as_array(transform, f"{name}: transform").astype(np.float64)
    if matrices.shape not in ((4, 4), (len(chosen), 4, 4)):
        raise InputError(
            f"{name}: transform has shape {matrices.shape}; give (4, 4), or ({len(chosen)}, 4, 4), one for each object"
        )
    if not np.isfinite(matrices).all() or (matrices[..., 3, :] != (0.0, 0.0, 0.0, 1.0)).any():
        raise InputError(f"{name}: transform must be finite, with the last row 0, 0, 0, 1")
    return Placement(chosen, np.broadcast_to(matrices, (len(chosen), 4, 4)))


def _chosen(objects: Sequence[ObjectInfo], choice: ObjectChoice, name: str) -> list[int]:
    """The indices of the objects that are chosen, in order, each once."""
    if choice is None:
        return list(range(len(objects)))
    choices = [choice] if isinstance(choice, (str, int, np.integer, ObjectInfo)) else _listed(choice, name)
    return list(dict.fromkeys(index for each in choices for index in _matching(objects, each, name)))


def _listed(choice: Any, name: str) -> list[Any]:
    try:
        return list(choice)
    except TypeError:
        raise InputError(f"{name}: objects is {quoted(choice)}; give names, indices, or entries of objects") from None


def _matching(objects: Sequence[ObjectInfo], choice: Any, name: str) -> list[int]:
    """The indices of the objects that one pattern, index or entry selects."""
    if isinstance(choice, ObjectInfo):
        matches = [k for k, each in enumerate(objects) if each == choice]
    elif isinstance(choice, str):
        matches = [k for k, each in enumerate(objects) if fnmatchcase(each.name, choice)]
    else:
        return [whole_number(choice, f"{name}: object", 0, len(objects) - 1)]
    if not matches:
        names = ", ".join(sorted({each.name for each in objects} - {""})[:_MOST_NAMES])
        raise InputError(f"{name}: no object is called {quoted(choice)}; there are: {names}")
    return matches
