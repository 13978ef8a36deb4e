"""Compile kernels on all cores before anything is timed, and report it.

An *example call* performs a typical task on a small scene: it renders by a plan, traces rays, or builds a store.
``scripts/record_kernels.py`` makes each call and records its kernels under the name of the example
(`kernels.toolchain.kernel_manifest`). Before a process first performs such a task, `precompile` compiles the recorded
kernels that are missing on disk, in several processes. If all are on disk, as in every later process, nothing runs.
Kernels without a record are compiled on their first call.

`picture.example_calls` and the studies hold the calls, on `small_scenes`; `work.warm_ups` lists all of them.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import NamedTuple

from ..base.progress import report_progress
from ..base.wording import counted
from ..kernels.marshalling import argument_count, import_object
from ..kernels.toolchain.compile_pool import KernelRequest, compile_kernels
from ..kernels.toolchain.device_code import FORMS, DeviceKernel
from ..kernels.toolchain.kernel_cache import user_cache
from ..kernels.toolchain.kernel_loading import events, has_compiler, is_on_disk
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up


class ExampleCall(NamedTuple):
    """A call on a small scene, whose kernels are recorded."""

    name: str  # key of the record
    call: Callable[[], object]
    kernels: set[KernelRequest] | None  # None: the example has no record


@cache
def precompile(name: str) -> None:
    """Compile those kernels of an example that are missing on disk, once per process."""
    compile_missing(kernels_of_warm_up(name) or ())


def precompile_all(examples: Iterable[ExampleCall]) -> int:
    """Compile the missing kernels of several examples together. Returns the number of kernels compiled."""
    examples = list(examples)
    missing = compile_missing({each for example in examples for each in example.kernels or ()})
    before = len(events)
    for example in examples:
        example.call()  # compiles kernels without a record
    return missing + sum(event.source == "compiled" for event in events[before:])


def compile_missing(kernels: Iterable[KernelRequest]) -> int:
    """Compile kernels that are not on disk. Returns their number."""
    missing = missing_of(kernels)
    _compile(missing, None, "this machine")
    return len(missing)


def precompile_devices(kernels: Iterable[DeviceKernel]) -> None:
    """Compile the kernels of devices that are missing on disk."""
    _compile({KernelRequest(each.kernel.name, each.key) for each in kernels if not each.is_on_disk()}, FORMS, "devices")


def _compile(missing: set[KernelRequest], levels: Sequence[str] | None, what: str) -> None:
    """Compile kernels on all cores with a progress message. No-op if the cache is read-only; `loading` warns then.

    levels : as for `compile_kernels`
    what : what they are for, in the message
    """
    if missing and has_compiler() and user_cache().is_writable():
        with report_progress(f"compiling {counted(len(missing), 'kernel')} for {what}, once") as progress:
            compile_kernels(missing, progress, levels=levels)


def missing_of(kernels: Iterable[KernelRequest]) -> set[KernelRequest]:
    """The kernels that are not on disk."""
    return {each for each in kernels if _is_missing(each)}


def _is_missing(request: KernelRequest) -> bool:
    try:
        kernel = import_object(request.kernel)
        if argument_count(request.key) != kernel.py_func.__code__.co_argcount:  # changed since the record, likewise
            return False
        return not is_on_disk(kernel, request.key)
    except (AttributeError, ModuleNotFoundError):  # a name has changed since the record; its first call compiles it
        return False


def are_on_disk(kernels: Iterable[KernelRequest] | None) -> bool:
    """Whether all kernels of an example are on disk; False if it has no record."""
    return kernels is not None and not missing_of(kernels)
