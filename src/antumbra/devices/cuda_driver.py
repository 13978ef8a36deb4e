"""NVIDIA's driver, by ctypes: its library, its errors by name, and the cards that it offers. No toolkit is needed."""

import ctypes
import os
import sys
from contextlib import suppress
from ctypes import POINTER, c_char_p, c_float, c_int, c_size_t, c_ubyte, c_uint, c_void_p
from functools import cache
from typing import Any, NamedTuple

from .device import DeviceError, check_process

LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
LEAST_VERSION = 10_000
"""CUDA 10.0, whose drivers are the first that take our PTX: 1000 times the major version, plus 10 times the minor."""

LEAST_CAPABILITY = 7, 5
"""Turing, the oldest cards that our PTX is for."""

_ADDRESS, _OUT = ctypes.c_uint64, POINTER(c_void_p)
_SIGNATURES: dict[str, tuple[Any, ...]] = {
    "cuInit": (c_uint,),
    "cuDriverGetVersion": (POINTER(c_int),),
    "cuGetErrorName": (c_int, POINTER(c_char_p)),
    "cuDeviceGetCount": (POINTER(c_int),),
    "cuDeviceGet": (POINTER(c_int), c_int),
    "cuDeviceGetName": (c_char_p, c_int, c_int),
    "cuDeviceGetAttribute": (POINTER(c_int), c_int, c_int),
    "cuDevicePrimaryCtxRetain": (_OUT, c_int),
    "cuCtxPushCurrent_v2": (c_void_p,),
    "cuCtxPopCurrent_v2": (_OUT,),
    "cuMemGetInfo_v2": (POINTER(c_size_t), POINTER(c_size_t)),
    "cuMemAlloc_v2": (POINTER(_ADDRESS), c_size_t),
    "cuMemFree_v2": (_ADDRESS,),
    "cuMemHostAlloc": (_OUT, c_size_t, c_uint),
    "cuMemFreeHost": (c_void_p,),
    "cuMemcpyHtoDAsync_v2": (_ADDRESS, c_void_p, c_size_t, c_void_p),
    "cuMemcpyDtoHAsync_v2": (c_void_p, _ADDRESS, c_size_t, c_void_p),
    "cuMemsetD8Async": (_ADDRESS, c_ubyte, c_size_t, c_void_p),
    "cuStreamCreate": (_OUT, c_uint),
    "cuStreamDestroy_v2": (c_void_p,),
    "cuStreamWaitEvent": (c_void_p, c_void_p, c_uint),
    "cuEventCreate": (_OUT, c_uint),
    "cuEventDestroy_v2": (c_void_p,),
    "cuEventRecord": (c_void_p, c_void_p),
    "cuEventQuery": (c_void_p,),
    "cuEventElapsedTime": (POINTER(c_float), c_void_p, c_void_p),
    "cuModuleLoadDataEx": (_OUT, c_void_p, c_uint, POINTER(c_int), _OUT),
    "cuModuleGetFunction": (_OUT, c_void_p, c_char_p),
    "cuFuncGetAttribute": (POINTER(c_int), c_int, c_void_p),
    "cuLaunchKernel": (c_void_p, *[c_uint] * 7, c_void_p, _OUT, _OUT),
}

_CAPABILITY = 75, 76  # attributes of a device: its capability, major and minor
_COMPUTE_MODE, _PROHIBITED = 20, 2

OUT_OF_MEMORY, NOT_READY = 2, 600
_NO_DEVICE = 100
_CURES = {
    OUT_OF_MEMORY: "close other programs that use the card, or compute on the CPU",
    3: "start processes with multiprocessing.get_context('spawn'), since the driver does not survive a fork",
    34: "a toolkit's stub was loaded in the place of the driver; remove its folder from LD_LIBRARY_PATH",
    46: "another program has the card for itself; wait for it, or take another card",
    _NO_DEVICE: "no card was found; check that nvidia-smi lists it, and CUDA_VISIBLE_DEVICES",
    214: "the card's memory is faulty; take another card",
    222: "the driver is too old for the code; update it",
    700: "please report it; the process cannot use the card any more",
    702: "the system stops long kernels on a card with a display; take another card",
    719: "please report it; the process cannot use the card any more",
    802: "the driver has not started yet; wait, or restart nvidia-fabricmanager",
    803: "the driver was updated; restart the computer",
    804: "the driver is too old for this card; update it",
}


class CudaDriver:
    """The driver's library, initialised.

    version : of CUDA, as `LEAST_VERSION`

    Raises
    ------
    DeviceError
        If it is missing, too old, or finds no card.
    """

    def __init__(self, path: str) -> None:
        self.process = os.getpid()
        try:
            self._library = ctypes.CDLL(path)
        except OSError:
            cure = "if there is a card, install its driver"
            raise DeviceError(f"CUDA: there is no NVIDIA driver ({path} cannot be loaded); {cure}") from None
        for name, types in _SIGNATURES.items():
            function = getattr(self._library, name, None)
            if function is None:
                raise DeviceError(f"CUDA: the NVIDIA driver is too old, it lacks {name}; update it")
            function.argtypes, function.restype = types, c_int
        self.check("CUDA", "cuInit", 0)
        version = c_int()
        self.check("CUDA", "cuDriverGetVersion", version)
        self.version = version.value
        if self.version < LEAST_VERSION:
            raise DeviceError(
                f"CUDA: the NVIDIA driver is too old: it supports CUDA {_version_text(self.version)}, and kernels need "
                f"{_version_text(LEAST_VERSION)}; update it"
            )

    def status(self, function: str, *arguments: Any) -> int:
        """The status that a function of the driver returns. Where it takes a pointer, ctypes passes a reference."""
        return int(getattr(self._library, function)(*arguments))

    def check(self, where: object, function: str, *arguments: Any) -> None:
        """Call a function of the driver; DeviceError with the name of its error, and the cure, if it fails.

        where : the device, for the message
        """
        if status := self.status(function, *arguments):
            raise self.error(where, function, status)

    def error(self, where: object, function: str, status: int, cure: str | None = None) -> DeviceError:
        """The error for the status that a function returned."""
        cure = cure or _CURES.get(status, "if it happens again, please report it")
        return DeviceError(f"{where}: {function}: {self._name_of(status)}; {cure}")

    def _name_of(self, status: int) -> str:
        name = c_char_p()
        if self.status("cuGetErrorName", status, name) or name.value is None:
            return f"CUDA error {status}"
        return name.value.decode()

    def attribute(self, device: int, which: int) -> int:
        """An attribute of a device."""
        value = c_int()
        self.check(f"cuda:{device}", "cuDeviceGetAttribute", value, which, device)
        return value.value


def _version_text(version: int) -> str:
    return f"{version // 1000}.{version % 1000 // 10}"


@cache
def _driver(path: str) -> CudaDriver:
    return CudaDriver(path)


def cuda_driver() -> CudaDriver:
    """The driver of this process; a DeviceError if there is none, or in a fork of a process that has used it."""
    driver = _driver(LIBRARY)
    check_process(driver.process, "CUDA")
    return driver


# --- Cards ------------------------------------------------------------------------------------------------------------


class CudaCard(NamedTuple):
    """A card that the driver offers."""

    model: str
    driver: str
    problem: str | None  # why it cannot run our kernels, with the cure


def cuda_cards() -> list[CudaCard]:
    """All cards, in the order of ``cuda:0``, ``cuda:1``, ...; DeviceError without a usable driver."""
    driver, count = cuda_driver(), c_int()
    driver.check("CUDA", "cuDeviceGetCount", count)
    return [_card(driver, ordinal) for ordinal in range(count.value)]


def _card(driver: CudaDriver, ordinal: int) -> CudaCard:
    name = ctypes.create_string_buffer(256)
    driver.check(f"cuda:{ordinal}", "cuDeviceGetName", name, len(name), ordinal)
    version = f"CUDA {_version_text(driver.version)}"
    return CudaCard(name.value.decode(errors="replace"), version, _problem(driver, ordinal))


def _problem(driver: CudaDriver, ordinal: int) -> str | None:
    capability = tuple(driver.attribute(ordinal, each) for each in _CAPABILITY)
    if capability < LEAST_CAPABILITY:
        return f"its compute capability is {capability[0]}.{capability[1]}, and kernels need 7.5 (Turing, of 2018)"
    if driver.attribute(ordinal, _COMPUTE_MODE) == _PROHIBITED:
        return "its compute mode forbids programs; an administrator allows them: nvidia-smi -c 0"
    return None


# --- Contexts ---------------------------------------------------------------------------------------------------------


class CudaContext:
    """A card's primary context, which other libraries of the process use too. ``with`` makes it current in a thread."""

    def __init__(self, ordinal: int, where: str) -> None:
        self.driver, self._where, self.handle = cuda_driver(), where, c_void_p()
        self.driver.check(where, "cuDevicePrimaryCtxRetain", self.handle, ordinal)

    def __enter__(self) -> "CudaContext":
        self.driver.check(self._where, "cuCtxPushCurrent_v2", self.handle)
        return self

    def __exit__(self, *_: object) -> None:
        self.driver.status("cuCtxPopCurrent_v2", c_void_p())

    def check(self, function: str, *arguments: Any) -> None:
        """Call a function of the driver in this context; DeviceError if it fails."""
        with self:
            self.driver.check(self._where, function, *arguments)

    def status(self, function: str, *arguments: Any) -> int:
        """Call a function of the driver in this context, and return its status."""
        with self:
            return self.driver.status(function, *arguments)

    def discard(self, function: str, handle: Any) -> None:
        """Free or destroy something; nothing happens in a fork, or if the driver has failed before."""
        if os.getpid() == self.driver.process:
            with suppress(DeviceError):
                self.status(function, handle)
