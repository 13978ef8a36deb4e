"""Ray lists of the plan `auto` if there may be a card: traced there once that pays, until then by the next source."""

from ...devices.device import DeviceError
from ...query.ray_list import RayArguments, TracedRays
from ..accelerator import SceneTrees
from ..auto_accelerator import accelerator_of
from ..card_choice import CardChoice
from .device_ray_lists import DeviceRayLists
from .source_protocols import HitSource


class CardRays:
    """Traces ray lists on the card that `CardChoice` chooses, or by the next source: a `HitSource`."""

    def __init__(self, trees: SceneTrees, threads: int, following: HitSource) -> None:
        self._trees, self._threads, self._following = trees, threads, following
        self._choice = CardChoice(trees.data.n_triangles, threads)
        self._on_card: DeviceRayLists | None = None

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        """The hits of rays. InputError if a ray is invalid."""
        if self._choice.pays(rays.n, any_hit):
            try:
                if self._on_card is None:
                    self._on_card = DeviceRayLists(self._trees, accelerator_of(self._choice.plan, self._threads))
                return self._on_card.trace_rays(rays, any_hit, threads)
            except DeviceError:  # of no interest to a user who has not asked for a device
                self._choice.give_up()
        return self._following.trace_rays(rays, any_hit, threads)
