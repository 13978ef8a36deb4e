"""Measures build times of trees for shadow rays [Feltman et al. 2012, Table 1], and the trace time they save.

Methods take turns within each round. The median of the rounds counts.
"""

from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

from ...bvh import binned_sah, srdh
from ...rendering.renderer import Renderer
from ..answers import digest
from ..views import View
from .measure import Workload
from .variants import BUILDERS

PIXELS = (16, 32)  # widths of the pre-renders of Table 1
TRACERS = ("single", "multifrusta", "packet16", "wide")
BUILDS = ("bsah", "srdh")
SPP = 16  # samples of the pictures that are traced


class BuildTimes(NamedTuple):
    """Seconds to build trees for the rays of one pre-render of a `Workload`.

    What the paper measures is measured by one thread, as in the paper. All threads do the rest.
    """

    scene: str
    pixels: int  # width of the pre-render
    triangles: int
    rays: int
    hits: int  # intersections of the rays with triangles
    sah_single: float  # bsah with one triangle in a leaf, one thread
    sah: float  # bsah
    rays_by_sah: float  # making the rays, and finding their intersections by the bsah tree, one thread
    published: float  # srdh:paper, one thread
    rays_by_lbvh: float  # making the rays, and finding their intersections by an lbvh that is built for this
    srdh: float

    @property
    def both(self) -> float:
        """Time to build a SAH tree and a tree for shadow rays, relative to the SAH tree alone.

        This is the paper's ratio, with one triangle in a leaf.
        """
        return (self.sah_single + self.rays_by_sah + self.published) / self.sah_single

    @property
    def instead(self) -> float:
        """Time to build the tree for shadow rays alone, as a `Renderer` does, relative to bsah."""
        return (self.rays_by_lbvh + self.srdh) / self.sah


class RenderTimes(NamedTuple):
    """Seconds of one plan to render the direct light of a view."""

    scene: str
    build: str  # one of BUILDS
    tracer: str
    rays: int
    built: float
    traced: float
    bits: bytes  # digest of the answer


def build_times(view: View, spp: int, threads: int | None, rounds: int, say: Callable[[str], None]) -> list[BuildTimes]:
    """Measure Table 1 for one view; InputError if its camera sees nothing."""
    work, alone = Workload(view, spp, threads), Workload(view, spp, 1)
    laps: dict[int, list[dict[str, float]]] = {k: [] for k in PIXELS}
    counts = {}
    for turn in range(-1, rounds):  # the first turn only warms up
        for k in PIXELS:
            say(f"{view.name}, building for {k} x {k} pixels, round {max(turn, 0) + 1} of {rounds}")
            seconds, counts[k] = _build_once(work, alone, k)
            if turn >= 0:
                laps[k].append(seconds)
    middle = {k: {part: median(lap[part] for lap in laps[k]) for part in laps[k][0]} for k in PIXELS}
    return [BuildTimes(view.name, k, len(work.triangles.vertices), *counts[k], **middle[k]) for k in PIXELS]


def _build_once(work: Workload, alone: Workload, pixels: int) -> tuple[dict[str, float], tuple[int, int]]:
    """Build all trees once; return (seconds of each part, (rays, hits)). `alone` is the same workload of one thread."""
    vertices, threads, seconds = work.triangles.vertices, work.threads, {}

    def timed(part: str, do: Callable):
        start = perf_counter()
        done = do()
        seconds[part] = perf_counter() - start
        return done

    timed("sah_single", lambda: binned_sah.build(vertices, 1, 1))
    timed("sah", lambda: binned_sah.build(vertices, threads))
    met = timed("rays_by_sah", lambda: alone.shown(pixels, alone.sah).among(vertices, None, 1))
    timed("published", lambda: BUILDERS["srdh:paper"].build(vertices, 1, rays=met))
    met = timed("rays_by_lbvh", lambda: work.shown(pixels, None).among(vertices, None, threads))
    timed("srdh", lambda: srdh.build(vertices, threads, rays=met))
    return seconds, (len(met.origins), len(met.prims))


def render_times(view: View, threads: int | None, rounds: int, say: Callable[[str], None]) -> list[RenderTimes]:
    """Measure each of BUILDS with each of TRACERS. The representative rays are the default of a `Renderer`."""
    plans = [(build, tracer) for tracer in TRACERS for build in BUILDS]
    renderers = {plan: Renderer(view.scene, "+".join(plan), threads) for plan in plans}
    seconds: dict[Any, list[tuple[float, float]]] = {plan: [] for plan in plans}
    found: dict[Any, tuple[int, bytes]] = {}
    for turn in range(-1, rounds):  # the first turn only warms up
        for plan, renderer in renderers.items():
            say(f"{view.name}, {renderer.plan}, round {max(turn, 0) + 1} of {rounds}")
            frame = renderer.render(view.camera, view.lights, spp=SPP if turn >= 0 else 1)
            if turn >= 0:
                seconds[plan].append((frame.timings["build"], frame.timings["trace"]))
            found[plan] = frame.rays, digest(frame.bits)
    rows = []
    for plan in plans:
        rays, bits = found[plan]
        built, traced = (median(column) for column in zip(*seconds[plan]))
        rows.append(RenderTimes(view.name, *plan, rays, built, traced, bits))
    return rows
