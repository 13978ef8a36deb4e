"""Procedural scenes as scene data, with a camera and a light. The generators are imported when they are first used."""

from collections.abc import Iterator

import numpy as np

from ..scene.camera import Camera
from ..scene.lights import QuadLight
from ..scene.mesh import MeshInfo, ObjectInfo, Piece, StaticMeshes, make_mesh
from ..scene.scene_data import MemoryData


class _ProceduralMeshes(StaticMeshes):
    """Meshes with their own camera and light."""

    def __init__(self, meshes, file, camera, light):
        super().__init__(meshes, file)
        self._camera, self._light = camera, light

    def cameras(self, time: float) -> list:
        return [self._camera]

    def lights(self, time: float) -> list:
        return [self._light]


def procedural_data(name: str, triangles: int | None, seed: int) -> MemoryData:
    """What the procedural scene of this name holds; `engine.scene.procedural` documents the arguments."""
    from .procedural_scenes import generate

    made = generate(name, triangles, seed)
    colour = np.asarray(made.palette, np.float32)[made.colour]
    mesh = make_mesh(name, made.vertices, made.faces, colour, f"procedural {name}")
    camera, light = Camera(**made.camera), QuadLight(**made.light)
    return MemoryData(_ProceduralMeshes([mesh], f"procedural {name}", camera, light), name=name)


class StreamedCity:
    """``procedural("city", ...)`` as a stream of pieces, which are never all in memory.

    Name, up axis, camera, light and pieces are as in the `Scene`, with faces in the same order. It is its own source.

    Parameters
    ----------
    triangles, seed
        As for `procedural`.
    processes : int
        Number of processes that make its blocks.
    """

    name = "city"
    up = "y"
    file = "procedural city"
    duration = 0.0
    animated = False
    appearance = None
    notes = ()

    def __init__(self, triangles: int | None = None, seed: int = 0, processes: int = 1):
        from .palette import check_request
        from .procedural_scenes import PROCEDURAL

        triangles = PROCEDURAL["city"].default_triangles if triangles is None else triangles
        self._arguments, self._processes = check_request("city", triangles, seed), processes
        self.meshes: list[MeshInfo] = []
        self.objects = [ObjectInfo(self.name, -1, 0)]

    @property
    def n_triangles(self) -> int:
        """The number of triangles that was asked for; there are up to as many."""
        return self._arguments[0]

    @property
    def source(self) -> "StreamedCity":
        return self

    def pieces(self, time: float) -> Iterator[Piece]:
        """The blocks of the city, one at a time."""
        from .city import stream_blocks
        from .procedural_scenes import PALETTE

        palette = np.asarray(PALETTE, np.float32)
        for vertices, faces, colour in stream_blocks(*self._arguments, self._processes):
            yield Piece(vertices[None], faces, palette[colour], self.file)

    def cameras(self, time: float) -> list:
        from .procedural_scenes import city_view

        return [Camera(**city_view(self._arguments[0])[0])]

    def lights(self, time: float) -> list:
        from .procedural_scenes import city_view

        return [QuadLight(**city_view(self._arguments[0])[1])]
