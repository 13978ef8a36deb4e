"""The file format of a store, version 4, and its metadata. All numbers are little-endian.

::

    header      one page of 4096 bytes: `HEADER`, zeros, and the CRC-32 of all this in the last four bytes
    chunks      each begins on a page: nodes, corners, prim_ids, palette, index, zeros up to the next page
    heights     of terrain only; begin on a page: rows of float32 or float64, zeros up to the next page
    cut-outs    if there are faces that let light pass; begin on a page, see `stored_cutouts`
    looks       if there are textures or other materials; begin on a page, see `stored_looks`
    directory   begins on a page: `COUNTS`, a `TABLE` row for each chunk, the top tree's nodes, metadata (JSON), zeros

CRC-32 checksums cover the padding, so they detect a changed byte anywhere. The header is written last, so a file whose
build was interrupted begins with zeros. The metadata describes the scene without its triangles as JSON, from which
floats are restored bit for bit. Version 3 had no looks, and version 2 no cut-outs: all faces were solid.
"""

import json
import struct
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import alternatives, quoted
from ..base.errors import InputError
from ..bvh.compact_tree import CompactTree
from ..scene.camera import Camera
from ..scene.light_lists import DirectionalLights, PointLights
from ..scene.lights import AmbientOcclusion, DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight
from ..scene.raster import Raster
from ..scene.scene_bounds import Detail
from ..scene.terrain import GridPoints
from ..scene.units import LengthUnit

# --- File layout ------------------------------------------------------------------------------------------------------


STORE_SUFFIX = ".antumbra"
TILES_SUFFIX = ".tiles"  # of a manifest of several stores, see `tiled_store`
PAGE = 4096
NODE_BYTES = 64  # bytes of a node
MAGIC = b"ANTUMBRA"
VERSION = 4
OLDEST = 2  # that is read
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
    nodes: NDArray[np.int64]  # (k,): number of nodes of the chunk's tree
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

    tree: CompactTree  # prim_ids are indices in the whole scene
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


class StoredArray(NamedTuple):
    """An array in a section, after those before it."""

    dtype: str | np.dtype[Any]
    shape: tuple[int, ...]

    @property
    def bytes(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64)) * np.dtype(self.dtype).itemsize


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
    tree = CompactTree(
        lines.view(np.float32).reshape(nodes, 16),
        lines.view(np.int32).reshape(nodes, 16),
        data[at.prim_ids : at.palette].view(np.int32),
        data[at.corners : at.prim_ids].view(np.float32).reshape(triangles, 9),
    )
    palette = data[at.palette : at.palette_rows].view(np.float32).reshape(colours, 3)
    return Chunk(tree, palette, data[at.palette_rows : at.end].view(index_dtype(colours)))


# --- Heights of terrain -----------------------------------------------------------------------------------------------


BAND = 256  # rows with a checksum


class HeightSection(NamedTuple):
    """The place of heights in a file."""

    offset: int  # of the first row
    bytes: int  # length with its padding
    grid: GridPoints
    dtype: str
    crcs: tuple[int, ...]  # CRC-32 of each band

    def band(self, k: int) -> tuple[int, int]:
        """Where a band begins, and its length with its padding."""
        size = BAND * self.grid.columns * np.dtype(self.dtype).itemsize
        return self.offset + k * size, min(size, self.bytes - k * size)


def section_from_json(record: Any) -> HeightSection:
    """A section from its fields as JSON. Raises TypeError or ValueError if they do not fit."""
    offset, size, grid, dtype, crcs = record
    return HeightSection(offset, size, GridPoints(*grid), dtype, tuple(crcs))


# --- Cut-outs ---------------------------------------------------------------------------------------------------------


class CutoutSection(NamedTuple):
    """The place of cut-outs in a file, and the sizes of their arrays; see `stored_cutouts`."""

    offset: int
    bytes: int  # length with its padding
    faces: int
    masks: int
    rows: int  # of depths
    months: int  # 12; or 0 if no mask changes over the year
    texels: int
    crc: int  # CRC-32 of all bytes


# --- Looks ------------------------------------------------------------------------------------------------------------


class LookSection(NamedTuple):
    """The place of the looks of faces in a file, and what is not in blocks; see `stored_looks`."""

    offset: int
    bytes: int  # length with its padding
    table: int  # where the table begins in the section
    crc: int  # CRC-32 of the table, which has those of the blocks
    attributes: list[str]  # those that the scene has
    is_textured: bool  # whether a face shows a base colour texture
    images: dict[str, list[int]]  # offset in the section and length of each, by its SHA-256
    materials: list[str]  # as from `stored_materials.material_to_json`


# --- Metadata ---------------------------------------------------------------------------------------------------------


_CAMERA = ("position", "target", "up", "vfov", "width", "height", "projection", "extent")


class StoredObjects(NamedTuple):
    """The objects of a scene, in the order of `Scene.objects`, and their faces."""

    names: list[str]
    types: list[str]
    parents: list[str]
    faces: list[int]  # numbers of consecutive faces of one object
    of: list[int]  # the object of each of these runs
    had_surfaces: bool = False  # whether the scene has semantic surfaces, which the store does not keep

    def fault(self, n_triangles: int) -> str:
        """What is wrong with fields from JSON; "" if nothing is."""
        texts, n = (self.names, self.types, self.parents), len(self.names)
        if not all(len(each) == n and all(isinstance(text, str) for text in each) for each in texts):
            return "its objects have no proper names"
        numbers = len(self.faces) == len(self.of) and all(type(k) is int for k in (*self.faces, *self.of))
        if not numbers or min(self.faces, default=0) < 1 or not all(0 <= k < n for k in self.of):
            return "its objects have no proper faces"
        return "" if sum(self.faces) == n_triangles else "its objects do not have all faces"


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
    heights: HeightSection | None = None  # of the terrain that is the scene
    objects: StoredObjects | None = None  # None: all faces are one object
    cutouts: CutoutSection | None = None  # None: all faces are solid
    looks: LookSection | None = None  # None: all faces have plain colours
    framed: NDArray[np.float64] | None = None  # (k, 3), world: `default_picture.framed_points`; None: see the bounds
    detail: Detail | None = (
        None  # None: views from outside show it, as copies of meshes, or an earlier version built it
    )


def meta_to_json(meta: StoreMeta) -> bytes:
    """The metadata as JSON."""
    record = meta._asdict()
    for name in ("crs", "raster", "unit", "heights", "objects", "cutouts", "looks", "framed", "detail"):
        if record[name] is None:
            del record[name]
    record["bounds"], record["origin"], record["box"] = (_plain(a) for a in (meta.bounds, meta.origin, meta.box))
    if meta.objects is not None:
        record["objects"] = meta.objects._asdict()
    if meta.looks is not None:
        record["looks"] = meta.looks._asdict()
    if meta.framed is not None:
        record["framed"] = meta.framed.tolist()
    if meta.detail is not None:
        record["detail"] = {name: each.tolist() for name, each in meta.detail._asdict().items()}
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
    if "heights" in record:
        record["heights"] = section_from_json(record["heights"])
    if "objects" in record:
        record["objects"] = StoredObjects(**record["objects"])
    if "cutouts" in record:
        record["cutouts"] = CutoutSection(*record["cutouts"])
    if "looks" in record:
        record["looks"] = LookSection(**record["looks"])
    if "framed" in record:
        record["framed"] = np.array(record["framed"], np.float64)
    if "detail" in record:
        record["detail"] = Detail(**{name: np.array(each, np.float64) for name, each in record["detail"].items()})
    return StoreMeta(**record)


_KINDS: dict[str, Any] = {each.__name__: each for each in (
    AmbientOcclusion, DirectionalLight, DirectionalLights, DiskLight, PointLight, PointLights, QuadLight, SphereLight,
)}  # fmt: skip


def _plain(value: object) -> object:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _light_fields(light: Light) -> dict[str, Any]:
    kind, named = type(light).__name__, {"name": light.name} if light.name else {}
    if kind not in _KINDS:
        raise InputError(f"a store cannot save the scene's {kind}; replace it by {alternatives(list(_KINDS))}")
    return {"type": kind} | named | {f.name: _plain(getattr(light, f.name)) for f in fields(light)}


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
