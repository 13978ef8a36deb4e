"""Charts of meshes on one square, by xatlas in a process of its own.

xatlas may crash, which must not end the caller's process. Separate processes also let Ctrl-C stop it.
"""

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import temporary_folder

_INPUT, _OUTPUT = "meshes.npz", "charts.npz"
_START = """
import json, sys
sys.path[:] = json.loads(sys.stdin.readline())
from antumbra.baking.chart_process import serve
serve(json.loads(sys.stdin.readline()))
"""
_KILLED = 9  # the signal by which systems end processes when memory runs out
_CURE = "bake into texture coordinates of the file (uv), or at vertices (without texture)"


class ChartMesh(NamedTuple):
    """A mesh divided into charts."""

    uv: NDArray[np.float64]  # (v, 2) float64 in [0, 1], from the top left
    faces: NDArray[np.int64]  # (f, 3) into `uv`, in the order of the mesh's faces
    source: NDArray[np.int64]  # (v,) the mesh's vertex of each row of `uv`


class _Meshes(NamedTuple):
    """Meshes as arrays that a file can hold."""

    counts: NDArray[np.int64]  # (m, 2) int64: number of vertices and faces of each mesh
    vertices: NDArray[np.floating]  # (v, k), of all meshes
    faces: NDArray[np.integer]  # (f, 3), each into the vertices of its mesh

    @classmethod
    def joined(cls, meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> "_Meshes":
        counts = np.array([[len(vertices), len(faces)] for vertices, faces in meshes], np.int64)
        return cls(counts, *(np.concatenate(arrays) for arrays in zip(*meshes)))

    def split(self) -> list[tuple[np.ndarray, np.ndarray]]:
        ends = np.cumsum(self.counts, 0)[:-1].T
        return list(zip(np.split(self.vertices, ends[0]), np.split(self.faces, ends[1])))

    def save(self, path: Path) -> None:
        np.savez(path, **self._asdict())

    @classmethod
    def load(cls, path: Path) -> "_Meshes":
        with np.load(path) as arrays:
            return cls(*(arrays[name] for name in cls._fields))


def charts_of(
    meshes: Sequence[tuple[NDArray[np.float32], NDArray[np.uint32]]], size: int, padding: int
) -> list[ChartMesh]:
    """Divide meshes into charts, and pack these into a square.

    Parameters
    ----------
    meshes : sequence of ((v, 3) float32 positions, (f, 3) uint32 faces)
    size : int
        Approximate number of texels per side.
    padding : int
        Texels between charts.

    Raises
    ------
    InputError
        If xatlas crashes.
    """
    with temporary_folder() as folder:
        _Meshes.joined(meshes).save(folder / _INPUT)
        request = "".join(json.dumps(each) + "\n" for each in (sys.path, [str(folder), size, padding]))
        done = subprocess.run(  # ends the process on Ctrl-C
            [sys.executable, "-c", _START],
            input=request.encode(),
            capture_output=True,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        if done.returncode or not (folder / _OUTPUT).is_file():
            raise InputError(f"xatlas cannot unwrap these surfaces ({_reason(done)}); {_CURE}")
        out = _Meshes.load(folder / _OUTPUT)
    return [ChartMesh(rows[:, :2], faces.astype(np.int64), rows[:, 2].astype(np.int64)) for rows, faces in out.split()]


def _reason(done: "subprocess.CompletedProcess[bytes]") -> str:
    """Why a process failed: memory, its signal, the last line of its traceback, or its exit code."""
    errors = done.stderr.decode(errors="replace")
    if done.returncode == -_KILLED or "bad_alloc" in errors or "MemoryError" in errors:
        return "memory ran out"
    if done.returncode < 0:
        return f"its process ended with {signal.Signals(-done.returncode).name}"
    lines = errors.strip().splitlines()
    return lines[-1][:200] if lines else f"its process ended with exit code {done.returncode}"


def serve(request: tuple[str, int, int]) -> None:
    """Serve `charts_of`, which ends this process on Ctrl-C."""
    import xatlas

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    folder, size, padding = Path(request[0]), *request[1:]
    meshes, atlas = _Meshes.load(folder / _INPUT).split(), xatlas.Atlas()
    for positions, faces in meshes:
        atlas.add_mesh(positions, faces)
    options = xatlas.PackOptions()
    options.resolution, options.padding, options.bilinear, options.create_image = size, padding, True, False
    atlas.generate(pack_options=options)
    scale = np.array([atlas.width, atlas.height], np.float64) / max(atlas.width, atlas.height, 1)
    charts = []
    for k in range(len(meshes)):
        source, faces, uv = atlas[k]
        charts.append((np.column_stack([uv.astype(np.float64) * scale, source]), faces))
    _Meshes.joined(charts).save(folder / _OUTPUT)
