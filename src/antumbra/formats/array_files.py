"""NumPy arrays in .npy and .npz files, checked before they are read, and folders of vertex frames.

Files may come from any source: headers and sizes are checked first, and nothing is unpickled. A folder with frames.npy
and faces.npy is one mesh at several times.
"""

import json
import math
import re
import zipfile
from collections.abc import Generator, Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import checked_file
from ..base.memory import check_reading
from ..base.wording import counted
from ..scene.camera import Camera
from ..scene.lights import Light
from ..scene.mesh import MeshInfo, ObjectInfo, Piece, check_finite, face_colours, used_faces

# --- .npy and .npz files ----------------------------------------------------------------------------------------------


_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_METHODS = zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED
_COPIES = 3  # of an array while it is read: compressed, expanded, and as float64
_ENCRYPTED = 1  # flag bit of a zip entry


def mapped_array(path: Path, where: str) -> np.ndarray:
    """A .npy file, memory-mapped after its header has been checked against the file size. Nothing is unpickled."""
    checked_file(path, where)
    with path.open("rb") as stream:
        shape, fortran, dtype = _header(stream, where)
        offset = stream.tell()
    needed = _checked_size(shape, dtype, path.stat().st_size - offset, where)
    if needed == 0:
        return np.empty(shape, dtype)
    return np.memmap(path, dtype, "r", offset, shape, "F" if fortran else "C")


def npz_arrays(path: Path, names: Iterable[str]) -> dict[str, np.ndarray]:
    """The arrays of a .npz file with the given lower-case names, as far as it has them. Nothing is unpickled.

    Raises
    ------
    InputError
        If an entry is not an array of numbers, or the arrays expand to far more than the file size.
    Exception
        Of various types from zipfile, zlib and others, if the archive is damaged.
    """
    requested, arrays = set(names), {}
    with zipfile.ZipFile(path) as archive:
        entries = {entry.filename.removesuffix(".npy").lower(): entry for entry in archive.infolist()}
        entries = {name: entry for name, entry in entries.items() if name in requested}
        expanded = sum(entry.file_size for entry in entries.values())
        check_reading(_COPIES * expanded, path.name, path.stat().st_size)
        for name, entry in entries.items():
            arrays[name] = _array_of(archive, entry, f"{path.name}, array {name!r}")
    return arrays


def _array_of(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, where: str) -> np.ndarray:
    if entry.compress_type not in _METHODS or entry.flag_bits & _ENCRYPTED:
        raise InputError(f"{where} is encrypted or compressed by an unsupported method; write it with numpy.savez")
    with archive.open(entry) as stream:
        shape, fortran, dtype = _header(stream, where)
        needed = _checked_size(shape, dtype, entry.file_size - stream.tell(), where)
        data = stream.read(needed)
        if len(data) < needed or stream.read(1):  # reading to the end verifies the checksum
            raise InputError(f"{where} does not have its declared size; copy it again")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _header(stream: IO[bytes], where: str) -> tuple[tuple[int, ...], bool, np.dtype]:
    try:
        shape, fortran, dtype = _HEADERS[npy.read_magic(stream)](stream)
    except Exception as error:  # the header is Python source, whose parser raises many error types
        raise InputError(f"{where}: not a numpy array file; write it with numpy.save") from error
    if dtype.hasobject or dtype.kind not in "fiu":
        raise InputError(f"{where} holds {dtype}; only plain numbers are read")
    if any(n < 0 for n in shape):
        raise InputError(f"{where} has shape {shape}; write it again with numpy.save")
    return shape, fortran, dtype


def _checked_size(shape: tuple[int, ...], dtype: np.dtype, available: int, where: str) -> int:
    """The size of an array in bytes; InputError if the file has fewer."""
    needed = math.prod(shape) * dtype.itemsize
    if needed > available:
        raise InputError(f"{where} says {needed} bytes of data, but has {available}; it is cut short, copy it again")
    return needed


# --- Folders of vertex frames -----------------------------------------------------------------------------------------


FILES = ("frames.npy", "faces.npy", "face_rgba.npy", "info.json")
"""The files that are read from a folder. Only the first two are required."""

FRAMES_PER_SECOND = 24.0  # if info.json gives no times
_SPAN = re.compile(r"\bt\s*=\s*(-?[0-9.]{1,20})\s*\.\.\s*(-?[0-9.]{1,20})")


class VertexFrames:
    """A mesh at several times, linearly interpolated in between (see `antumbra.scene.mesh.Source`).

    The frames are memory-mapped. Each is read and checked when it is needed.
    """

    def __init__(
        self, file: str, frames: np.ndarray, faces: np.ndarray, colour: NDArray[np.float32], times: np.ndarray
    ) -> None:
        self.file = file
        self.duration = float(times[-1] - times[0])
        self._frames, self._times, self._colour = frames, times - times[0], colour
        self._faces, self._used = used_faces(faces, frames.shape[1], f"{file}/faces.npy")
        self.meshes, self.objects = [MeshInfo(file, len(self._faces), 1)], [ObjectInfo(file, 0, 0)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        k = int(np.searchsorted(self._times, time, side="right")) - 1
        vertices, towards, share = self._frame(k), None, 0.0
        if self._times[k] < time and k + 1 < len(self._times):
            share = float((time - self._times[k]) / (self._times[k + 1] - self._times[k]))
            towards = self._frame(k + 1)
        yield Piece(vertices, self._faces, self._colour, f"{self.file}/frames.npy", towards, share)

    def cameras(self, time: float) -> list[Camera]:
        return []

    def lights(self, time: float) -> list[Light]:
        return []

    def _frame(self, k: int) -> np.ndarray:
        """Frame k, (1, v, 3): float32 if the file stores float32, else float64."""
        frame = self._frames[k]
        dtype = np.float32 if frame.dtype == np.float32 else np.float64
        vertices = np.ascontiguousarray(frame if self._used is None else frame[self._used], dtype)
        check_finite(vertices, f"{self.file}/frames.npy frame {k}")
        return vertices[None]


def read_frames(folder: Path) -> tuple[VertexFrames, list[str]]:
    """(source, notes) for a folder with frames.npy and faces.npy."""
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
    """The frame times in seconds: "times" in info.json, or evenly spaced over its span ("t=0.0..2.5")."""
    info = {}
    if path.exists():
        checked_file(path, where)
        try:
            info = json.loads(path.read_bytes())
        except (ValueError, RecursionError):
            raise InputError(f"{where}: not JSON; fix or remove it") from None
    if not isinstance(info, dict):
        raise InputError(f"{where}: must be a JSON object; fix or remove it")
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


def _as_times(value: Any, count: int, where: str) -> np.ndarray:
    numbers = isinstance(value, list) and all(type(v) in (int, float) and abs(v) < 1e300 for v in value)
    if not numbers or len(value) != count:
        raise InputError(f'{where}: "times" must be a list of {counted(count, "number")}, one for each frame')
    return np.array(value, np.float64)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
