"""A folder of arrays: the vertices of one mesh at several moments."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from .arrayfile import mapped_array
from .files import checked_file
from .mesh import MeshInfo, ObjectInfo, check_finite, face_colours, used_faces
from .source import Piece

FILES = ("frames.npy", "faces.npy", "face_rgba.npy", "info.json")
"""The files that are read from a folder. Only the first two are required."""

FRAMES_PER_SECOND = 24.0  # if info.json has no times
_SPAN = re.compile(r"\bt\s*=\s*(-?[0-9.]{1,20})\s*\.\.\s*(-?[0-9.]{1,20})")


class VertexFrames:
    """Vertices at several times, interpolated linearly in between (see `antumbra.scene.source.Source`).

    The frames stay on disk, memory-mapped. A frame is read and checked when a time needs it.
    """

    def __init__(self, file: str, frames, faces, colour, times: np.ndarray):
        self.file = file
        self.duration = float(times[-1] - times[0])
        self._frames, self._times, self._colour = frames, times - times[0], colour
        self._faces, self._used = used_faces(faces, frames.shape[1], f"{file}/faces.npy")
        self.meshes, self.objects = [MeshInfo(file, len(self._faces), 1)], [ObjectInfo(file, 0, 0)]

    def pieces(self, time: float) -> Iterator[Piece]:
        k = int(np.searchsorted(self._times, time, side="right")) - 1
        vertices, towards, share = self._frame(k), None, 0.0
        if self._times[k] < time and k + 1 < len(self._times):
            share = float((time - self._times[k]) / (self._times[k + 1] - self._times[k]))
            towards = self._frame(k + 1)
        yield Piece(vertices, self._faces, self._colour, f"{self.file}/frames.npy", towards, share)

    def cameras(self, time: float) -> list:
        return []

    def lights(self, time: float) -> list:
        return []

    def _frame(self, k: int) -> np.ndarray:
        """Frame k, (1, v, 3): float32 if the file holds float32, else float64."""
        frame = self._frames[k]
        dtype = np.float32 if frame.dtype == np.float32 else np.float64
        vertices = np.ascontiguousarray(frame if self._used is None else frame[self._used], dtype)
        check_finite(vertices, f"{self.file}/frames.npy frame {k}")
        return vertices[None]


def read_frames(folder: Path) -> tuple[VertexFrames, list[str]]:
    """(source, notes) of a folder with frames.npy and faces.npy."""
    name = folder.resolve().name
    missing = [f for f in FILES[:2] if not (folder / f).exists()]
    if missing:
        raise InputError(f"{name}: a folder without {' and '.join(missing)}; name a scene file in it instead")
    frames = mapped_array(folder / "frames.npy", f"{name}/frames.npy")
    if frames.ndim != 3 or frames.shape[2] != 3 or frames.dtype.kind != "f" or frames.size == 0:
        raise InputError(f"{name}/frames.npy is {frames.dtype} {frames.shape}; it must be float, (frames, vertices, 3)")
    faces = mapped_array(folder / "faces.npy", f"{name}/faces.npy")
    colour, path = None, folder / "face_rgba.npy"
    if path.exists():
        colour = _linear(mapped_array(path, f"{name}/face_rgba.npy"), f"{name}/face_rgba.npy")
    colour = face_colours(colour, len(faces) if faces.ndim else 0, f"{name}/face_rgba.npy")
    times = _times(folder / "info.json", len(frames), f"{name}/info.json")
    return VertexFrames(name, frames, faces, colour, times), []


def _linear(rgba: np.ndarray, where: str) -> np.ndarray:
    if rgba.ndim != 2 or rgba.shape[1] not in (3, 4) or (rgba.dtype != np.uint8 and rgba.dtype.kind != "f"):
        raise InputError(f"{where} is {rgba.dtype} {rgba.shape}; it must be uint8 or float, (faces, 4)")
    return rgba[:, :3] / np.float32(255.0) if rgba.dtype == np.uint8 else np.asarray(rgba[:, :3])


def _times(path: Path, count: int, where: str) -> np.ndarray:
    """The frames' times in seconds: "times" of info.json, or evenly spread over its span ("t=0.0..2.5")."""
    info = {}
    if path.exists():
        checked_file(path, where)
        try:
            info = json.loads(path.read_bytes())
        except (ValueError, RecursionError):
            raise InputError(f"{where}: not JSON; mend or remove it") from None
    if not isinstance(info, dict):
        raise InputError(f"{where}: must be a JSON object; mend or remove it")
    span = _SPAN.search(info["frames"]) if isinstance(info.get("frames"), str) else None
    if info.get("times") is not None:
        times = _as_times(info["times"], count, where)
    elif span and count > 1:
        times = np.linspace(_number(span[1]), _number(span[2]), count)
    else:
        times = np.arange(count) / FRAMES_PER_SECOND
    if not (np.isfinite(times).all() and (np.diff(times) > 0.0).all()):
        raise InputError(f"{where}: the times of the frames must be finite and increase")
    return times


def _as_times(value, count: int, where: str) -> np.ndarray:
    numbers = isinstance(value, list) and all(type(v) in (int, float) and abs(v) < 1e300 for v in value)
    if not numbers or len(value) != count:
        raise InputError(f'{where}: "times" must be a list of {count} numbers, one for each frame')
    return np.array(value, np.float64)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
