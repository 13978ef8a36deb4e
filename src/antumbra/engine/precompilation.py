"""Compile kernels on all cores before anything is timed, and report it.

An *example call* does on a small scene what users do on theirs: it renders by a plan, traces rays, or builds a store.
``scripts/record_kernels.py`` makes each call and records its kernels under the name of the example
(`kernels.toolchain.kernel_manifest`). Before a process does the same for the first time, `precompile` compiles the
recorded kernels that are missing on disk, in several processes. If all are on disk, as in every later process, nothing
runs. Kernels without a record are compiled on their first call.

`picture.example_calls` and `jobs.warm_ups` hold the calls.
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, NamedTuple

from ..base.progress import report_progress
from ..kernels.marshalling import argument_count, import_object
from ..kernels.toolchain.compile_pool import KernelRequest, compile_kernels
from ..kernels.toolchain.kernel_cache import user_cache
from ..kernels.toolchain.kernel_loading import events, has_compiler, is_on_disk
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up
from .plan import Plan


class Example(NamedTuple):
    """A call on a small scene, whose kernels are recorded."""

    name: str  # key of the record
    call: Callable[[], object]
    kernels: set[KernelRequest] | None  # None: the example has no record


@cache
def precompile(name: str) -> None:
    """Compile those kernels of an example that are missing on disk, once per process."""
    compile_missing(kernels_of_warm_up(name) or ())


@cache
def precompile_plan(plan: Plan, gbuffer: str, counters: bool = False) -> bool:
    """Compile those kernels of a plan's shadows, and of a frame with them, that are missing on disk, once per process.

    counters : include a tracer's separate counting kernels

    Returns
    -------
    bool
        Whether kernels without a record may still be missing: some were, and the plan has no record of its own.
    """
    counters = counters and plan.tracer.counts_apart
    if plan.trace == "cones":
        precompile("cones, wide lights")
    kernels = kernels_of_plan(plan, gbuffer, counters)
    missing = compile_missing(kernels or ())
    return kernels is None or (missing > 0 and kernels_of_warm_up(plan_record(plan, gbuffer, counters)) is None)


def precompile_all(examples: Iterable[Example]) -> int:
    """Compile the missing kernels of several examples together. Returns the number of kernels compiled."""
    examples = list(examples)
    missing = compile_missing({each for example in examples for each in example.kernels or ()})
    before = len(events)
    for example in examples:
        example.call()  # compiles kernels without a record
    return missing + sum(event.source == "compiled" for event in events[before:])


def compile_missing(kernels: Iterable[KernelRequest]) -> int:
    """Compile kernels that are not on disk, on all cores with a progress message. Returns their number.

    Compiles nothing if the cache is read-only; `loading` warns then.
    """
    missing = missing_of(kernels)
    if missing and has_compiler() and user_cache().is_writable():
        with report_progress(f"compiling {len(missing)} kernels for this machine, once") as progress:
            compile_kernels(missing, progress)
    return len(missing)


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


# --- Records of plans -------------------------------------------------------------------------------------------------


def plan_record(plan: Plan, gbuffer: str, counters: bool) -> str:
    """The name under which the kernels of rendering by a plan are recorded."""
    return f"{plan} ({gbuffer}{', counted' if counters else ''})"


def kernels_of_plan(plan: Plan, gbuffer: str, counters: bool) -> set[KernelRequest] | None:
    """The kernels of rendering by a plan, or None if there is no record.

    For a plan without a record, they are combined from the records of plans that use its methods.
    """

    def without_counters(p: Plan) -> set[KernelRequest]:
        return kernels_of_warm_up(plan_record(p, gbuffer, False)) or set()

    record = kernels_of_warm_up(plan_record(plan, gbuffer, counters))
    if record is not None:
        return record
    tracing = kernels_of_warm_up(plan_record(Plan(trace=plan.trace), gbuffer, counters))
    if tracing is None:
        return None
    base = without_counters(Plan(trace="single"))
    for methods in _added_methods(plan):
        extended = without_counters(Plan(trace="single", **methods))
        tracing = (tracing - (base - extended)) | (extended - base)
    return tracing


def _added_methods(plan: Plan) -> list[dict[str, Any]]:
    """The methods that a plan adds to the default one, as plan fields, grouped as their kernels are recorded."""
    fields = "cull", "build", "optimise", "update"
    added = {f: method for f in fields if (method := getattr(plan, f)) not in (None, getattr(Plan(), f))}
    parts: list[dict[str, Any]] = [{field: method} for field, method in added.items()]
    if plan.cull and plan.update:
        parts.append({"cull": "grid32", "update": plan.update})
    return parts
