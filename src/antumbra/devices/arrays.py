"""Arrays in a device's memory that this library shares with others, such as PyTorch, CuPy and JAX.

`borrow` takes their arrays without a copy, and a `DeviceArray` is what they take. Both protocols are supported: DLPack
and ``__cuda_array_interface__``. With DLPack, no side waits on the host: work in our queue starts after the work that
makes a borrowed array, and work in the consumer's stream starts after ours.
"""

import ctypes
from ctypes import POINTER, c_char_p, c_int32, c_int64, c_uint8, c_uint16, c_uint64, c_void_p, py_object
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..base.errors import InputError
from .device import Device, DeviceMemory, Event, Queue

_PROCESSOR, _CUDA, _MANAGED = 1, 2, 13  # DLPack's kinds of devices
_NAMES = {_PROCESSOR: "cpu", _CUDA: "cuda", _MANAGED: "cuda"}

# --- DLPack's structures ----------------------------------------------------------------------------------------------


class _Tensor(ctypes.Structure):
    _fields_ = (
        ("data", c_void_p),
        ("device", c_int32 * 2),
        ("ndim", c_int32),
        ("code", c_uint8),
        ("bits", c_uint8),
        ("lanes", c_uint16),
        ("shape", POINTER(c_int64)),
        ("strides", POINTER(c_int64)),
        ("offset", c_uint64),
    )


class _Managed(ctypes.Structure):
    """A tensor with the function that its consumer calls when it is done."""


_Deleter = ctypes.CFUNCTYPE(None, POINTER(_Managed))
_Managed._fields_ = (("tensor", _Tensor), ("context", c_void_p), ("deleter", _Deleter))

_KINDS = "iuf"  # of NumPy, at DLPack's codes
_BOOL = 6
_NAME = b"dltensor"  # of a capsule; consumers rename it

_api = ctypes.pythonapi
_new_capsule = ctypes.PYFUNCTYPE(py_object, c_void_p, c_char_p, c_void_p)(("PyCapsule_New", _api))
_pointer_of = ctypes.PYFUNCTYPE(c_void_p, py_object, c_char_p)(("PyCapsule_GetPointer", _api))
_dead_pointer_of = ctypes.PYFUNCTYPE(c_void_p, c_void_p, c_char_p)(("PyCapsule_GetPointer", _api))
_is_valid = ctypes.PYFUNCTYPE(ctypes.c_int, c_void_p, c_char_p)(("PyCapsule_IsValid", _api))

_exported: dict[int, tuple[Any, ...]] = {}  # address of a `_Managed` -> what must stay alive until it is deleted


def _delete(managed: Any) -> None:
    _exported.pop(ctypes.addressof(managed.contents), None)


def _destroy(capsule: int) -> None:
    if _is_valid(capsule, _NAME):  # nobody has taken it
        _exported.pop(_dead_pointer_of(capsule, _NAME), None)


_deleter = _Deleter(_delete)
_destructor = ctypes.PYFUNCTYPE(None, c_void_p)(_destroy)  # of an address: an object would be revived by a reference


def _code_of(dtype: np.dtype[Any]) -> int:
    return _BOOL if dtype == np.bool_ else _KINDS.index(dtype.kind)


def _dtype_of(tensor: _Tensor, what: str) -> np.dtype[Any]:
    if tensor.lanes == 1 and tensor.bits % 8 == 0:
        if tensor.code == _BOOL:
            return np.dtype(np.bool_)
        if tensor.code < len(_KINDS):
            return np.dtype(f"{_KINDS[tensor.code]}{tensor.bits // 8}")
    raise InputError(f"{what} has elements of a kind that NumPy lacks; convert it, for example to float32")


# --- Arrays of other libraries ----------------------------------------------------------------------------------------


class BorrowedArray(NamedTuple):
    """A C-contiguous array of another library in a device's memory; it lives as long as `owner`."""

    address: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    owner: object


def place_of(value: object) -> str | None:
    """Where an array of another library is, such as "cuda:1"; None if it is on the host, or no array."""
    described = getattr(value, "__dlpack_device__", None)
    if described is not None:
        kind, ordinal = described()
        return f"{_NAMES.get(int(kind), f'DLPack device {int(kind)}')}:{ordinal}" if kind != _PROCESSOR else None
    return "cuda" if hasattr(value, "__cuda_array_interface__") else None


def borrow(value: Any, device: Device, what: str, queue: Queue | None = None) -> BorrowedArray:
    """An array of another library, in the memory of this device, without a copy.

    Parameters
    ----------
    value
        It speaks DLPack or ``__cuda_array_interface__``.
    device : Device
    what : str
        Its name, as the subject of messages.
    queue : Queue, optional
        Where it will be used; the default queue if None. Later work there starts after the work that makes the array.

    Raises
    ------
    InputError
        If it is elsewhere, not C-contiguous, or of a kind that NumPy lacks.
    """
    queue = queue or device.queue
    if isinstance(value, DeviceArray) and value.device.name == device.name:  # of another owner, or on OpenCL
        queue.wait(value.ready())
        return BorrowedArray(value.memory.address, value.shape, value.dtype, value.memory)
    if hasattr(value, "__dlpack_device__"):
        return _by_dlpack(value, device, what, queue)
    return _by_interface(value.__cuda_array_interface__, value, device, what, queue)


def _by_dlpack(value: Any, device: Device, what: str, queue: Queue) -> BorrowedArray:
    kind, ordinal = (int(part) for part in value.__dlpack_device__())
    usual = _CUDA if kind == _MANAGED else kind
    if usual != device.dlpack_kind or (usual == _CUDA and ordinal != device.ordinal):
        place = f"{_NAMES.get(kind, f'DLPack device {kind}')}:{ordinal}"
        raise InputError(f"{what} is on {place}, and {device} computes; move it, or choose that device")
    try:
        capsule = value.__dlpack__(stream=queue.handle) if usual == _CUDA else value.__dlpack__()
    except (BufferError, RuntimeError, TypeError) as error:  # of PyTorch: it needs gradients
        raise InputError(f"{what} cannot be shared: {error}") from None
    tensor = _Managed.from_address(_pointer_of(capsule, _NAME)).tensor
    dtype, shape = _dtype_of(tensor, what), tuple(tensor.shape[: tensor.ndim])
    if tensor.strides:
        _check_strides(tuple(each * dtype.itemsize for each in tensor.strides[: tensor.ndim]), shape, dtype, what)
    return BorrowedArray((tensor.data or 0) + tensor.offset, shape, dtype, capsule)  # a capsule deletes what it holds


def _by_interface(interface: dict[str, Any], value: Any, device: Device, what: str, queue: Queue) -> BorrowedArray:
    if device.dlpack_kind != _CUDA:
        raise InputError(f"{what} is on a CUDA device, and {device} computes; move it, or choose that device")
    dtype, shape, strides = np.dtype(interface["typestr"]), tuple(interface["shape"]), interface.get("strides")
    if strides is not None:
        _check_strides(tuple(strides), shape, dtype, what)
    if (stream := interface.get("stream")) is not None:
        queue.wait(device.foreign_queue(stream).record())
    return BorrowedArray(interface["data"][0], shape, dtype, value)


def _check_strides(strides: tuple[int, ...], shape: tuple[int, ...], dtype: np.dtype[Any], what: str) -> None:
    expected = [prod(shape[k + 1 :]) * dtype.itemsize for k in range(len(shape))]
    if prod(shape) and any(n > 1 and have != want for n, have, want in zip(shape, strides, expected)):
        raise InputError(f"{what} is not contiguous; copy it first, in PyTorch by .contiguous()")


# --- Our arrays -------------------------------------------------------------------------------------------------------


class DeviceArray:
    """An array in a device's memory, for example a result. It has no operations of its own.

    ``torch.from_dlpack(array)``, ``cupy.from_dlpack(array)`` and ``jax.dlpack.from_dlpack(array)`` share its memory;
    `numpy` copies it to the host.

    Parameters
    ----------
    memory : DeviceMemory
        It lives as long as this array, and arrays of other libraries that share it.
    shape : tuple of int
        C-contiguous, from the start of the memory.
    dtype : bool, integers or floats
    queue : Queue
        The one that fills it.
    """

    def __init__(self, memory: DeviceMemory, shape: tuple[int, ...], dtype: DTypeLike, queue: Queue) -> None:
        self.memory, self.shape, self.dtype, self._queue = memory, tuple(shape), np.dtype(dtype), queue
        if prod(self.shape) * self.dtype.itemsize > memory.size:
            raise ValueError(f"{self.shape} of {self.dtype} do not fit in {memory.size} bytes")

    @property
    def device(self) -> Device:
        """Where it is."""
        return self.memory.device

    def __repr__(self) -> str:
        return f"DeviceArray({self.shape}, {self.dtype}, {self.device.name})"

    def ready(self) -> Event:
        """The event after the work that fills the array."""
        return self._queue.record()

    def numpy(self) -> NDArray[Any]:
        """A copy on the host, once the work that fills the array is done."""
        return self.memory.read(np.empty(self.shape, self.dtype), queue=self._queue)

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        """The array for libraries that do not use DLPack. They may ignore streams, so the work is awaited here."""
        if self.device.dlpack_kind != _CUDA:
            raise AttributeError(f"an array on {self.device} has no __cuda_array_interface__")
        self._queue.synchronise()
        data = self.memory.address, False
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": data,
            "strides": None,
            "stream": None,
            "version": 3,
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        if self.device.dlpack_kind is None:
            raise BufferError(f"memory of {self.device} cannot be shared; copy it: .numpy()")
        return self.device.dlpack_kind, self.device.ordinal

    def __dlpack__(self, *, stream: int | None = None, **newer: Any) -> object:
        """A capsule of the array.

        stream : of the consumer, whose later work starts after the work that fills the array; None: the default one;
            -1: the consumer orders them itself
        newer : arguments of later versions of the protocol; a consumer must accept the first version
        """
        if newer.get("copy"):
            raise BufferError("an array on a device is shared, not copied; copy it: .numpy()")
        device = self.__dlpack_device__()
        if device[0] != _CUDA:
            self._queue.synchronise()
        elif stream != -1:
            self.device.foreign_queue(stream or 1).wait(self.ready())  # 1 is the default stream in CUDA too
        rank = len(self.shape)
        shape = (c_int64 * rank)(*self.shape)
        code, bits = _code_of(self.dtype), 8 * self.dtype.itemsize
        tensor = _Tensor(self.memory.address, device, rank, code, bits, 1, shape, None, 0)
        managed = _Managed(tensor, None, _deleter)
        address = ctypes.addressof(managed)
        _exported[address] = managed, shape, self.memory
        return _new_capsule(address, _NAME, ctypes.cast(_destructor, c_void_p))
