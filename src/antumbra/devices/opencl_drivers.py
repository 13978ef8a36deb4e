"""OpenCL drivers: which there are, and which devices of theirs can run our kernels.

The graphics cards' drivers are listed by the system. Intel's driver for processors comes from PyPI (extra
``opencl-cpu``), and the file in its wheel that should list it names a folder of another machine, so it is listed here.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from ..base.extras import import_extra
from ..base.files import temporary_folder
from .device import DeviceError, check_process

_WHEEL, _LIBRARY = "intel-opencl-rt", "libintelocl.so"
_VENDORS = "/etc/OpenCL/vendors"
_NOT_FOUND = -1001  # CL_PLATFORM_NOT_FOUND_KHR: the loader knows no driver

NO_DRIVER = (
    "no OpenCL driver was found; install the graphics card's driver, or, to test on a processor under Linux: "
    "pip install 'antumbra[opencl-cpu]'"
)


def pyopencl() -> ModuleType:
    """The package; MissingPackage with the command that installs it."""
    return import_extra("pyopencl", 'device="opencl"', "opencl")


class OpenClDevice(NamedTuple):
    """A device that an OpenCL driver offers."""

    handle: Any  # pyopencl.Device
    model: str
    driver: str
    is_gpu: bool
    problem: str | None  # why it cannot run our kernels, with the cure

    @classmethod
    def of(cls, handle: Any) -> "OpenClDevice":
        """The description of a ``pyopencl.Device``."""
        gpu = bool(handle.type & pyopencl().device_type.GPU)
        return cls(
            handle, handle.name.strip(), f"{handle.platform.name} {handle.driver_version}", gpu, _problem(handle)
        )


def opencl_devices() -> list[OpenClDevice]:
    """All devices of all drivers, graphics cards first, in the order of ``opencl:0``, ``opencl:1``, ...

    Raises
    ------
    MissingPackage
        If pyopencl is not installed.
    DeviceError
        In a fork of a process that has called this function.
    """
    devices, process = _devices()
    check_process(process, "OpenCL")
    return devices


@cache
def _devices() -> tuple[list[OpenClDevice], int]:
    cl, found = pyopencl(), []
    with _wheels_listed():
        try:
            platforms = cl.get_platforms()
        except cl.Error as error:
            if error.code != _NOT_FOUND:
                raise DeviceError(f"OpenCL: {error_name(error)}; update the graphics card's driver") from None
            platforms = []
    for platform in platforms:
        with suppress(cl.Error):  # a driver without devices
            found += [OpenClDevice.of(handle) for handle in platform.get_devices()]
    return sorted(found, key=lambda device: not device.is_gpu), os.getpid()


def error_name(error: Any) -> str:
    """The name in the OpenCL standard of a ``pyopencl.Error``, after the function that failed."""
    return f"{error.routine}: CL_{pyopencl().status_code.to_string(error.code)}"


# --- What kernels need ------------------------------------------------------------------------------------------------


def _problem(handle: Any) -> str | None:
    """Why a device cannot run our kernels, with the cure; None if it can."""
    cl = pyopencl()
    if not _il_versions(handle):
        return f"its driver does not take SPIR-V{_other_way(handle)}"
    if handle.address_bits != 64:
        return "it has 32-bit addresses, and kernels need 64; use another device"
    if not _info(handle, "DOUBLE_FP_CONFIG"):
        return "it has no float64, which undecided tests need; use another device"
    exact = cl.device_fp_config.ROUND_TO_NEAREST | cl.device_fp_config.DENORM
    if handle.single_fp_config & exact != exact:
        return "its float32 does not round to nearest, or flushes small numbers to zero; use another device"
    if not _info(handle, "SVM_CAPABILITIES"):
        return "it has no shared virtual memory, so kernels cannot take addresses; update its driver"
    return None


def _il_versions(handle: Any) -> str:
    """The versions of SPIR-V that a device takes; empty if none."""
    return text if "SPIR-V" in (text := str(_info(handle, "IL_VERSION") or "")) else ""


def _other_way(handle: Any) -> str:
    return '; use device="cuda"' if "nvidia" in handle.vendor.lower() else "; update it, or use another device"


def _info(handle: Any, name: str) -> Any:
    """A property of a device; None if the driver is too old to know it."""
    cl = pyopencl()
    try:
        return handle.get_info(getattr(cl.device_info, name))
    except (cl.Error, AttributeError):
        return None


# --- The driver in Intel's wheels -------------------------------------------------------------------------------------


@contextmanager
def _wheels_listed() -> Iterator[None]:
    """Within the context, the loader of OpenCL drivers also finds the one in Intel's wheels, if they are installed.

    The loader reads ``OCL_ICD_VENDORS`` once. If the user has set it, it stays as it is.
    """
    library = _wheel_library()
    if library is None or "OCL_ICD_VENDORS" in os.environ:
        yield
        return
    with temporary_folder() as folder:
        for listed in Path(os.environ.get("OPENCL_VENDOR_PATH", _VENDORS)).glob("*.icd"):
            with suppress(OSError):
                text = listed.read_text()
                if Path(text.strip()).name != _LIBRARY:
                    (folder / listed.name).write_text(text)
        (folder / "antumbra-intel-cpu.icd").write_text(f"{library}\n")
        os.environ["OCL_ICD_VENDORS"] = str(folder)
        try:
            yield
        finally:
            del os.environ["OCL_ICD_VENDORS"]


def _wheel_library() -> Path | None:
    """Intel's driver for processors, from PyPI; None if it is not installed."""
    if not sys.platform.startswith("linux"):
        return None
    try:
        listed = files(_WHEEL) or []
    except PackageNotFoundError:
        return None
    paths = (Path(str(each.locate())).resolve() for each in listed if each.name == _LIBRARY)
    return next((path for path in paths if path.exists()), None)
