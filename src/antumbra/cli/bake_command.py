"""``antumbra bake``: bake ambient occlusion, shadows or light of a scene into a glTF file."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from . import arguments, console
from .arguments import open_scene, quietly
from .console import ProgressDisplay
from .options import (
    SCENE_HELP,
    Json,
    PictureLightOption,
    Quiet,
    SamplerOption,
    Threads,
    TimeOption,
    UpOption,
    takes,
    writes,
)
from .shards import MergeOption, RayOption, ShardOption, executor_for, report_shard

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..jobs.bake import Baked
    from ..scene.lights import Light


class BakedQuantity(StrEnum):
    ao = "ao"
    shadow = "shadow"
    sun = "sun"
    light = "light"
    bent_normal = "bent-normal"


@dataclass(frozen=True)
class BakeArguments:
    """The arguments of the command line."""

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")]
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The .glb file to write.", metavar="FILE", callback=writes(".glb"))
    ]
    what: Annotated[BakedQuantity, typer.Option(help="Quantity to bake.")] = BakedQuantity.ao
    vertex: Annotated[bool, typer.Option("--vertex", help="Bake values at vertices (the default).")] = False
    attribute: Annotated[
        str | None,
        typer.Option(
            help="Vertex attribute: COLOR_0, or a custom name such as _AO.  [default: COLOR_0; for bent normals "
            "_BENT_NORMAL]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None
    multiply: Annotated[
        bool, typer.Option("--multiply", help="Multiply the file's COLOR_0 instead of replacing it.")
    ] = False
    texture: Annotated[
        int | None,
        typer.Option(
            help="Bake a square texture of SIZE texels per side instead of vertices.",
            metavar="SIZE",
            show_default=False,
        ),
    ] = None
    uv: Annotated[
        int | None,
        typer.Option(
            help="UV set of the file for the texture.  [default: a new atlas]", metavar="SET", show_default=False
        ),
    ] = None
    bits: Annotated[int, typer.Option(help="Bits per texture channel: 8 or 16.")] = 8
    exr: Annotated[bool, typer.Option("--exr", help="Also write the texture as .exr next to FILE.")] = False
    denoise: Annotated[bool, typer.Option("--denoise", help="Smooth the noise of ao or shadow over 4x4 texels.")] = (
        False
    )
    radius: Annotated[
        float | None,
        typer.Option(help="For ao: greatest distance of occluders.  [default: no limit]", show_default=False),
    ] = None
    light: PictureLightOption = None
    sky: Annotated[
        float | None,
        typer.Option(help="For light: add the irradiance of an open sky.", metavar="LUX", show_default=False),
    ] = None
    exposure: Annotated[
        float | None,
        typer.Option(
            help="Exposure factor; values are clipped at 1.  [default: 1; for light automatic]", show_default=False
        ),
    ] = None
    spp: Annotated[int, typer.Option(help="Rays per vertex or texel and light.", min=1, max=1024)] = 256
    sampler: SamplerOption = "hammersley"
    keep_hidden: Annotated[bool, typer.Option("--keep-hidden", help="Keep points inside solids dark.")] = False
    time: TimeOption = 0.0
    up: UpOption = None
    plan: Annotated[
        str | None,
        typer.Option(help="Plan; see antumbra plans.  [default: auto]", show_default=False),
    ] = None
    threads: Threads = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False

    def options(self) -> dict[str, Any]:
        """The arguments of `antumbra.bake` that do not depend on the scene."""
        names = "attribute", "multiply", "texture", "uv", "bits", "exr", "denoise", "radius", "exposure"
        more = "spp", "sampler", "keep_hidden", "time", "plan", "threads"
        return {name: getattr(self, name) for name in (*names, *more)}


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
    if args.sky is not None and args.what is not BakedQuantity.light:
        raise InputError("--sky belongs to --what light; leave it out")
    spec = arguments.parse_scene(args.scene)
    specs = [arguments.parse_light(text) for text in args.light or []]

    from ..jobs.bake.bake_input import BakeSource, check_options, is_gltf
    from ..jobs.bake.bake_job import bake as bake_source

    executor = executor_for(args, args.output)
    check_options(args.what.value, lights=[a for a in specs if not isinstance(a, int)] or None, **args.options())
    with ProgressDisplay(args.quiet) as display:
        display.say("reading the scene")
        scene = open_scene(spec, None if args.up is None else args.up.value, args.quiet)
        lights = _lights(args, specs, scene)
        source = BakeSource(scene, spec.path if spec.path is not None and is_gltf(spec.path) else None)
        start, keep = perf_counter(), executor or args.output.with_suffix(".parts")
        with quietly():
            result = bake_source(source, args.output, args.what.value, lights=lights, keep=keep, **args.options())
        if result is None:
            return report_shard(executor, args, perf_counter() - start)
    if args.json:
        console.print_json(result._asdict())
    elif not args.quiet:
        console.print_fields(_fields(result))
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
