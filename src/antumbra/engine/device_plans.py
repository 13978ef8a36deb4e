"""Plans that trace on a device, such as ``bsah+device:cuda:0``: their tracers, and the option ``device``.

The tree is built on the CPU and uploaded once. Devices find what blocks shadow rays, and any and the nearest hits of
ray lists. The CPU finds what a camera sees, hits on cut-outs, and all hits; instances and stores are traced on the CPU
altogether.
"""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import Bvh
from ..devices.device_list import CPU, default_device, open_device, parse_device
from ..errors import InputError
from ..kernels.parallel import thread_count
from ..progress import ProgressCallback
from ..query.shadow_query import ShadowQuery, ray_count
from ..scene.instance_data import InstanceData
from ..scene.scene_data import MemoryData, SceneData
from ..trace.counters import RAYS
from .method_registry import DEVICE, Tracer
from .plan import DEFAULT_PLAN, Plan, parse_plan


@cache
def device_tracer(name: str) -> Any:
    """The `trace.device.device_tracer.DeviceTracer` of a device, by its full name. All engines share it."""
    from ..trace.device.device_tracer import DeviceTracer  # imported late: most processes use no device

    return DeviceTracer(open_device(name))


class OnDevice(NamedTuple):
    """A tree on a device, and the device's tracer."""

    tracer: Any  # `DeviceTracer`
    tree: Any  # `trace.device.device_tree.DeviceTree`


@cache
def _tracer_of(name: str) -> Tracer:
    """The tracer of plans on a device, by its full name."""

    def prepare(bvh: Bvh, threads: int | None = None) -> OnDevice:
        tracer = device_tracer(name)
        return OnDevice(tracer, tracer.tree(bvh))

    def trace(
        prepared: OnDevice,
        query: ShadowQuery,
        bits: NDArray[np.uint64],
        threads: int | None,
        counters: NDArray[np.int64] | None,
        progress: ProgressCallback | None,
    ) -> None:
        prepared.tracer.trace_shadow(prepared.tree, query, bits, thread_count(threads), progress)
        if counters is not None:
            counters[RAYS] += ray_count(query)

    return Tracer(
        prepare, trace, f"one ray per thread on the device {name}, exact with the help of the CPU", "", keeps=True
    )


def find_device_tracer(name: str) -> tuple[str, Tracer] | None:
    """The tracer ``device:NAME``, with the device's full name."""
    device = name.partition(":")[2]
    if not device or device == CPU:
        return None
    full = ":".join(map(str, parse_device(device, "the device of the plan")))
    return f"{DEVICE}:{full}", _tracer_of(full)


def device_of(plan: Plan) -> str | None:
    """The full name of the device on which a plan traces; None: it traces on the CPU."""
    family, _, device = plan.trace.partition(":")
    return device if family == DEVICE else None


def cpu_plan(plan: Plan) -> Plan:
    """The plan whose kernels a plan needs on the CPU."""
    return plan if device_of(plan) is None else replace(plan, trace="single")


def traces_on_device(data: SceneData) -> bool:
    """Whether devices trace a scene: it is in memory, without instances."""
    return isinstance(data, MemoryData) and not isinstance(data, InstanceData)


def plan_on(device: str | None, plan: str | Plan | None, data: SceneData | None = None) -> str | Plan | None:
    """The plan of an engine that is given a device, a plan, or both.

    Parameters
    ----------
    device : str or None
        A name such as ``"cuda"``, ``"cuda:1"``, ``"opencl"`` or ``"cpu"``. None: what ``ANTUMBRA_DEVICE`` names, if
        there is no plan either.
    plan : str, Plan or None
    data : SceneData or None
        The scene; one that devices do not trace gets its plan for the CPU.

    Raises
    ------
    InputError
        If there is no such device, or the plan traces elsewhere.
    """
    if device is None:
        device = default_device() if plan is None else None
        if device is None:
            return plan
    kind, ordinal = parse_device(device)
    if kind == CPU:
        return plan
    full = f"{kind}:{ordinal}"
    if plan is None or str(plan) == DEFAULT_PLAN:
        return plan if data is not None and not traces_on_device(data) else f"bsah+{DEVICE}:{full}"
    parsed = parse_plan(plan)
    if device_of(parsed) != full:
        raise InputError(
            f"plan {str(plan)!r} does not trace on {full}; leave out the plan or the device, or write {DEVICE}:{full} "
            f"in place of {parsed.trace}"
        )
    return parsed
