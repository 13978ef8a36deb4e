"""glTF and GLB files: containers, buffers and data URIs, with sizes checked before reading, and without compression.

Buffer views are compressed by meshoptimizer: EXT_meshopt_compression and KHR_meshopt_compression. Encoders add a filter
to the values of some views: unit vectors in octahedral form, quaternions by their three smallest components, floats
with a shared exponent, or colours as luma and chroma. The decoder undoes it, so accessors read the quantized integers
and floats of KHR_mesh_quantization.
"""

import base64
import binascii
import struct
import weakref
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeAlias
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import MissingPackage, import_extra
from ...base.files import checked_file, sibling, temporary_folder
from ...base.memory import check_reading
from ...kernels.parallel import map_in_threads
from ..face_ranges import FileBytes
from ..json_fields import Fields, parse

GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
MESHOPT_EXTENSIONS = "EXT_meshopt_compression", "KHR_meshopt_compression"
SUPPORTED = {
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "EXT_mesh_gpu_instancing",
    *MESHOPT_EXTENSIONS,
}
HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "MSFT_packing_", "KHR_xmp")
FEW_ELEMENTS = 1 << 21
"""Files whose accessors have at most so many elements are read whole even for stores, which is faster."""

CURE = "decompress it first, for example with: npx @gltf-transform/cli copy in.glb out.glb"


Buffer: TypeAlias = np.ndarray | FileBytes
"""(byteLength,) uint8, in memory or in a file."""

Buffers = list[Buffer | None]
"""The buffers of a file; None: it has no data."""


class ScratchFile:
    """A scratch file for decompressed data, which is removed with this object."""

    def __init__(self) -> None:
        with ExitStack() as stack:
            self._path, self._end = stack.enter_context(temporary_folder()) / "decompressed", 0
            self.close = weakref.finalize(self, stack.pop_all().close)

    def add(self, values: np.ndarray) -> FileBytes:
        """Append the bytes of an array."""
        with self._path.open("ab") as stream:
            stream.write(np.ascontiguousarray(values).data)
        self._end += values.nbytes
        return FileBytes(self._path, self._end - values.nbytes, values.nbytes)


class GltfDocument(NamedTuple):
    """A glTF file: its JSON and its buffers. No buffer view is compressed."""

    file: str
    folder: Path
    root: Fields
    buffers: Buffers
    scratch: ScratchFile | None = None  # takes what is decompressed; None: that stays in memory, and so do the buffers


def open_gltf(path: Path, streamed: bool = False) -> GltfDocument:
    """Read a .glb or .gltf file, identified by content, and the buffers in it or beside it.

    streamed : leave the buffers of a large file on the disk
    """
    data, file = FileBytes(path), path.name
    text, binary = split_glb(data, file) if bytes(data[:4]) == GLB_MAGIC else (bytes(data), None)
    if text[:64].lstrip(b"\xef\xbb\xbf \t\r\n")[:1] not in (b"{", b"[", b""):
        raise InputError(f"{file}: is not a glTF file, which begins with glTF or a brace; export it again")
    root = parse(text, file)
    _check_version(root)
    _check_extensions(root)
    for key in ("buffers", "images"):
        for fields in root.objects(key):
            uri = fields.text("uri", None)
            if uri is not None and not is_data_uri(uri):
                sibling(path.parent, uri, fields.place("uri"))
    buffers = [_buffer(b, i, binary, path.parent) for i, b in enumerate(root.objects("buffers"))]
    scratch = ScratchFile() if streamed and _n_elements(root) > FEW_ELEMENTS else None
    if scratch is None:
        buffers = [None if buffer is None else in_memory(buffer) for buffer in buffers]
    return GltfDocument(file, path.parent, *decompress_views(root, buffers, scratch), scratch)


def in_memory(buffer: Buffer) -> np.ndarray:
    """The bytes of a buffer, or of a part of it."""
    return buffer.read() if isinstance(buffer, FileBytes) else buffer


def _n_elements(root: Fields) -> int:
    """The elements of all accessors, as the file declares them."""
    counts = [accessor.data.get("count") for accessor in root.objects("accessors")]
    return sum(count for count in counts if isinstance(count, int))


def split_glb(data: FileBytes, file: str) -> tuple[bytes, FileBytes | None]:
    """The JSON and binary chunks of a GLB container."""
    if len(data) < 20:
        raise InputError(f"{file}: GLB header is cut short at {len(data)} bytes; copy the file again")
    version, length = struct.unpack("<II", bytes(data[4:12]))
    if version != 2:
        raise InputError(f"{file}: GLB version is {version}; convert the file to glTF 2.0")
    if length > len(data):
        raise InputError(
            f"{file}: GLB length says {length} bytes, the file has {len(data)}; it is truncated, copy again"
        )
    chunks: list[tuple[int, int, int]] = []
    offset = 12
    while offset + 8 <= length:
        size, kind = struct.unpack("<II", bytes(data[offset : offset + 8]))
        offset += 8
        if size > length - offset:
            remaining = length - offset
            raise InputError(
                f"{file}: GLB chunk {len(chunks)} says {size} bytes, {remaining} are left; copy the file again"
            )
        chunks.append((kind, offset, size))
        offset += size
    if not chunks or chunks[0][0] != JSON_CHUNK:
        raise InputError(f"{file}: the first GLB chunk is not JSON; export the file again")
    text = bytes(data[chunks[0][1] : chunks[0][1] + chunks[0][2]])
    binary = next((data[o : o + n] for kind, o, n in chunks[1:2] if kind == BINARY_CHUNK), None)
    return text, binary


def is_data_uri(uri: str) -> bool:
    """Whether a URI holds the data itself."""
    return uri[:5].lower() == "data:"


def data_uri_bytes(uri: str, where: str) -> bytes:
    """The bytes in a data URI."""
    head, comma, body = uri.partition(",")
    if not comma:
        raise InputError(f"{where} is a data URI without a comma; export the file again")
    raw = unquote_to_bytes(body)
    if not head.lower().endswith(";base64"):
        return raw
    try:
        return base64.b64decode(raw, validate=True)
    except (binascii.Error, ValueError):
        raise InputError(f"{where} is a data URI that is not base64; export the file again") from None


def _buffer(fields: Fields, index: int, binary: FileBytes | None, folder: Path) -> Buffer | None:
    size, uri = fields.whole("byteLength"), fields.text("uri", None)
    place = fields.place("byteLength")
    data: Buffer
    if uri is None:
        if index > 0 or binary is None:
            return None
        data = binary
    elif is_data_uri(uri):
        data = np.frombuffer(data_uri_bytes(uri, fields.place("uri")), np.uint8)
    else:
        path = sibling(folder, uri, fields.place("uri"))
        if is_fallback(fields) and not path.exists():
            return None
        data = FileBytes(checked_file(path, f"{fields.place('uri')} {uri[:80]!r}"))
    _check_size(size, len(data), place)
    return data[:size]


def _check_size(declared: int, available: int, place: str) -> None:
    if declared > available:
        raise InputError(
            f"{place} says {declared} bytes, but there are {available}; the data is cut short, copy it again"
        )


def _check_version(root: Fields) -> None:
    asset = root.object("asset")
    version = None if asset is None else asset.text("version", None)
    if version is None:
        raise InputError(f"{root.where} asset.version is missing; is this a glTF file?")
    if version.split(".")[0] != "2":
        raise InputError(f"{root.where} asset.version is {version[:20]!r}; convert the file to glTF 2.0")


def _check_extensions(root: Fields) -> None:
    for name in root.texts("extensionsRequired"):
        if name not in SUPPORTED and not name.startswith(HARMLESS):
            raise InputError(
                f"{root.where} extensionsRequired has {name[:60]!r}, which is unsupported; export without it"
            )


# --- Buffer views compressed by meshoptimizer -------------------------------------------------------------------------


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


def is_fallback(buffer: Fields) -> bool:
    """Whether a buffer is a fallback: it holds data for readers without a decoder, and may be missing."""
    extensions = (buffer.extension(name) for name in MESHOPT_EXTENSIONS)
    return any(extension is not None and extension.flag("fallback") for extension in extensions)


def decompress_views(root: Fields, buffers: Buffers, scratch: ScratchFile | None) -> tuple[Fields, Buffers]:
    """A file without compressed buffer views: (JSON, buffers). Unchanged if it has none.

    scratch : takes the views, one after the other; None: memory does

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
        if scratch is not None:
            for i, extension in packed.items():
                out[i] = _spilled(library, views[i], extension, buffers, scratch)
            return Fields(_plain_json(root.data), root.where), out
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


def _spilled(library: ModuleType, view: Fields, extension: Fields, buffers: Buffers, scratch: ScratchFile) -> FileBytes:
    """Decompress a view into a scratch file."""
    count, stride = extension.whole("count"), extension.whole("byteStride", low=1, high=257)
    check_reading(count * stride + extension.whole("byteLength", low=1), extension.where, cure=CURE)
    return scratch.add(_decode(library, _compressed_view(view, extension, buffers)))


def _view_data(view: Fields, buffers: Buffers) -> Buffer | None:
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
        extension.where, bytes(data), count, stride, extension.text("mode"), extension.text("filter", "NONE")
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
