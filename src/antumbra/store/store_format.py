"""The file format of a store, version 1, and its metadata. All numbers are little-endian.

::

    header      one page of 4096 bytes: `HEADER`, zeros, and the CRC-32 of all this in the last four bytes
    chunks      each begins on a page: nodes, corners, prim_ids, palette, index, zeros up to the next page
    directory   begins on a page: `COUNTS`, a `TABLE` row for each chunk, the top tree's nodes, metadata (JSON), zeros

CRC-32 checksums cover the padding, so they detect a changed byte anywhere. The header is written last, so a file whose
build was interrupted begins with zeros. The metadata describes the scene without its triangles as JSON, from which
floats are restored bit for bit.
"""

import json
import struct
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import quoted
from ..bvh.nodes import Bvh
from ..scene.camera import Camera
from ..scene.light_lists import DirectionalLights, PointLights
from ..scene.lights import AmbientOcclusion, DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight
from ..scene.raster import Raster
from ..scene.units import LengthUnit

# --- File layout ------------------------------------------------------------------------------------------------------


STORE_SUFFIX = ".antumbra"
PAGE = 4096
NODE_BYTES = 64  # bytes of a BVH node in a chunk
MAGIC = b"ANTUMBRA"
VERSION = 1
COMPLETE = 1
HEADER = struct.Struct("<8sIIQQQI")
"""Magic, version, COMPLETE, size of the file, and the directory's offset, size and CRC-32."""
HEADER_CRC = PAGE - 4  # offset of the header's own CRC-32, in every version
COUNTS = struct.Struct("<QQQ")
"""Number of chunks, number of nodes of the top tree, and size of the metadata in bytes."""

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
    """The table of all chunks of a store, one column per field. It is always in memory."""

    offset: NDArray[np.int64]  # (k,): where the chunk begins in the file, a multiple of PAGE
    bytes: NDArray[np.int64]  # (k,): length of the chunk with its padding, a multiple of PAGE
    triangles: NDArray[np.int64]  # (k,): number of triangles
    nodes: NDArray[np.int64]  # (k,): number of nodes of the chunk's BVH
    colours: NDArray[np.int64]  # (k,): number of rows of the chunk's palette
    crc: NDArray[np.uint32]  # (k,): CRC-32 of all bytes of the chunk
    box: NDArray[np.float32]  # (k, 6): lower, then upper corner; the exact bounds of the chunk's triangles
    root: NDArray[np.float32]  # (k, 16): a copy of the chunk's root node


class TopTree(NamedTuple):
    """A tree whose leaves are chunks. Nodes are as in `Bvh`, but a link < 0 is ``~(8 * chunk)`` or EMPTY."""

    nodes: NDArray[np.float32]  # (m, 16), 64-byte aligned
    links: NDArray[np.int32]  # (m, 16), the same memory


class Chunk(NamedTuple):
    """A chunk of a scene: views of the buffer that it was read into."""

    bvh: Bvh  # BVH of the chunk's triangles; prim_ids are indices in the whole scene
    palette: NDArray[np.float32]  # (p, 3): the distinct base colours
    palette_rows: NDArray[Any]  # (n,) uint8, uint16 or uint32: slot -> row of the palette


class ChunkLayout(NamedTuple):
    """Offsets of a chunk's arrays, in bytes from the chunk's first byte. An array ends where the next one begins."""

    nodes: int
    corners: int
    prim_ids: int
    palette: int
    palette_rows: int
    end: int  # end of the last array, without the padding


def pages(n_bytes: int) -> int:
    """`n_bytes`, rounded up to whole pages."""
    return -(-n_bytes // PAGE) * PAGE


def index_dtype(n_colours: int) -> np.dtype[Any]:
    """The dtype of indices into a palette of `n_colours` rows."""
    return np.dtype("u1" if n_colours <= 1 << 8 else "<u2" if n_colours <= 1 << 16 else "<u4")


def chunk_places(triangles: int, nodes: int, colours: int) -> ChunkLayout:
    """The offsets of a chunk's arrays."""
    corners = NODE_BYTES * nodes
    prim_ids = corners + 36 * triangles
    palette = prim_ids + 4 * triangles
    rows = palette + 12 * colours
    return ChunkLayout(0, corners, prim_ids, palette, rows, rows + triangles * index_dtype(colours).itemsize)


def chunk_views(data: NDArray[np.uint8], triangles: int, nodes: int, colours: int) -> Chunk:
    """The arrays of a chunk as views of its bytes, (m,) uint8."""
    at = chunk_places(triangles, nodes, colours)
    lines = data[at.nodes : at.corners]
    bvh = Bvh(
        lines.view(np.float32).reshape(nodes, 16),
        lines.view(np.int32).reshape(nodes, 16),
        data[at.prim_ids : at.palette].view(np.int32),
        data[at.corners : at.prim_ids].view(np.float32).reshape(triangles, 9),
    )
    palette = data[at.palette : at.palette_rows].view(np.float32).reshape(colours, 3)
    return Chunk(bvh, palette, data[at.palette_rows : at.end].view(index_dtype(colours)))


# --- Metadata ---------------------------------------------------------------------------------------------------------


_CAMERA = ("position", "target", "up", "vfov", "width", "height", "projection", "extent")


class StoreMeta(NamedTuple):
    """The scene of a store, without its triangles."""

    name: str  # name of the scene
    up: str  # "y" or "z"
    n_triangles: int
    bounds: NDArray[np.float64]  # (2, 3), world space
    origin: NDArray[np.float64]  # (3,): origin of the recentred frame, in world space
    box: NDArray[np.float32]  # (2, 3): exact bounds of all vertices in the recentred frame
    cameras: list[Camera]
    lights: list[Light]
    notes: tuple[str, ...]  # notes of the loaders that read the source files
    built: dict[str, Any]  # the settings of the build
    crs: str | None = None  # of the world coordinates
    raster: Raster | None = None  # the cells of the raster of heights in the store
    unit: LengthUnit | None = None  # of the world coordinates; None: that of the CRS, or metres


def meta_to_json(meta: StoreMeta) -> bytes:
    """The metadata as JSON."""
    record = meta._asdict()
    for name in ("crs", "raster", "unit"):
        if record[name] is None:
            del record[name]  # so that earlier versions read the store
    record["bounds"], record["origin"], record["box"] = (_plain(a) for a in (meta.bounds, meta.origin, meta.box))
    record["cameras"] = [{name: _plain(getattr(c, name)) for name in _CAMERA} for c in meta.cameras]
    record["lights"] = [_light_fields(light) for light in meta.lights]
    return json.dumps(record).encode()


def meta_from_json(data: bytes) -> StoreMeta:
    """The metadata from JSON that `meta_to_json` wrote."""
    record = json.loads(data)
    record["bounds"], record["origin"] = np.array(record["bounds"]), np.array(record["origin"])
    record["box"] = np.array(record["box"], np.float32)
    record["cameras"] = [Camera(**values) for values in record["cameras"]]
    record["lights"] = [_light(values) for values in record["lights"]]
    if not isinstance(record["notes"], list):
        raise ValueError(f"its notes are {quoted(record['notes'])}")
    record["notes"] = tuple(record["notes"])
    if "raster" in record:
        record["raster"] = Raster(*record["raster"])
    if "unit" in record:
        record["unit"] = LengthUnit(*record["unit"])
    return StoreMeta(**record)


_KINDS: dict[str, Any] = {each.__name__: each for each in (
    AmbientOcclusion, DirectionalLight, DirectionalLights, DiskLight, PointLight, PointLights, QuadLight, SphereLight,
)}  # fmt: skip


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _light_fields(light: Light) -> dict[str, Any]:
    named = {"name": light.name} if light.name else {}
    return {"type": type(light).__name__} | named | {f.name: _plain(getattr(light, f.name)) for f in fields(light)}


def _light(values: dict[str, Any]) -> Light:
    kind, name, values["colour"] = values.pop("type"), values.pop("name", ""), tuple(values["colour"])
    light: Light = _KINDS[kind](**values)
    for key, value in values.items():  # overwrite: normalising a direction again could change its last bit
        if isinstance(checked := getattr(light, key), np.ndarray):
            value = np.array(value, np.float64)
            if value.shape != checked.shape or not np.allclose(value, checked, rtol=1e-12, atol=1e-12):
                raise ValueError(f"a {kind} has the {key} {quoted(values[key])}")
        object.__setattr__(light, key, value)
    return light.named(name)
