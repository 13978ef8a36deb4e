"""The public class of scenes in stores."""

from typing import Any

from ..base.checks import byte_count
from ..base.errors import InputError
from ..store.store_file import Store, StoreData
from .scene import AnyScene, DataAttribute


class PagedScene(AnyScene):
    """A scene whose triangles are in a store; `antumbra.load` returns it for a file ``*.antumbra``.

    The scene is static. Its name, up axis, CRS, bounds, origin, cameras and lights equal those of a `Scene` of the same
    sources, as do the results of all queries. The store does not record the mesh of a triangle, so all faces form one
    object. Methods that need all triangles at once raise InputError. Unpickling a scene opens its store again, by its
    path.

    Attributes
    ----------
    store : Store
        The open file.
    max_memory : int or None
        Limit in bytes on the memory of the process, for all queries without a `max_memory` argument, such as `occluded`
        and `closest_hit`; None: 4 GiB.
    """

    data: StoreData
    store = DataAttribute[Store]()
    _max_memory: int | None

    def __init__(self, store: Store):
        self.__setstate__({"data": StoreData(store)})

    @property
    def max_memory(self) -> int | None:
        """Limit in bytes on the memory of the process; None: 4 GiB. Setting an invalid size raises InputError."""
        return self._max_memory

    @max_memory.setter
    def max_memory(self, size: int | None) -> None:
        size = None if size is None else byte_count(size, "max_memory", 1)
        if size != self._max_memory:
            self._max_memory, self._engine = size, None

    def __getstate__(self) -> dict[str, Any]:
        return {"data": self.data, "max_memory": self._max_memory}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self._max_memory = state.get("max_memory")

    def refusal(self) -> InputError:
        """The error raised by methods that need all triangles."""
        return self.data.refusal()

    def __repr__(self) -> str:
        return f"PagedScene({self.name!r}, {self.n_triangles} triangles, up={self.up!r})"
