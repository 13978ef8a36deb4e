"""Procedural scenes as scene data, with a camera and a light. The generators are imported on first use."""

from collections.abc import Generator
from contextlib import closing
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from ..scene.camera import Camera
from ..scene.lights import Light, QuadLight
from ..scene.mesh import Mesh, MeshInfo, ObjectInfo, Piece, StaticMeshes, make_mesh
from ..scene.scene_data import MemoryData

if TYPE_CHECKING:
    from .shapes import PaletteMesh


class _ProceduralMeshes(StaticMeshes):
    """Meshes with their own camera and light."""

    def __init__(self, meshes: list[Mesh], file: str, camera: Camera, light: QuadLight) -> None:
        super().__init__(meshes, file)
        self._camera, self._light = camera, light

    def cameras(self, time: float) -> list[Camera]:
        return [self._camera]

    def lights(self, time: float) -> list[Light]:
        return [self._light]


def procedural_data(name: str, triangles: int | None, seed: int) -> MemoryData:
    """Scene data of a procedural scene; `engine.scene.procedural` documents the arguments."""
    from .procedural_scenes import generate

    scene = generate(name, triangles, seed)
    colour = np.asarray(scene.palette, np.float32)[scene.colour]
    mesh = make_mesh(name, scene.vertices, scene.faces, colour, f"procedural {name}")
    camera, light = Camera(**scene.camera), QuadLight(**scene.light)
    return MemoryData(_ProceduralMeshes([mesh], f"procedural {name}", camera, light), name=name)


class StreamedCity:
    """``procedural("city", ...)`` as a stream of pieces that are never in memory all at once.

    Name, up axis, camera, light and pieces equal those of the `Scene`, with faces in the same order. It is its own
    source.

    Parameters
    ----------
    triangles, seed
        As for `procedural`.
    processes : int
        Number of processes that generate the blocks.
    """

    name = "city"
    up = "y"
    file = "procedural city"
    duration = 0.0
    animated = False
    notes, terrain = (), None

    def __init__(self, triangles: int | None = None, seed: int = 0, processes: int = 1) -> None:
        from .palette import check_request
        from .procedural_scenes import PROCEDURAL

        triangles = PROCEDURAL["city"].default_triangles if triangles is None else triangles
        self._arguments, self._processes = check_request("city", triangles, seed), processes
        self._blocks: Generator[PaletteMesh, None, None] | None = None  # of the next spans, made by other processes
        self._next = 0  # the span after the last one that was read
        self.meshes: list[MeshInfo] = []
        self.objects = [ObjectInfo(self.name, -1, 0)]

    def open_faces(self) -> None:
        """None: all faces are solid."""

    def looks(self) -> None:
        """None: all faces have plain colours."""

    @property
    def n_triangles(self) -> int:
        """The requested number of triangles, an upper bound of the actual number."""
        return self._arguments[0]

    @property
    def source(self) -> "StreamedCity":
        return self

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        """The blocks of the city, one at a time."""
        from .city import stream_blocks

        with closing(stream_blocks(*self._arguments, self._processes)) as blocks:
            yield from map(self._piece, blocks)

    @property
    def n_spans(self) -> int:
        from .city import n_groups

        return n_groups(self._arguments[0])

    def span(self, k: int) -> Generator[Piece, None, None]:
        """The blocks of a group. While spans are read in order, other processes generate the next ones."""
        from .city import GROUP, city_groups, stream_blocks

        if k != self._next:
            self.close()
        elif self._blocks is None:
            self._blocks = stream_blocks(*self._arguments, self._processes, k)
        self._next = k + 1
        blocks = islice(self._blocks, GROUP) if self._blocks else next(city_groups(*self._arguments, k))
        yield from map(self._piece, blocks)

    def close(self) -> None:
        """End the processes that generate the next spans."""
        if self._blocks is not None:
            self._blocks.close()
        self._blocks = None

    def _piece(self, block: "PaletteMesh") -> Piece:
        from .procedural_scenes import PALETTE

        return Piece(block.vertices[None], block.faces, np.asarray(PALETTE, np.float32)[block.colour], self.file)

    def cameras(self, time: float) -> list[Camera]:
        from .procedural_scenes import city_view

        return [Camera(**city_view(self._arguments[0])[0])]

    def lights(self, time: float) -> list[Light]:
        from .procedural_scenes import city_view

        return [QuadLight(**city_view(self._arguments[0])[1])]
