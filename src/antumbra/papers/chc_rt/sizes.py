"""The sizes of scenes [Mattausch et al. 2015, Table 1]."""

from typing import NamedTuple

from ...engine.paged_scene import PagedScene
from ...engine.paged_source import MAX_MEMORY
from ...errors import InputError
from ...store.store_format import chunk_places
from .measure import InCore
from .views import WalkPlace


class SceneSize(NamedTuple):
    """The size of a scene in bytes: of what CHC+RT traces in memory, or of a store's file."""

    scene: str
    triangles: int
    total: int  # a store also has a directory, and zeros up to whole pages
    bvh: int  # the nodes
    geometry: int  # triangles and their colours
    share: float  # the memory that may be used, as a share of `total`, at most 1


def size_in_memory(core: InCore) -> SceneSize:
    """The size of a scene in memory."""
    bvh, geometry = core.bytes()
    return SceneSize(core.place.name, core.place.scene.n_triangles, bvh + geometry, bvh, geometry, 1.0)


def size_of_store(place: WalkPlace, max_memory: int | None) -> SceneSize:
    """The size of a store. All of `max_memory` counts for its share, though rays and pictures take some."""
    scene = place.scene
    if not isinstance(scene, PagedScene):
        raise InputError(f"{place.name}: is not a store; name it with --scene instead of --store")
    chunks, top = scene.store.chunks, scene.store.top
    bvh, geometry = top.nodes.nbytes, 0
    for triangles, nodes, colours in zip(*(a.tolist() for a in (chunks.triangles, chunks.nodes, chunks.colours))):
        at = chunk_places(triangles, nodes, colours)
        bvh, geometry = bvh + at.corners - at.nodes, geometry + at.end - at.corners
    total, most = scene.store.path.stat().st_size, max_memory or scene.max_memory or MAX_MEMORY
    return SceneSize(place.name, scene.n_triangles, total, bvh, geometry, min(most / total, 1.0))
