"""What a `Renderer` makes: a frame, and how long each phase of it took."""

from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..query.gbuffer import GBuffer

PHASES = ("evaluate", "gbuffer", "cull", "build", "trace", "filter", "shade")


class Frame(NamedTuple):
    """A rendered frame. H, W: the camera's height and width."""

    image: np.ndarray  # (H, W, 3) float32, linear
    visibility: list[np.ndarray]  # of each light (H, W) float32: share of the light seen; 1 where nothing is
    bits: list[np.ndarray]  # of each light (H, W, ceil(n / 64)) uint64: bit s = its sample s occluded; 0: nothing seen
    gbuffer: GBuffer  # what each pixel sees
    rays: int  # shadow rays asked, also of surfaces that light bounces off; diffuse rays are not counted
    timings: dict[str, float]  # seconds of each of PHASES and "total"; compilation is never inside
    counters: dict[str, int] | None  # sums over the shadow rays (see trace.counters); None unless asked for
    refined: np.ndarray | None = None  # (H, W) bool: penumbrae and edges that were refined; None unless asked for
    indirect: np.ndarray | None = None  # (H, W, 3) float32: irradiance by light that bounced; None unless asked for
    scheduled: list[dict] | None = None  # by CHC+RT: what each question took, see `chcrt.schedule.Statistics`
    paging: dict[str, int] | None = None  # of a store: chunks that came and went, see `store.residency.Paging`

    def save(self, path, exposure: float | None = None) -> None:
        """Write ``.png`` (sRGB; exposure None: automatic) or ``.exr`` (linear; image, visibility, depth, normal).

        Raises
        ------
        InputError
            On another suffix or a path that cannot be written; no partial file is left.
        """
        from ..image.save import save_frame

        save_frame(self, path, exposure)


class Clock:
    """Adds up the seconds of each phase."""

    def __init__(self):
        self.seconds = dict.fromkeys(PHASES, 0.0)
        self.start = self.last = perf_counter()

    def lap(self, phase: str) -> None:
        now = perf_counter()
        self.seconds[phase] += now - self.last
        self.last = now

    def timings(self) -> dict[str, float]:
        return {**self.seconds, "total": self.last - self.start}
