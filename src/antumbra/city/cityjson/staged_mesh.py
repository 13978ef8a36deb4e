"""A mesh in a scratch file, which is written and read piece by piece."""

import weakref
from collections.abc import Generator
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.files import temporary_folder
from ...scene.mesh import Mesh, MeshInfo, ObjectInfo, Piece
from ...scene.scene_bounds import faces_of
from ...store.staging_files import Record, StagedPieces, staged_pieces


class StagedMesh:
    """The source of one mesh. Its scratch file is removed with it. It never moves.

    folder : for scratch files
    """

    duration = 0.0
    in_memory = False

    def __init__(self, file: str):
        with ExitStack() as stack:
            self.file, self.folder = file, stack.enter_context(temporary_folder())
            self._stream = stack.enter_context((self.folder / "pieces").open("wb"))
            weakref.finalize(self, stack.pop_all().close)
        self._staged, self._record = StagedPieces(self._stream, file, has_all_runs=True), Record()
        self.meshes, self.objects = list[MeshInfo](), list[ObjectInfo]()

    def add(self, part: Mesh, owners: NDArray[np.int32], objects: list[ObjectInfo]) -> None:
        """Write a part of the mesh.

        owners : (f,) of its faces, indices of objects
        objects : of the part
        """
        where = f'{self.file}: mesh "{self.file}"'
        all_owners = (owners + len(self.objects)).astype(np.int32)
        self._staged.add(Piece(part.positions[None], part.faces, part.colour, where, owners=all_owners))
        self.objects += objects

    def end(self) -> None:
        """End writing; the parts can be read from now on."""
        self._stream.close()
        self._record = self._staged.record()
        self.meshes = [MeshInfo(self.file, self._staged.survey.n_triangles, 1)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        runs = self._record["runs"]
        ends, begin = np.cumsum(runs[:, 0]), 0
        for piece, _ in staged_pieces(self.folder / "pieces", self._record, 0, len(self._record["pieces"])):
            faces = np.arange(begin, begin := begin + faces_of(piece))
            yield piece._replace(owners=runs[np.searchsorted(ends, faces, "right"), 1].astype(np.int32))

    def cameras(self, time: float) -> list[Any]:
        return []

    def lights(self, time: float) -> list[Any]:
        return []
