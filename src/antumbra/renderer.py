"""One frame, or a sequence with state kept between frames: evaluate, G-buffer, cull, build, trace, shade."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .bvh import BUILDERS, OPTIMISERS, UPDATERS
from .bvh.blocks import BlockTree, block_tree
from .bvh.nodes import Bvh
from .chcrt.surfaces import nearest_scheduled, primary_hits
from .cull import CULLERS
from .cull.cull import Culled
from .errors import InputError
from .frame import Clock, Frame
from .image.filter import smoothed
from .image.fraction import as_needed, fraction
from .image.shade import ambient_light
from .indirect import indirect_light
from .job import Job
from .paged import default_plan, paged
from .parallel import thread_count
from .plan import parse_plan
from .query.diffuse import Passes, diffuse_passes
from .query.gbuffer import GBuffer, from_hits
from .query.picture import Surfaces, surfaces_of
from .query.raster import rasterise
from .query.rays import cull_value
from .query.refine import FinerSamples, edges, finer_samples
from .query.sampling import light_samples
from .query.subpixels import block_copies, block_means, subpixel_gbuffer
from .query.surface import seen_by
from .rayhierarchy.soup import soup_of
from .scene.camera import Camera
from .scene.lights import check_lights
from .scene.triangles import Triangles
from .srdh_rays import Showing, Shown, SrdhRays, check_srdh_rays
from .trace.bounce import Nearest, nearest_surfaces
from .trace.counters import as_dict, new_counters
from .trace.primary import trace_primary
from .warm import warm_up, warm_up_bounce, warm_up_indirect, warm_up_paged, warm_up_quality


class Accelerated(NamedTuple):
    """A scene at one moment with its BVH, if the plan has one."""

    triangles: Triangles  # all of them, whatever has been culled
    bvh: Bvh | None  # of those that are left; prim_ids counts in all; None: the tracer walks none
    prepared: Any  # what the plan's tracer takes: the BVH, something made from it, or a `Soup` of those left


class Renderer:
    """Renders frames of one scene by one plan.

    Parameters
    ----------
    scene : Scene
    plan : str, Plan or None
        None: ``"bsah+multifrusta"``; of a scene in a store ``"bsah+chcrt"``.
    threads : int or None
        None: all cores.
    gbuffer : "raster" or "rays"
        How primary visibility is found; both give the same bits. What a store holds is always found by rays.
    srdh_rays : SrdhRays or None
        Which rays a builder is shown that wants some (`srdh`); None: those of 16 x 16 pixels of each frame.
    max_memory : int or None
        Bytes that the process may have in memory at any time, for a scene in a store; None: 4 GiB.
    """

    def __init__(
        self, scene, plan=None, threads=None, gbuffer="raster", srdh_rays: SrdhRays | None = None, max_memory=None
    ):
        if gbuffer not in ("raster", "rays"):
            raise InputError(f'gbuffer is {gbuffer!r}; it must be "raster" or "rays"')
        self.scene, self.plan = scene, parse_plan(default_plan(scene) if plan is None else plan)
        self.threads = thread_count(threads)
        check_srdh_rays(srdh_rays, self.plan)
        self.showing = Showing(srdh_rays or SrdhRays(), self.threads) if self.plan.wants_rays else None
        self.one_tree = self.plan.build is not None and self.showing is None  # for shadow rays and the camera's
        update = self.plan.update  # what it keeps from frame to frame
        self._kept = UPDATERS[update].keep(self._new_tree) if update else None
        self._rays: Callable | None = None  # vertices, BVH of them -> Intersections; while a builder may want them
        self._last: Accelerated | None = None  # of the frames before, where that can be used again
        self.paged = paged(scene, self.plan, self.threads, max_memory)
        self.gbuffer = gbuffer if self.paged is None else "rays"

    def render(
        self, camera, lights, *, spp=16, time=0.0, counters=False, sampler="larcher-pillichshammer", cull_faces=None,
        filter=False, adaptive=None, progress=None, bounce=None,
    ) -> Frame:  # fmt: skip
        """Render a frame; see `antumbra.render`."""
        lights = check_lights(lights)
        if not isinstance(camera, Camera):
            raise InputError(f"camera must be an antumbra.Camera, not {type(camera).__name__}")
        samples, facing = [light_samples(s, spp, sampler) for s in lights], cull_value(cull_faces)
        if adaptive is not None and self.paged is not None:
            raise InputError(f"{self.scene.name}: adaptive sampling wants all triangles at once; leave it out")
        finer = None if adaptive is None else finer_samples(lights, adaptive, sampler)
        passes = None if bounce is None else diffuse_passes(lights, bounce, sampler)
        warm_up(self.plan, self.gbuffer, counters)
        if self.paged is not None:
            warm_up_paged()
        if filter or finer:
            warm_up_quality(self.plan, self.gbuffer)
        if self.showing is not None and self.showing.asked.bounce:
            warm_up_bounce()
        if passes is not None:
            warm_up_indirect(self.plan, self.gbuffer)
        return self.frame(camera, lights, samples, facing, time, counters, progress, bool(filter), finer, passes)

    def frame(
        self, camera, lights, samples, facing=0, time=0.0, counters=False, progress=None, smooth=False,
        finer: FinerSamples | None = None, passes: Passes | None = None,
    ) -> Frame:  # fmt: skip
        """Render a frame from checked arguments: ``samples`` of each light from `light_samples`, ``facing`` a value of
        CULL_FACES, ``smooth``: filter; ``finer``: the samples of refined pixels; ``passes``: of diffuse rays."""
        clock = Clock()
        if self.paged is not None:
            self.paged.begin(camera.width * camera.height, sum(-(-s.shape[1] // 64) for s in samples))
        triangles, whole = self._moment(time)
        clock.lap("evaluate")
        if self.gbuffer == "rays" and whole is None:
            whole = self.build(triangles) if self.one_tree else self.for_camera(triangles)
            clock.lap("build")
        if whole is not None and self.plan.tracer.keeps:
            whole.prepared.begin()
        surfaces = self.look(triangles, camera, whole if self.gbuffer == "rays" else None, progress)
        gbuffer, triangles = surfaces.gbuffer, surfaces.triangles
        clock.lap("gbuffer")
        job = Job(self, triangles, lights, facing, new_counters(counters), progress, clock)
        queries = job.queries(surfaces, samples)
        clock.lap("trace")
        finer_queries = [] if finer is None else [q._replace(samples=s) for q, s in zip(queries, finer.penumbra)]
        shown = job.show(queries, gbuffer, samples, whole)
        job.accelerate([*queries, *finer_queries], whole if self.one_tree else None, shown)
        self._keep(job.accelerated)
        bits = [job.ask(query) for query in queries]
        clock.lap("trace")
        rays = camera.rays(triangles.origin)
        seen = seen_by(gbuffer, rays)
        visibility = [fraction(seen, q, b, smooth, self.threads) for q, b in zip(queries, bits)]
        clock.lap("filter")
        refined = None
        if finer is not None:
            edge = edges(seen, triangles.colour, self.threads)
            refined = edge | job.refine(seen, queries, bits, visibility, finer.penumbra, smooth)
            clock.lap("trace")
        indirect = None
        if passes is not None:
            indirect = indirect_light(job, surfaces, queries[0].origins, passes, job.nearest(whole, shown))
            clock.lap("trace")
            if smooth:
                indirect = smoothed(seen, indirect, self.threads)
                clock.lap("filter")
        arrived = job.arriving(gbuffer, queries, bits, seen if smooth else None)
        ambient = ambient_light(gbuffer, lights, arrived) if indirect is None else np.zeros(3, np.float32)
        image = job.shade(surfaces, arrived, visibility, ambient, indirect)
        clock.lap("shade")
        if finer is not None and edge.any():
            pixels = surfaces_of(subpixel_gbuffer(triangles, rays, edge, self.threads), triangles)
            clock.lap("gbuffer")
            queries = [as_needed(query) for query in job.queries(pixels, finer.edges)]
            clock.lap("trace")
            job.accelerate(queries, job.accelerated, shown)
            fine = [job.ask(query) for query in queries]
            clock.lap("trace")
            around = None if indirect is None else block_copies(indirect[edge], pixels.ids.shape)
            picture = job.picture(pixels, queries, fine, ambient, around)
            image[edge] = block_means(picture, int(np.count_nonzero(edge)))
            clock.lap("shade")
        gbuffer = gbuffer._replace(face=surfaces.ids)
        scheduled = job.accelerated.prepared.told if self.plan.tracer.keeps else None
        paging = None if self.paged is None else self.paged.paging()
        frame = Frame(image, visibility, bits, gbuffer, job.rays, clock.timings(), as_dict(job.tally), refined)
        return frame._replace(indirect=indirect, scheduled=scheduled, paging=paging)

    def accelerate(self, time=0.0) -> Accelerated:
        """The scene's triangles at a time, with their BVH if the plan has one."""
        return self.build(self.scene.triangles(time, self.threads))

    def culled(self, triangles: Triangles, queries) -> Culled | None:
        """The triangles that segments of these queries can meet; None if the plan culls nothing."""
        return CULLERS[self.plan.cull].cull(triangles, queries, self.threads) if self.plan.cull else None

    def show(
        self, triangles: Triangles, queries, bvh: Bvh | None = None, bounce: Callable | None = None
    ) -> Shown | None:
        """The rays that this plan's builder is shown for these queries; None if it wants none. See `Showing.show`."""
        return self.showing.show(queries, triangles, bvh, bounce) if self.showing else None

    def build(self, triangles: Triangles, culled: Culled | None = None, shown: Shown | None = None) -> Accelerated:
        """All triangles, or those that culling left, ready to be traced: with a BVH, unless the tracer walks none.

        `shown` is for a builder that wants rays.

        Raises
        ------
        InputError
            If the builder wants rays, and none are shown.
        """
        if self.plan.build is None:
            return self.prepare(triangles, None, culled)
        if self.showing is not None:
            if shown is None:
                raise InputError(f"plan {str(self.plan)!r}: its builder wants rays of a picture, or of points that ask")
            kept = None if culled is None else culled.kept
            self._rays = lambda vertices, bvh: shown.among(vertices, kept, self.threads, bvh)
        try:
            bvh = self._tree(triangles.vertices if culled is None else culled.vertices)
        finally:
            self._rays = None
        if culled is not None:
            bvh = bvh._replace(prim_ids=culled.kept[bvh.prim_ids])
        if self.showing is not None:
            self.showing.built(bvh)
        return self.prepare(triangles, bvh, culled)

    def _tree(self, vertices) -> Bvh:
        if self._kept is not None:
            return self._kept.update(vertices, self.threads)
        return self._new_tree(vertices, self.threads)

    def _new_tree(self, vertices, threads) -> Bvh:
        assert self.plan.build is not None
        builder, name = BUILDERS[self.plan.build], self.plan.optimise
        bvh = builder.build(vertices, threads, **self._shown_to(builder, vertices))
        if name is None:
            return bvh
        return OPTIMISERS[name].optimise(bvh, threads, **self._shown_to(OPTIMISERS[name], vertices, bvh))

    def _shown_to(self, method, vertices, bvh: Bvh | None = None) -> dict:
        """The arguments of a method that wants rays; `bvh`: of the triangles, if there is one."""
        return {"rays": self._rays(vertices, bvh)} if method.wants_rays and self._rays else {}

    def for_camera(self, triangles: Triangles) -> Accelerated:
        """What the camera's rays are traced through where the plan has no BVH, or one that is made for shadow rays."""
        bvh = BUILDERS["bsah"].build(triangles.vertices, self.threads)
        return Accelerated(triangles, bvh, block_tree(bvh, self.threads))

    def prepare(self, triangles: Triangles, bvh: Bvh | None, culled: Culled | None = None) -> Accelerated:
        """What this plan's tracer takes: made from the BVH that its builder made, if it walks one; else the triangles.

        `culled`: the triangles that are left; None: all.
        """
        made = soup_of(triangles, culled) if bvh is None else bvh
        return Accelerated(triangles, bvh, self.plan.tracer.prepare(made, self.threads))

    def see(self, triangles, camera, accelerated: Accelerated | None = None) -> GBuffer:
        """The G-buffer of a camera: by rasterisation, or by rays where there is a BVH of all triangles."""
        rays = camera.rays(triangles.origin)
        if accelerated is None:
            face, t = rasterise(triangles.vertices.reshape(-1, 9), rays, self.threads)
        else:
            prepared = accelerated.prepared
            if self.plan.tracer.keeps:
                return from_hits(*primary_hits(prepared, rays, self.threads), triangles, rays, self.threads)
            tree = prepared if isinstance(prepared, BlockTree) else accelerated.bvh
            face, t = trace_primary(tree, rays, self.threads)
        return from_hits(face, t, triangles, rays, self.threads)

    def look(self, triangles: Triangles, camera, accelerated: Accelerated | None = None, progress=None) -> Surfaces:
        """The surfaces that a camera sees; arguments as for `see`."""
        if self.paged is not None:
            return self.paged.look(camera, progress)
        return surfaces_of(self.see(triangles, camera, accelerated), triangles)

    def nearest(self, accelerated: Accelerated) -> Nearest:
        """What finds the surfaces that passes of diffuse rays meet first, where there is a BVH of all triangles."""
        if self.paged is not None:
            return self.paged.nearest
        triangles, threads = accelerated.triangles, self.threads
        if self.plan.tracer.keeps:
            return partial(nearest_scheduled, scheduled=accelerated.prepared, triangles=triangles, threads=threads)
        assert accelerated.bvh is not None
        return partial(nearest_surfaces, bvh=accelerated.bvh, triangles=triangles, threads=threads)

    def _moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time, and what traces them all if that is known from the frames before."""
        if self.paged is not None:
            return self.paged.accelerated.triangles, self.paged.accelerated
        if self._last is None:
            return self.scene.triangles(time, self.threads), None
        return self._last.triangles, self._last

    def _keep(self, accelerated: Accelerated) -> None:
        """Keep what has been built for the next frames, if the tracer remembers what it saw, and nothing moves."""
        still = not self.scene.animated and self.plan.cull is None and self.showing is None
        if still and self.plan.tracer.keeps:
            self._last = accelerated

    def answer(self, accelerated: Accelerated, query, tally=None, progress=None) -> np.ndarray:
        """The bits of a ShadowQuery by this plan's tracer, (h, w, ceil(spp / 64)) uint64."""
        bits = np.zeros((*query.sides.shape, -(-query.samples.shape[1] // 64)), np.uint64)
        self.plan.tracer.trace(accelerated.prepared, query, bits, self.threads, tally, progress)
        return bits


def render(
    scene, camera=None, lights=None, *, spp=16, plan=None, time=0.0, threads=None, counters=False,
    gbuffer="raster", sampler="larcher-pillichshammer", cull_faces=None, filter=False,
    adaptive=None, progress=None, srdh_rays=None, bounce=None, max_memory=None,
) -> Frame:  # fmt: skip
    """Render one frame with exact shadows.

    Parameters
    ----------
    scene : Scene
    camera : Camera or None
        None: ``scene.default_camera()``.
    lights : list of lights, one light, or None
        None: the scene's own lights at `time`, or ``scene.default_light()`` if it has none.
    spp : int
        Shadow rays a pixel and light, 1 to 1024; `PointLights`, and `AmbientOcclusion` with an spp, have their own.
    plan : str, Plan or None
        Which methods answer, such as ``"bsah+single"`` (see ``antumbra plans``). Never changes the bits, unless it
        neglects what few rays see (``"bsah+chcrt:20"``). None: ``"bsah+multifrusta"``; of a store ``"bsah+chcrt"``.
    time : float
        Seconds, clamped to [0, scene.duration].
    threads : int or None
        None: all cores.
    counters : bool
        Count tests and nodes exactly (costs a little time).
    gbuffer : "raster" or "rays"
        How primary visibility is found. Never changes the bits.
    sampler : str
        A name in `antumbra.query.sampling.SAMPLERS`.
    cull_faces : None, "front" or "back"
        Triangles that turn this side to a receiver do not block its rays.
    filter : bool
        Smooth the visibility, not the bits, over 4 x 4 pixels of the same surface: 16 times as many samples of the
        light take part where the penumbra is wide. Of interleaved `PointLights` it smooths what arrives from them.
    adaptive : int or None
        Ask again, with this many shadow rays a pixel and light (1 to 1024), in penumbrae, where the new visibility
        replaces the old one; and at edges, where they are divided among 16 sub-pixels, whose mean the pixel of
        the image then is. Lights that have their own numbers of rays keep them, in each sub-pixel too.
    progress : function of (done, total), optional
        Called about ten times a second while rays are traced.
    srdh_rays : SrdhRays or None
        Which rays the builder `srdh` is shown; None: those of 16 x 16 pixels. Never changes the bits.
    bounce : int or None
        Instead of ambient light, light that bounces once: this many diffuse rays a pixel (1 to 1024), each with a
        shadow ray to each light from where it ends. `sampler` spreads them too.
    max_memory : int or None
        Bytes that the process may have in memory, for a scene in a store; None: 4 GiB.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        On a value out of range, an unknown plan, or things that are not cameras and lights.
    """
    camera = scene.default_camera() if camera is None else camera
    if lights is None:
        lights = [scene.light(i, time) for i in range(len(scene.lights))] or [scene.default_light()]
    return Renderer(scene, plan, threads, gbuffer, srdh_rays, max_memory).render(
        camera,
        lights,
        spp=spp,
        time=time,
        counters=counters,
        sampler=sampler,
        cull_faces=cull_faces,
        filter=filter,
        adaptive=adaptive,
        progress=progress,
        bounce=bounce,
    )
