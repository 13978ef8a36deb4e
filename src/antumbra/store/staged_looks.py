"""Looks of faces in the files of a build: columns of staged pieces, and the materials and images of a unit."""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..scene.face_looks import LOOK_WIDTHS, FaceLooks, LookFinder, plain_looks
from ..scene.materials import Material
from ..scene.mesh import Piece
from .stored_materials import Images, material_to_json

Record = Mapping[str, np.ndarray]


def write_looks(stream: BinaryIO, looks: FaceLooks) -> list[bool]:
    """Write the looks of a piece. Return which attributes there are."""
    columns = [getattr(looks, name) for name in LOOK_WIDTHS]
    stream.write(np.ascontiguousarray(looks.kind, np.int32).data)
    for column in columns:
        if column is not None:
            stream.write(np.ascontiguousarray(column, np.float32).data)
    return [column is not None for column in columns]


def staged_looks(path: Path, record: Record, first: int, last: int) -> Iterator[FaceLooks]:
    """Yield the looks of the pieces `first` to `last`, exclusive, of a file of `StagedPieces`."""
    with path.open("rb") as stream:
        for row in record["pieces"][first:last]:
            n = int(row["copies"]) * int(row["faces"])
            if not row["looks"]:
                yield plain_looks(n)
                continue
            stream.seek(int(row["looks"]))
            kind = np.fromfile(stream, np.int32, n)
            columns = [
                np.fromfile(stream, np.float32, n * width).reshape(n, width) if has else None
                for has, (width, _) in zip(row["has"].tolist(), LOOK_WIDTHS.values())
            ]
            yield FaceLooks(kind, *columns)


class UnitLooks:
    """Numbers the materials of a unit, and collects their images."""

    def __init__(self) -> None:
        self._numbers, self._images = dict[Material, int](), Images()
        self._texts = list[str]()

    def of(self, finder: LookFinder | None, piece: Piece) -> FaceLooks | None:
        """The looks of a piece, which index the materials of the unit; `finder`: None for plain colours."""
        if finder is None:
            return None
        looks, materials = finder.of(piece)
        return looks.numbered(np.array([self._number(each) for each in materials], np.int32))

    def _number(self, material: Material) -> int:
        if material not in self._numbers:
            self._numbers[material] = len(self._texts)
            self._texts.append(material_to_json(material, self._images))
        return self._numbers[material]

    def write(self, stream: BinaryIO) -> dict[str, np.ndarray]:
        """Write the images. Return what describes them, for the record of the unit."""
        places = dict[str, list[int]]()
        for key, data in self._images.encoded.items():
            places[key] = [stream.tell(), len(data)]
            stream.write(data)
        text = json.dumps({"materials": self._texts, "images": places})
        return {"looks": np.frombuffer(text.encode(), np.uint8)}


class UnitMaterials:
    """The materials of all units, each once.

    files, records : of the units; the files are read only for images
    """

    def __init__(self, files: Callable[[int], Path], records: Callable[[int], Record], count: int):
        self._files, self._images = files, dict[str, tuple[int, int, int]]()
        numbers = dict[str, int]()
        self.numbers = list[np.ndarray]()  # of each unit: number of each of its materials
        for k in range(count):
            about = json.loads(records(k)["looks"].tobytes())
            self.numbers.append(np.array([numbers.setdefault(t, len(numbers)) for t in about["materials"]], np.int32))
            for key, (offset, size) in about["images"].items():
                self._images.setdefault(key, (k, offset, size))
        self.texts = list(numbers)

    def image(self, key: str) -> bytes:
        """An image by its SHA-256."""
        k, offset, size = self._images[key]
        with self._files(k).open("rb") as stream:
            stream.seek(offset)
            return stream.read(size)
