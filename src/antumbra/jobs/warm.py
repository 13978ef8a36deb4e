"""All jobs whose kernels can be compiled ahead of time: those of rendering, and those of this folder."""

from collections.abc import Iterable

from ..plan import Plan
from ..rendering import warm
from ..rendering.ready import Job
from .sun.hours import tally_job


def jobs(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Job]:
    """The jobs of the given plans, and the jobs common to all plans; arguments as for `rendering.warm.jobs`."""
    return [tally_job(), *warm.jobs(plans, papers)]
