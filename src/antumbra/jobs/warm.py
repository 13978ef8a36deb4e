"""All jobs whose kernels can be compiled ahead of time: those of rendering, and those of this folder."""

from collections.abc import Iterable

import numpy as np

from ..engine.plan import Plan
from ..engine.precompilation import Job, fixed_job, small_scene
from ..engine.scene import Scene
from ..query.light_samples import light_samples
from ..query.receivers import Receivers
from ..query.shadow_query import below_horizon
from ..rendering.warm import jobs as rendering_jobs
from ..scene.lights import PointLight
from .bake.measure import Asked, Meter, SurfacePoints
from .sight.bitrows import reordered
from .sun.hours import tally_job


def jobs(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Job]:
    """The jobs of the given plans, and the jobs common to all plans; arguments as for `rendering.warm.jobs`."""
    return [tally_job(), points_job(), *rendering_jobs(plans, papers)]


def points_job() -> Job:
    """The job of baked light, and of matrices of lines of sight, without tracing."""

    def work():
        scene, light, up = Scene.of_data(small_scene()), PointLight((0.0, 2.0, 0.0)), np.array([[0.0, 1.0, 0.0]])
        samples = light_samples(light, 1)
        for what in ("light", "bent-normal"):
            asked = Asked(what, [light], 1, "larcher-pillichshammer", "bsah+single", 0.0, 1)
            Meter(scene, asked, 1).values(SurfacePoints(np.zeros((1, 3)), up))
        ends = Receivers.on_surface(np.zeros((1, 3)), up, np.zeros(3))
        (query,) = scene.engine.with_options("bsah+single", 1, None).queries(ends, [light], [samples])
        below_horizon(query, 1)
        reordered(np.zeros((1, 1), np.uint64), np.zeros(1, np.int64), 1)

    return fixed_job("points", work)
