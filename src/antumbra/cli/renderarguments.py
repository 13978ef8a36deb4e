"""The command-line arguments of ``antumbra render``, and their conversion to options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from ..plan import parse_plan
from . import arguments
from .ground import parse_ground
from .options import (
    SCENE_HELP,
    CameraOption,
    CullFaces,
    GBufferBy,
    Json,
    MaxMemoryOption,
    Quiet,
    SrdhRaysOption,
    Threads,
    UpOption,
)
from .outputs import films, pictures, writes
from .pictureoptions import (
    QUALITIES,
    AdaptiveOption,
    AdaptiveSppOption,
    AntialiasOption,
    AoOption,
    BackgroundOption,
    BounceOption,
    CullFacesOption,
    ExposureOption,
    FilterOption,
    GBufferOption,
    GroundOption,
    PictureLightOption,
    Preset,
    PresetOption,
    PresetSppOption,
    SamplerOption,
    SkyOption,
    SmoothNormalsOption,
    TexturesOption,
    VplOption,
)
from .renderoptions import RenderOptions
from .sharing import MergeOption, RayOption, ShardOption


@dataclass(frozen=True)
class RenderArguments:
    """The arguments of the command line: each field is an argument or an option."""

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
    background: BackgroundOption = None
    ground: GroundOption = "auto"
    ao: AoOption = None
    vpl: VplOption = None
    bounce: BounceOption = None
    time: Annotated[
        float | None, typer.Option(help="Seconds into the animation.  [default: 0]", show_default=False)
    ] = None
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
    spp: PresetSppOption = None
    sampler: SamplerOption = "larcher-pillichshammer"
    filter: FilterOption = None
    antialias: AntialiasOption = True
    adaptive: AdaptiveOption = None
    adaptive_spp: AdaptiveSppOption = None
    textures: TexturesOption = True
    smooth_normals: SmoothNormalsOption = True
    plan: Annotated[
        str | None,
        typer.Option(
            help="The methods that answer; see antumbra plans.  [default: auto; of a store bsah+chcrt]",
            show_default=False,
        ),
    ] = None
    explain_plan: Annotated[
        bool,
        typer.Option("--explain-plan", help="Show what the plan auto chose, why, and the times."),
    ] = False
    srdh_rays: SrdhRaysOption = None
    gbuffer: GBufferOption = GBufferBy.auto
    cull_faces: CullFacesOption = CullFaces.none
    threads: Threads = None
    max_memory: MaxMemoryOption = None
    exposure: ExposureOption = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    counters: Annotated[bool, typer.Option("--counters", help="Count rays, nodes and tests exactly.")] = False
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

    def options(self) -> RenderOptions:
        """Parse the arguments.

        Raises
        ------
        InputError
            If a text cannot be parsed.
        """
        given = lambda text, parse, *more: None if text is None else parse(text, *more)
        quality = QUALITIES[self.preset]
        spp = quality.spp if self.spp is None else self.spp
        smooth = quality.filter if self.filter is None else self.filter
        refined = (quality.adaptive if self.adaptive is None else self.adaptive) and self.adaptive_spp is None
        adaptive = min(4 * spp, 1024) if refined else self.adaptive_spp
        camera = given(self.camera, arguments.parse_camera)
        wide = isinstance(camera, arguments.CameraSpec) and camera.kind == "panoramic"
        asked = RenderOptions(
            source=self.scene,
            spec=arguments.parse_scene(self.scene),
            up=None if self.up is None else self.up.value,
            size=arguments.parse_size(self.size or ("2048x1024" if wide else "1024x1024")),
            camera=camera,
            lights=[arguments.parse_light(text) for text in self.light or []],
            sky=given(self.sky, arguments.parse_sky),
            background=given(self.background, arguments.parse_background),
            ambient=[] if self.ao is None else [arguments.parse_ambient(self.ao)],
            vpl=self.vpl,
            bounce=self.bounce,
            spp=spp,
            sampler=self.sampler,
            filter=smooth,
            adaptive=adaptive,
            plan=self.plan,
            srdh_rays=given(self.srdh_rays, arguments.parse_srdh_rays),
            gbuffer=self.gbuffer.value,
            cull_faces=self.cull_faces.side,
            threads=self.threads,
            max_memory=given(self.max_memory, arguments.parse_bytes, "--max-memory"),
            exposure=self.exposure,
            counters=self.counters,
            json=self.json,
            quiet=self.quiet,
            textures=self.textures,
            smooth_normals=self.smooth_normals,
            antialias=self.antialias,
            moving=self.frames is not None,
            ground=parse_ground(self.ground),
        )
        if self.frames is None and asked.srdh_rays is not None and asked.srdh_rays.last_frame:
            raise InputError(
                "--srdh-rays last-frame belongs to --frames FIRST:LAST; a single picture has no frame before"
            )
        return asked
