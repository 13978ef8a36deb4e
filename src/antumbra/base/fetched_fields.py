"""Named tuples with fields that are computed, or copied from a device, when the host first reads them."""

from collections.abc import Iterator
from typing import Any, ClassVar


class FetchedFields:
    """The base, before its named tuple, of a class that has properties in the place of some fields.

    A subclass makes its instances with None in the place of the fields that it fetches. Unpacking, indexing, pickling
    and `_replace` fetch all fields, and so do kernels, which take it for a `_plain`.
    """

    _plain: ClassVar[Any]

    def __iter__(self) -> Iterator[Any]:
        return (getattr(self, name) for name in self._plain._fields)

    def __getitem__(self, key: Any) -> Any:
        return tuple(self)[key]

    def _replace(self, **changes: Any) -> Any:
        return self._plain(*self)._replace(**changes)

    def __reduce__(self) -> tuple[Any, ...]:
        return self._plain, tuple(self)
