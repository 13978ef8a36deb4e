"""The checked options of ``antumbra render``: everything that determines its pictures, except the time."""

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from . import arguments, report
from .arguments import CameraSpec, SceneSpec
from .ground import ground_of
from .sceneinput import limit_memory

if TYPE_CHECKING:
    import numpy as np

    from ..bvh.srdh_rays import SrdhRays
    from ..engine.any_scene import AnyScene
    from ..jobs.engines import Engine
    from ..plan import Plan
    from ..rendering.frame import Frame
    from ..rendering.renderer import Renderer
    from ..scene.camera import Camera
    from ..scene.lights import Light


class RenderOptions(NamedTuple):
    """The options of ``antumbra render``."""

    source: str  # the scene as it was written
    spec: SceneSpec
    up: str | None
    size: tuple[int, int]  # width, height
    camera: int | CameraSpec | None
    lights: list  # lights, and indices of the scene's own
    sky: "str | Path | np.ndarray | None"  # from `parse_sky`
    background: "str | np.ndarray | None"  # from `parse_background`; None: the sky
    ambient: list  # ambient occlusion, or nothing
    vpl: int | None  # number of photons
    bounce: int | None  # diffuse rays per pixel
    spp: int
    sampler: str
    filter: bool
    adaptive: int | None
    plan: str | None  # None: the default for the kind of scene
    srdh_rays: "SrdhRays | None"  # rays that the plan's builder is shown
    gbuffer: str
    cull_faces: str | None  # the side of triangles that blocks no shadow ray
    threads: int | None
    max_memory: int | None  # bytes, for a scene in a store
    exposure: float | None  # None: automatic
    counters: bool
    json: bool
    quiet: bool
    textures: bool = True
    smooth_normals: bool = True  # whether the normals of vertices shade
    antialias: bool = True  # whether edges are smoothed without another ray
    moving: bool = False  # whether the pictures are the frames of an animation
    ground: str | float = "off"  # from `parse_ground`

    def check(self, *plans: "str | Plan") -> None:
        """Raise InputError for errors that can be detected before a scene is read.

        plans : plans that are compared, instead of the one among the options
        """
        from ..image.save import checked_exposure
        from ..plan import DEFAULT_PLAN, parse_plan, with_sample
        from ..query.sampling import sample_sets

        if self.exposure is not None:
            checked_exposure(self.exposure)
        if self.srdh_rays is not None or self.plan is not None:  # plans of a comparison are parsed already
            with_sample([parse_plan(plan) for plan in plans or [self.plan or DEFAULT_PLAN]], self.srdh_rays)
        sample_sets(self.spp, self.sampler)

    def about(self, scene: "AnyScene") -> "RenderOptions":
        """These options, with the default plan for the kind of scene if none was named."""
        return self if self.plan is not None else self._replace(plan=scene.engine.source.default_plan)

    def renderer(self, scene: "AnyScene") -> "Renderer":
        from .. import Renderer
        from ..plan import parse_plan, with_sample

        limit_memory(scene, self.max_memory)
        (plan,) = [self.plan] if self.srdh_rays is None else with_sample([parse_plan(self.plan or "")], self.srdh_rays)
        return Renderer(scene, plan, self.threads, self.gbuffer)

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
        from ..image.background import skies_of

        lights = self.direct_lights(scene, time)
        if self.vpl is not None:
            sources = [lights[0], *skies_of(lights[1:])]
            lights += [virtual_point_lights(scene, s, self.vpl, time=time, threads=self.threads) for s in sources]
        return lights

    def quality(self) -> dict:
        """The arguments of `Renderer.render` that say how many rays are traced, and what is made of their bits."""
        return {name: getattr(self, name) for name in ("spp", "sampler", "filter", "adaptive", "bounce", "cull_faces")}

    def shot(self, scene: "AnyScene", renderer: "Renderer", time: float, progress, layers: bool = False) -> "Shot":
        """Render a frame at a time; ``progress(text, runs)`` returns a progress function for `runs` traced queries.

        layers : whether the frame keeps its image light by light, for an EXR file
        """
        camera, lights, asked = self._asked(scene, time, layers)
        pictures = (1 if self.adaptive is None else 3) * (1 if asked["ground"] is False else 2)
        runs = len(lights) * (pictures + (self.bounce or 0)) + renderer.source.looks
        frame = renderer.render(camera, lights, progress=progress("tracing shadow rays", runs), **asked)
        return Shot(scene.clamped(time), camera, lights, frame)

    def shot_in_bands(
        self, scene: "AnyScene", time: float, engine: "Engine", digest: str, layers: bool = False
    ) -> "Shot | None":
        """The same frame, whose rays an engine traces; None if it leaves some to other processes."""
        from ..jobs.bands import render_bands

        camera, lights, asked = self._asked(scene, time, layers)
        settings = self.settings(scene, digest, time)
        frame = render_bands(self.renderer(scene), camera, lights, engine, digest, settings, **asked)
        return None if frame is None else Shot(scene.clamped(time), camera, lights, frame)

    def _asked(self, scene: "AnyScene", time: float, layers: bool) -> "tuple[Camera, list[Light], dict]":
        """The arguments of `Renderer.render`."""
        ground = self.ground_height(scene, time)
        more = {
            "time": time, "counters": self.counters, "background": self.background is None and not self._no_sky,
            "layers": layers, "textures": self.textures, "smooth_normals": self.smooth_normals,
            "ground": False if ground is None else ground, "antialias": self.antialias,
        }  # fmt: skip
        return self.view(scene, time), self.all_lights(scene, time), {**more, **self.quality()}

    def options(self) -> dict:
        """Names and values, for ``--json``."""
        rays = None if self.srdh_rays is None else report.srdh_rays_fields(self.srdh_rays)
        more = {
            name: getattr(self, name)
            for name in ("plan", "gbuffer", "threads", "textures", "smooth_normals", "antialias")
        }
        return {**self.quality(), **more, "srdh_rays": rays}

    def settings(self, scene: "AnyScene", digest: str, time: float) -> dict:
        """The settings that decide the bits of the picture of a time, in the types of JSON.

        An exact plan, its rays, the method of the G-buffer and the threads change no bit, and are left out. So is the
        exposure.
        """
        from ..plan import parse_plan
        from ..version import VERSION as __version__

        plan = None if self.plan is None else parse_plan(self.plan)
        ground = self.ground_height(scene, time)
        return report.plain(
            {
                "version": __version__,
                "scene": digest,
                "up": scene.up,
                "time": scene.clamped(time),
                "camera": report.camera_fields(self.view(scene, time)),
                "lights": [report.light_fields(light) for light in self.direct_lights(scene, time)],
                "vpl": self.vpl,
                "bounce": self.bounce,
                "spp": self.spp,
                "sampler": self.sampler,
                "filter": self.filter,
                "adaptive": self.adaptive,
                "cull_faces": self.cull_faces,
                "textures": self.textures,
                "smooth_normals": self.smooth_normals,
                "antialias": self.antialias and self.adaptive is None,
                **({} if self.background is None else {"background": self.background}),
                **({"sky": "none"} if self._no_sky else {}),
                **({} if ground is None else {"ground": ground}),
                **({} if plan is None or plan.tracer.exact else {"plan": str(plan)}),
            }
        )


class Shot(NamedTuple):
    """A frame and its inputs."""

    time: float  # seconds, clamped to the animation
    camera: "Camera"
    lights: "list[Light]"
    frame: "Frame"


def scene_digest(spec: SceneSpec) -> str:
    """Which scene it is, by the contents of the file, or of the files in the folder that are read.

    Files that a file refers to (textures, buffers of a .gltf) are not read.
    """
    from ..scene.frames import FILES
    from ..store.layout import STORE_SUFFIX

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
