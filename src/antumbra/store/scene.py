"""The scene of a store, of which only what is looked at comes into memory."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..scene.mesh import MeshInfo
from ..scene.scene import Scene
from ..scene.source import Piece
from ..scene.triangles import Triangles
from .read import Store, open_store


class _Paged:
    """The source of a `PagedScene`: its cameras and lights, and no pieces."""

    duration = 0.0

    def __init__(self, store: Store):
        self.file = store.path.name
        self.meshes: list[MeshInfo] = []
        self._meta = store.meta

    def pieces(self, time: float) -> Iterator[Piece]:
        raise self.refusal()

    def refusal(self) -> InputError:
        """What to say to whoever wants all triangles."""
        return InputError(
            f"{self.file}: is paged, and its {self._meta.n_triangles} triangles are not read at once; "
            "render it by a plan that ends in chcrt"
        )

    def cameras(self, time: float) -> list:
        return list(self._meta.cameras)

    def lights(self, time: float) -> list:
        return list(self._meta.lights)


class PagedScene(Scene):
    """A scene whose triangles are in a store: what `antumbra.load` gives for a file ``*.antumbra``.

    Nothing moves. Name, up axis, bounds, origin, cameras and lights are those of a `Scene` of the same sources; which
    mesh a triangle came from is not known. Whatever wants all triangles at once raises InputError.

    Attributes
    ----------
    store : Store
        The open file.
    """

    def __init__(self, store: Store):
        meta = store.meta
        self.store, self.name, self.up, self.notes, self.duration = store, meta.name, meta.up, meta.notes, 0.0
        self.source = _Paged(store)
        self.meshes = self.source.meshes
        self.bounds, self.origin = meta.bounds, meta.origin
        self._cameras, self._lights = list(meta.cameras), list(meta.lights)

    @property
    def n_triangles(self) -> int:
        return self.store.n_triangles

    @property
    def colours(self) -> np.ndarray:
        """InputError: they are in the chunks of the store."""
        raise self.source.refusal()

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """InputError: they are not to be had all at once."""
        raise self.source.refusal()

    def __repr__(self) -> str:
        return f"PagedScene({self.name!r}, {self.n_triangles} triangles, up={self.up!r})"


def load_store(path: Path) -> PagedScene:
    """The scene of a store."""
    return PagedScene(open_store(path))
