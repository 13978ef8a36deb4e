"""Small images of a scene in a store, for its default view: only the chunks that they show are read."""

import numpy as np
from numpy.typing import NDArray

from ...query.shadow_query import Surfaces
from ...scene.camera import Camera
from ...scene.triangles import Triangles
from ...store.store_data import ALL_BYTES
from .paged_source import Paged
from .source_protocols import FrameMemory

_PIXEL_BYTES = 256  # memory of a pixel while it is traced


class ViewsInStore:
    """`scene_views.SceneViews` of a store, by the source of an engine that has no other use."""

    def __init__(self, source: Paged) -> None:
        self._source = source
        self.box: NDArray[np.float32] = source.bounds
        self.origin = source.scene.origin

    def see(self, camera: Camera) -> Surfaces:
        return self._traced(camera, False)

    def see_solid(self, camera: Camera) -> Surfaces:
        return self._traced(camera, True)

    def triangles(self) -> Triangles | None:
        source, data = self._source, self._source.scene
        source.release()
        return data.triangles(0.0, source.threads) if data.fits(ALL_BYTES) else None

    def end(self) -> None:
        self._source.release()

    def _traced(self, camera: Camera, only_solid: bool) -> Surfaces:
        source = self._source
        source.warm_up()
        source.begin(FrameMemory(_PIXEL_BYTES * camera.width * camera.height, 0, 0))
        return source.see(camera, slice(0, camera.height), only_solid=only_solid)
