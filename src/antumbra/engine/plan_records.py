"""The records of the kernels with which plans render, and compiling those that are missing."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from ..kernels.toolchain.compile_pool import KernelRequest
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up
from .auto.one_picture import LIMITS, Few
from .plan import Plan
from .precompilation import compile_missing, precompile


@contextmanager
def one_picture() -> Iterator[None]:
    """Within the context, this process makes a single picture.

    If kernels of the default fixed plan are missing on disk, `auto` compiles and uses only these. The next process
    compiles the rest.
    """
    LIMITS.makes_one_picture = True
    try:
        yield
    finally:
        LIMITS.makes_one_picture = False
        if LIMITS.few is not None:
            LIMITS.few = None
            precompile_plan.cache_clear()


def _prepare_one_picture(gbuffer: str, counters: bool) -> bool:
    """Compile the kernels of the default fixed plan, and limit `auto` to them if any were missing."""
    fixed = Plan()
    if compile_missing(kernels_of_plan(fixed, gbuffer, counters and fixed.tracer.counts_apart) or ()) == 0:
        return False
    assert fixed.build is not None
    LIMITS.few = Few(fixed.trace, fixed.build)
    return True


@cache
def precompile_plan(plan: Plan, gbuffer: str, counters: bool = False) -> bool:
    """Compile those kernels of a plan's shadows, and of a frame with them, that are missing on disk, once per process.

    counters : include a tracer's separate counting kernels

    Returns
    -------
    bool
        Whether kernels without a record may still be missing: some were, and the plan has no record of its own.
    """
    if plan.chooses and LIMITS.makes_one_picture and _prepare_one_picture(gbuffer, counters):
        return False
    counters = counters and plan.tracer.counts_apart
    if plan.trace == "cones":
        precompile("cones, wide lights")
    kernels = kernels_of_plan(plan, gbuffer, counters)
    missing = compile_missing(kernels or ())
    return kernels is None or (missing > 0 and kernels_of_warm_up(plan_record(plan, gbuffer, counters)) is None)


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
