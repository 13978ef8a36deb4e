"""The looks of a store: materials, texture coordinates and normals of faces, after its cut-outs, and images.

::

    blocks      the looks of `BLOCK` consecutive faces each, without those that have plain colours only
    images      encoded as the source had them, each once
    table       a `ROW` for each block, zeros up to the next page

Blocks are in the order of faces, not of chunks: chunks stay as they are, cut-outs and faces that no ray hits need no
place of their own, and the faces of an object, which are seen together, are near each other. A block has an attribute
only if one of its faces has it, and equal corners once: neighbours share texture coordinates. Materials are numbered in
the order of the first faces that have them, so the bytes do not depend on the pieces in which a scene was read.
"""

import json
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from hashlib import sha256
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..scene.appearance import Appearance, textured_faces
from ..scene.face_looks import LOOK_WIDTHS, FaceLooks
from ..scene.materials import Material, Texture, pbr_of
from .staging_files import Record
from .store_format import LookSection, StoredArray, index_dtype, pages
from .stored_materials import StoredTextures, decoding_cost, images_of, material_of

BLOCK = 4096
ROW = np.dtype(
    [
        ("offset", "<i8"),  # from the begin of the section
        ("bytes", "<i4"),
        ("crc", "<u4"),
        ("kinds", "<u2"),  # distinct `FaceLooks.kind`; 0: the faces have plain colours
        ("uv", "<u2"),  # distinct corners
        ("colours", "<u2"),
        ("normals", "<u2"),  # 1 or 0
        ("tangents", "<u2"),
        ("second_uv", "<u2"),  # distinct corners
    ]
)
"""A block in the table."""


_ROWS = {"uv": "uv_rows", "colours": "colour_rows", "second_uv": "second_rows"}
"""Attributes of which equal corners are stored once, and the arrays that index them."""


def _columns(row: np.ndarray, n: int) -> dict[str, StoredArray]:
    """The arrays of a block of n faces, in order."""
    kinds, uv, colours, normals, tangents, second = (int(row[name]) for name in ("kinds", *LOOK_WIDTHS))
    columns = {
        "kinds": StoredArray("<i4", (kinds,)), "uv": StoredArray("<f4", (uv, 2)),
        "colours": StoredArray("<f4", (colours, 4)), "second_uv": StoredArray("<f4", (second, 2)),
        "normals": StoredArray("<f4", (normals * n, 12)), "tangents": StoredArray("<f4", (tangents * n, 10)),
        "uv_rows": StoredArray("<u2", (n * (uv > 0), 3)), "colour_rows": StoredArray("<u2", (n * (colours > 0), 3)),
        "second_rows": StoredArray("<u2", (n * (second > 0), 3)),
        "kind_rows": StoredArray(index_dtype(kinds), (n * (kinds > 1),)),
    }  # fmt: skip
    return columns


# --- Writing ----------------------------------------------------------------------------------------------------------


class LookWriter:
    """Writes blocks, then images and the table, to a file.

    materials : of all faces, as from `material_to_json`
    """

    def __init__(self, stream: BinaryIO, materials: Sequence[str]):
        self._stream, self._materials = stream, materials
        self._has_texture = np.array([*("texture" in json.loads(each) for each in materials), False])
        self._attributes, self._is_textured = set[str](), False
        self._numbers, self._used = np.full(len(materials), -1, np.int32), list[int]()
        self._rows, self._waiting, self._n = list[np.ndarray](), list[FaceLooks](), 0

    def add(self, looks: FaceLooks) -> None:
        """Write the looks of the next faces."""
        self._attributes |= {name for name in LOOK_WIDTHS if getattr(looks, name) is not None}
        self._is_textured |= bool(
            (self._has_texture[looks.kind >> 1] & (looks.kind >= 0) & (looks.kind & 1 == 1)).any()
        )
        self._waiting.append(looks.numbered(self._new_numbers(looks.kind)))
        self._n += len(looks.kind)
        if self._n >= BLOCK:
            self._write(self._n // BLOCK * BLOCK)

    def finish(self, images: Callable[[str], bytes]) -> Record:
        """Write what is left, and return the fields of `LookSection` but its offset; `images`: by their SHA-256."""
        self._write(self._n)
        materials = [self._materials[k] for k in self._used]
        places = dict[str, list[int]]()
        for key in dict.fromkeys(key for each in materials for key in images_of(each)):
            data = images(key)
            places[key] = [self._stream.tell(), len(data)]
            self._stream.write(data)
        begin, table = self._stream.tell(), np.array(self._rows, ROW).tobytes()
        end = pages(begin + len(table))
        table = table.ljust(end - begin, b"\0")
        self._stream.write(table)
        fields = {
            "bytes": end, "table": begin, "crc": zlib.crc32(table), "attributes": sorted(self._attributes),
            "is_textured": self._is_textured, "images": places, "materials": materials,
        }  # fmt: skip
        return {"looks": np.frombuffer(json.dumps(fields).encode(), np.uint8)}

    def _new_numbers(self, kind: NDArray[np.int32]) -> NDArray[np.int32]:
        found, first = np.unique(kind[kind >= 0] >> 1, return_index=True)
        for material in found[np.argsort(first)].tolist():
            if self._numbers[material] < 0:
                self._numbers[material] = len(self._used)
                self._used.append(material)
        return self._numbers

    def _write(self, n: int) -> None:
        """Write blocks of the next n faces."""
        if not n:
            return
        looks = _joined(self._waiting)
        for first in range(0, n, BLOCK):
            data, row = _encoded(looks.part(first, min(first + BLOCK, n)))
            row["offset"] = self._stream.tell()
            self._stream.write(data)
            self._rows.append(row)
        self._n -= n
        self._waiting = [looks.part(n, n + self._n)] if self._n else []


def _joined(parts: Sequence[FaceLooks]) -> FaceLooks:
    """The looks of consecutive faces."""
    columns = list[NDArray[np.float32] | None]()
    for name, (width, default) in LOOK_WIDTHS.items():
        found = [getattr(part, name) for part in parts]
        missing = [np.full((len(part.kind), width), default, np.float32) for part in parts]
        is_there = any(each is not None for each in found)
        columns.append(np.concatenate([a if b is None else b for a, b in zip(missing, found)]) if is_there else None)
    return FaceLooks(np.concatenate([part.kind for part in parts]), *columns)


def _encoded(looks: FaceLooks) -> tuple[bytes, np.ndarray]:
    """The bytes of a block, and its row without the offset."""
    row = np.zeros((), ROW)
    kinds, kind_rows = np.unique(looks.kind, return_inverse=True)
    arrays: dict[str, np.ndarray] = {"kinds": kinds, "kind_rows": kind_rows}
    for name, (_, default) in LOOK_WIDTHS.items():
        column: NDArray[np.float32] | None = getattr(looks, name)
        if column is None or (column == default).all():
            continue
        if name in _ROWS:
            arrays[name], arrays[_ROWS[name]] = _distinct(column.reshape(3 * len(column), -1))
            row[name] = len(arrays[name])
        else:
            arrays[name], row[name] = column, 1
    if len(kinds) == 1 and kinds[0] < 0 and len(arrays) == 2:
        return b"", row
    row["kinds"] = len(kinds)
    data = b"".join(
        np.ascontiguousarray(arrays[name], column.dtype).tobytes()
        for name, column in _columns(row, len(looks.kind)).items()
        if np.prod(column.shape)
    )
    row["bytes"], row["crc"] = len(data), zlib.crc32(data)
    return data, row


def _distinct(rows: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """(distinct rows, the number of each row among them) of rows with an even number of columns, bit by bit."""
    number = np.zeros(len(rows), np.int64)
    for column in np.ascontiguousarray(rows).view(np.int64).T:
        number = number * len(rows) + np.unique(column, return_inverse=True)[1]
    _, first, index = np.unique(number, return_index=True, return_inverse=True)
    return rows[first], index


# --- Reading ----------------------------------------------------------------------------------------------------------


def section_fault(section: LookSection, n_triangles: int) -> str:
    """The first fault of a section, whose fields may be anything, in words; "" if there is none."""
    n_blocks = -(-n_triangles // BLOCK)
    numbers = section.offset, section.bytes, section.table, section.crc
    if not all(type(each) is int and 0 <= each < 1 << 62 for each in numbers):
        return "its looks have no place"
    if section.bytes != pages(section.table + n_blocks * ROW.itemsize):
        return f"its looks have {section.bytes} bytes, which do not fit {n_blocks} blocks"
    if not set(section.attributes) <= set(LOOK_WIDTHS) or not isinstance(section.is_textured, bool):
        return "its looks have other attributes"
    for key, (offset, size) in section.images.items():
        if not all(type(each) is int and each >= 0 for each in (offset, size)) or offset + size > section.table:
            return "an image has no place"
        if len(key) != 64:
            return "an image has no digest"
    for text in section.materials:
        material_of(json.loads(text), StoredTextures(lambda key: b""))
        if not set(images_of(text)) <= set(section.images):
            return "an image of a material is missing"
    return ""


class StoredLooks:
    """The looks of the faces of one file.

    section : their place
    n : number of faces
    read : fills a view with the bytes of the file from an offset on, and returns their number
    damaged : makes the error about looks that are damaged, from words
    """

    def __init__(
        self,
        section: LookSection,
        n: int,
        read: Callable[[memoryview, int], int],
        damaged: Callable[[str], InputError],
    ):
        self.section, self._n, self._read, self._damaged = section, n, read, damaged

    @cached_property
    def _table(self) -> np.ndarray:
        """(b,) ROW. InputError if it is damaged."""
        section, n_blocks = self.section, -(-self._n // BLOCK)
        data = self._bytes(section.table, section.bytes - section.table)
        if zlib.crc32(data) != section.crc:
            raise self._damaged("are damaged")
        table = np.frombuffer(data, ROW, n_blocks)
        ends = table["offset"] + table["bytes"]
        good = (table["offset"] >= 0) & (table["bytes"] >= 0) & (ends <= section.table)
        good &= (table["kinds"] <= BLOCK) & (table["normals"] <= 1) & (table["tangents"] <= 1)
        if not good.all():
            raise self._damaged(f"are not consistent (block {int(np.argmin(good))} has no place)")
        return table

    def image(self, key: str) -> bytes:
        """An image by its SHA-256. InputError if it is damaged."""
        data = self._bytes(*self.section.images[key])
        if sha256(data).hexdigest() != key:
            raise self._damaged("are damaged")
        return bytes(data)

    def check(self) -> None:
        """Read all blocks and images. Raises the InputError of the first one that is damaged."""
        for block in range(len(self._table)):
            self._block(block)
        for key in self.section.images:
            self.image(key)

    def blocks_of(self, faces: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], FaceLooks]]:
        """Yield the places of some of the faces, (m,), and the looks of these, until all that have looks are there."""
        numbers = faces // BLOCK
        order = np.argsort(numbers, kind="stable")
        blocks, first = np.unique(numbers[order], return_index=True)
        for block, places in zip(blocks.tolist(), np.split(order, first[1:])):
            if (arrays := self._block(block)) is not None:
                yield places, _rows(arrays, faces[places] - block * BLOCK)

    def _block(self, k: int) -> dict[str, np.ndarray] | None:
        """The arrays of a block; None if its faces have plain colours. InputError if it is damaged."""
        row, n = self._table[k], min(BLOCK, self._n - k * BLOCK)
        if not row["kinds"]:
            return None
        data = self._bytes(int(row["offset"]), int(row["bytes"]))
        if zlib.crc32(data) != row["crc"]:
            raise self._damaged("are damaged")
        arrays, at = dict[str, np.ndarray](), 0
        columns = _columns(row, n)
        if sum(column.bytes for column in columns.values()) != len(data):
            raise self._damaged(f"are not consistent (block {k} has {len(data)} bytes)")
        for name, column in columns.items():
            count = int(np.prod(column.shape))
            arrays[name] = np.frombuffer(data, column.dtype, count, at).reshape(column.shape)
            at += column.bytes
        kinds, most = arrays["kinds"], 2 * len(self.section.materials)
        good = (kinds >= -1).all() and (kinds < most).all()
        for name, rows in {"kinds": "kind_rows", **_ROWS}.items():
            good &= int(arrays[rows].max(initial=0)) < max(len(arrays[name]), 1)
        if not good:
            raise self._damaged(f"are not consistent (block {k} has numbers without rows)")
        return arrays

    def _bytes(self, offset: int, size: int) -> bytearray:
        """Some bytes of the section. InputError if they cannot be read."""
        data = bytearray(size)
        try:
            n_read = self._read(memoryview(data), self.section.offset + offset)
        except OSError as error:
            raise self._damaged(f"cannot be read ({error.strerror or error})") from None
        if n_read < size:
            raise self._damaged("are damaged")
        return data


def _rows(arrays: dict[str, np.ndarray], rows: NDArray[np.int64]) -> FaceLooks:
    """The looks of some faces of a block."""
    kind = arrays["kinds"][arrays["kind_rows"][rows]] if len(arrays["kind_rows"]) else arrays["kinds"].repeat(len(rows))
    corners = {
        name: arrays[name][arrays[index][rows]].reshape(len(rows), -1) if len(arrays[name]) else None
        for name, index in _ROWS.items()
    }
    of_faces = {name: arrays[name][rows] if len(arrays[name]) else None for name in ("normals", "tangents")}
    return FaceLooks(kind, **corners, **of_faces)


_SPLIT = "normals", "tangents"  # are copied to arrays of their own
_ROW_BYTES = 48  # the kind of a face, its block and its place there


class LooksPart(NamedTuple):
    """The looks of consecutive faces of a scene: those of a store, or of a tile."""

    first: int  # number of the first face in the scene
    looks: StoredLooks | None  # None: all faces have plain colours


class SceneLooks:
    """The looks of all faces of a scene: `scene.scene_data.LookReader`.

    parts : in the order of faces
    """

    def __init__(self, parts: Sequence[LooksPart]):
        self._parts, self._firsts = parts, [part.first for part in parts]
        there = [part.looks for part in parts if part.looks is not None]
        self._attributes = {name for looks in there for name in looks.section.attributes}
        texts = dict.fromkeys(text for looks in there for text in looks.section.materials)
        self._records, number = [json.loads(text) for text in texts], {text: k for k, text in enumerate(texts)}
        self._numbers = [
            np.array([] if part.looks is None else [number[text] for text in part.looks.section.materials], np.int32)
            for part in parts
        ]
        owners = {key: looks for looks in there for key in looks.section.images}
        self._textures = StoredTextures(lambda key: owners[key].image(key))
        self._is_textured = any(looks.section.is_textured for looks in there)

    def with_part(self, part: LooksPart) -> "SceneLooks":
        """These looks, and those of the faces that follow."""
        return SceneLooks([*self._parts, part])

    @property
    def materials(self) -> list[Material]:
        """The materials of all faces."""
        return [material_of(record, self._textures) for record in self._records]

    @property
    def is_varied(self) -> bool:
        return self._is_textured or "colours" in self._attributes

    @property
    def has_pbr(self) -> bool:
        return not all(pbr_of(material).is_plain for material in self.materials)

    def of(self, faces: NDArray[np.integer]) -> Appearance:
        n = len(faces)
        kind, found = np.full(n, -1, np.int32), dict[str, NDArray[np.float32]]()
        for name in self._attributes:
            width, default = LOOK_WIDTHS[name]
            found[name] = np.full((n, width), default, np.float32)
        part_of = np.searchsorted(self._firsts, faces, "right") - 1
        for k in np.unique(part_of).tolist():
            part, places = self._parts[k], np.flatnonzero(part_of == k)
            if part.looks is None:
                continue
            for at, looks in part.looks.blocks_of(faces[places].astype(np.int64) - part.first):
                looks, rows = looks.numbered(self._numbers[k]), places[at]
                kind[rows] = looks.kind
                for name, column in found.items():
                    if (values := getattr(looks, name)) is not None:
                        column[rows] = values
        return _appearance(self.materials, kind, found)

    def row_bytes(self) -> int:
        copied = {name: 2 if name in _SPLIT else 1 for name in self._attributes}
        return _ROW_BYTES + sum(4 * LOOK_WIDTHS[name].n * n for name, n in copied.items())

    def decoding_bytes(self, textures: Iterable[Texture], threads: int) -> int:
        return decoding_cost(textures, threads).total

    def forget(self, textures: Iterable[Texture] = ()) -> int:
        return self._textures.forget(textures)

    def check(self) -> None:
        """Read all of them. Raises the InputError of the first one that is damaged."""
        for part in self._parts:
            if part.looks is not None:
                part.looks.check()


def _appearance(
    materials: list[Material], kind: NDArray[np.int32], found: dict[str, NDArray[np.float32]]
) -> Appearance:
    """The appearance of faces from their looks."""
    n, material_of_face, mapped = len(kind), kind >> 1, (kind >= 0) & (kind & 1 == 1)
    normals, tangents = found.get("normals"), found.get("tangents")

    def part(of: np.ndarray | None, columns: slice, *shape: int) -> Any:
        return None if of is None else np.ascontiguousarray(of[:, columns]).reshape(n, *shape)

    uv = part(found.get("uv"), slice(None), 3, 2)
    return Appearance(
        materials,
        material_of_face,
        np.zeros((n, 3, 2), np.float32) if uv is None and mapped.any() else uv,
        part(found.get("colours"), slice(None), 3, 4),
        part(normals, slice(9), 3, 3),
        part(normals, slice(9, None), 3),
        textured_faces(materials, material_of_face, mapped),
        mapped,
        part(tangents, slice(9), 3, 3),
        part(tangents, slice(9, None)),
        second_uv=part(found.get("second_uv"), slice(None), 3, 2),
    )
