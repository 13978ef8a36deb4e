"""glTF accessors: bounds-checked numbers in buffers, sparse values, normalised integers, and Draco decompression."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.memory import check_reading
from ...base.wording import counted
from ..face_ranges import BINARY_PLY, FileBytes, FileRows
from ..json_fields import Fields
from .gltf_file import CURE, GltfDocument

# --- Accessors --------------------------------------------------------------------------------------------------------


COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_STEP = 1 << 22  # bytes between two checks
_MOST_COUNT = 1 << 40
_VALUE_BYTES = 12  # of memory per number: as stored, selected, and as it is kept
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


Rows: TypeAlias = NDArray[Any] | None
"""Rows of an accessor: a mask, or numbers, which ascend; None: all."""

_NONE = np.empty(0, np.int64)


class Accessors:
    """The accessors of a document. Each is decoded once and cached; those of a file on the disk are read by rows."""

    def __init__(self, document: GltfDocument):
        self._document = document
        self._fields = document.root.objects("accessors")
        self._views = document.root.objects("bufferViews")
        self._available = sum(len(b) for b in document.buffers if b is not None)
        self._decoded: dict[int, np.ndarray | FileRows] = {}
        self._finite: dict[int, np.ndarray] = {}
        self._reserved = self._checked = 0  # bytes that the document takes so far, and at the last check

    def __len__(self) -> int:
        return len(self._fields)

    def has_data(self, index: int) -> bool:
        """Whether the file stores values for the accessor; without, they are zeros."""
        return "bufferView" in self._fields[index] or "sparse" in self._fields[index]

    def count(self, index: int, *kinds: str) -> int:
        """The number of elements, once they are found in the file; they may be left there."""
        self._raw(index, kinds, _NONE)
        count: int = self._fields[index].whole("count")
        return count

    def supply(self, index: int, values: np.ndarray) -> None:
        """Set the values ((count, width) numbers) of an accessor whose data are stored elsewhere in the file."""
        fields = self._fields[index]
        shape = fields.whole("count"), WIDTHS.get(fields.text("type"), 0)
        if values.shape != shape:
            raise InputError(f"{fields.where} says {shape}, the compressed data are {values.shape}; export it again")
        self._decoded[index] = self._kept(values.astype(self._dtype(fields)))
        self._finite.pop(index, None)

    def _kept(self, values: np.ndarray) -> "np.ndarray | FileRows":
        """Decompressed values, in the scratch file if there is one."""
        scratch, row = self._document.scratch, np.dtype((values.dtype, values.shape[1:]))
        return values if scratch is None else scratch.add(values).rows(row, row.itemsize)

    def reserve(self, size: int, where: str) -> None:
        """Count memory of the document that is about to be taken; InputError if it takes too much.

        Many primitives may share an accessor, and many nodes a list of instances, so a small file can take much.
        """
        self._reserved += size
        if self._reserved >= self._checked + _STEP:
            self._checked = self._reserved
            check_reading(self._reserved, f"{where} and what precedes it", self._available)

    def reserve_primitives(self, primitives: list[Fields], where: str) -> None:
        """`reserve` what the attributes, indices and morph targets of primitives take."""
        for primitive in primitives:
            holders = [primitive.data.get("attributes"), *(target.data for target in primitive.objects("targets"))]
            indices = [index for each in holders if isinstance(each, dict) for index in each.values()]
            most = _MOST_COUNT if primitive.extension(DRACO_EXTENSION) else self._available
            sizes = [self._size(index, most) for index in (primitive.data.get("indices"), *indices)]
            if self._document.scratch is None:
                self.reserve(sum(sizes), where)
            elif primitive.extension(DRACO_EXTENSION):
                check_reading(sum(sizes), primitive.where, cure=CURE)

    def _size(self, index: object, most: int) -> int:
        """Bytes of memory for an accessor's values; 0 if reading it will fail, since it has more than `most`."""
        if not isinstance(index, int) or not 0 <= index < len(self._fields):
            return 0
        fields = self._fields[index].data
        count, width = fields.get("count"), WIDTHS.get(str(fields.get("type")), 0)
        return _VALUE_BYTES * width * count if isinstance(count, int) and 0 <= count <= most else 0

    def view_bytes(self, holder: Fields, key: str) -> bytes:
        """The bytes of the bufferView that a field refers to."""
        view = self._views[holder.whole(key, high=len(self._views))]
        size = view.whole("byteLength", low=1)
        flat = Fields({**holder.data, "byteOffset": 0}, holder.where)
        return self._read(self._view(flat, size, 1, np.dtype(np.uint8)), None, size).tobytes()

    def stored(self, index: int) -> np.ndarray:
        """(count, width): the numbers in their stored type."""
        return self._raw(index, tuple(WIDTHS))

    def floats(self, index: int, *kinds: str, rows: Rows = None) -> np.ndarray:
        """(n, width): float32 as stored; integers as float64, normalised if the file says so."""
        values = self._raw(index, kinds, rows)
        if values.dtype.kind == "f":
            return values
        if not self._fields[index].flag("normalized"):
            return values.astype(np.float64)
        scaled = values / float(np.iinfo(values.dtype).max)
        return np.maximum(scaled, -1.0)

    def finite(self, index: int, *kinds: str, rows: Rows = None) -> np.ndarray:
        """`floats` as float64, shared by all who ask for the accessor. Raises InputError on NaN or infinity."""
        is_shared = rows is None or self._document.scratch is None
        values = self.floats(index, *kinds, rows=None if is_shared else rows)
        if not is_shared or index not in self._finite:
            if not np.isfinite(values).all():
                raise InputError(f"{self._fields[index].where} holds NaN or infinity; export the file again")
            if not is_shared:
                return values.astype(np.float64)
            self._finite[index] = values.astype(np.float64)
        shared = self._finite[index]
        return shared if rows is None else shared[rows]

    def whole(self, index: int, *kinds: str, rows: Rows = None) -> np.ndarray:
        """(n, width) unsigned integers."""
        values = self._raw(index, kinds, rows)
        if values.dtype.kind != "u":
            raise self._fields[index].bad("componentType", "5121, 5123 or 5125 (unsigned) for indices")
        return values

    def _raw(self, index: int, kinds: tuple[str, ...], rows: Rows = None) -> np.ndarray:
        fields = self._fields[index]
        if fields.text("type") not in kinds:
            raise fields.bad("type", " or ".join(kinds) + " where it is used")
        if index not in self._decoded:
            self._decoded[index] = self._decode(fields)
        return self._read(self._decoded[index], rows, fields.whole("count"))

    def _read(self, values: "np.ndarray | FileRows", rows: Rows, count: int) -> np.ndarray:
        """Rows of an accessor with `count` rows."""
        if isinstance(values, FileRows):
            return values.first(count) if rows is None else values[rows]
        return values if rows is None else values[rows]

    def _decode(self, fields: Fields) -> "np.ndarray | FileRows":
        width, dtype = WIDTHS[fields.text("type")], self._dtype(fields)
        count, sparse = fields.whole("count"), fields.object("sparse")
        if "bufferView" in fields:
            values = self._view(fields, count, width, dtype)
            if sparse is None:
                return values
            if isinstance(values, FileRows):
                check_reading(_VALUE_BYTES * width * count, fields.where, cure=BINARY_PLY)
            values = self._read(values, None, count)
        else:  # zeros; legitimate ones accompany data in buffers, which bounds their count
            if count > self._available:
                raise fields.bad("count", f"at most {self._available}, the bytes in buffers, without bufferView")
            values = np.zeros((count, width), dtype)
        return self._kept(values if sparse is None else self._with_sparse(values, sparse))

    def _with_sparse(self, values: np.ndarray, sparse: Fields) -> np.ndarray:
        count = sparse.whole("count", low=1, high=len(values) + 1)
        indices, replacements = sparse.object("indices"), sparse.object("values")
        if indices is None or replacements is None:
            raise InputError(f"{sparse.where} needs indices and values; export the file again")
        rows = self._read(self._view(indices, count, 1, self._dtype(indices)), None, count)[:, 0]
        if rows.dtype.kind != "u" or rows.max() >= len(values):
            raise InputError(
                f"{indices.where} reaches beyond the {counted(len(values), 'element')}; export the file again"
            )
        values = values.copy()
        values[rows] = self._read(self._view(replacements, count, values.shape[1], values.dtype), None, count)
        return values

    def _view(self, fields: Fields, count: int, width: int, dtype: np.dtype) -> "np.ndarray | FileRows":
        """(count, width) numbers in a buffer, after checking that bufferView and buffer are large enough."""
        view = self._views[fields.whole("bufferView", high=len(self._views))]
        number = view.whole("buffer", high=len(self._document.buffers))
        buffer = self._document.buffers[number]
        if buffer is None:
            raise InputError(f"{self._document.file}: buffers[{number}] has no data; export the file again")
        start, size = view.whole("byteOffset", 0), view.whole("byteLength")
        if start + size > len(buffer):
            end = f"ends at byte {start + size}, buffers[{number}] at {len(buffer)}"
            raise InputError(f"{view.where} {end}; the data is cut short, copy the file again")
        offset, element = fields.whole("byteOffset", 0), width * dtype.itemsize
        stride = view.whole("byteStride", element)
        if stride < element:
            raise view.bad("byteStride", f"at least {element}, the size of an element")
        needed = offset + stride * (count - 1) + element if count else 0
        if needed > size:
            raise InputError(f"{fields.where} needs {needed} bytes, its bufferView has {size}; export it again")
        if count == 0:
            return np.empty((0, width), dtype)
        if isinstance(buffer, FileBytes):
            return buffer[start + offset :].rows(np.dtype((dtype, (width,))), stride)
        return np.ndarray((count, width), dtype, buffer, start + offset, (stride, dtype.itemsize))

    def _dtype(self, fields: Fields) -> np.dtype:
        component = fields.whole("componentType")
        if component not in COMPONENTS:
            raise fields.bad("componentType", "one of " + ", ".join(map(str, COMPONENTS)))
        return np.dtype(COMPONENTS[component])


# --- KHR_draco_mesh_compression ---------------------------------------------------------------------------------------


DRACO_EXTENSION = "KHR_draco_mesh_compression"
_TRIANGLES = 4


def decompress(primitive: Fields, accessors: Accessors) -> list[int]:
    """Decompress a primitive into its accessors, and return their indices.

    A primitive that is also stored uncompressed is not decompressed; the list is then empty.

    Raises
    ------
    InputError
        If the library is missing, or the data cannot be decoded.
    """
    extension = primitive.extension(DRACO_EXTENSION)
    attributes = primitive.mapping("attributes", len(accessors))
    if extension is None or "POSITION" not in attributes or accessors.has_data(attributes["POSITION"]):
        return []
    if primitive.whole("mode", _TRIANGLES) != _TRIANGLES:
        raise InputError(f"{primitive.where} is a compressed strip; {CURE}")
    library = import_extra("DracoPy", f"{primitive.where}, compressed with Draco,", "compressed")
    data, indices = accessors.view_bytes(extension, "bufferView"), primitive.whole("indices", high=len(accessors))
    try:
        mesh = library.decode(data)
        arrays = {
            attributes[name]: np.asarray(mesh.get_attribute_by_unique_id(number)["data"])
            for name, number in extension.mapping("attributes", 1 << 31).items()
            if name in attributes
        }
        arrays[indices] = np.asarray(mesh.faces).reshape(-1, 1)
    except Exception as error:  # the library raises various exceptions on damaged data
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{primitive.where}: Draco data cannot be decoded ({reason}); export the file again"
        ) from error
    for index, values in arrays.items():
        accessors.supply(index, values)
    return list(arrays)
