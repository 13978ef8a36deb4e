"""``antumbra warmup``: compiles all kernels now, so that none compiles later."""

from time import perf_counter
from typing import Annotated

import typer

from . import report
from .options import Json, Quiet
from .progress import ProgressDisplay


def warmup(
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help="Only for this plan; may be repeated.  [default: all methods]",
            metavar="PLAN",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compile all kernels now and keep them on disk, and measure this machine.

    Otherwise each kernel is compiled when it is first used, once for each machine and version. The plan auto predicts
    times by what is measured here; otherwise by figures of another machine.

    \b
    Examples
      antumbra warmup
      antumbra warmup --plan bsah+single
    """
    from ..engine.precompilation import precompile_all
    from ..jobs.warm import jobs
    from ..kernels.loading import user_cache
    from ..plan import covering_plans, parse_plan
    from ..rendering.calibration import calibrate

    plans = [parse_plan(text) for text in plan] if plan else covering_plans()
    wanted = jobs(plans)
    start = perf_counter()
    with ProgressDisplay(quiet):
        compiled = precompile_all(wanted)
        measured = calibrate()._asdict() if any(plan.tracer.chooses for plan in plans) else None
    seconds, folder = perf_counter() - start, str(user_cache().path)
    if json:
        names = [job.name for job in wanted]
        report.print_json(
            {"jobs": names, "compiled": compiled, "folder": folder, "seconds": seconds, "machine": measured}
        )
    elif not quiet:
        print(
            f"kernels of {len(wanted)} jobs are ready, {compiled} of them new, in {folder} ({report.duration(seconds)})"
        )
