"""glTF and GLB files: containers, buffers and data URIs, with sizes checked before reading, and without compression."""

import base64
import binascii
import struct
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote_to_bytes

import numpy as np

from ...base.errors import InputError
from ...base.files import checked_file, sibling
from ..json_fields import Fields, parse
from .meshopt_views import MESHOPT_EXTENSIONS, Buffers, decompress_views, is_fallback

GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", 0x4E4F534A, 0x004E4942
SUPPORTED = {
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "EXT_mesh_gpu_instancing",
    *MESHOPT_EXTENSIONS,
}
HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "MSFT_packing_", "KHR_xmp")
CURE = "decompress it first, for example with: npx @gltf-transform/cli copy in.glb out.glb"


class GltfDocument(NamedTuple):
    """A glTF file: its JSON and its buffers. No buffer view is compressed."""

    file: str
    folder: Path
    root: Fields
    buffers: Buffers


def open_gltf(path: Path) -> GltfDocument:
    """Read a .glb or .gltf file, identified by content, and the buffers in it or beside it."""
    data, file = path.read_bytes(), path.name
    text, binary = split_glb(data, file) if data[:4] == GLB_MAGIC else (data, None)
    root = parse(text, file)
    _check_version(root)
    _check_extensions(root)
    for key in ("buffers", "images"):
        for fields in root.objects(key):
            uri = fields.text("uri", None)
            if uri is not None and not is_data_uri(uri):
                sibling(path.parent, uri, fields.place("uri"))
    buffers = [_buffer(b, i, binary, path.parent) for i, b in enumerate(root.objects("buffers"))]
    return GltfDocument(file, path.parent, *decompress_views(root, buffers))


def split_glb(data: bytes, file: str) -> tuple[bytes, memoryview | None]:
    """The JSON and binary chunks of a GLB container."""
    if len(data) < 20:
        raise InputError(f"{file}: GLB header is cut short at {len(data)} bytes; copy the file again")
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InputError(f"{file}: GLB version is {version}; convert the file to glTF 2.0")
    if length > len(data):
        raise InputError(
            f"{file}: GLB length says {length} bytes, the file has {len(data)}; it is truncated, copy again"
        )
    chunks: list[tuple[int, int, int]] = []
    offset = 12
    while offset + 8 <= length:
        size, kind = struct.unpack_from("<II", data, offset)
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
    view = memoryview(data)
    text = bytes(view[chunks[0][1] : chunks[0][1] + chunks[0][2]])
    binary = next((view[o : o + n] for kind, o, n in chunks[1:2] if kind == BINARY_CHUNK), None)
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


def _buffer(fields: Fields, index: int, binary: memoryview | None, folder: Path) -> np.ndarray | None:
    size, uri = fields.whole("byteLength"), fields.text("uri", None)
    place = fields.place("byteLength")
    data: bytes | memoryview
    if uri is None:
        if index > 0 or binary is None:
            return None
        data = binary
    elif is_data_uri(uri):
        data = data_uri_bytes(uri, fields.place("uri"))
    else:
        path = sibling(folder, uri, fields.place("uri"))
        if is_fallback(fields) and not path.exists():
            return None
        path = checked_file(path, f"{fields.place('uri')} {uri[:80]!r}")
        _check_size(size, path.stat().st_size, place)
        with path.open("rb") as stream:
            data = stream.read(size)
    _check_size(size, len(data), place)
    return np.frombuffer(data, np.uint8, size)


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
