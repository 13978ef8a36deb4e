"""When the plan `auto` loads the kernels of methods that first pictures do without."""

from functools import cache
from math import inf
from typing import ClassVar

from ...kernels.toolchain.kernel_loading import has_compiler
from ...kernels.toolchain.kernel_manifest import kernels_of_warm_up
from ..precompilation import missing_of
from .cost_model import GOOD, GUIDED, cost_of


class KernelLoads:
    """Decides when methods are worth loading: their kernels take time, once per process.

    By the ski-rental rule, a method is loaded once the queries so far would have gained that time.
    """

    SECONDS: ClassVar[dict[str, float]] = {"culling": 0.02, GUIDED: 0.03}  # of tracers: `Cost.load`

    def __init__(self) -> None:
        self._due = dict(self.SECONDS)  # method -> seconds still to be gained; 0: loaded

    def pays(self, method: str, gain: float, load: float = 0.0) -> bool:
        """Whether a method that gains `gain` seconds in a query should be used, and so loaded.

        load : seconds to load a method that is not in SECONDS
        """
        if gain <= 0.0:
            return False
        self._due[method] = max(self._due.get(method, load) - gain, 0.0)
        return self._due[method] == 0.0


TRACER_LOADS = KernelLoads()
"""Of tracers that `auto` tries."""


def worth_loading(tracers: list[str], seconds: float) -> list[str]:
    """The tracers that are loaded, or should be for a query that takes `seconds` by the others.

    seconds : 0: none is loaded for this query
    """
    costs = {name: cost_of(name) for name in tracers}
    return [
        name
        for name, cost in costs.items()
        if not cost.load or TRACER_LOADS.pays(name, cost.saving * seconds, _load_seconds(name))
    ]


@cache
def _load_seconds(tracer: str) -> float:
    """Predicted seconds until a tracer's kernels are loaded, including compiling those that are not on disk."""
    missing = missing_of(kernels_of_warm_up(f"{GOOD}+{tracer} (raster)") or ())
    return cost_of(tracer).load + (sum(each.seconds for each in missing) if has_compiler() or not missing else inf)
