"""The arguments of ``antumbra render``, and the picture they specify.

A `PictureSpec` holds everything that determines a picture except the time.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from ..base.checks import number
from ..base.errors import InputError
from ..base.option_fields import field_values
from ..engine.plan import parse_plan
from ..picture.picture_records import picture_record, plain
from ..picture.render_options import EngineOptions, RenderOptions
from ..scene.lights import MAX_SPP
from . import arguments, console
from .arguments import CameraSpec
from .options import (
    QUALITIES,
    AoOption,
    CameraOption,
    ExposureOption,
    Json,
    PictureLightOption,
    Preset,
    PresetOption,
    Quiet,
    SceneArgument,
    SkyOption,
    SrdhRaysOption,
    UpOption,
    VplOption,
    arguments_of,
    films,
    literal,
    pictures,
    writes,
)
from .scene_arguments import DEFAULT_SCENE, SceneSpec, limit_memory, open_scene
from .shards import MergeOption, RayOption, ShardOption
from .vegetation_options import VegetationOption, VegetationSpec, add_vegetation, parse_vegetation

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..engine.plan import Plan
    from ..engine.scene import AnyScene
    from ..formats.camera_paths import CameraPath
    from ..picture.frame import Frame
    from ..picture.renderer import Renderer
    from ..scene.camera import Camera
    from ..scene.lights import Light
    from ..techniques.srdh.representative_rays import SrdhRays
    from ..work.executors import Executor


# --- Shadow-catcher plane: whether there is one, and its height -------------------------------------------------------


WORDS = "auto", "on", "off"
_FARTHEST = 1e30


def parse_ground(text: str) -> str | float:
    """Parse one of `WORDS`, or a height."""
    word = text.strip()
    if word in WORDS:
        return word
    try:
        return number(float(word), "--ground", -_FARTHEST, _FARTHEST)
    except ValueError as error:  # an InputError is one
        raise InputError(f"--ground is {text!r}; it must be auto, on, off or a height such as -1.5") from error


def ground_of(setting: str | float, scene: "AnyScene", camera: "Camera", time: float | None) -> float | None:
    """The height of the ground for `Renderer.render`; None: no ground.

    setting : from `parse_ground`
    time : seconds; None: the ground suits all frames of an animation
    """
    from ..engine.scene import is_outside

    if setting == "off":
        return None
    if setting == "auto" and not is_outside(scene, camera):
        return None
    return scene.ground_height(time) if isinstance(setting, str) else setting


# --- Light in rooms and courtyards ------------------------------------------------------------------------------------


ROOM_LIGHT: dict[str, Any] = {"bounce": 32, "bounce_step": 4}
"""Options of bounced light for ``--preset final`` in rooms and courtyards, whose corners get no other light."""


def is_enclosed(scene: "AnyScene") -> bool:
    """Whether a scene is shown from inside a room or a courtyard."""
    try:
        return scene.view.room is not None
    except InputError:  # at some time the scene has no triangles: that frame reports the error
        return False


# --- Parsed arguments: everything that determines a picture except the time -------------------------------------------


Progress = Callable[[str, int], Callable[[int, int], object]]
"""progress(text, runs): a function of (done, total) for `runs` traced queries."""


class PictureSpec(NamedTuple):
    """The picture specified by the arguments of ``antumbra render`` or ``compare``."""

    source: str  # the argument SCENE, with its options
    scene_spec: SceneSpec
    size: tuple[int, int]  # width, height
    camera: int | CameraSpec | None
    lights: "list[int | Light]"  # lights, or indices of the scene's lights
    sky: "str | Path | NDArray[np.float64] | None"  # from `parse_sky`
    background: "str | NDArray[np.float64] | None"  # background from `parse_background`; None: the sky
    ambient: "list[Light]"  # ambient occlusion, or nothing
    vpl: int | None  # number of photons
    ground: str | float  # from `parse_ground`
    picture: RenderOptions  # `options` completes them
    engine: EngineOptions  # plan None: the default for this kind of scene
    srdh_rays: "SrdhRays | None"  # training rays of the plan's builder
    exposure: float | None  # None: automatic
    json: bool
    quiet: bool
    moving: bool  # whether the pictures are the frames of an animation
    trees: VegetationSpec | None = None  # vegetation that is added to the scene
    lights_rooms: bool = False  # whether light bounces in rooms and courtyards, as `ROOM_LIGHT` says
    path: "CameraPath | None" = None  # of the camera, instead of `camera`

    def check(self, *plans: "str | Plan") -> None:
        """Raise InputError for errors that can be detected before a scene is read.

        plans : the plans of a comparison, instead of the one in the options
        """
        from ..engine.plan import DEFAULT_PLAN, parse_plan, with_sample
        from ..picture.image_files import checked_exposure

        if self.exposure is not None:
            checked_exposure(self.exposure)
        plan = self.engine.plan
        if self.srdh_rays is not None or plan is not None:  # plans of a comparison are parsed already
            with_sample([parse_plan(each) for each in plans or [plan or DEFAULT_PLAN]], self.srdh_rays)

    def open(self) -> "AnyScene":
        """The scene, with its trees."""
        return add_vegetation(open_scene(self.scene_spec, self.quiet), self.trees)

    def scene_digest(self) -> str:
        """A digest that identifies the scene and its trees."""
        digest = scene_digest(self.scene_spec)
        return digest if self.trees is None else f"{digest} {self.trees.digest()}"

    def about(self, scene: "AnyScene") -> "PictureSpec":
        """This picture, with the plan of its device or the default one for this kind of scene if none was specified."""
        from ..engine.engine import chosen_plan

        plan = chosen_plan(scene.data, self.engine.plan, self.engine.device)
        return self._replace(engine=replace(self.engine, plan=plan, device=None))

    def renderer(self, scene: "AnyScene") -> "Renderer":
        from .. import Renderer
        from ..engine.plan import DEFAULT_PLAN, parse_plan, with_sample

        settings = field_values(self.engine) | {"max_memory": limit_memory(scene, self.engine.max_memory)}
        if self.srdh_rays is not None:
            (settings["plan"],) = with_sample([parse_plan(self.engine.plan or DEFAULT_PLAN)], self.srdh_rays)
        return Renderer(scene, **settings)

    @property
    def _no_sky(self) -> bool:
        return isinstance(self.sky, str)

    def view(self, scene: "AnyScene", time: float) -> "Camera":
        """The camera at a time."""
        if self.path is not None:
            return self.path.camera(time, scene.up, self.size)
        return arguments.make_camera(self.camera, scene, time, self.size, self.moving)

    def clamped(self, scene: "AnyScene", time: float) -> float:
        """`time`, clamped to the animation of the scene and the path of the camera."""
        return min(max(time, 0.0), max(scene.duration, self.path.duration if self.path else 0.0))

    def ground_height(self, scene: "AnyScene", time: float) -> float | None:
        """The height of the ground at a time; None: no ground. It is the same for all frames of an animation."""
        if self.moving:
            return ground_of(self.ground, scene, self.view(scene, 0.0), None)
        return ground_of(self.ground, scene, self.view(scene, time), time)

    def direct_lights(self, scene: "AnyScene", time: float) -> "list[Light]":
        """The lights at a time, without virtual point lights."""
        from ..scene.sky import with_rays

        lights = arguments.make_picture_lights(self.lights, self.sky, scene, time)
        return [with_rays(light, self.picture.spp) for light in lights] + self.ambient

    def all_lights(self, scene: "AnyScene", time: float) -> "list[Light]":
        """The lights at a time, with virtual point lights."""
        from .. import virtual_point_lights
        from ..picture.sky_background import skies_of

        lights = self.direct_lights(scene, time)
        if self.vpl is not None:
            sources, n, threads = [lights[0], *skies_of(lights[1:])], self.vpl, self.engine.threads
            lights += [virtual_point_lights(scene, s, n, self.picture.seed, time, threads=threads) for s in sources]
        return lights

    def options(self, scene: "AnyScene", time: float, layers: bool = False) -> RenderOptions:
        """The options of the picture at a time; `layers`: keep the image of each light, for an EXR file."""
        ground = self.ground_height(scene, time)
        return replace(
            replace(self.picture, **ROOM_LIGHT) if self.lights_rooms and is_enclosed(scene) else self.picture,
            time=scene.clamped(time),
            ground=False if ground is None else ground,
            background=self.background is None and not self._no_sky,
            layers=layers,
        )

    def shot(
        self, scene: "AnyScene", renderer: "Renderer", time: float, progress: Progress, layers: bool = False
    ) -> "Shot":
        """Render a frame at a time; ``progress(text, runs)`` returns a progress function for `runs` traced queries."""
        camera, lights, options = self._inputs(scene, time, layers)
        pictures = (1 if options.adaptive is None else 3) * (1 if options.ground is False else 2)
        runs = len(lights) * (pictures + (options.bounce or 0) * options.bounces) + renderer.source.looks
        frame = renderer.render(camera, lights, options=options, progress=progress("tracing shadow rays", runs))
        return Shot(camera, lights, options, frame)

    def shot_in_bands(
        self, scene: "AnyScene", time: float, executor: "Executor", digest: str, layers: bool = False
    ) -> "Shot | None":
        """The same frame, traced by an executor in bands; None if other processes trace some of them."""
        from ..work.work_parts import render_bands

        camera, lights, options = self._inputs(scene, time, layers)
        settings = self.settings(scene, digest, time)
        frame = render_bands(self.renderer(scene), camera, lights, options, executor, digest, settings)
        return None if frame is None else Shot(camera, lights, options, frame)

    def _inputs(self, scene: "AnyScene", time: float, layers: bool) -> "tuple[Camera, list[Light], RenderOptions]":
        return self.view(scene, time), self.all_lights(scene, time), self.options(scene, time, layers)

    def record(self, options: RenderOptions) -> dict[str, Any]:
        """Names and values of the picture and engine options, for ``--json``."""
        rays = self.srdh_rays
        rays_fields = {"srdh_rays": None if rays is None else console.srdh_rays_fields(rays)}
        return {**field_values(options), **field_values(self.engine), **rays_fields}

    def settings(self, scene: "AnyScene", digest: str, time: float) -> dict[str, Any]:
        """The settings that determine the picture at a time, as JSON types.

        The exposure is omitted, and so are exact plans, their training rays, the G-buffer method and the threads, which
        do not change any bit.
        """
        from ..engine.plan import parse_plan

        plan = None if self.engine.plan is None else parse_plan(self.engine.plan)
        settings: dict[str, Any] = plain(
            {
                "scene": digest,
                "up": scene.up,
                **picture_record(self.view(scene, time), self.direct_lights(scene, time), self.options(scene, time)),
                "vpl": self.vpl,
                "behind": self.background,
                **({} if plan is None or plan.tracer.exact else {"plan": str(plan)}),
            }
        )
        return settings


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
    """A digest that identifies a scene: of its file, or of the files in its folder that are read.

    Files that the file refers to (textures, buffers of a .gltf) are not included.
    """
    from ..formats.array_files import FILES
    from ..store.store_format import STORE_SUFFIX

    digest = hashlib.sha256(usedforsecurity=False)
    for each in spec.added:
        digest.update(f"add {scene_digest(each.scene)} {each.scene.up} {each.scene.crs} {each.at}".encode())
    digest.update("".join(f"remove {name}\n" for name in spec.removed).encode())
    if spec.path is None:
        digest.update(f"{spec.name} {spec.triangles} {spec.seed}".encode())
        return digest.hexdigest()
    if spec.path.suffix.lower() == STORE_SUFFIX:  # the first page contains the checksum of all chunk checksums
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


# --- Arguments of ``antumbra render``, and their conversion to options ------------------------------------------------


_Options: Any = arguments_of("render")


@dataclass(frozen=True)
class RenderArguments(_Options):  # type: ignore[misc] # made from the options of a picture
    """The command-line arguments and options, one per field.

    The base class adds the options derived from `RenderOptions` and `EngineOptions`.
    """

    scene: SceneArgument = DEFAULT_SCENE
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help="A .png or .exr file; may be repeated. #### stands for the frame number. With --frames also .mp4, "
            ".webm or .gif.  [default: SCENE's name.png in the current folder]",
            metavar="FILE",
            show_default=False,
            callback=writes(pictures, films),
        ),
    ] = None
    html: Annotated[
        Path | None,
        typer.Option(
            help="Also write an .html page for offline use, with the picture, settings, times and counters.",
            metavar="FILE",
            show_default=False,
            callback=writes(".html"),
        ),
    ] = None
    size: Annotated[
        str | None,
        typer.Option(
            help="Picture size in pixels.  [default: 1024x1024; for a panorama 2048x1024]",
            metavar="WxH",
            show_default=False,
        ),
    ] = None
    camera: CameraOption = None
    camera_path: Annotated[
        Path | None,
        typer.Option(
            "--path",
            help="Move the camera of --frames along the keys in a .json file, or with the camera in a .glb file.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None
    light: PictureLightOption = None
    sky: SkyOption = None
    ao: AoOption = None
    vpl: VplOption = None
    frames: Annotated[
        str | None,
        typer.Option(
            help="Render an animation; LAST is included.",
            metavar="FIRST:LAST[:STEP]",
            show_default=False,
        ),
    ] = None
    fps: Annotated[
        float | None, typer.Option(help="Frames per second of --frames.  [default: 24]", show_default=False)
    ] = None
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Render finished frames again.")] = False
    trees: VegetationOption = None
    up: UpOption = None
    preset: PresetOption = Preset.standard
    srdh_rays: SrdhRaysOption = None
    explain_plan: Annotated[
        bool,
        typer.Option("--explain-plan", help="Explain what the plan auto chose, and why."),
    ] = False
    exposure: ExposureOption = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False

    def check(self) -> None:
        """Raise an InputError if options exclude each other."""
        for name, instead in (("--vpl", self.vpl), ("--bounce", self.bounce)):
            if self.ao is not None and instead is not None:
                raise InputError(f"--ao occludes the ambient light that {name} replaces; leave one of them out")
        if self.bounces is not None and self.bounce is None and self.preset is not Preset.final:
            raise InputError("--bounces follows the rays of --bounce further; add it, such as --bounce 16")
        if self.vpl is not None and self.bounce is not None:
            raise InputError("--vpl and --bounce both add one bounce of light; leave one of them out")
        if self.shard is not None or self.ray is not None or self.merge:
            self._check_shared()
        if self.camera_path is not None and self.camera is not None:
            raise InputError("--path and --camera both place the camera; leave one of them out")
        if self.frames is not None:
            if self.html is not None:
                raise InputError("--html is for a single picture; leave it or --frames out")
            if self.explain_plan:
                raise InputError("--explain-plan is for a single picture; leave it or --frames out")
            return
        if self.camera_path is not None:
            raise InputError("--path belongs to --frames FIRST:LAST; use --camera for a single picture")
        if self.fps is not None:
            raise InputError("--fps belongs to --frames FIRST:LAST; leave it out")
        if self.overwrite:
            raise InputError("--overwrite belongs to --frames FIRST:LAST; a single picture is always overwritten")

    def _check_shared(self) -> None:
        """Raise an InputError for options that need the whole picture in one process."""
        unshared = {"--html": self.html, "--explain-plan": self.explain_plan, "--counters": self.counters}
        for name, value in unshared.items():
            if value:
                raise InputError(f"{name} reports on a single process; leave it, or --shard and --ray, out")
        if self.plan is not None and not parse_plan(self.plan).tracer.exact:
            raise InputError(f"--plan {self.plan} depends on earlier work; --shard and --ray need an exact plan")

    def options(self) -> PictureSpec:
        """Parse the arguments.

        Raises
        ------
        InputError
            If a text cannot be parsed, or an option of the picture is out of range.
        """

        def optional(text: str | None, parse: Callable[..., Any], *more: str) -> Any:
            return None if text is None else parse(text, *more)

        camera, rays = (
            optional(self.camera, arguments.parse_camera),
            optional(self.srdh_rays, arguments.parse_srdh_rays),
        )
        path = None
        if self.camera_path is not None:
            from ..formats.camera_paths import read_camera_path

            path = read_camera_path(self.camera_path)
        wide = isinstance(camera, arguments.CameraSpec) and camera.kind == "panoramic"
        memory = optional(self.max_memory, arguments.parse_bytes, "--max-memory")
        spec = PictureSpec(
            source=self.record_of(self.scene),
            scene_spec=self.spec_of(self.scene),
            size=arguments.parse_size(self.size or ("2048x1024" if wide else "1024x1024")),
            camera=camera,
            lights=[arguments.parse_light(text) for text in self.light or []],
            sky=optional(self.sky, arguments.parse_sky),
            background=optional(self.background, arguments.parse_background),
            ambient=[] if self.ao is None else [arguments.parse_ambient(self.ao)],
            vpl=self.vpl,
            ground=parse_ground(self.ground),
            picture=self._picture(),
            engine=EngineOptions(**literal(vars(self), EngineOptions), max_memory=memory),
            srdh_rays=rays,
            exposure=self.exposure,
            json=self.json,
            quiet=self.quiet,
            moving=self.frames is not None,
            trees=parse_vegetation(self.trees),
            lights_rooms=self.preset is Preset.final and (self.bounce, self.vpl, self.ao) == (None, None, None),
            path=path,
        )
        if self.frames is None and rays is not None and rays.last_frame:
            raise InputError(
                "--srdh-rays last-frame belongs to --frames FIRST:LAST; a single picture has no previous frame"
            )
        return spec

    def _picture(self) -> RenderOptions:
        """The options of the picture; the preset supplies those not set."""
        preset = QUALITIES[self.preset]
        chosen = {"spp": preset.spp, "filter": preset.filter, **literal(vars(self), RenderOptions)}
        refined = preset.adaptive if self.adaptive is None else self.adaptive
        usual = min(4 * chosen["spp"], MAX_SPP) if refined else None
        return RenderOptions(**chosen, adaptive=usual if self.adaptive_spp is None else self.adaptive_spp)
