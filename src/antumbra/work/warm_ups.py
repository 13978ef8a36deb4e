"""All example calls whose kernels are compiled ahead of time: those common to all plans, of each plan, and of jobs."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from ..baking.surface_meter import Meter, MeterSettings, ReceiverPoints
from ..city.sight.least_heights import least_heights_of
from ..city.sight.mutual_horizons import hidden_by_horizons
from ..city.skyline.skyline import skyline
from ..city.sun.sun_tally import WHOLE, Calendar, SunLight, tally_of
from ..city.tables.bit_matrices import reorder_bits
from ..engine.plan import Plan, covering_plans
from ..engine.precompilation import Example, kernels_of_plan, plan_record
from ..engine.scene import Scene
from ..kernels.toolchain.kernel_manifest import kernels_of_warm_up
from ..picture.example_calls import (
    BOUNCED_RAYS,
    EXAMPLES,
    PLAIN,
    UP,
    WIDE_LIGHTS,
    example_frame,
    small_scene,
    small_terrain,
    small_view,
)
from ..picture.frame_request import TimeSample
from ..picture.traversal_steps import explain
from ..query.receivers import Receivers
from ..scene.lights import PointLight


def all_examples(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Example]:
    """The examples of some plans, and those common to all plans.

    plans : None: enough plans to cover every method
    papers : also cover the methods that packages add; they come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    calls = JOB_EXAMPLES | EXAMPLES
    calls |= WIDE_LIGHTS if any(plan.trace == "cones" for plan in plans) else {}
    calls |= BOUNCED_RAYS if any(plan.wants_rays for plan in plans) else {}
    examples = [Example(name, call, kernels_of_warm_up(name)) for name, call in calls.items()]
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                name, kernels = plan_record(plan, gbuffer, counters), kernels_of_plan(plan, gbuffer, counters)
                call = partial(example_frame, plan, gbuffer, replace(PLAIN, counters=counters))
                examples.append(Example(name, call, kernels))
    return examples


def _sum_suns() -> None:
    bits, ones, days = np.zeros((2, 1), np.uint64), np.zeros(1), np.zeros((1, 1), np.int32)
    tally_of(SunLight(bits, WHOLE), None, Calendar(days, ones, days, np.ones(1, bool), ones, np.zeros((1, 3))), 1, 1)


def _measure_points() -> None:
    """Baked light, and the bits of visibility matrices without their rays."""
    scene = Scene.of_data(small_scene())
    for what in ("light", "bent-normal"):
        settings = MeterSettings(
            what, [PointLight((0.0, 2.0, 0.0))], 1, "larcher-pillichshammer", "bsah+single", 0.0, 1
        )
        Meter(scene, settings, 1).values(ReceiverPoints(np.zeros((1, 3)), UP))
    ends = Receivers.on_surface(np.zeros((1, 3)), UP, np.zeros(3))
    hidden_by_horizons(ends, ends, 1)
    reorder_bits(np.zeros((1, 1), np.uint64), np.zeros(1, np.int64), 1)


def _count_steps() -> None:
    camera, lights = small_view()
    explain(Scene.of_data(small_scene()), [TimeSample(0.0, camera, lights)], ["bsah+single"], spp=1, threads=2)


def _least_heights() -> None:
    least_heights_of(Scene.of_data(small_terrain()), np.array([1.5, -1.5, 1.0]), 0.0, 1)


JOB_EXAMPLES: dict[str, Callable[[], object]] = {
    "sun hours": _sum_suns,
    "points": _measure_points,
    "skyline": lambda: skyline(Scene.of_data(small_scene()), UP, step=90.0, threads=1),
    "least heights": _least_heights,
    "counted steps": _count_steps,
}
