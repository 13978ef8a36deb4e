"""What a scene in a store holds; only the chunks in use are in memory."""

from pathlib import Path

import numpy as np

from ..checks import quoted
from ..errors import InputError
from ..scene.camera import Camera
from ..scene.data import SceneData
from ..scene.mesh import MeshInfo, ObjectInfo
from ..scene.survey import check_extent
from ..scene.triangles import Triangles
from .read import Store, open_store


class StoreData(SceneData):
    """Name, bounds, cameras and lights of a scene whose triangles are in a store. It is static."""

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


def load_store(path: Path) -> StoreData:
    """Open the scene of a store."""
    return StoreData(open_store(path))
