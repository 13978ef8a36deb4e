"""All example calls whose kernels are compiled ahead of time: of pictures by all plans, bakes and the wings."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

from ..base import wings
from ..base.command_registry import COMMANDS
from ..engine.plan import Plan, covering_plans
from ..engine.plan_records import kernels_of_plan, plan_record
from ..engine.precompilation import ExampleCall
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up
from ..picture.example_calls import BOUNCED_RAYS, EXAMPLES, PLAIN, WIDE_LIGHTS, example_frame


def all_examples(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[ExampleCall]:
    """The examples of studies, those common to all plans, and those of some plans.

    plans : None: enough plans to cover every method
    papers : also cover the methods that packages add; they come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    calls = _examples_of_studies() | EXAMPLES
    calls |= WIDE_LIGHTS if any(plan.trace == "cones" for plan in plans) else {}
    calls |= BOUNCED_RAYS if any(plan.wants_rays for plan in plans) else {}
    examples = [ExampleCall(name, call, kernels_of_warm_up(name)) for name, call in calls.items()]
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                name, kernels = plan_record(plan, gbuffer, counters), kernels_of_plan(plan, gbuffer, counters)
                call = partial(example_frame, plan, gbuffer, replace(PLAIN, counters=counters))
                examples.append(ExampleCall(name, call, kernels))
    return examples


def _examples_of_studies() -> dict[str, Callable[[], object]]:
    """Name -> example call, of all studies that have kernels of their own."""
    calls: dict[str, Callable[[], object]] = {}
    for command in COMMANDS.values():
        calls |= wings.named(command.kernels) if command.kernels else {}
    return calls
