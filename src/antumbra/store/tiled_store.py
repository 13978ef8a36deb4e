"""Scenes of several stores: a manifest lists the tiles, which have one frame, and 64-bit numbers of their faces.

A tile is a store of consecutive faces, which it numbers from 0 on; its bounds, and so its frame, are those of the whole
scene. The manifest is a JSON file beside the tiles::

    {"antumbra_tiles": 1,                 the version
     "crc": ...,                          CRC-32 of the rest, as `json.dumps` writes it
     "scene": {...},                      the scene without its triangles, as in a store
     "tiles": [{"file": "city-0000.antumbra",   beside the manifest
                "bytes": ...,             size of the file
                "sha256": "...",          of its directory, which has the checksums of all chunks
                "first": ...,             number of its first face in the scene, below 2^62
                "triangles": ...,
                "box": [[...], [...]]},   exact bounds in the frame
               ...]}                      in order; numbers between two tiles belong to no face

All chunks of all tiles form one table, below one tree. Tracers number faces by int32, so tiles that follow one another
form *ranges* of at most 2^31 - 1 faces.
"""

import hashlib
import json
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.checks import quoted
from ..base.errors import InputError
from ..base.files import sibling
from ..base.remote_files import url_of
from ..scene.alpha_masks import Cutouts, join_cutouts
from .store_checks import MAX_TRIANGLES, check_one_range, meta_fault
from .store_data import StoreData
from .store_directory import Directory, top_tree
from .store_file import Bytes, FaceRange, Store, open_bytes, open_store
from .store_format import Chunk, Chunks, StoreMeta, meta_from_json, meta_to_json
from .stored_cutouts import ClearFaces, StoredCutouts
from .stored_looks import LooksPart, SceneLooks

VERSION = 1
_MAX_BYTES = 1 << 28  # of a manifest
_MAX_FACES = 1 << 62  # of a scene
_REMEDY = "copy all its files again, or build it again"


class Tile(NamedTuple):
    """A tile, as the manifest lists it."""

    file: str  # beside the manifest
    bytes: int  # size of the file
    sha256: str  # of its directory
    first: int  # number of its first face in the scene
    triangles: int
    box: list[list[float]]  # bounds in the frame

    @classmethod
    def of(cls, store: Store, first: int) -> "Tile":
        """The tile of a store; `first`: the number of its first face."""
        meta = store.meta
        return cls(store.path.name, store.size, store.digest, first, meta.n_triangles, meta.box.tolist())


# --- The manifest -----------------------------------------------------------------------------------------------------


def manifest_to_json(meta: StoreMeta, tiles: Sequence[Tile]) -> bytes:
    """The bytes of a manifest; `meta` describes the whole scene."""
    record = {"scene": json.loads(meta_to_json(meta)), "tiles": [tile._asdict() for tile in tiles]}
    return json.dumps({"antumbra_tiles": VERSION, "crc": _crc(record), **record}, indent=1).encode()


def manifest_from_json(data: bytes, name: str) -> tuple[StoreMeta, list[Tile]]:
    """The scene and the tiles of a manifest, checked apart from the tiles; `name`: for errors."""
    try:
        record = json.loads(data)
        version, crc = record.pop("antumbra_tiles"), record.pop("crc")
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError):
        raise InputError(f"{name}: is no manifest of tiles; make one by antumbra build SCENE -o {name}") from None
    if version != VERSION:
        raise InputError(
            f"{name}: is a manifest of version {quoted(version)}, and this antumbra reads version {VERSION}; "
            "upgrade antumbra, or build it again"
        )
    if crc != _crc(record):
        raise InputError(f"{name}: is damaged; {_REMEDY}")
    try:
        tiles = [Tile(**each) for each in record["tiles"]]
        meta, fault = meta_from_json(json.dumps(record["scene"]).encode()), _tiles_fault(tiles)
        boxes = np.array([tile.box for tile in tiles], np.float32).reshape(-1, 6)
        fault = fault or meta_fault(meta, boxes, sum(tile.triangles for tile in tiles), _MAX_FACES)
        if not fault and meta.n_triangles != tiles[-1].first + tiles[-1].triangles:
            fault = "its last tile is not the end of its scene"
    except (ValueError, AttributeError, KeyError, TypeError, OverflowError, RecursionError) as error:
        fault = f"{type(error).__name__} in its fields"
    if fault:
        raise InputError(f"{name}: is not consistent ({fault}); {_REMEDY}")
    return meta, tiles


def _crc(record: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(record).encode())


def _tiles_fault(tiles: Sequence[Tile]) -> str:
    end = 0
    for tile in tiles:
        numbers = tile.bytes, tile.first, tile.triangles
        if not all(type(n) is int and 0 <= n <= _MAX_FACES for n in numbers) or not isinstance(tile.sha256, str):
            return f"tile {quoted(tile.file)} has no proper numbers"
        if not isinstance(tile.file, str) or tile.first < end or not 1 <= tile.triangles <= MAX_TRIANGLES:
            return f"tile {quoted(tile.file)} does not follow the one before it"
        end = tile.first + tile.triangles
    return "" if tiles else "it has no tiles"


# --- The scene of all tiles -------------------------------------------------------------------------------------------


class TiledStore(Store):
    """The stores of a manifest as one store.

    Faces of chunks are numbered within their range; `ranges` has the 64-bit numbers of the ranges.

    Parameters
    ----------
    path : Path
        The manifest.
    file : Bytes
        It, open.
    data : bytes
        Its contents.
    tiles : list of Tile
    stores : list of Store
        Open, one per tile; this store closes them.
    """

    def __init__(self, path: Path, file: Bytes, data: bytes, meta: StoreMeta, tiles: list[Tile], stores: list[Store]):
        chunks = Chunks(*(np.concatenate(columns) for columns in zip(*(store.chunks for store in stores))))
        directory = Directory(meta, chunks, top_tree(chunks.box, 1))
        version = min(store.version for store in stores)
        super().__init__(path, file, directory, hashlib.sha256(data).hexdigest(), version)
        self.size += sum(store.size for store in stores)
        self.tiles, self._stores, self._data = tiles, stores, data
        self._starts = np.cumsum([0, *map(len, stores)])  # first chunk of each tile, and the end
        self.ranges = tuple(_ranges(tiles, self._starts.tolist()))
        first = {range_.chunks.start: range_.first for range_ in self.ranges}
        self._bases, base = list[int](), 0  # of each tile: number of its first face in its range
        for tile, start in zip(tiles, self._starts.tolist()):
            base = first.get(start, base)
            self._bases.append(tile.first - base)
        if self.has_cutouts:
            check_one_range(path.name, self.n_triangles)

    def chunk(self, k: int, memory: np.ndarray | None = None) -> Chunk:
        tile, local = self._place(k)
        chunk = self._stores[tile].chunk(local, memory)
        ids = chunk.tree.prim_ids
        ids += np.int32(self._bases[tile])
        return chunk

    def check(self, k: int, memory: np.ndarray | None = None) -> None:
        tile, local = self._place(k)
        self._stores[tile].check(local, memory)

    @property
    def has_cutouts(self) -> bool:
        return any(store.has_cutouts for store in self._stores)

    def cutouts(self) -> StoredCutouts | None:
        found = [store.cutouts() for store in self._stores]
        parts, arrays = list[tuple[Cutouts | None, int]](), list[StoredCutouts]()
        clear = list[ClearFaces]()
        for each, base in zip(found, self._bases):
            if each is not None:
                faces = each.cutouts.faces + np.int32(base)
                parts.append((each.cutouts._replace(faces=faces), 0))
                arrays.append(each)
                clear.append(each.clear._replace(faces=each.clear.faces + np.int32(base)))
        joined = join_cutouts(parts)
        if joined is None:
            return None
        corners, colours = (np.concatenate(columns) for columns in zip(*((a.corners, a.colours) for a in arrays)))
        return StoredCutouts(joined, corners, colours, ClearFaces(*map(np.concatenate, zip(*clear))))

    def looks(self) -> SceneLooks | None:
        parts = [LooksPart(tile.first, store.own_looks()) for tile, store in zip(self.tiles, self._stores)]
        return SceneLooks(parts) if any(part.looks is not None for part in parts) else None

    def cutout_bytes(self) -> int:
        return sum(store.cutout_bytes() for store in self._stores)

    def content(self) -> Iterator[bytes]:
        """The manifest, which has the digests of the tiles."""
        yield self._data

    def close(self) -> None:
        for store in self._stores:
            store.close()
        super().close()

    def _opener(self) -> Callable[[Path], Store]:
        return open_tiles

    def _place(self, k: int) -> tuple[int, int]:
        """The tile of chunk k, and the number of the chunk there."""
        tile = int(np.searchsorted(self._starts, k, "right")) - 1
        return tile, k - int(self._starts[tile])


def _ranges(tiles: Sequence[Tile], starts: list[int]) -> Iterator[FaceRange]:
    """The longest ranges of consecutive tiles whose faces int32 can number."""
    begin, total = 0, tiles[-1].first + tiles[-1].triangles
    for end in range(1, len(tiles) + 1):
        first = tiles[begin].first
        if end == len(tiles) or tiles[end].first + tiles[end].triangles - first > MAX_TRIANGLES:
            last = tiles[end - 1]
            yield FaceRange(slice(starts[begin], starts[end]), first, last.first + last.triangles - first, total)
            begin = end


def open_tiles(path: str | os.PathLike[str]) -> TiledStore:
    """Open the stores of a manifest: read and check all headers and directories, but no chunk.

    Raises
    ------
    InputError
        If the manifest or a tile is missing or damaged, or if a tile is not the one that the manifest describes.
    """
    path = Path(path)
    name = path.name or str(path)
    with ExitStack() as stack:
        file = open_bytes(path)
        stack.callback(file.close)
        if file.size > _MAX_BYTES:
            raise InputError(f"{name}: is no manifest of tiles, since it has {file.size} bytes")
        buffer = bytearray(file.size)
        data = bytes(buffer[: file.read(memoryview(buffer), 0)])
        meta, tiles = manifest_from_json(data, name)
        stores = [stack.enter_context(_open_tile(path, tile, meta)) for tile in tiles]
        store = TiledStore(path, file, data, meta, tiles, stores)
        stack.pop_all()
    return store


def _open_tile(path: Path, tile: Tile, meta: StoreMeta) -> Store:
    place = path.parent / tile.file
    if url_of(path) is None:
        place = sibling(path.parent, tile.file, f"{path.name}: a tile")
    try:
        store = open_store(place)
    except InputError as error:
        raise InputError(f"{path.name}: tile {error}") from None
    found = store.meta
    if not (np.array_equal(found.origin, meta.origin) and np.array_equal(found.bounds, meta.bounds)):
        fault = "is in another frame"
    elif (store.digest, store.size, store.n_triangles, found.box.tolist()) != (
        tile.sha256, tile.bytes, tile.triangles, tile.box,
    ):  # fmt: skip
        fault = "is not the one of the manifest"
    else:
        return store
    store.close()
    raise InputError(f"{path.name}: tile {tile.file} {fault}; {_REMEDY}")


def load_tiles(path: Path) -> StoreData:
    """Open the scene of a manifest."""
    return StoreData(open_tiles(path))
