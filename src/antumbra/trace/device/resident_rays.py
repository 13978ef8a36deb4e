"""Rays in arrays on the device that traces them, such as tensors of PyTorch: they are read there, by address."""

from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import InputError
from ...devices.arrays import BorrowedArray, DeviceArray, borrow, place_of
from ...devices.device import Device
from .device_kernels import PointBuffer
from .device_launches import DeviceLaunches
from .device_rays import RayBuffers

_LARGEST = float(np.finfo(np.float32).max)
_DOUBLE = {np.dtype(np.float32): 0, np.dtype(np.float64): 1}


def is_resident(value: object) -> bool:
    """Whether a value is an array in the memory of a device."""
    return isinstance(value, DeviceArray) or place_of(value) is not None


def borrowed(value: Any, device: Device, what: str) -> BorrowedArray:
    """An array of points or directions, (..., 3), on the device; one on the host is copied there.

    Raises
    ------
    InputError
        If it is elsewhere, or has another shape or type.
    """
    if isinstance(value, DeviceArray) and value.device.name == device.name:  # one card has one address space
        array = BorrowedArray(value.memory.address, value.shape, value.dtype, value.memory)
    elif is_resident(value):
        array = borrow(value, device, what)
    else:
        values = np.ascontiguousarray(value, np.float64)
        memory = device.upload(values, what)
        array = BorrowedArray(memory.address, values.shape, values.dtype, memory)
    if array.dtype not in _DOUBLE:
        raise InputError(f"{what} holds {array.dtype}; on a device it must be float32 or float64")
    if not array.shape or array.shape[-1] != 3:
        raise InputError(f"{what} must have shape (..., 3), not {array.shape}")
    return array


def is_double(array: BorrowedArray) -> int:
    """1 if points are float64, 0 if they are float32."""
    return _DOUBLE[array.dtype]


def frame_points(points: PointBuffer, n: int, out: int, launches: DeviceLaunches) -> list[int]:
    """Convert n points to the scene's frame, at the address `out`, and return the faults: see the kernel."""
    faults = launches.block("faults", 12, "counts")
    faults.fill()
    launches.launch("frame_points", (points, n, out, faults.address), n)
    found: list[int] = faults.read(np.empty(3, np.int32)).tolist()
    return found


def _number(value: ArrayLike, what: str) -> float:
    if is_resident(value) or np.ndim(value) != 0:
        raise InputError(f"{what} must be one number for rays on a device; copy the rays to the host for one per ray")
    return float(np.asarray(value))


class ResidentRays(NamedTuple):
    """Rays on a device, with checked shapes, types and intervals. Coordinates are checked when they are traced."""

    origins: BorrowedArray
    ends: BorrowedArray  # directions, or targets
    shape: tuple[int, ...]
    segments: bool
    tmin: float
    tmax: float
    cull_faces: int
    frame: tuple[float, float, float]  # world position of the origin of the scene's frame

    @classmethod
    def checked(
        cls,
        device: Device,
        origins: Any,
        ends: Any,
        segments: bool,
        interval: tuple[ArrayLike, ArrayLike],
        cull_faces: int,
        frame: tuple[float, float, float],
    ) -> "ResidentRays":
        """Rays from arrays on this device, or partly on the host, with `interval`, (tmin, tmax).

        Raises
        ------
        InputError
            If an array is elsewhere, or has another shape or type; if the interval is not of two numbers.
        """
        start = borrowed(origins, device, "origins")
        end = borrowed(ends, device, "targets" if segments else "directions")
        shapes = start.shape[:-1], end.shape[:-1]
        shape = max(shapes, key=prod)
        if any(prod(each) != 1 and each != shape for each in shapes):
            raise InputError(f"on a device, origins {start.shape} and {end.shape} must have one shape, or be one point")
        tmin, tmax = _number(interval[0], "tmin"), _number(interval[1], "tmax")
        if not 0.0 <= tmin < np.inf or tmax != tmax:
            raise InputError("tmin must be finite and not negative, and tmax not NaN")
        return cls(start, end, shape, segments, tmin, tmax, cull_faces, frame)

    @property
    def n(self) -> int:
        """Number of rays."""
        return prod(self.shape)

    def in_frame(self, launches: DeviceLaunches) -> RayBuffers:
        """The rays in the scene's frame. InputError if one is invalid."""
        origins = self._framed("origins", self.origins, launches, False)
        ends = self._framed("targets" if self.segments else "directions", self.ends, launches, not self.segments)
        return RayBuffers(origins, ends, 0, 0, 0, int(self.segments), self.tmin, self.tmax, -1)

    def _framed(self, what: str, array: BorrowedArray, launches: DeviceLaunches, directions: bool) -> int:
        """The address of the array's points in the scene's frame, float32."""
        out = launches.block("ends" if what != "origins" else what, 12 * max(self.n, 1), "the rays")
        row = 0 if prod(array.shape) == 3 else 3
        frame = (0.0, 0.0, 0.0) if directions else self.frame
        points = PointBuffer(array.address, is_double(array), row, frame, int(directions), _LARGEST)
        count, ray, _ = frame_points(points, self.n, out.address, launches)
        if count:
            fault = "hold NaN or infinity, or are beyond float32" + ", or a zero" * directions
            raise InputError(f"{what} {fault} (ray {ray})")
        return out.address
