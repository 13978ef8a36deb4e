"""The scene of a store; only the chunks in use are in memory."""

import threading
from pathlib import Path

import numpy as np

from ..checks import byte_count, quoted
from ..errors import InputError
from ..scene.any_scene import AnyScene
from ..scene.camera import Camera
from ..scene.mesh import MeshInfo, ObjectInfo
from ..scene.survey import check_extent
from ..scene.triangles import Triangles
from .read import Store, open_store


class PagedScene(AnyScene):
    """A scene whose triangles are in a store; `antumbra.load` returns it for a file ``*.antumbra``.

    The scene is static. Name, up axis, CRS, bounds, origin, cameras and lights equal those of a `Scene` of the same
    sources, and so do the answers to all questions. The store does not record the mesh of a triangle, so all its faces
    are one object. Methods that need all triangles at once raise InputError. A pickled scene opens its store again, by
    its path.

    Attributes
    ----------
    store : Store
        The open file.
    max_memory : int or None
        Limit in bytes on the memory of the process, for all questions that do not give their own, such as `occluded`
        and `closest_hit`; None: 4 GiB.
    own : threading.local
        What each Python thread keeps between its questions.
    """

    def __init__(self, store: Store):
        if not isinstance(store, Store):
            raise InputError(f"store is {quoted(store)}; antumbra.load opens a store by its path")
        meta = store.meta
        check_extent(meta.bounds, store.path.name)  # earlier versions built stores of narrower scenes
        self.store, self.name, self.up, self.notes, self.duration = store, meta.name, meta.up, meta.notes, 0.0
        self.meshes: list[MeshInfo] = []
        self.objects = [ObjectInfo(meta.name, -1, 0)]
        self.bounds, self.origin, self.crs = meta.bounds, meta.origin, meta.crs
        self._cameras, self._lights = list(meta.cameras), list(meta.lights)
        self.max_memory = None
        self.own = threading.local()

    @property
    def max_memory(self) -> int | None:
        """Limit in bytes on the memory of the process; None: 4 GiB. Setting it raises InputError if it is no size."""
        return self._max_memory

    @max_memory.setter
    def max_memory(self, size: int | None) -> None:
        self._max_memory = None if size is None else byte_count(size, "max_memory", 1)

    def __getstate__(self) -> dict:
        return {name: value for name, value in self.__dict__.items() if name != "own"}

    def __setstate__(self, state: dict) -> None:
        self.__dict__.update(state)
        self.own = threading.local()

    @property
    def n_triangles(self) -> int:
        return self.store.n_triangles

    @property
    def object_of_face(self) -> np.ndarray:
        """(n,) int32, all 0, read-only and without memory of its own: a store is one object."""
        return np.broadcast_to(np.int32(0), self.n_triangles)

    @property
    def colours(self) -> np.ndarray:
        """Always raises InputError: the colours are in the chunks of the store."""
        raise self.refusal()

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """Always raises InputError: the triangles are never all in memory."""
        raise self.refusal()

    def refusal(self) -> InputError:
        """The error raised by methods that need all triangles."""
        return InputError(
            f"{self.store.path.name}: is a store, and its {self.n_triangles:,} triangles are never all in memory; "
            "ask a scene in memory for this"
        )

    def _cameras_at(self, time: float) -> list[Camera]:
        return self._cameras

    def _lights_at(self, time: float) -> list:
        return self._lights

    def __repr__(self) -> str:
        return f"PagedScene({self.name!r}, {self.n_triangles} triangles, up={self.up!r})"


def load_store(path: Path) -> PagedScene:
    """Open the scene of a store."""
    return PagedScene(open_store(path))
