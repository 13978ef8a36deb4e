"""``antumbra render``: from a scene to a picture with exact shadows."""

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from ..errors import InputError
from . import arguments, report, summary
from .frames import Job, output_path, render_frames
from .options import SCENE_HELP, CameraOption, GBufferBy, Json, Quiet, SppOption, SrdhRaysOption, Threads, UpOption
from .progress import Activity
from .renderoptions import Asked
from .sceneinput import open_scene


def render(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .png or .exr file; #### is a frame's number.  [default: SCENE's name.png, here]",
            metavar="FILE",
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the picture in pixels.", metavar="WxH")] = "1024x1024",
    camera: CameraOption = None,
    light: Annotated[
        list[str] | None,
        typer.Option(help="An index, or KIND:...[@INTENSITY]; may be repeated.", metavar="LIGHT", show_default=False),
    ] = None,
    ao: Annotated[
        str | None,
        typer.Option(
            help="Ambient occlusion by what is nearer than RADIUS (inf: by everything), besides the lights.",
            metavar="RADIUS[@INTENSITY]",
            show_default=False,
        ),
    ] = None,
    vpl: Annotated[
        int | None,
        typer.Option(
            help="Instead of ambient light, light that bounces once: photons of the first light become point lights.",
            min=1,
            max=16384,
            metavar="PHOTONS",
            show_default=False,
        ),
    ] = None,
    bounce: Annotated[
        int | None,
        typer.Option(
            help="Instead of ambient light, light that bounces once: so many diffuse rays from each pixel.",
            min=1,
            max=1024,
            metavar="RAYS",
            show_default=False,
        ),
    ] = None,
    time: Annotated[
        float | None, typer.Option(help="Seconds into the animation.  [default: 0]", show_default=False)
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(
            help="An animation instead of one picture; LAST is included.",
            metavar="FIRST:LAST[:STEP]",
            show_default=False,
        ),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(help="Frames a second of --frames.  [default: 24]", show_default=False)
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Render frames again that are finished already.")
    ] = False,
    up: UpOption = None,
    spp: SppOption = 16,
    sampler: Annotated[
        str,
        typer.Option(
            help="Points on the light: larcher-pillichshammer, hammersley, sobol or halton[:0|:18|:36|:full].",
            metavar="NAME",
        ),
    ] = "larcher-pillichshammer",
    filter: Annotated[bool, typer.Option("--filter", help="Smooth noise in penumbrae over 4x4 pixels.")] = False,
    adaptive: Annotated[
        bool, typer.Option("--adaptive", help="Refine penumbrae with more rays, and edges by sub-pixels.")
    ] = False,
    adaptive_spp: Annotated[
        int | None,
        typer.Option(
            help="Shadow rays for each refined pixel and light; implies --adaptive.  [default: 4 times --spp]",
            min=1,
            max=1024,
            show_default=False,
        ),
    ] = None,
    plan: Annotated[
        str | None,
        typer.Option(
            help="Which methods answer; see antumbra plans.  [default: bsah+multifrusta; of a store bsah+chcrt]",
            show_default=False,
        ),
    ] = None,
    srdh_rays: SrdhRaysOption = None,
    gbuffer: Annotated[GBufferBy, typer.Option(help="How it is found what pixels see.")] = GBufferBy.raster,
    threads: Threads = None,
    max_memory: Annotated[
        str | None,
        typer.Option(
            help="Memory to render a store with, in bytes, or with M or G: 512M.  [default: 4G]",
            metavar="SIZE",
            show_default=False,
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(help="Factor on the light of a .png.  [default: automatic]", show_default=False),
    ] = None,
    counters: Annotated[bool, typer.Option("--counters", help="Count rays, nodes and tests exactly.")] = False,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Render SCENE with exact shadows.

    Without arguments, the embedded atrium is rendered to antumbra.png. Cameras and lights come from the file at the
    time given; a scene without a camera is shown whole, one without lights gets a square light above it.

    \b
    CAMERA
      1                         the second camera of the file
      0,1.7,8:0,1,0             from 0,1.7,8 towards 0,1,0
      0,1.7,8:0,1,0:45          ... with a vertical field of view of 45 degrees instead of 60

    \b
    LIGHT
      0                                    the first light of the file
      point:X,Y,Z
      quad:CX,CY,CZ:UX,UY,UZ:VX,VY,VZ      a parallelogram around C with the edges U and V
      disk:CX,CY,CZ:NX,NY,NZ:RADIUS        a disk around C that faces N
      sphere:CX,CY,CZ:RADIUS
      sun:DX,DY,DZ[:ANGULAR_DIAMETER]      shines along D; 0.53 degrees wide, as the sun
      ...@INTENSITY                        candela (sun: lux), 1 by default

    Frame k of --frames shows the moment k / fps; after the animation's end, its end. A frame whose file is there
    already, from the same scene and options, is not rendered again: repeat a command that was interrupted, and it goes
    on. All frames have the exposure of the first one, unless --exposure is given. A frame that fails is named, and the
    others go on; the exit code is 2 then.

    \b
    Examples
      antumbra render
      antumbra render sponza.glb --size 1920x1080 --spp 64 -o sponza.exr
      antumbra render city.ply --up z --light sun:1,0.5,-1 --camera=-90,-60,40:0,0,5
      antumbra render hall.glb --light point:0,3,0@50 --light sphere:2,1,2:0.2@10 --counters
      antumbra render hall.glb --ao 2 --spp 64
      antumbra render hall.glb --vpl 1000
      antumbra render hall.glb --bounce 20 --sampler halton --filter
      antumbra render robot.glb --time 1.5 --filter --adaptive
      antumbra render robot.glb --time 1.5 --json
      antumbra render robot.glb --frames 0:240 -o f.####.png
      antumbra render robot.glb --frames 0:240 --plan srdh+single --srdh-rays last-frame
      antumbra render "procedural:city?triangles=500k&seed=3"
      antumbra render city.antumbra --max-memory 2G
    """
    for name, instead in (("--vpl", vpl), ("--bounce", bounce)):
        if ao is not None and instead is not None:
            raise InputError(f"--ao dims the ambient light that {name} replaces; leave one of them out")
    if vpl is not None and bounce is not None:
        raise InputError("--vpl and --bounce are both light that bounces once; leave one of them out")
    spec = arguments.parse_scene(scene)
    asked = Asked(
        source=scene,
        spec=spec,
        up=None if up is None else up.value,
        size=arguments.parse_size(size),
        camera=None if camera is None else arguments.parse_camera(camera),
        lights=[arguments.parse_light(text) for text in light or []],
        ambient=[] if ao is None else [arguments.parse_ambient(ao)],
        vpl=vpl,
        bounce=bounce,
        spp=spp,
        sampler=sampler,
        filter=filter,
        adaptive=min(4 * spp, 1024) if adaptive and adaptive_spp is None else adaptive_spp,
        plan=plan,
        srdh_rays=None if srdh_rays is None else arguments.parse_srdh_rays(srdh_rays),
        gbuffer=gbuffer.value,
        threads=threads,
        max_memory=None if max_memory is None else arguments.parse_bytes(max_memory, "--max-memory"),
        exposure=exposure,
        counters=counters,
        json=json,
        quiet=quiet,
    )
    sequence = None if frames is None else arguments.parse_frames(frames, time, fps)
    if sequence is None and fps is not None:
        raise InputError("--fps belongs to --frames FIRST:LAST; leave it out")
    if sequence is None and overwrite:
        raise InputError("--overwrite belongs to --frames FIRST:LAST; a single picture is always written anew")
    if sequence is None and asked.srdh_rays is not None and asked.srdh_rays.last_frame:
        raise InputError("--srdh-rays last-frame belongs to --frames FIRST:LAST; a single picture has no frame before")
    path = output_path(output, spec.stem, sequence)
    asked.check()
    with Activity(quiet) as activity:
        activity.say("reading the scene")
        start = perf_counter()
        opened = open_scene(spec, asked.up, quiet)
        asked = asked.about(opened)
        load = perf_counter() - start
        activity.say("preparing")
        if sequence is None:
            shot = asked.shot(opened, asked.renderer(opened), 0.0 if time is None else time, activity.parts)
            activity.say("writing the picture")
            saved = summary.save(shot.frame, path, exposure)
        else:
            animation = render_frames(Job(asked, opened, load, path, overwrite), sequence, activity)
    if sequence is not None:
        return animation.tell()
    if json:
        report.print_json(summary.picture_answer(asked, opened, load, shot, saved))
    elif not quiet:
        report.print_fields(summary.picture_fields(asked, opened, load, shot, saved))
    return 0
