"""The public class of scenes in stores."""

from typing import TYPE_CHECKING, cast

from ..base.checks import byte_count
from ..base.errors import InputError
from ..base.wording import counted
from ..store.store_data import StoreData
from ..store.store_file import Store
from ..store.system_resources import default_limit, resident_memory
from .scene import AnyScene, DataAttribute

if TYPE_CHECKING:
    from .scene_views import SceneViews

_VIEW_MEMORY = 512 << 20  # bytes for the small images from which the default view follows


class PagedScene(AnyScene):
    """A scene whose triangles are in a store; `antumbra.load` returns it for ``*.antumbra`` and ``*.tiles``.

    The scene is static. Its name, up axis, CRS, bounds, origin, cameras and lights equal those of a `Scene` of the same
    sources, as do the results of all queries, and pictures show the same textures, normals and materials. Objects have
    their names, types and parents, but no mesh; there are no semantic surfaces and attributes of a city. Methods that
    need all triangles at once raise InputError if these exceed `max_memory`. Corners have the precision of the frame;
    those of float32 sources are exact. Unpickling a scene opens its store again, by its path.

    Attributes
    ----------
    store : Store
        The open file, or the tiles. Above 2^31 - 1 triangles, faces are numbered by int64.
    max_memory : int or None
        Limit in bytes on the memory of the process, for all queries without a `max_memory` argument, such as `occluded`
        and `closest_hit`; None: 4 GiB, or 1 GiB beyond what the process already holds, whichever is more.
    """

    data: StoreData
    store = DataAttribute[Store]()

    def __init__(self, store: Store):
        self.__setstate__({"data": StoreData(store)})

    @property
    def max_memory(self) -> int | None:
        """Limit in bytes on the memory of the process; None: see above. Setting an invalid size raises InputError."""
        return self.data.max_memory

    @max_memory.setter
    def max_memory(self, size: int | None) -> None:
        size = None if size is None else byte_count(size, "max_memory", 1)
        if size != self.data.max_memory:
            self.data.max_memory, self._engine = size, None

    def _views(self) -> "SceneViews":
        from .sources.paged_source import RESERVED, Paged
        from .sources.paged_views import ViewsInStore

        needed = self.data.cutout_bytes + RESERVED + _VIEW_MEMORY
        limit = min(self.max_memory or default_limit(), resident_memory() + needed)
        return ViewsInStore(cast(Paged, self.engine.with_options(None, None, limit).source))  # the scene's chunks leave

    def refusal(self) -> InputError:
        """The error raised by methods that need all triangles."""
        return self.data.refusal()

    def __repr__(self) -> str:
        return f"PagedScene({self.name!r}, {counted(self.n_triangles, 'triangle')}, up={self.up!r})"
