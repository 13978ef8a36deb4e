"""One frame, or a sequence with state kept between frames: evaluate, G-buffer, cull, build, trace, shade."""

from functools import partial

import numpy as np

from ..bvh.blocks import BlockTree
from ..chcrt.surfaces import nearest_scheduled, primary_hits
from ..errors import InputError
from ..image.filter import smoothed
from ..image.fraction import as_needed, fraction
from ..image.shade import ambient_light
from ..kernels.parallel import thread_count
from ..plan import parse_plan
from ..query.diffuse import Passes, diffuse_passes
from ..query.gbuffer import GBuffer, from_hits
from ..query.picture import Surfaces, surfaces_of
from ..query.raster import rasterise
from ..query.rays import cull_value
from ..query.refine import FinerSamples, edges, finer_samples
from ..query.sampling import light_samples
from ..query.subpixels import block_copies, block_means, subpixel_gbuffer
from ..query.surface import seen_by
from ..scene.camera import Camera
from ..scene.lights import check_lights
from ..scene.triangles import Triangles
from ..trace.counters import as_dict, new_counters
from ..trace.primary.trace import trace_primary
from ..trace.rays.bounce import Nearest, nearest_surfaces
from .accelerate import Accelerated, Accelerator
from .frame import Clock, Frame
from .indirect import indirect_light
from .job import Job
from .paged import default_plan, paged
from .srdh_rays import SrdhRays
from .warm import warm_up, warm_up_bounce, warm_up_indirect, warm_up_paged, warm_up_quality


class Renderer(Accelerator):
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
        super().__init__(parse_plan(default_plan(scene) if plan is None else plan), thread_count(threads), srdh_rays)
        self.scene = scene
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
            warm_up_quality()
        if self.showing is not None and self.showing.asked.bounce:
            warm_up_bounce()
        if passes is not None:
            warm_up_indirect(self.gbuffer)
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
        job = Job(self, triangles, lights, facing, new_counters() if counters else None, progress, clock)
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
        counted = as_dict(job.tally) if counters else None
        frame = Frame(image, visibility, bits, gbuffer, job.rays, clock.timings(), counted, refined)
        return frame._replace(indirect=indirect, scheduled=scheduled, paging=paging)

    def accelerate(self, time=0.0) -> Accelerated:
        """The scene's triangles at a time, with their BVH if the plan has one."""
        return self.build(self.scene.triangles(time, self.threads))

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
