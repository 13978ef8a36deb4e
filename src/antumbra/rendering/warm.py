"""All jobs whose kernels can be compiled ahead of time."""

from collections.abc import Iterable

from ..engine.accelerator import best_tree_job
from ..engine.engine import wide_lights_job
from ..engine.in_memory_source import rays_job
from ..engine.paged_source import paged_job
from ..engine.plan import Plan, covering_plans
from ..engine.precompilation import Job
from ..engine.primary_visibility import camera_rays_job, cutouts_job
from ..engine.store_building import store_job
from ..picture.render_kernels import (
    antialias_job,
    appearance_job,
    bounce_job,
    explicit_rays_job,
    ground_job,
    indirect_job,
    quality_job,
    rendering_job,
)
from ..picture.traversal_steps import steps_job


def jobs(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Job]:
    """The jobs of the given plans, and the jobs common to all plans.

    plans : None: enough plans to cover every method
    papers : cover the methods added by packages too; they come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    found = [
        rays_job(),
        best_tree_job(),
        camera_rays_job(),
        quality_job(),
        antialias_job(),
        appearance_job(),
        ground_job(),
        explicit_rays_job(),
        indirect_job("raster"),
        indirect_job("rays"),
    ]
    found += [steps_job(), store_job(), paged_job(), cutouts_job()]
    found += [wide_lights_job()] if any(plan.trace == "cones" for plan in plans) else []
    found += [bounce_job()] if any(plan.wants_rays for plan in plans) else []
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                found.append(rendering_job(plan, gbuffer, counters))
    return found
