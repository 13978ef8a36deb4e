"""Buffer views compressed by meshoptimizer: EXT_meshopt_compression and KHR_meshopt_compression.

Encoders add a filter to the values of some views: unit vectors in octahedral form, quaternions by their three smallest
components, floats with a shared exponent, or colours as luma and chroma. The decoder undoes it, so accessors read
the quantized integers and floats of KHR_mesh_quantization.
"""

from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import MissingPackage, import_extra
from ...base.memory import check_reading
from ...kernels.parallel import map_in_threads
from ..json_fields import Fields

MESHOPT_EXTENSIONS = "EXT_meshopt_compression", "KHR_meshopt_compression"

MAX_RATIO = 1024
"""Upper bound on decoded bytes per compressed byte. The densest code, of constant values in version 1 of the vertex
codec, has one byte for four byte columns of up to 256 rows."""


class CompressedView(NamedTuple):
    """A compressed buffer view, with the fields of its extension."""

    where: str  # name in errors
    data: bytes
    n_elements: int
    stride: int  # bytes of an element
    mode: str  # ATTRIBUTES, TRIANGLES or INDICES
    filter: str  # NONE, OCTAHEDRAL, QUATERNION, EXPONENTIAL or COLOR


Buffers = list[np.ndarray | None]
"""The buffers of a file, (byteLength,) uint8 each; None: it has no data."""


def is_fallback(buffer: Fields) -> bool:
    """Whether a buffer is a fallback: it holds data for readers without a decoder, and may be missing."""
    extensions = (buffer.extension(name) for name in MESHOPT_EXTENSIONS)
    return any(extension is not None and extension.flag("fallback") for extension in extensions)


def decompress_views(root: Fields, buffers: Buffers) -> tuple[Fields, Buffers]:
    """A file without compressed buffer views: (JSON, buffers). Unchanged if it has none.

    Otherwise each view becomes a buffer, so that no compressed bytes remain. Fallback buffers are used only if the
    library is missing: viewers with a decoder ignore them, so faults in them go unnoticed.

    Raises
    ------
    InputError
        If the library is missing and there is no fallback, or the data cannot be decoded.
    """
    views = root.objects("bufferViews")
    packed = {i: extension for i, view in enumerate(views) if (extension := _extension(view)) is not None}
    if not packed:
        return root, buffers
    out = [_view_data(view, buffers) for view in views]
    try:
        library = import_extra("meshopt", f"{root.where} compressed with meshopt,", "compressed")
    except MissingPackage:
        if any(out[i] is None for i in packed):
            raise
    else:
        stored = sum(len(buffer) for buffer in buffers if buffer is not None)  # views may share it
        compressed, expanded = list[CompressedView](), 0
        for i, extension in packed.items():
            view = _compressed_view(views[i], extension, buffers)
            compressed.append(view)
            expanded += len(view.data) + view.n_elements * view.stride
            check_reading(expanded, f"{root.where} its compressed data", stored)
        for i, data in zip(packed, map_in_threads(partial(_decode, library), compressed)):
            out[i] = data
    return Fields(_plain_json(root.data), root.where), out


def _extension(view: Fields) -> Fields | None:
    return next((found for name in MESHOPT_EXTENSIONS if (found := view.extension(name)) is not None), None)


def _view_data(view: Fields, buffers: Buffers) -> np.ndarray | None:
    """The bytes of a view in its buffer, fewer if the buffer is cut short; None: the buffer has no data."""
    buffer = buffers[view.whole("buffer", high=len(buffers))]
    start = view.whole("byteOffset", 0)
    return None if buffer is None else buffer[start : start + view.whole("byteLength")]


def _compressed_view(view: Fields, extension: Fields, buffers: Buffers) -> CompressedView:
    data, size = _view_data(extension, buffers), extension.whole("byteLength", low=1)
    if data is None or len(data) < size:
        number, available = extension.whole("buffer"), "no data" if data is None else f"{len(data)} bytes"
        raise InputError(f"{extension.where} needs {size} bytes, buffers[{number}] has {available}; copy it again")
    count, stride = extension.whole("count"), extension.whole("byteStride", low=1, high=257)
    length = view.whole("byteLength")
    if count * stride != length:
        raise InputError(f"{view.where} has {length} bytes, its compressed data {count} * {stride}; export it again")
    if length > MAX_RATIO * size:
        raise InputError(f"{extension.where} has {length} bytes in {size}, which no encoder writes; export it again")
    return CompressedView(
        extension.where, data.tobytes(), count, stride, extension.text("mode"), extension.text("filter", "NONE")
    )


def _decode(library: ModuleType, view: CompressedView) -> NDArray[np.uint8]:
    try:
        rows = library.decode_gltf_buffer(view.data, view.n_elements, view.stride, view.mode, view.filter)
    except Exception as error:  # the library raises various exceptions on damaged data
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{view.where}: meshopt data cannot be decoded ({reason}); export it again") from error
    return np.ascontiguousarray(rows).reshape(-1).view(np.uint8)


def _plain_json(data: dict[str, Any]) -> dict[str, Any]:
    """The JSON of a file whose views are buffers of their own, without the extensions."""
    out = {**data, "buffers": [{"byteLength": view["byteLength"]} for view in data["bufferViews"]]}
    out["bufferViews"] = [_plain_view(view, i) for i, view in enumerate(data["bufferViews"])]
    for key in ("extensionsUsed", "extensionsRequired"):
        names = [name for name in data.get(key) or () if name not in MESHOPT_EXTENSIONS]
        out.pop(key, None)
        if names:
            out[key] = names
    return out


def _plain_view(view: dict[str, Any], index: int) -> dict[str, Any]:
    out = {key: value for key, value in view.items() if key not in ("byteOffset", "extensions")} | {"buffer": index}
    extensions = {k: v for k, v in (view.get("extensions") or {}).items() if k not in MESHOPT_EXTENSIONS}
    return out | {"extensions": extensions} if extensions else out
