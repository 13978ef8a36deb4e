"""Render one frame, or a sequence of frames with state kept between them, of one scene by one plan."""

from collections.abc import Sequence

import numpy as np

from ..checks import choice, flag, instance, number
from ..engine.accelerate import Accelerated
from ..engine.engine import Engine
from ..engine.loading import SceneLike, scene_of
from ..engine.looking import AUTO, METHODS, compiled_for
from ..engine.see import see
from ..engine.source import Progress
from ..errors import InputError
from ..image.background import skies_of
from ..kernels.progress import hushed, shown
from ..plan import Plan
from ..query.diffuse import diffuse_passes
from ..query.gbuffer import GBuffer
from ..query.rays import cull_value
from ..query.refine import finer_samples
from ..query.sampling import light_samples
from ..scene.camera import Camera
from ..scene.lights import Light, check_lights
from ..scene.triangles import Triangles
from .frame import Frame
from .passes import draw
from .render_jobs import (
    warm_up,
    warm_up_antialias,
    warm_up_bounce,
    warm_up_dressed,
    warm_up_ground,
    warm_up_indirect,
    warm_up_listed,
    warm_up_quality,
)
from .request import Request
from .rows import Rows
from .state import KeptRows

MAX_HEIGHT = 1e30
"""Of a ground, up or down: float32 holds it, as it does positions of cameras."""


class Renderer:
    """Renders frames of one scene by one plan, and keeps state from frame to frame.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        A scene in memory or in a store, a path, or a mesh of another library.
    plan : str, Plan or None
        None: ``"auto"``; for a scene in a store ``"bsah+chcrt"``.
    threads : int or None
        None: all cores.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility; both give the same bits. "auto" is raster, or rays through a tree that an
        earlier frame has kept, whichever was faster. A store, and a camera that is not perspective, always use rays.
    max_memory : int or None
        Limit in bytes on the memory of the process at any time, for a scene in a store; None: 4 GiB.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, or the plan cannot render a scene in a store.
    """

    def __init__(
        self,
        scene: SceneLike,
        plan: str | Plan | None = None,
        threads: int | None = None,
        gbuffer: str = AUTO,
        max_memory: int | None = None,
    ):
        scene = scene_of(scene)
        choice(gbuffer, "gbuffer", METHODS)
        self.scene, self.engine = scene, Engine(scene, plan, threads, max_memory, gbuffer=gbuffer)
        self.plan, self.threads = self.engine.plan, self.engine.threads
        self.accelerator, self.source = self.engine.accelerator, self.engine.source

    @hushed
    def render(
        self, camera: Camera, lights: Sequence[Light] | Light, *, spp: int = 16, time: float = 0.0,
        counters: bool = False, sampler: str = "larcher-pillichshammer", cull_faces: str | None = None,
        filter: bool | None = None, adaptive: int | None = None, progress: Progress | bool | None = None,
        bounce: int | None = None, background: bool = True, layers: bool = False, textures: bool = True,
        smooth_normals: bool = True, ground: bool | float = False, antialias: bool = True,
    ) -> Frame:  # fmt: skip
        """Render one frame; `antumbra.render` documents the parameters."""
        request = self.request(
            camera, lights, spp=spp, time=time, counters=counters, sampler=sampler, cull_faces=cull_faces,
            filter=filter, adaptive=adaptive, bounce=bounce, background=background, layers=layers, textures=textures,
            smooth_normals=smooth_normals, ground=ground, antialias=antialias,
        )  # fmt: skip
        with shown("tracing", progress) as heard:
            return draw(self.source, self.accelerator, request._replace(progress=heard))

    def rows(self, request: Request) -> Rows:
        """The picture of a request in bands of rows, to be traced one by one, in any order and in any process."""
        return Rows(self.source, self.accelerator, request)

    def from_rows(self, request: Request, kept: KeptRows) -> Frame:
        """The frame of a request whose rays were traced before: that of `render`, without the time of tracing."""
        frame = draw(self.source, self.accelerator, request, kept)
        return frame._replace(timings={**frame.timings, "trace": 0.0})

    def request(
        self, camera: Camera, lights: Sequence[Light] | Light, *, spp: int = 16, time: float = 0.0,
        counters: bool = False, sampler: str = "larcher-pillichshammer", cull_faces: str | None = None,
        filter: bool | None = None, adaptive: int | None = None, bounce: int | None = None, background: bool = True,
        layers: bool = False, textures: bool = True, smooth_normals: bool = True, ground: bool | float = False,
        antialias: bool = True,
    ) -> Request:  # fmt: skip
        """The checked arguments of `render`. The kernels that they need are compiled."""
        camera, lights = _checked_view(self.scene, camera, lights)
        time = self.scene.clamped(time)
        samples, facing = [light_samples(s, spp, sampler) for s in lights], cull_value(cull_faces)
        finer = None if adaptive is None else finer_samples(lights, adaptive, sampler)
        passes = None if bounce is None else diffuse_passes(lights, bounce, sampler)
        request = Request(
            camera,
            lights,
            samples,
            facing,
            time,
            flag(counters, "counters"),
            None,
            filter is not None and flag(filter, "filter"),
            finer,
            passes,
            flag(background, "background"),
            (filter is None or bool(filter)) and bool(skies_of(lights)),
            flag(layers, "layers"),
            flag(textures, "textures"),
            flag(smooth_normals, "smooth_normals"),
            self._ground(ground, time),
            flag(antialias, "antialias"),
        )
        self._warm_up(request)
        return request

    def _ground(self, ground: bool | float, time: float) -> float | None:
        """The height of the ground that the argument `ground` of `render` asks for."""
        given = ground is not None and (not isinstance(ground, (bool, np.bool_)) or bool(ground))
        if not given:
            return None
        if self.source.in_store:
            raise InputError(f"{self.scene.name}: no ground catches the shadows of a scene in a store; leave it out")
        if isinstance(ground, (bool, np.bool_)):
            return self.scene.ground_height(time)
        return number(ground, "ground (height)", -MAX_HEIGHT, MAX_HEIGHT)

    def _warm_up(self, request: Request) -> None:
        """Compile all kernels that the frame calls."""
        gbuffer, showing = compiled_for(self.source.gbuffer), self.accelerator.showing
        warm_up(self.plan, gbuffer, request.counters)
        self.source.warm_up()
        if request.smooth or request.smooth_skies or request.finer is not None:
            warm_up_quality()
        if request.smooths_edges:
            warm_up_antialias()
        if (request.textures or request.smooth_normals) and self.scene.appearance is not None:
            warm_up_dressed()
        if showing is not None and showing.asked.bounce:
            warm_up_bounce()
        if request.camera.listed:
            warm_up_listed()
        if request.passes is not None:
            warm_up_indirect(gbuffer)
        if request.ground is not None:
            warm_up_ground()

    def accelerate(self, time=0.0) -> Accelerated:
        """The scene's triangles at a time in seconds, with their BVH if the plan has one."""
        return self.accelerator.build(self.scene.triangles(time, self.threads))

    def see(self, triangles: Triangles, camera, accelerated: Accelerated | None = None) -> GBuffer:
        """The G-buffer of a camera: by rays through `accelerated`; by rasterisation if it is None."""
        return see(triangles, camera, accelerated, self.threads)


def _checked_view(scene, camera, lights) -> tuple[Camera, list[Light]]:
    """The camera and the list of lights of a picture; the order of `render` is scene, camera, lights."""
    if isinstance(lights, Camera) or (isinstance(camera, (Light, list, tuple)) and not isinstance(camera, Camera)):
        raise InputError("camera and lights stand in the wrong order; write render(scene, camera, lights)")
    return instance(camera, Camera, "camera"), check_lights(lights, scene.up)


@hushed
def render(
    scene: SceneLike, camera: Camera | None = None, lights: Sequence[Light] | Light | None = None, *,
    spp: int = 16, plan: str | Plan | None = None, time: float = 0.0, threads: int | None = None,
    counters: bool = False, gbuffer: str = AUTO, sampler: str = "larcher-pillichshammer",
    cull_faces: str | None = None, filter: bool | None = None, adaptive: int | None = None,
    progress: Progress | bool | None = None, bounce: int | None = None,
    max_memory: int | None = None, background: bool = True, layers: bool = False, textures: bool = True,
    smooth_normals: bool = True, ground: bool | float = False, antialias: bool = True,
) -> Frame:  # fmt: skip
    """Render one frame with exact shadows.

    A shadow ray is occluded if a triangle meets its segment strictly between receiver and light sample.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        A scene in memory or in a store, a path, or a mesh of another library.
    camera : Camera or None
        None: ``scene.default_camera(time=time)``.
    lights : list of lights, one light, or None
        None: ``scene.default_lights(time)``, the scene's own lights or daylight.
    spp : int
        Shadow rays per pixel and light, 1 to 1024. `PointLights`, and `AmbientOcclusion` with its own spp, ignore it.
    plan : str, Plan or None
        The methods, such as ``"bsah+single"`` (see ``antumbra plans``). A plan never changes the bits, unless it
        neglects geometry that few rays see (``"bsah+chcrt:20"``). None: ``"auto"``, which chooses the methods; for a
        store ``"bsah+chcrt"``.
    time : float
        Seconds, clamped to [0, scene.duration].
    threads : int or None
        None: all cores.
    counters : bool
        Count tests and nodes exactly (costs a little time).
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility, as for `Renderer`. It never changes the bits.
    sampler : str
        A name in `antumbra.query.sampling.SAMPLERS`.
    cull_faces : None, "front" or "back"
        Triangles whose given side faces the receiver do not block its rays.
    filter : bool or None
        Smooth the visibility, but not the bits, over 4 x 4 pixels of the same surface. In wide penumbrae each pixel
        then uses 16 times as many samples of the light. For interleaved lists of lights the irradiance is smoothed.
        None: only the irradiance of a `Sky` is smoothed.
    adaptive : int or None
        Refine with this many shadow rays per pixel and light, 1 to 1024; None: no refinement. In penumbrae the new
        visibility replaces the old one. At edges the rays are divided among 16 sub-pixels, and the image pixel is
        their mean. Lights with their own numbers of rays keep them, in each sub-pixel too.
    progress : function of (done, total), or bool, optional
        Called about ten times a second while rays are traced. False: nothing is shown. None: terminals and notebooks
        show a bar after a second.
    bounce : int or None
        Replace ambient light by light that bounces once: this many diffuse rays per pixel, 1 to 1024. Each diffuse
        ray has a shadow ray to each light from its end. `sampler` distributes the diffuse rays too.
    max_memory : int or None
        Limit in bytes on the memory of the process, for a scene in a store; None: 4 GiB.
    background : bool
        Whether pixels that see no surface show the skies among the lights. Without a sky, they are black in the image,
        and a PNG shows a soft daylight there, which sheds no light. If False, they are black.
    layers : bool
        Keep base colours, the image of each light alone, and objects in `Frame.layers`; EXR files then have them.
    textures : bool
        Show textures and colours of vertices. If not, each face has its mean colour, `Scene.colours`.
    smooth_normals : bool
        Shade with the normals of vertices, if the scene has them. If not, each face has its own. Neither changes the
        bits or the visibility: shadows stay on the geometric surface.
    ground : bool or float
        A level ground below the scene, of which only the shadows are seen. True: just under the lowest point of this
        moment; a number: at this height along the scene's up axis, in world units (see `Scene.ground_height`). Pixels
        that see it show what is behind, times the light that arrives over the light that would without shadows.
        `Frame.ground` has its visibility. It blocks no ray, changes no other pixel and is not in `Frame.mask`. It is
        not seen from below, and a store has none.
    antialias : bool
        Smooth the edges of surfaces in the image, its coverage and the light of its layers, at next to no cost: pixels
        at an edge are mixed with their neighbours across it, by the shape of the edge. No ray is traced, and neither
        bits, visibility nor G-buffer change. `adaptive` smooths edges better, and replaces it. If False, each pixel
        shows what its centre sees.

    Returns
    -------
    Frame
        The image (H, W, 3) float32, and the visibility, bits and timings.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, or an argument is not a camera or a light.
    """
    scene = scene_of(scene)
    if camera is None:
        camera = scene.default_camera(time=time)
    if lights is None:
        lights = scene.default_lights(time)
    return Renderer(scene, plan, threads, gbuffer, max_memory).render(
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
        background=background,
        layers=layers,
        textures=textures,
        smooth_normals=smooth_normals,
        ground=ground,
        antialias=antialias,
    )
