"""``antumbra render``: renders a scene with exact shadows."""

import json
from time import perf_counter

from . import arguments, renderpage, report, summary
from .frames import AnimationJob, film_path, output_path, pictures_of, render_frames
from .options import takes
from .picturespec import Shot, scene_digest
from .planreport import print_choices
from .progress import ProgressDisplay
from .renderarguments import RenderArguments
from .sceneinput import open_scene
from .sharing import engine_for, tell_shard


@takes(RenderArguments)
def render(given: RenderArguments) -> int:
    """Render SCENE with exact shadows.

    Without arguments, it renders the embedded atrium to antumbra.png. Cameras and lights come from the file, at the
    given time. Without a camera, the scene is shown from a little above, and a hall or room from inside. Without
    lights, there are sun and sky, and in a closed room a lamp.

    \b
    CAMERA
      1                         the second camera of the file
      0,1.7,8:0,1,0             position 0,1.7,8, target 0,1,0
      0,1.7,8:0,1,0:45          ... with a vertical field of view of 45 degrees instead of 60
      ortho                     an orthographic view that shows the scene; top: from straight above
      ortho:9,9,9:0,0,0:4       ... from a position to a target, 4 units high
      panorama                  all directions, from where the default camera is, or from the middle of a room
      panorama:0,1.7,8:0,1,0    ... from a position, with the heading of a target in the middle

    \b
    LIGHT
      0                                    the first light of the file
      point:X,Y,Z
      quad:CX,CY,CZ:UX,UY,UZ:VX,VY,VZ      a parallelogram around C with the edges U and V
      disk:CX,CY,CZ:NX,NY,NZ:RADIUS        a disk around C that faces N
      sphere:CX,CY,CZ:RADIUS
      sun:DX,DY,DZ[:ANGULAR_DIAMETER]      shines along D; 0.53 degrees wide by default, like the sun
      ...@INTENSITY                        candela (sun: lux), 1 by default

    Frame k of --frames shows the time k / fps; later frames show the animation's end. A frame is not rendered again if
    its file exists already, from the same scene and options. So an interrupted command continues when you repeat it.
    All frames have the exposure of the first one, unless --exposure is given. If a frame fails, its error is shown and
    the others continue; the exit code is then 2. A .mp4, .webm or .gif file is a film of the frames.

    \b
    Examples
      antumbra render
      antumbra render sponza.glb --size 1920x1080 --spp 64 -o sponza.exr
      antumbra render city.ply --up z --light sun:1,0.5,-1 --camera=-90,-60,40:0,0,5
      antumbra render hall.glb --light point:0,3,0@50 --light sphere:2,1,2:0.2@10 --counters
      antumbra render hall.glb --ao 2 --spp 64 --counters --html hall.html
      antumbra render hall.glb --vpl 1000
      antumbra render hall.glb --bounce 20 --sampler halton --filter
      antumbra render robot.glb --time 1.5 --filter --adaptive
      antumbra render robot.glb --time 1.5 --json
      antumbra render robot.glb --frames 0:240 -o f.####.png
      antumbra render robot.glb --frames 0:48 --fps 24 -o robot.mp4
      antumbra render robot.glb --frames 0:240 --plan srdh+single --srdh-rays last-frame
      antumbra render "procedural:city?triangles=500k&seed=3"
      antumbra render city.antumbra --max-memory 2G
      antumbra render sponza.glb --ao 2 --explain-plan
    """
    from ..jobs.engines import Whole

    given.check()
    asked = given.options()
    sequence = None if given.frames is None else arguments.parse_frames(given.frames, given.time, given.fps)
    film = film_path(given.output, sequence, asked)
    path = pictures_of(film) if film else output_path(given.output, asked.spec.stem, sequence)
    html = given.html
    asked.check()
    engine = engine_for(given, path)
    with ProgressDisplay(asked.quiet) as display:
        display.say("reading the scene")
        start = perf_counter()
        opened = open_scene(asked.spec, asked.up, asked.quiet)
        asked = asked.about(opened)
        load = perf_counter() - start
        display.say("preparing")
        if sequence is not None:
            job = AnimationJob(asked, opened, load, path, given.overwrite, film)
            animation = render_frames(job, sequence, display, engine or Whole())
        else:
            linear = path.suffix.lower() == ".exr"
            digest = scene_digest(asked.spec) if linear or engine else ""
            shot: Shot | None
            if engine is None:
                shot = asked.shot(opened, asked.renderer(opened), given.time or 0.0, display.parts, linear)
            else:
                shot = asked.shot_in_bands(opened, given.time or 0.0, engine, digest, linear)
            if shot is None:  # a shard
                return tell_shard(engine, given, perf_counter() - start - load)
            display.say("writing the picture")
            note = json.dumps(asked.settings(opened, digest, shot.time)) if linear else None
            saved = summary.save(shot.frame, path, asked.exposure, note, background=asked.behind)
            if html is not None:
                renderpage.save(asked, opened, load, shot, saved, html)
    if sequence is not None:
        return animation.tell()
    assert shot is not None
    if asked.json:
        report.print_json(summary.picture_answer(asked, opened, load, shot, saved))
    elif not asked.quiet:
        report.print_fields(summary.picture_fields(asked, opened, load, shot, saved))
        if given.explain_plan:
            print_choices(shot, opened.n_triangles)
    return 0
