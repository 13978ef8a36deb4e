"""All warm-ups for ahead-of-time compilation: those of pictures, of bakes and of the wings."""

from collections.abc import Iterable

from ..base import wings
from ..base.command_registry import COMMANDS
from ..engine.auto_accelerator import best_tree_warm_up
from ..engine.plan import Plan, covering_plans
from ..engine.plan_kernels import wide_lights_warm_up
from ..engine.precompilation import WarmUp
from ..engine.primary_visibility import camera_rays_warm_up, cutouts_warm_up
from ..engine.sources.device_rays import devices_warm_up
from ..engine.sources.in_memory_source import all_hits_warm_up, rays_warm_up, update_warm_up
from ..engine.sources.instanced_source import instances_warm_up
from ..engine.sources.paged_hits import paged_hits_warm_up
from ..engine.sources.paged_source import paged_warm_up
from ..engine.sources.terrain_shadows import terrain_rays_warm_up, terrain_warm_up
from ..engine.store_building import store_warm_up
from ..picture.render_kernels import (
    antialias_warm_up,
    appearance_warm_up,
    bounce_warm_up,
    explicit_rays_warm_up,
    ground_warm_up,
    indirect_warm_up,
    quality_warm_up,
    rendering_warm_up,
)
from ..picture.traversal_steps import steps_warm_up


def rendering_warm_ups(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[WarmUp]:
    """The warm-ups of some plans, and those common to all plans.

    plans : None: enough plans to cover every method
    papers : also cover the methods that packages add; they come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    warm_ups = [
        rays_warm_up(),
        all_hits_warm_up(),
        best_tree_warm_up(),
        update_warm_up(),
        camera_rays_warm_up(),
        quality_warm_up(),
        antialias_warm_up(),
        appearance_warm_up(),
        ground_warm_up(),
        explicit_rays_warm_up(),
        indirect_warm_up("raster"),
        indirect_warm_up("rays"),
    ]
    warm_ups += [
        steps_warm_up(),
        store_warm_up(),
        paged_warm_up(),
        paged_hits_warm_up(),
        cutouts_warm_up(),
        instances_warm_up(),
    ]
    warm_ups += [terrain_warm_up(), terrain_rays_warm_up(), devices_warm_up()]
    warm_ups += [wide_lights_warm_up()] if any(plan.trace == "cones" for plan in plans) else []
    warm_ups += [bounce_warm_up()] if any(plan.wants_rays for plan in plans) else []
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                warm_ups.append(rendering_warm_up(plan, gbuffer, counters))
    return warm_ups


def all_warm_ups(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[WarmUp]:
    """The warm-ups of all studies, and those of `rendering_warm_ups`, whose arguments these are."""
    studies = [wings.named(command.kernels)() for command in COMMANDS.values() if command.kernels]
    return [*studies, *rendering_warm_ups(plans, papers)]
