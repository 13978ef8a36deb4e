"""Camera paths: perspective cameras over time, as keys in a JSON file, or as the first camera of an animated glTF file.

A JSON file has the cameras at some times; numbers in between are interpolated linearly::

    {"keys": [{"time": 0, "position": [0, 1.7, 40], "target": [0, 3, 0]},
              {"time": 4, "position": [9, 1.7, 20], "target": [0, 3, 0], "up": [0, 1, 0], "vfov": 45}]}

Before the first and after the last time, the camera stands still.
"""

from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.checks import alternatives
from ..base.errors import InputError
from ..base.files import checked_file
from ..scene.camera import Camera
from .gltf.gltf_source import GltfSource, read_gltf
from .json_fields import Fields, parse

CAMERA_PATH_SUFFIXES = ".json", ".glb", ".gltf"
_FIELDS = "time", "position", "target", "up", "vfov"
_UPS = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class CameraPath(Protocol):
    """A camera over time."""

    @property
    def duration(self) -> float:
        """Seconds until the camera stands still."""
        ...

    def camera(self, time: float, up: str, size: tuple[int, int]) -> Camera:
        """The camera at a time in seconds.

        up : "y" or "z", the up axis of the scene
        size : width and height of the picture
        """
        ...


class KeyedPath(NamedTuple):
    """Cameras at given times."""

    name: str
    times: NDArray[np.float64]  # (k,), ascending
    views: NDArray[np.float64]  # (k, 10): position, target, up (zeros: that of the scene), vfov in degrees

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    def camera(self, time: float, up: str, size: tuple[int, int]) -> Camera:
        views = self.views.copy()
        views[~views[:, 6:9].any(1), 6:9] = _UPS[up]
        at = np.array([np.interp(time, self.times, column) for column in views.T])
        try:
            return Camera(at[:3], at[3:6], at[6:9], at[9], *size)
        except InputError as error:
            raise InputError(f"{self.name}: at {time:g} s, {error}") from None


class GltfPath(NamedTuple):
    """The first camera of a glTF file, which is turned about the x axis for scenes with +Z up."""

    name: str
    source: GltfSource

    @property
    def duration(self) -> float:
        return self.source.duration

    def camera(self, time: float, up: str, size: tuple[int, int]) -> Camera:
        seen = self.source.cameras(min(max(time, 0.0), self.duration))[0]
        vectors = (seen.position, seen.target, seen.up)
        position, target, upwards = ((x, -z, y) if up == "z" else (x, y, z) for x, y, z in vectors)
        return Camera(position, target, upwards, seen.vfov, *size, projection=seen.projection, extent=seen.extent)


def read_camera_path(path: Path) -> CameraPath:
    """The path in a file.

    Raises
    ------
    InputError
        If the file cannot be read, has no keys, or its times do not ascend; or if it has no camera, or does not move.
    """
    checked_file(path, path.name)
    if path.suffix.lower() not in CAMERA_PATH_SUFFIXES:
        raise InputError(f"{path.name}: is no camera path; give a {alternatives(CAMERA_PATH_SUFFIXES)} file")
    if path.suffix.lower() != ".json":
        source, _ = read_gltf(path)
        if not source.cameras(0.0) or source.duration == 0.0:
            raise InputError(f"{path.name}: has no camera that moves; animate one, or use --camera")
        return GltfPath(path.name, source)
    keys = parse(path.read_bytes(), path.name).objects("keys")
    if not keys:
        raise InputError(f"{path.name}: has no keys; give at least one with a time, a position and a target")
    times, views = np.array([key.number("time") for key in keys]), np.array([_view(key) for key in keys])
    if (np.diff(times) <= 0.0).any():
        late = keys[int(np.argmax(np.diff(times) <= 0.0)) + 1]
        raise late.bad("time", "later than the time of the key before")
    return KeyedPath(path.name, times, views)


def _view(key: Fields) -> NDArray[np.float64]:
    """The row of a key in `KeyedPath.views`."""
    for name in key.data:
        if name not in _FIELDS:
            raise InputError(f"{key.place(name)} is unknown; a key has {alternatives(_FIELDS)}")
    position, target = key.numbers("position", 3), key.numbers("target", 3)
    up = key.numbers("up", 3, np.zeros(3))
    return np.array([*position, *target, *up, key.number("vfov", 60.0)])
