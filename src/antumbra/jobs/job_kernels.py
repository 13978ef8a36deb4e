"""All compile jobs for ahead-of-time compilation: those of rendering and those of `jobs`."""

from collections.abc import Iterable

import numpy as np

from ..engine.auto_accelerator import best_tree_job
from ..engine.device_rays import devices_job
from ..engine.in_memory_source import all_hits_job, rays_job, update_job
from ..engine.instanced_source import instances_job
from ..engine.paged_hits import paged_hits_job
from ..engine.paged_source import paged_job
from ..engine.plan import Plan, covering_plans
from ..engine.plan_kernels import wide_lights_job
from ..engine.precompilation import Job, fixed_job, small_scene
from ..engine.primary_visibility import camera_rays_job, cutouts_job
from ..engine.scene import Scene
from ..engine.store_building import store_job
from ..engine.terrain_shadows import terrain_job, terrain_rays_job
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
from ..query.receivers import Receivers
from ..scene.lights import PointLight
from .bake.surface_meter import Meter, MeterSettings, ReceiverPoints
from .bit_matrices import reorder_bits
from .line_of_sight.least_heights import least_heights_job
from .line_of_sight.mutual_horizons import hidden_by_horizons
from .skyline.skyline import skyline_job
from .sun.sun_tally import tally_job


def rendering_jobs(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Job]:
    """The jobs of some plans, and those common to all plans.

    plans : None: enough plans to cover every method
    papers : also cover the methods that packages add; they come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    jobs = [
        rays_job(),
        all_hits_job(),
        best_tree_job(),
        update_job(),
        camera_rays_job(),
        quality_job(),
        antialias_job(),
        appearance_job(),
        ground_job(),
        explicit_rays_job(),
        indirect_job("raster"),
        indirect_job("rays"),
    ]
    jobs += [steps_job(), store_job(), paged_job(), paged_hits_job(), cutouts_job(), instances_job()]
    jobs += [terrain_job(), terrain_rays_job(), devices_job()]
    jobs += [wide_lights_job()] if any(plan.trace == "cones" for plan in plans) else []
    jobs += [bounce_job()] if any(plan.wants_rays for plan in plans) else []
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                jobs.append(rendering_job(plan, gbuffer, counters))
    return jobs


def all_jobs(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Job]:
    """The jobs of `rendering_jobs` and those of this folder; arguments as for `rendering_jobs`."""
    return [tally_job(), points_job(), skyline_job(), least_heights_job(), *rendering_jobs(plans, papers)]


def points_job() -> Job:
    """The job of baked light and visibility matrices, without tracing."""

    def work() -> None:
        scene, light, up = Scene.of_data(small_scene()), PointLight((0.0, 2.0, 0.0)), np.array([[0.0, 1.0, 0.0]])
        for what in ("light", "bent-normal"):
            settings = MeterSettings(what, [light], 1, "larcher-pillichshammer", "bsah+single", 0.0, 1)
            Meter(scene, settings, 1).values(ReceiverPoints(np.zeros((1, 3)), up))
        ends = Receivers.on_surface(np.zeros((1, 3)), up, np.zeros(3))
        hidden_by_horizons(ends, ends, 1)
        reorder_bits(np.zeros((1, 1), np.uint64), np.zeros(1, np.int64), 1)

    return fixed_job("points", work)
