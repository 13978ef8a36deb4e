"""`render` and `Renderer`: render one frame, or a sequence of frames with cached state, of one scene by one plan."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any, ParamSpec

from ..base.checks import checked_instance, choice, whole_number
from ..base.errors import InputError
from ..base.option_fields import Given, method_with_keywords, split_keywords, with_keywords
from ..base.progress import ProgressCallback, show_progress, with_quiet_progress
from ..engine.accelerator import Accelerated, Accelerator
from ..engine.device_plans import cpu_plan
from ..engine.engine import Engine
from ..engine.measured_scenes import check_degrees
from ..engine.plan import Plan
from ..engine.plan_records import precompile_plan
from ..engine.precompilation import precompile
from ..engine.primary_visibility import AUTO, METHODS, precompiled_method, primary_visibility
from ..engine.scene import AnyScene
from ..engine.scene_loading import SceneLike, scene_of
from ..engine.sources.source_protocols import RenderSource
from ..query.gbuffer import GBuffer
from ..scene.camera import Camera
from ..scene.lights import Light, check_lights
from ..scene.triangles import Triangles
from .frame import Frame, FrameState, TracedBits, cpu_sees_if_full
from .frame_passes import render_frame
from .frame_request import Request, request_of
from .render_options import PBR, EngineOptions, RenderKeywords, RenderOptions, options_of
from .row_bands import RowBands

_P = ParamSpec("_P")


class Renderer:
    """Renders frames of one scene by one plan, and caches state between frames.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        A scene in memory or in a store, a path, or a mesh of another library.
    plan : str, Plan or None
        None: ``"auto"``; for a scene in a store ``"bsah+chcrt"``.
    threads : int or None
        None: all cores.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility; both give the same bits. "auto" rasterizes; once a tree is cached, it uses
        whichever method was faster. Stores and non-perspective cameras always use rays.
    max_memory : int or None
        Limit in bytes on the memory of the process, for scenes in a store; None: see `PagedScene.max_memory`. On a
        device, the limit on the memory taken there; None: all that is free.
    device : str or None
        The device that traces shadow rays, such as ``"cuda"``; see `antumbra.engine.engine.Engine`.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, or the plan cannot render a scene in a store.

    Examples
    --------
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> renderer, camera = at.Renderer(room), room.cameras[0].resized(64, 48)
    >>> lamps = [at.SphereLight((x, 4, 0), 0.5, intensity=100) for x in (-1, 0, 1)]
    >>> frames = [renderer.render(camera, lamp, spp=16) for lamp in lamps]  # they share the tree
    >>> len(frames), frames[0].image.shape
    (3, (48, 64, 3))
    """

    def __init__(
        self,
        scene: SceneLike,
        plan: str | Plan | None = None,
        threads: int | None = None,
        gbuffer: str = AUTO,
        max_memory: int | None = None,
        device: str | None = None,
    ) -> None:
        scene = scene_of(scene)
        choice(gbuffer, "gbuffer", METHODS)
        self.scene, self.engine = scene, Engine(scene, plan, threads, max_memory, gbuffer=gbuffer, device=device)
        self.plan, self.threads = self.engine.plan, self.engine.threads
        self._expected = 1  # frames

    @property
    def accelerator(self) -> Accelerator:
        """The accelerator of the engine."""
        return self.engine.accelerator

    @property
    def source(self) -> RenderSource:
        """The render source of the engine."""
        return self.engine.source

    def expect(self, frames: int) -> None:
        """State how many frames follow, so that the plan `auto` chooses the first frame's methods for all of them.

        Frames of an animated scene choose for themselves.

        Parameters
        ----------
        frames : int
            An estimate; it changes no bit.

        Raises
        ------
        InputError
            If it is not a positive whole number.
        """
        self._expected = whole_number(frames, "frames", 1, 1 << 40)

    @method_with_keywords(RenderOptions, 2)
    @with_quiet_progress
    def render(
        self,
        given: Given[_P],
        camera: Camera,
        lights: Sequence[Light] | Light,
        options: RenderOptions | None = None,
        progress: ProgressCallback | bool | None = None,
        *args: _P.args,
        **keywords: _P.kwargs,
    ) -> Frame:
        """Render one frame.

        Parameters
        ----------
        camera : Camera
        lights : list of lights, or one light
        options : RenderOptions or None
            All options together; further keywords replace single fields.
        progress : function of (done, total), or bool, optional
            As in `antumbra.render`.

        Returns
        -------
        Frame

        Raises
        ------
        InputError
            If a value is out of range, the camera's position is in degrees, or an argument is not a camera or a light.
        """
        request = self.request(camera, lights, options_of(options, given(*args, **keywords)))
        with show_progress("tracing", progress) as report, self.engine.lock:
            frames, self._expected = self._expected, max(self._expected - 1, 1)
            request = request._replace(progress=report, frames=frames)
            while True:
                with cpu_sees_if_full(self.engine):
                    return render_frame(FrameState(self.engine, request))

    def rows(self, request: Request) -> RowBands:
        """Render a request in bands of rows, which can be traced in any order and in any process."""
        return RowBands(self.engine, request)

    def from_rows(self, request: Request, traced: TracedBits) -> Frame:
        """The frame of a request whose rays were traced before, as from `render`, but without the time of tracing."""
        with self.engine.lock:
            while True:
                with cpu_sees_if_full(self.engine):
                    frame = render_frame(FrameState(self.engine, request, traced))
                    return frame._replace(timings={**frame.timings, "trace": 0.0})

    def request(self, camera: Camera, lights: Sequence[Light] | Light, options: RenderOptions | None = None) -> Request:
        """Check the arguments of `render`, and compile the kernels that they need."""
        camera, lights = _check_view(self.scene, camera, lights)
        options = options_of(options, {})
        options = replace(options, time=self.scene.clamped(options.time))
        request = request_of(camera, lights, options, self._ground_height(options))
        self._precompile(request)
        return request

    def _ground_height(self, options: RenderOptions) -> float | None:
        """The height of the shadow-catcher plane; None: no plane."""
        if options.ground is False:
            return None
        return self.scene.ground_height(options.time) if options.ground is True else options.ground

    def _precompile(self, request: Request) -> None:
        """Compile all kernels that the frame calls."""
        gbuffer, options = precompiled_method(self.source.gbuffer), request.options
        selector = self.accelerator.ray_selector
        _precompile_frames(cpu_plan(self.plan), gbuffer, options.counters)
        self.source.warm_up()
        if request.smooth or request.smooth_skies or request.finer is not None:
            precompile("filter and refinement")
        if options.smooths_edges:
            precompile("anti-aliasing")
        data = self.scene.data
        has_looks, has_pbr = (
            data.appearance is not None,
            data.appearance is not None and data.appearance.pbr is not None,
        )
        if (looks := data.stored_looks) is not None:
            has_looks, has_pbr = True, looks.has_pbr
        if (options.textures or options.smooth_normals) and has_looks:
            precompile("textures and normals")
        if options.materials == PBR and has_pbr:
            precompile("materials")
        if selector is not None and selector.asked.bounce:
            precompile("a diffuse bounce")
        if request.camera.listed:
            precompile("orthographic and panoramic cameras")
        if request.passes:
            precompile(f"light that bounces ({gbuffer})")
        if request.ground is not None:
            precompile("a ground")

    def accelerate(self, time: float = 0.0) -> Accelerated:
        """The scene's triangles at a time in seconds, with their BVH if the plan builds one."""
        return self.accelerator.build(self.scene.triangles(time, self.threads))

    def see(self, triangles: Triangles, camera: Camera, accelerated: Accelerated | None = None) -> GBuffer:
        """The G-buffer of a camera: by rays through `accelerated`; by rasterisation if it is None."""
        return primary_visibility(triangles, camera, accelerated, self.threads)


@cache
def _precompile_frames(plan: Plan, gbuffer: str, counters: bool) -> None:
    """Compile the kernels with which a plan renders.

    Plugins and unrecorded combinations of methods may call kernels without a record; an example frame finds them.
    """
    if precompile_plan(plan, gbuffer, counters):
        from .example_calls import PLAIN, example_frame  # most processes need no example

        example_frame(plan, gbuffer, replace(PLAIN, counters=counters))


def _check_view(scene: AnyScene, camera: Any, lights: Any) -> tuple[Camera, list[Light]]:
    """Check the camera and the lights, and their order."""
    if isinstance(lights, Camera) or (isinstance(camera, (Light, list, tuple)) and not isinstance(camera, Camera)):
        raise InputError("camera and lights are in the wrong order; write render(scene, camera, lights)")
    camera = checked_instance(camera, Camera, "camera")
    check_degrees(scene, camera.position[None], "camera positions")
    return camera, check_lights(lights, scene.up)


@with_keywords(RenderKeywords, 3)
@with_quiet_progress
def render(
    given: Given[_P],
    scene: SceneLike,
    camera: Camera | None = None,
    lights: Sequence[Light] | Light | None = None,
    options: RenderOptions | None = None,
    progress: ProgressCallback | bool | None = None,
    *args: _P.args,
    **keywords: _P.kwargs,
) -> Frame:
    """Render one frame with exact shadows.

    A shadow ray is occluded if a triangle intersects its segment strictly between receiver and light sample.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        A scene in memory or in a store, a path, or a mesh of another library.
    camera : Camera or None
        None: ``scene.default_camera(time=time)``.
    lights : list of lights, one light, or None
        None: ``scene.default_lights(time)``, the scene's own lights or daylight.
    options : RenderOptions or None
        All options of the picture together; further keywords replace single fields.
    progress : function of (done, total), or bool, optional
        Called about ten times per second while rays are traced. False: no display. None: terminals and notebooks show
        a progress bar after one second.

    Returns
    -------
    Frame
        With the image, (H, W, 3) float32, the visibility, the bits and the timings.

    Raises
    ------
    InputError
        If a value is out of range, the plan is unknown, the camera's position is in degrees, or an argument is not a
        camera or a light.

    Examples
    --------
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> frame = at.render(room, room.cameras[0].resized(64, 48), room.lights, spp=16)
    >>> frame.image.shape, frame.visibility[0].shape, frame.names
    ((48, 64, 3), (48, 64), ('quad',))
    >>> frame.save("room.png")  # doctest: +SKIP
    """
    of_renderer, of_picture = split_keywords(given(*args, **keywords), EngineOptions)
    picture_options, scene = options_of(options, of_picture), scene_of(scene)
    if camera is None:
        camera = scene.default_camera(time=picture_options.time)
    if lights is None:
        lights = scene.default_lights(picture_options.time)
    renderer = Renderer(scene, **of_renderer)
    request = renderer.request(camera, lights, picture_options)
    with show_progress("tracing", progress) as report, renderer.engine.lock:
        request = request._replace(progress=report)
        while True:
            with cpu_sees_if_full(renderer.engine):
                return render_frame(FrameState(renderer.engine, request))
