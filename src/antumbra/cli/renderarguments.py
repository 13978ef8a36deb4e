"""The command-line arguments of ``antumbra render``, and their conversion to options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import InputError
from ..plan import parse_plan
from ..rendering.options import EngineOptions, RenderOptions
from ..scene.lights import MAX_SPP
from . import arguments
from .ground import parse_ground
from .options import SCENE_HELP, CameraOption, Json, Quiet, SrdhRaysOption, UpOption
from .outputs import films, pictures, writes
from .pictureoptions import (
    QUALITIES,
    AoOption,
    ExposureOption,
    PictureLightOption,
    Preset,
    PresetOption,
    SkyOption,
    VplOption,
)
from .picturespec import PictureSpec
from .sharing import MergeOption, RayOption, ShardOption
from .written import arguments_of, literal

_Options: Any = arguments_of("render")


@dataclass(frozen=True)
class RenderArguments(_Options):
    """The arguments of the command line: each field is an argument or an option.

    The base class has those of `RenderOptions` and `EngineOptions`.
    """

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .png or .exr file; #### is a frame's number. A .mp4, .webm or .gif file of --frames.  "
            "[default: SCENE's name.png, here]",
            metavar="FILE",
            callback=writes(pictures, films),
        ),
    ] = None
    html: Annotated[
        Path | None,
        typer.Option(
            help="Write a page too: the picture, its settings, times and counters, in one .html file.",
            metavar="FILE",
            show_default=False,
            callback=writes(".html"),
        ),
    ] = None
    size: Annotated[
        str | None,
        typer.Option(
            help="Size of the picture in pixels.  [default: 1024x1024; of a panorama 2048x1024]",
            metavar="WxH",
            show_default=False,
        ),
    ] = None
    camera: CameraOption = None
    light: PictureLightOption = None
    sky: SkyOption = None
    ao: AoOption = None
    vpl: VplOption = None
    frames: Annotated[
        str | None,
        typer.Option(
            help="An animation instead of one picture; LAST is included.",
            metavar="FIRST:LAST[:STEP]",
            show_default=False,
        ),
    ] = None
    fps: Annotated[
        float | None, typer.Option(help="Frames a second of --frames.  [default: 24]", show_default=False)
    ] = None
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Render frames again that are finished already.")] = (
        False
    )
    up: UpOption = None
    preset: PresetOption = Preset.standard
    srdh_rays: SrdhRaysOption = None
    explain_plan: Annotated[
        bool,
        typer.Option("--explain-plan", help="Show what the plan auto chose, why, and the times."),
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
                raise InputError(f"--ao dims the ambient light that {name} replaces; leave one of them out")
        if self.vpl is not None and self.bounce is not None:
            raise InputError("--vpl and --bounce are both light that bounces once; leave one of them out")
        if self.shard is not None or self.ray is not None or self.merge:
            self._check_shared()
        if self.frames is not None:
            if self.html is not None:
                raise InputError("--html shows a single picture; leave it or --frames out")
            if self.explain_plan:
                raise InputError("--explain-plan explains a single picture; leave it or --frames out")
            return
        if self.fps is not None:
            raise InputError("--fps belongs to --frames FIRST:LAST; leave it out")
        if self.overwrite:
            raise InputError("--overwrite belongs to --frames FIRST:LAST; a single picture is always written anew")

    def _check_shared(self) -> None:
        """Raise an InputError for options of pictures that one process makes."""
        alone = {"--html": self.html, "--explain-plan": self.explain_plan, "--counters": self.counters}
        for name, given in alone.items():
            if given:
                raise InputError(f"{name} tells of the work of one process; leave it, or --shard and --ray, out")
        if self.plan is not None and not parse_plan(self.plan).tracer.exact:
            raise InputError(f"--plan {self.plan} depends on the work before; --shard and --ray need an exact plan")

    def options(self) -> PictureSpec:
        """Parse the arguments.

        Raises
        ------
        InputError
            If a text cannot be parsed, or an option of the picture is out of range.
        """
        given = lambda text, parse, *more: None if text is None else parse(text, *more)
        camera, rays = given(self.camera, arguments.parse_camera), given(self.srdh_rays, arguments.parse_srdh_rays)
        wide = isinstance(camera, arguments.CameraSpec) and camera.kind == "panoramic"
        memory = given(self.max_memory, arguments.parse_bytes, "--max-memory")
        asked = PictureSpec(
            source=self.scene,
            spec=arguments.parse_scene(self.scene),
            up=None if self.up is None else self.up.value,
            size=arguments.parse_size(self.size or ("2048x1024" if wide else "1024x1024")),
            camera=camera,
            lights=[arguments.parse_light(text) for text in self.light or []],
            sky=given(self.sky, arguments.parse_sky),
            behind=given(self.background, arguments.parse_background),
            ambient=[] if self.ao is None else [arguments.parse_ambient(self.ao)],
            vpl=self.vpl,
            ground=parse_ground(self.ground),
            picture=self._picture(),
            engine=EngineOptions(**literal(self, EngineOptions), max_memory=memory),
            srdh_rays=rays,
            exposure=self.exposure,
            json=self.json,
            quiet=self.quiet,
            moving=self.frames is not None,
        )
        if self.frames is None and rays is not None and rays.last_frame:
            raise InputError(
                "--srdh-rays last-frame belongs to --frames FIRST:LAST; a single picture has no frame before"
            )
        return asked

    def _picture(self) -> RenderOptions:
        """The options of the picture, by the preset where none are written."""
        preset = QUALITIES[self.preset]
        chosen = {"spp": preset.spp, "filter": preset.filter, **literal(self, RenderOptions)}
        refined = preset.adaptive if self.adaptive is None else self.adaptive
        usual = min(4 * chosen["spp"], MAX_SPP) if refined else None
        return RenderOptions(**chosen, adaptive=usual if self.adaptive_spp is None else self.adaptive_spp)
