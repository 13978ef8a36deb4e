"""Plans that trace on a device, such as ``bsah+device:cuda:0``: the option ``device``, and what stays on the CPU.

The CPU builds ``bsah`` trees, which are uploaded once; devices build ``lbvh`` ones themselves, which animated scenes
get by default, since each frame needs a new tree. Devices find what blocks shadow rays, and any and the nearest hits of
ray lists, also on cut-outs and on copies of meshes, and what perspective cameras see. The CPU finds what other cameras
see, and all hits. Stores are traced on the CPU, unless a plan such as ``bsah+chcrt+device:cuda:0`` lets a device trace
their camera, shadow and diffuse rays.
"""

from dataclasses import replace

from ..base.errors import InputError
from ..devices.device_list import CPU, default_device, parse_device
from ..scene.scene_data import SceneData
from .device_tracers import DEVICE, method_on_cpu
from .plan import DEFAULT_PLAN, Plan, parse_plan


def cpu_plan(plan: Plan) -> Plan:
    """The plan whose kernels a plan needs on the CPU."""
    return plan if plan.device is None else replace(plan, trace=method_on_cpu(plan.trace))


def traces_on_device(data: SceneData) -> bool:
    """Whether devices trace all rays of a scene by themselves: it is in memory."""
    return data.resident


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
        if data is not None and not traces_on_device(data):
            return plan
        return f"{'lbvh' if data is not None and data.animated else 'bsah'}+{DEVICE}:{full}"
    parsed = parse_plan(plan)
    if parsed.device != full:
        raise InputError(
            f"plan {str(plan)!r} does not trace on {full}; leave out the plan or the device, or write {DEVICE}:{full} "
            f"in place of {parsed.trace}"
        )
    return parsed
