"""All compile jobs for ahead-of-time compilation: those of rendering and those of `jobs`."""

from collections.abc import Iterable

import numpy as np

from ..baking.surface_meter import Meter, MeterSettings, ReceiverPoints
from ..city.sight.least_heights import least_heights_warm_up
from ..city.sight.mutual_horizons import hidden_by_horizons
from ..city.skyline.skyline import skyline_warm_up
from ..city.sun.sun_tally import tally_warm_up
from ..city.tables.bit_matrices import reorder_bits
from ..engine.auto_accelerator import best_tree_warm_up
from ..engine.device_rays import devices_warm_up
from ..engine.plan import Plan, covering_plans
from ..engine.plan_kernels import wide_lights_warm_up
from ..engine.precompilation import WarmUp, fixed_warm_up, small_scene
from ..engine.primary_visibility import camera_rays_warm_up, cutouts_warm_up
from ..engine.scene import Scene
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
from ..query.receivers import Receivers
from ..scene.lights import PointLight


def rendering_warm_ups(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[WarmUp]:
    """The jobs of some plans, and those common to all plans.

    plans : None: enough plans to cover every method
    papers : also cover the methods that packages add; they come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    jobs = [
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
    jobs += [
        steps_warm_up(),
        store_warm_up(),
        paged_warm_up(),
        paged_hits_warm_up(),
        cutouts_warm_up(),
        instances_warm_up(),
    ]
    jobs += [terrain_warm_up(), terrain_rays_warm_up(), devices_warm_up()]
    jobs += [wide_lights_warm_up()] if any(plan.trace == "cones" for plan in plans) else []
    jobs += [bounce_warm_up()] if any(plan.wants_rays for plan in plans) else []
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                jobs.append(rendering_warm_up(plan, gbuffer, counters))
    return jobs


def all_warm_ups(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[WarmUp]:
    """The jobs of `rendering_warm_ups` and those of this folder; arguments as for `rendering_warm_ups`."""
    return [
        tally_warm_up(),
        points_warm_up(),
        skyline_warm_up(),
        least_heights_warm_up(),
        *rendering_warm_ups(plans, papers),
    ]


def points_warm_up() -> WarmUp:
    """The job of baked light and visibility matrices, without tracing."""

    def work() -> None:
        scene, light, up = Scene.of_data(small_scene()), PointLight((0.0, 2.0, 0.0)), np.array([[0.0, 1.0, 0.0]])
        for what in ("light", "bent-normal"):
            settings = MeterSettings(what, [light], 1, "larcher-pillichshammer", "bsah+single", 0.0, 1)
            Meter(scene, settings, 1).values(ReceiverPoints(np.zeros((1, 3)), up))
        ends = Receivers.on_surface(np.zeros((1, 3)), up, np.zeros(3))
        hidden_by_horizons(ends, ends, 1)
        reorder_bits(np.zeros((1, 1), np.uint64), np.zeros(1, np.int64), 1)

    return fixed_warm_up("points", work)
