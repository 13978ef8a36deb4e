"""The parsed arguments of ``antumbra render``: everything that determines its pictures, except the time."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..rendering.keywords import deciding, values
from ..rendering.options import EngineOptions, RenderOptions
from . import arguments, report
from .arguments import CameraSpec, SceneSpec
from .ground import ground_of
from .sceneinput import limit_memory

if TYPE_CHECKING:
    import numpy as np

    from ..bvh.srdh_rays import SrdhRays
    from ..engine.scene import AnyScene
    from ..jobs.engines import Engine
    from ..plan import Plan
    from ..rendering.frame import Frame
    from ..rendering.renderer import Renderer
    from ..scene.camera import Camera
    from ..scene.lights import Light


class PictureSpec(NamedTuple):
    """The picture that ``antumbra render`` or ``compare`` was asked for."""

    source: str  # the scene as it was written
    spec: SceneSpec
    up: str | None
    size: tuple[int, int]  # width, height
    camera: int | CameraSpec | None
    lights: list  # lights, and indices of the scene's own
    sky: "str | Path | np.ndarray | None"  # from `parse_sky`
    behind: "str | np.ndarray | None"  # background from `parse_background`; None: the sky
    ambient: list  # ambient occlusion, or nothing
    vpl: int | None  # number of photons
    ground: str | float  # from `parse_ground`
    picture: RenderOptions  # `options` completes them
    engine: EngineOptions  # plan None: the default for the kind of scene
    srdh_rays: "SrdhRays | None"  # rays that the plan's builder is shown
    exposure: float | None  # None: automatic
    json: bool
    quiet: bool
    moving: bool  # whether the pictures are the frames of an animation

    def check(self, *plans: "str | Plan") -> None:
        """Raise InputError for errors that can be detected before a scene is read.

        plans : plans that are compared, instead of the one among the options
        """
        from ..picture.image_files import checked_exposure
        from ..plan import DEFAULT_PLAN, parse_plan, with_sample

        if self.exposure is not None:
            checked_exposure(self.exposure)
        plan = self.engine.plan
        if self.srdh_rays is not None or plan is not None:  # plans of a comparison are parsed already
            with_sample([parse_plan(each) for each in plans or [plan or DEFAULT_PLAN]], self.srdh_rays)

    def about(self, scene: "AnyScene") -> "PictureSpec":
        """This, with the default plan for the kind of scene if none was named."""
        from ..engine.engine import default_plan_of

        if self.engine.plan is not None:
            return self
        return self._replace(engine=replace(self.engine, plan=default_plan_of(scene.data)))

    def renderer(self, scene: "AnyScene") -> "Renderer":
        from .. import Renderer
        from ..plan import DEFAULT_PLAN, parse_plan, with_sample

        limit_memory(scene, self.engine.max_memory)
        asked = values(self.engine)
        if self.srdh_rays is not None:
            (asked["plan"],) = with_sample([parse_plan(self.engine.plan or DEFAULT_PLAN)], self.srdh_rays)
        return Renderer(scene, **asked)

    @property
    def _no_sky(self) -> bool:
        return isinstance(self.sky, str)

    def view(self, scene: "AnyScene", time: float) -> "Camera":
        """The camera at a time."""
        return arguments.make_camera(self.camera, scene, time, self.size, self.moving)

    def ground_height(self, scene: "AnyScene", time: float) -> float | None:
        """The height of the ground at a time; None: there is none. All frames of an animation have the same."""
        if self.moving:
            return ground_of(self.ground, scene, self.view(scene, 0.0), None)
        return ground_of(self.ground, scene, self.view(scene, time), time)

    def direct_lights(self, scene: "AnyScene", time: float) -> "list[Light]":
        """The lights at a time, without the virtual point lights made from photons."""
        return arguments.make_picture_lights(self.lights, self.sky, scene, time) + self.ambient

    def all_lights(self, scene: "AnyScene", time: float) -> "list[Light]":
        """The lights at a time, with the virtual point lights made from photons."""
        from .. import virtual_point_lights
        from ..picture.shading import skies_of

        lights = self.direct_lights(scene, time)
        if self.vpl is not None:
            sources, threads = [lights[0], *skies_of(lights[1:])], self.engine.threads
            lights += [virtual_point_lights(scene, s, self.vpl, time=time, threads=threads) for s in sources]
        return lights

    def options(self, scene: "AnyScene", time: float, layers: bool = False) -> RenderOptions:
        """The options of the picture of a time; `layers`: it keeps its image light by light, for an EXR file."""
        ground = self.ground_height(scene, time)
        return replace(
            self.picture,
            time=scene.clamped(time),
            ground=False if ground is None else ground,
            background=self.behind is None and not self._no_sky,
            layers=layers,
        )

    def shot(self, scene: "AnyScene", renderer: "Renderer", time: float, progress, layers: bool = False) -> "Shot":
        """Render a frame at a time; ``progress(text, runs)`` returns a progress function for `runs` traced queries."""
        camera, lights, options = self._asked(scene, time, layers)
        pictures = (1 if options.adaptive is None else 3) * (1 if options.ground is False else 2)
        runs = len(lights) * (pictures + (options.bounce or 0)) + renderer.source.looks
        frame = renderer.render(camera, lights, options=options, progress=progress("tracing shadow rays", runs))
        return Shot(camera, lights, options, frame)

    def shot_in_bands(
        self, scene: "AnyScene", time: float, engine: "Engine", digest: str, layers: bool = False
    ) -> "Shot | None":
        """The same frame, whose rays an engine traces; None if it leaves some to other processes."""
        from ..jobs.bands import render_bands

        camera, lights, options = self._asked(scene, time, layers)
        settings = self.settings(scene, digest, time)
        frame = render_bands(self.renderer(scene), camera, lights, options, engine, digest, settings)
        return None if frame is None else Shot(camera, lights, options, frame)

    def _asked(self, scene: "AnyScene", time: float, layers: bool) -> "tuple[Camera, list[Light], RenderOptions]":
        return self.view(scene, time), self.all_lights(scene, time), self.options(scene, time, layers)

    def record(self, options: RenderOptions) -> dict:
        """Names and values of the options of a picture and of its engine, for ``--json``."""
        rays = self.srdh_rays
        own = {"srdh_rays": None if rays is None else report.srdh_rays_fields(rays)}
        return {**values(options), **values(self.engine), **own}

    def settings(self, scene: "AnyScene", digest: str, time: float) -> dict:
        """The settings that decide the picture of a time, in the types of JSON.

        An exact plan, its rays, the method of the G-buffer and the threads change no bit, and are left out. So is the
        exposure.
        """
        from ..plan import parse_plan
        from ..version import VERSION as __version__

        plan = None if self.engine.plan is None else parse_plan(self.engine.plan)
        return report.plain(
            {
                "version": __version__,
                "scene": digest,
                "up": scene.up,
                "camera": report.camera_fields(self.view(scene, time)),
                "lights": [report.light_fields(light) for light in self.direct_lights(scene, time)],
                "vpl": self.vpl,
                **deciding(self.options(scene, time)),
                "behind": self.behind,
                **({} if plan is None or plan.tracer.exact else {"plan": str(plan)}),
            }
        )


class Shot(NamedTuple):
    """A frame and its inputs."""

    camera: "Camera"
    lights: "list[Light]"
    options: RenderOptions
    frame: "Frame"

    @property
    def time(self) -> float:
        """Seconds, clamped to the animation."""
        return self.options.time


def scene_digest(spec: SceneSpec) -> str:
    """Which scene it is, by the contents of the file, or of the files in the folder that are read.

    Files that a file refers to (textures, buffers of a .gltf) are not read.
    """
    from ..formats.array_files import FILES
    from ..store.store_format import STORE_SUFFIX

    digest = hashlib.sha256(usedforsecurity=False)
    if spec.path is None:
        digest.update(f"{spec.name} {spec.triangles} {spec.seed}".encode())
        return digest.hexdigest()
    if spec.path.suffix.lower() == STORE_SUFFIX:  # its first page has the checksum of the checksums of all chunks
        with spec.path.open("rb") as stream:
            digest.update(stream.read(4096))
        return digest.hexdigest()
    folder = spec.path.is_dir()
    for path in [spec.path / name for name in FILES] if folder else [spec.path]:
        if folder and not path.exists():
            continue
        digest.update(path.name.encode() if folder else b"")
        digest.update(_contents(path))
    digest.update(b"" if spec.lod is None else f"lod {spec.lod}".encode())
    return digest.hexdigest()


def _contents(path: Path) -> bytes:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()
