"""Which devices there are, their names, and opening one by its name.

A name is a kind with a number, such as ``cuda:1``; a kind alone means number 0. ``cpu`` means no device: kernels run on
the processor's threads. ``host`` is for tests: it runs a card's code on the processor. ``ANTUMBRA_DEVICE`` holds the
name that is used where none is given.
"""

import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import NamedTuple

from ..base.checks import alternatives, quoted, spelling_hint
from ..base.errors import InputError
from .device import Device, DeviceError

CPU, HOST = "cpu", "host"
VARIABLE = "ANTUMBRA_DEVICE"
_chosen: ContextVar[str | None] = ContextVar("device", default=None)
_budget: ContextVar[int | None] = ContextVar("antumbra_device_budget", default=None)


class DeviceInfo(NamedTuple):
    """A device, or a kind of device that cannot be used."""

    name: str  # "cuda:0"; the kind alone if its driver is missing
    model: str  # the vendor's name; empty if the driver is missing
    driver: str  # name and version; empty if it is missing
    problem: str | None  # why it cannot be used, with the cure; None if it can
    is_card: bool  # whether plans may choose it by themselves; processors are for tests


class _Kind(NamedTuple):
    """A kind of devices."""

    listed: Callable[[], Iterable[DeviceInfo]]  # may raise InputError
    open: Callable[[int, int | None], Device]  # (number, max_memory)


def _cuda_devices() -> Iterable[DeviceInfo]:
    from .cuda_driver import cuda_cards

    return (DeviceInfo(f"cuda:{k}", *card, True) for k, card in enumerate(cuda_cards()))


def _open_cuda(ordinal: int, max_memory: int | None) -> Device:
    from .cuda import Cuda

    return Cuda(ordinal, max_memory)


def _opencl_devices() -> Iterable[DeviceInfo]:
    from .opencl_drivers import NO_DRIVER, opencl_devices

    devices = opencl_devices()
    if not devices:
        raise DeviceError(NO_DRIVER)
    return (
        DeviceInfo(f"opencl:{k}", each.model, each.driver, each.problem, each.is_gpu) for k, each in enumerate(devices)
    )


def _open_opencl(ordinal: int, max_memory: int | None) -> Device:
    from .opencl import OpenCl

    return OpenCl(ordinal, max_memory)


def _open_host(ordinal: int, max_memory: int | None) -> Device:
    from .host.host_device import HostDevice

    if ordinal:
        raise DeviceError(f"there is no host:{ordinal}; there is one host")
    return HostDevice(max_memory=max_memory)


_KINDS = {
    "cuda": _Kind(_cuda_devices, _open_cuda),
    "opencl": _Kind(_opencl_devices, _open_opencl),
    HOST: _Kind(lambda: (), _open_host),
}
"""The kinds of devices, those that plans prefer first. The host is not listed, since only tests use it."""


# --- Names ------------------------------------------------------------------------------------------------------------


_NAME = re.compile(r"([a-z]+)(?::(\d{1,3}))?")


def parse_device(name: str, what: str = "device") -> tuple[str, int]:
    """(kind, number) of a device's name; ("cpu", 0) for ``cpu``.

    what : the option, for the message

    Raises
    ------
    InputError
        If there is no such kind; the message lists the names that are valid on this machine.
    """
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None or match[1] not in (CPU, *_KINDS) or (match[1] == CPU and match[2]):
        names = [CPU, *(device.name for device in list_devices() if device.problem is None), HOST]
        hint = spelling_hint(name, (CPU, *_KINDS)) if isinstance(name, str) else ""
        others = [kind for kind in _KINDS if not any(each.startswith(kind) for each in names)]
        unusable = f"; {alternatives(others)} cannot be used here, antumbra doctor says why" if others else ""
        raise InputError(f"{what} is {quoted(name)}; {hint}it must be {alternatives(names)}{unusable}")
    return match[1], int(match[2] or 0)


@contextmanager
def using_device(name: str | None) -> Iterator[None]:
    """Within the context, `default_device` is this one; None: it stays as it is.

    Raises
    ------
    InputError
        If there is no such kind of device.
    """
    if name is not None:
        parse_device(name)
    token = _chosen.set(_chosen.get() if name is None else name)
    try:
        yield
    finally:
        _chosen.reset(token)


def default_device() -> str | None:
    """The name of `using_device`, or in ``ANTUMBRA_DEVICE``; None if that is unset or empty."""
    name = _chosen.get() or os.environ.get(VARIABLE)
    if not name:
        return None
    parse_device(name, VARIABLE)
    return name


@contextmanager
def device_budget(max_memory: int | None) -> Iterator[None]:
    """Within the context, `current_budget` is `max_memory`, in bytes; None: it stays as it is."""
    token = _budget.set(_budget.get() if max_memory is None else max_memory)
    try:
        yield
    finally:
        _budget.reset(token)


def current_budget() -> int | None:
    """The bytes that may be allocated on a device that is opened now; None: all that is free."""
    return _budget.get()


# --- Devices ----------------------------------------------------------------------------------------------------------


def list_devices() -> list[DeviceInfo]:
    """All devices, and why those that cannot be used cannot. Listing starts the drivers, but opens no device."""
    found: list[DeviceInfo] = []
    for kind, (listed, _) in _KINDS.items():
        try:
            found += listed()
        except InputError as error:
            found.append(DeviceInfo(kind, "", "", str(error), False))
    return found


def best_card() -> str | None:
    """The name of the first card that can be used, CUDA before OpenCL; None without one. Never a processor."""
    for listed, _ in _KINDS.values():
        with suppress(InputError):
            for device in listed():
                if device.is_card and device.problem is None:
                    return device.name
    return None


def open_device(device: str | Device, max_memory: int | None = None) -> Device:
    """The device of a name, for one owner; a `Device` is returned as it is.

    max_memory : bytes that the owner may allocate at one time; None: all that is free

    Raises
    ------
    InputError
        If the name is unknown or means no device (``cpu``), a package is missing, or the device cannot be used.
    """
    if isinstance(device, Device):
        return device
    kind, ordinal = parse_device(device)
    if kind == CPU:
        raise InputError('device is "cpu", and this needs a card; antumbra doctor lists them')
    return _KINDS[kind].open(ordinal, max_memory)
