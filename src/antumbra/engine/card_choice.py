"""Whether a card traces the ray lists of the plan `auto`: only if there is one, and if the gain pays for transfers.

The predicted time of a list is that of its copies, by the measured bandwidth, plus the card's work. Predicted gains are
added up. The card is opened, and its tree uploaded, once the total gain has reached the cost of doing so (the
ski-rental rule), so that at most twice the minimum is lost. Processors that drivers list as devices are never chosen.
"""

from functools import cache
from time import perf_counter

import numpy as np

from ..devices.device import Device
from ..devices.device_list import best_card
from .auto.cost_model import RAY_SECONDS
from .plan import Plan

START_SECONDS = 1.0  # to open a card and compile its kernels by the driver, once per process
LIST_SECONDS = 1e-4  # to launch the kernels of a list, and to wait for them
CARD_RAY_SECONDS = 1e-9  # of a card, until it is measured
_IN, _OUT = 24, 20  # bytes of a ray, and of a nearest hit; a bit suffices for any hit
_TREE = 88  # bytes of a triangle in a tree
_PROBE = 1 << 24  # bytes
_SLOWEST = 3e9  # bytes per second of a bus, until it is measured


@cache
def card() -> str | None:
    """The name of the card that may be chosen; None: there is none."""
    return best_card()


@cache
def _bandwidths(name: str) -> tuple[float, float]:
    """(bytes per second to a card, and from it), measured."""
    from .device_tracers import device_tracer

    device: Device = device_tracer(name).device
    data = device.host_array(_PROBE, np.uint8)
    data[:] = 0
    with device.allocate(_PROBE, "the probe of the bandwidth") as memory:
        seconds = []
        for copy in memory.write, memory.write, memory.read:  # the first copy starts the driver's machinery
            start = perf_counter()
            copy(data)
            seconds.append(perf_counter() - start)
    return _PROBE / seconds[1], _PROBE / seconds[2]


class CardChoice:
    """Decides for the ray lists of one scene.

    triangles : number of triangles
    threads : of the CPU
    """

    def __init__(self, triangles: int, threads: int) -> None:
        self._upload, self._threads = _TREE * triangles, threads
        self._gained, self._open, self._never = 0.0, False, False

    def pays(self, rays: int, any_hit: bool) -> bool:
        """Whether a list is traced on the card; `plan` is then its plan."""
        gain = rays * RAY_SECONDS / self._threads - self._seconds(rays, any_hit)
        if gain <= 0.0 or self._never:
            return False
        if not self._open:
            self._gained += gain
            if self._gained > START_SECONDS + self._upload / _SLOWEST:  # only now, since drivers take time to start
                self._never = card() is None
                self._open = not self._never
        return self._open

    def give_up(self) -> None:
        """Never choose the card again: it failed, or the scene does not fit."""
        self._never, self._open = True, False

    def _seconds(self, rays: int, any_hit: bool) -> float:
        """The predicted time of a list on the card, whose tree is there."""
        there, back = _bandwidths(str(card())) if self._open else (_SLOWEST, _SLOWEST)
        copied_back = rays / 8 if any_hit else rays * _OUT
        return LIST_SECONDS + rays * (CARD_RAY_SECONDS + _IN / there) + copied_back / back

    @property
    def plan(self) -> Plan:
        """The plan on the card."""
        return Plan(build="bsah", trace=f"device:{card()}")
