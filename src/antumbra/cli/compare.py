"""``antumbra compare``: measures plans on the same picture."""

from dataclasses import replace
from time import perf_counter

from . import comparepage, comparesummary, report
from .about import about
from .comparearguments import CompareArguments
from .failures import UNFORESEEN, say
from .options import takes
from .picturespec import Shot
from .progress import ProgressDisplay
from .sceneinput import limit_memory, open_scene


@takes(CompareArguments)
def compare(given: CompareArguments) -> int:
    """Measure plans on the same picture of SCENE, side by side.

    The plans take turns, and the medians of their frames are shown, phase by phase. Compilation is never timed. Each
    frame starts anew, as the picture of antumbra render: it keeps nothing from the frames before. Counters are those of
    a frame that is not timed.

    All plans must give the same bits. If an exact plan differs from the first one, the exit code is 1.

    The picture shows the rendered scene, and a heat map for each plan: the tests of boxes and triangles per shadow ray,
    in windows of 16x16 pixels. All maps have the same colours, on a logarithmic scale. A plan without a builder has no
    map, because its hierarchy is over the rays of all pixels. CAMERA and LIGHT are written as in antumbra render.

    \b
    Examples
      antumbra compare --plan bsah+single --plan bsah+multifrusta
      antumbra compare sponza.glb --plan bsah+wide --plan srdh+wide --plan cones --html sponza.html
      antumbra compare robot.glb --time 2 --plan lbvh+multifrusta --plan grid32+lbvh+multifrusta --rounds 9
      antumbra compare city.antumbra --plan bsah+chcrt --plan bsah+chcrt:20 --json
    """
    from ..kernels.parallel import thread_count
    from ..plan import with_sample
    from ..rendering.comparison import compare as compared
    from ..rendering.comparison import compared_plans
    from ..rendering.moments import Moment

    asked = given.options()
    path, page = given.output, given.html
    plans = compared_plans(given.plan or [])
    asked.check(*plans)
    plans = with_sample(plans, asked.srdh_rays)
    with ProgressDisplay(asked.quiet) as display:
        display.say("reading the scene")
        start = perf_counter()
        scene = open_scene(asked.spec, asked.up, asked.quiet)
        load = perf_counter() - start
        limit_memory(scene, asked.engine.max_memory)
        time = scene.clamped(given.time or 0.0)
        moment = Moment(time, asked.view(scene, time), asked.all_lights(scene, time))
        display.say("preparing")
        options = replace(asked.picture, time=time, antialias=False)  # a pixel that differs shows in no other pixel
        found = compared(scene, moment, plans, options, asked.engine, rounds=given.rounds, say=display.say)
        display.say("writing the picture")
        shot = Shot(moment.camera, moment.lights, options, found.frame)
        told = comparesummary.Told(
            given, asked, scene, load, shot, found, {**about(), "threads": thread_count(asked.engine.threads)}
        )
        panels = comparesummary.Panels(told)
        panels.save(path)
        if page is not None:
            comparepage.save(told, panels, page)
    if asked.json:
        report.print_json(comparesummary.answer(told))
    elif not asked.quiet:
        report.print_fields(comparesummary.fields(told))
        comparesummary.print_tables(told)
    for one in found.wrong:
        say(f"{comparesummary.differs(found, one)}; this is a bug, please report it with the scene and the command")
    return UNFORESEEN if found.wrong else 0
