"""One frame's work: its queries are made, asked and shaded, for what the camera or sub-pixels of it see."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ..image.fraction import refine_penumbra
from ..image.shade import arriving, shade
from ..query.picture import Surfaces, shadow_queries, surface_queries
from ..query.receivers import NOTHING
from ..query.shadow import ShadowQuery, fraction_lit
from ..trace.rays.bounce import Nearest, bounced
from .srdh_rays import Shown, fewer_samples, sparse_gbuffer

if TYPE_CHECKING:
    from .accelerate import Accelerated
    from .renderer import Renderer


class Job:
    """One frame: asks about, and shades, what its camera or sub-pixels of it see."""

    def __init__(self, renderer: "Renderer", triangles, lights, facing, tally, progress, clock):
        self.renderer, self.triangles, self.lights, self.facing = renderer, triangles, lights, facing
        self.tally, self.progress, self.clock, self.threads = tally, progress, clock, renderer.threads
        self.rays = 0  # asked so far

    def queries(self, surfaces: Surfaces, samples) -> list[ShadowQuery]:
        """The query of each light, with these samples of each."""
        return surface_queries(surfaces, self.lights, samples, self.facing, self.threads)

    def show(self, queries, gbuffer, samples, whole: "Accelerated | None") -> Shown | None:
        """The rays that the builder is shown for this frame; None if it wants none."""
        bounce = bounced_queries(self.renderer, self.triangles, gbuffer, self.lights, samples, self.facing)
        return self.renderer.show(self.triangles, queries, None if whole is None else whole.bvh, bounce)

    def accelerate(self, queries, ready: "Accelerated | None", shown: Shown | None) -> None:
        """Make ready for these queries; `ready`: what can trace them if nothing is culled, `shown`: for the builder."""
        culled = self.renderer.culled(self.triangles, queries)
        if culled is not None:
            self.clock.lap("cull")
        if culled is not None or ready is None:
            ready = self.renderer.build(self.triangles, culled, shown)
        self.accelerated = ready
        self.clock.lap("build")

    def nearest(self, whole: "Accelerated | None", shown: Shown | None) -> Nearest:
        """Make ready for queries of any surfaces, whatever has been culled; what finds the nearest hits of ray passes.

        whole, shown : as for `accelerate`; `whole` may be for the camera's rays only
        """
        renderer = self.renderer
        if renderer.plan.cull:
            ready = whole if renderer.one_tree else None
            self.accelerated = ready or renderer.build(self.triangles, None, shown)
        trees = self.accelerated if renderer.one_tree else whole or renderer.for_camera(self.triangles)
        self.clock.lap("build")
        return renderer.nearest(trees)

    def ask(self, query: ShadowQuery) -> np.ndarray:
        self.rays += int(np.count_nonzero(query.sides != NOTHING)) * query.samples.shape[1]
        return self.renderer.answer(self.accelerated, query, self.tally, self.progress)

    def refine(self, seen, queries, bits, visibility, samples, smooth) -> np.ndarray:
        """Ask again in penumbrae and replace their visibility; (H, W) bool, where any light's was."""
        refined = np.zeros(seen.side.shape, np.bool_)
        for i, sets in enumerate(samples):
            finer, better = refine_penumbra(seen, queries[i], bits[i], sets, self.ask, smooth, self.threads)
            chosen = finer.sides != NOTHING
            visibility[i] = np.where(chosen, better, visibility[i])
            refined |= chosen
        return refined

    def arriving(self, gbuffer, queries, bits, seen=None) -> list[np.ndarray]:
        """What each light gives to each pixel's surface; see `image.shade.arriving`."""
        lqb = zip(self.lights, queries, bits)
        return [arriving(gbuffer, light, query, b, seen, self.threads) for light, query, b in lqb]

    def shade(self, surfaces: Surfaces, arrived, visibility, ambient, indirect=None) -> np.ndarray:
        """The image."""
        colour, up = surfaces.triangles.colour, self.renderer.scene.up
        return shade(surfaces.gbuffer, colour, self.lights, arrived, visibility, ambient, up, indirect, self.threads)

    def picture(self, surfaces: Surfaces, queries, bits, ambient, indirect=None) -> np.ndarray:
        """The image by the bits of these queries, as they are."""
        shares = [fraction_lit(b, query.samples.shape[1], self.threads) for query, b in zip(queries, bits)]
        return self.shade(surfaces, self.arriving(surfaces.gbuffer, queries, bits), shares, ambient, indirect)


def bounced_queries(renderer: "Renderer", triangles, gbuffer, lights, samples, facing=0) -> Callable:
    """Function of a `Bvh` of all triangles -> queries of what diffuse rays meet, one from each of the pixels shown."""

    def bounce(bvh):
        assert renderer.showing is not None
        asked, threads = renderer.showing.asked, renderer.threads
        surfaces = bounced(sparse_gbuffer(gbuffer, asked), triangles, bvh, threads=threads)
        fewer = [fewer_samples(sets, asked.spp) for sets in samples]
        return shadow_queries(triangles, surfaces, lights, fewer, facing, threads)

    return bounce
