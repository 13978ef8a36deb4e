"""``antumbra bake``: bake ambient occlusion, shadows or light of a scene into a glTF file."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..baking.bake_options import BakeOptions
from ..base.errors import InputError
from . import arguments, console
from .options import (
    Before,
    Json,
    PictureLightOption,
    Quiet,
    SceneArgument,
    UpOption,
    arguments_of,
    literal,
    takes,
    writes,
)
from .scene_arguments import quietly
from .shards import MergeOption, RayOption, ShardOption, executor_for, report_shard
from .study_run import StudyRun

if TYPE_CHECKING:
    from ..baking.bake import Baked
    from ..engine.scene import AnyScene
    from ..scene.lights import Light


_Options: Any = arguments_of("bake", BakeOptions)


@dataclass(frozen=True, kw_only=True)
class BakeArguments(_Options):  # type: ignore[misc] # made from the options of a bake
    """The arguments of the command line, besides those derived from `BakeOptions`."""

    scene: SceneArgument
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The .glb file to write.", metavar="FILE", callback=writes(".glb"))
    ]
    vertex: Annotated[
        bool, typer.Option("--vertex", help="Bake values at vertices (the default)."), Before("attribute")
    ] = False
    light: Annotated[PictureLightOption, Before("exposure")] = None
    sky: Annotated[
        float | None,
        typer.Option(help="For light: add the irradiance of an open sky.", metavar="LUX", show_default=False),
    ] = None
    up: Annotated[UpOption, Before("plan")] = None
    shard: Annotated[ShardOption, Before("")] = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False


@takes(BakeArguments)
def bake(args: BakeArguments) -> int:
    """Bake occlusion, shadows or light of SCENE into a copy of its glTF file.

    Everything else in the file is kept: nodes, instances, materials, textures, animations. Other scenes are first
    converted to glTF, with their triangles and base colours.

    \b
    WHAT
      ao           visible share of the sky, weighted by the cosine
      shadow       mean visible share of the lights
      sun          irradiance of one sun, divided by its intensity
      light        light of all lights and the sky, linear RGB
      bent-normal  mean unoccluded direction

    An ao texture becomes the occlusion texture of the materials, which viewers apply to ambient light. Textures of
    shadow, sun and light are multiplied by the base colour and replace it, and the materials become unlit
    (KHR_materials_unlit). COLOR_0 multiplies the base colour; for shadow, sun and light it also makes the materials
    unlit. A mesh used by several nodes is duplicated, because each node receives different light.

    Points inside solids are dark but never visible; they get the values of visible points nearby. The front of a face
    is the side on which its corners run counter-clockwise, as in glTF.

    \b
    LIGHT
      As in antumbra render.  [default: the lights of SCENE, or daylight]

    \b
    Examples
      antumbra bake temple.glb -o temple_ao.glb
      antumbra bake temple.glb -o temple_ao.glb --texture 2048 --bits 16
      antumbra bake hall.glb -o hall_lit.glb --what light --sky 0.5 --texture 2048 --uv 1 --exr
      antumbra bake city.ply --up z -o city.glb --what sun --light sun:1,0.5,-1
      antumbra bake robot.glb -o robot.glb --attribute _AO --radius 0.5
    """
    if args.vertex and args.texture is not None:
        raise InputError("--vertex and --texture exclude each other; leave one of them out")
    if args.sky is not None and args.what != "light":
        raise InputError("--sky belongs to --what light; leave it out")
    spec = args.spec_of(args.scene)
    specs = [arguments.parse_light(text) for text in args.light or []]

    from ..baking.bake import bake_file
    from ..baking.bake_input import BakeSource, is_gltf
    from ..base.progress import PhaseClock
    from ..work.executors import executor_of

    executor = executor_for(args, args.output)
    options = BakeOptions(**literal(args, BakeOptions), lights=[a for a in specs if not isinstance(a, int)] or None)
    with StudyRun(args) as run:
        scene, _ = run.open(spec)
        lights = _lights(args, specs, scene)
        source = BakeSource(scene, spec.path if spec.path is not None and is_gltf(spec.path) else None)
        keep, options = executor_of(executor or args.output.with_suffix(".parts")), replace(options, lights=lights)
        with quietly():
            result = run.timed(bake_file, source, options, args.output, PhaseClock(), keep)
        if result is None:
            return report_shard(executor, args, run.seconds)
    run.report(result._asdict(), _fields(result))
    for note in () if args.json or args.quiet else result.notes:
        console.say(f"note: {note}")
    return 0


def _lights(args: BakeArguments, specs: "list[int | Light]", scene: "AnyScene") -> "list[Light] | None":
    """The lights of the arguments; None: the bake chooses."""
    from ..scene.lights import AmbientOcclusion
    from ..scene.sky import Sky

    sky = [] if args.sky is None else [AmbientOcclusion(intensity=args.sky)]
    if not specs and not sky:
        return None
    lights = arguments.make_lights(specs, scene, args.time) if specs or scene.lights else []
    return [light for light in lights if not isinstance(light, Sky)] + sky


def _fields(result: "Baked") -> Iterator[tuple[str, str]]:
    yield "file", str(result.path)
    for path in result.images:
        yield "image", str(path)
    where = "texels" if result.attribute is None else f"vertices ({result.attribute})"
    hidden = f", {result.hidden:,} inside solids" if result.hidden else ""
    yield result.what, f"{result.receivers:,} {where} in {result.parts:,} parts, {result.mean:.3f} on average{hidden}"
    if result.exposure != 1.0:
        yield "exposure", f"{result.exposure:.4g}"
    if result.seam is not None:
        yield "seams", f"99 % differ by less than {result.seam:.3f}"
    trace = result.seconds["trace"]
    yield "rays", f"{result.rays:,}, {result.rays / max(trace, 1e-9) / 1e6:.1f} million per second"
    yield "time", ", ".join(f"{name} {console.duration(s)}" for name, s in result.seconds.items())
