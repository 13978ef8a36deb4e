"""The file format of a store, version 1, and its metadata. All numbers are little-endian.

The metadata is the scene without its triangles, as JSON. Floats survive it bit for bit.

::

    header      one page of 4096 bytes: `HEADER`, zeros, and the CRC-32 of all this in the last four bytes
    chunks      each begins on a page: nodes, corners, prim_ids, palette, index, zeros up to the next page
    directory   begins on a page: `COUNTS`, a `TABLE` row for each chunk, the top tree's nodes, metadata (JSON), zeros

CRC-32 sums include the zeros, so they find a changed byte anywhere. The header is written last. So a file whose writing
was interrupted begins with zeros.
"""

import json
import struct
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from ..bvh.nodes import Bvh
from ..scene import lights as lights_module
from ..scene.camera import Camera
from ..scene.light_lists import DirectionalLights, PointLights
from ..scene.lights import Light

# --- The file format of a store, version 1. All numbers are little-endian ---------------------------------------------
#
# ::
#
#     header      one page of 4096 bytes: `HEADER`, zeros, and the CRC-32 of all this in the last four bytes
#     chunks      each begins on a page: nodes, corners, prim_ids, palette, index, zeros up to the next page
#     directory   begins on a page: `COUNTS`, a `TABLE` row for each chunk, the top tree's nodes, metadata (JSON),
#     zeros
#
# CRC-32 sums include the zeros, so they find a changed byte anywhere. The header is written last. So a file whose
# writing was interrupted begins with zeros.


STORE_SUFFIX = ".antumbra"
PAGE = 4096
NODE_BYTES = 64  # of a node in a chunk
MAGIC = b"ANTUMBRA"
VERSION = 1
COMPLETE = 1
HEADER = struct.Struct("<8sIIQQQI")
"""Magic, version, COMPLETE, size of the file, and the directory's offset, size and CRC-32."""
HEADER_CRC = PAGE - 4  # offset of the header's own CRC-32, in every version
COUNTS = struct.Struct("<QQQ")
"""Numbers of chunks, of nodes of the top tree, and of bytes of metadata."""

TABLE = np.dtype(
    [
        ("offset", "<i8"),
        ("bytes", "<i8"),
        ("triangles", "<i8"),
        ("nodes", "<i8"),
        ("colours", "<i8"),
        ("crc", "<u4"),
        ("box", "<f4", 6),
        ("root", "<f4", 16),
    ]
)
"""A row of the directory; see `Chunks` for the fields."""


class Chunks(NamedTuple):
    """The table of all chunks of a store, a column for each field. It is always in memory."""

    offset: np.ndarray  # (k,) int64: where the chunk begins in the file, a multiple of PAGE
    bytes: np.ndarray  # (k,) int64: length of the chunk with its padding, a multiple of PAGE
    triangles: np.ndarray  # (k,) int64: number of triangles
    nodes: np.ndarray  # (k,) int64: number of nodes of the chunk's BVH
    colours: np.ndarray  # (k,) int64: number of rows of the chunk's palette
    crc: np.ndarray  # (k,) uint32: CRC-32 of all bytes of the chunk
    box: np.ndarray  # (k, 6) float32: lower, then upper corner; the exact bounds of the chunk's triangles
    root: np.ndarray  # (k, 16) float32: a copy of the chunk's root node


class Chunk(NamedTuple):
    """A chunk of a scene: views of the memory that it was read into."""

    bvh: Bvh  # BVH of the chunk's triangles; prim_ids are indices in the whole scene
    palette: np.ndarray  # (p, 3) float32: the base colours that occur, each once
    index: np.ndarray  # (n,) uint8, uint16 or uint32: slot -> row of the palette


class ChunkPlace(NamedTuple):
    """Offsets of a chunk's arrays, in bytes from the chunk's first byte. An array ends where the next one begins."""

    nodes: int
    corners: int
    prim_ids: int
    palette: int
    index: int
    end: int  # end of the index, without the padding


def pages(n_bytes: int) -> int:
    """`n_bytes`, rounded up to whole pages."""
    return -(-n_bytes // PAGE) * PAGE


def index_dtype(colours: int) -> np.dtype:
    """The dtype of an index into a palette of `colours` rows."""
    return np.dtype("u1" if colours <= 1 << 8 else "<u2" if colours <= 1 << 16 else "<u4")


def chunk_places(triangles: int, nodes: int, colours: int) -> ChunkPlace:
    """The offsets of a chunk's arrays."""
    corners = NODE_BYTES * nodes
    prim_ids = corners + 36 * triangles
    palette = prim_ids + 4 * triangles
    index = palette + 12 * colours
    return ChunkPlace(0, corners, prim_ids, palette, index, index + triangles * index_dtype(colours).itemsize)


def chunk_views(data: np.ndarray, triangles: int, nodes: int, colours: int) -> Chunk:
    """The arrays of a chunk as views of its bytes, (m,) uint8."""
    at = chunk_places(triangles, nodes, colours)
    lines = data[at.nodes : at.corners]
    bvh = Bvh(
        lines.view(np.float32).reshape(nodes, 16),
        lines.view(np.int32).reshape(nodes, 16),
        data[at.prim_ids : at.palette].view(np.int32),
        data[at.corners : at.prim_ids].view(np.float32).reshape(triangles, 9),
    )
    palette = data[at.palette : at.index].view(np.float32).reshape(colours, 3)
    return Chunk(bvh, palette, data[at.index : at.end].view(index_dtype(colours)))


# --- The metadata of a store: the scene without its triangles, as JSON. Floats survive it bit for bit -----------------


_CAMERA = ("position", "target", "up", "vfov", "width", "height", "projection", "extent")


class Meta(NamedTuple):
    """The scene of a store, without its triangles."""

    name: str  # name of the scene
    up: str  # "y" or "z"
    n_triangles: int
    bounds: np.ndarray  # (2, 3) float64, world space
    origin: np.ndarray  # (3,) float64: origin of the recentred frame, in world space
    box: np.ndarray  # (2, 3) float32: exact bounds of all vertices in the recentred frame
    cameras: list[Camera]
    lights: list[Light]
    notes: tuple[str, ...]  # notes of the loaders that read the sources
    built: dict  # how the store was built: names and values
    crs: str | None = None  # of the world coordinates


def meta_to_json(meta: Meta) -> bytes:
    """The metadata as JSON."""
    told = meta._asdict()
    if meta.crs is None:
        del told["crs"]  # so that earlier versions read the store
    told["bounds"], told["origin"], told["box"] = (_plain(a) for a in (meta.bounds, meta.origin, meta.box))
    told["cameras"] = [{name: _plain(getattr(c, name)) for name in _CAMERA} for c in meta.cameras]
    told["lights"] = [_light_fields(light) for light in meta.lights]
    return json.dumps(told).encode()


def meta_from_json(data: bytes) -> Meta:
    """The metadata from JSON that `as_json` wrote."""
    told = json.loads(data)
    told["bounds"], told["origin"] = np.array(told["bounds"]), np.array(told["origin"])
    told["box"] = np.array(told["box"], np.float32)
    told["cameras"] = [Camera(**values) for values in told["cameras"]]
    told["lights"] = [_light(values) for values in told["lights"]]
    told["notes"] = tuple(told["notes"])
    return Meta(**told)


def _plain(value):
    return value.tolist() if isinstance(value, np.ndarray) else value


def _light_fields(light: Light) -> dict:
    named = {"name": light.name} if light.name else {}
    return {"type": type(light).__name__} | named | {f.name: _plain(getattr(light, f.name)) for f in fields(light)}


def _light(values: dict) -> Light:
    kind, name, values["colour"] = values.pop("type"), values.pop("name", ""), tuple(values["colour"])
    kinds = {kind.__name__: kind for kind in (PointLights, DirectionalLights)}
    light = (kinds.get(kind) or getattr(lights_module, kind))(**values)
    for key, value in values.items():  # overwrite: normalising a direction again could change its last bit
        object.__setattr__(light, key, np.array(value) if isinstance(getattr(light, key), np.ndarray) else value)
    return light.named(name)
