"""``antumbra warmup``: compile everything now, so that nothing compiles later."""

from time import perf_counter
from typing import Annotated

import typer

from . import report
from .activity import Activity
from .options import Json, Quiet


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
    """Compile all kernels now and keep them on disk.

    Otherwise that happens when a kernel is first used: once for each machine and version.

    \b
    Examples
      antumbra warmup
      antumbra warmup --plan bsah+single
    """
    from ..plan import covering_plans, parse_plan

    wanted = [parse_plan(text) for text in plan or []] or covering_plans()

    from ..kernels.jit import CACHE_DIR
    from ..warm import kernels_of

    work, start = kernels_of(dict.fromkeys(wanted)), perf_counter()
    with Activity(quiet) as activity:
        for i, (name, compile_kernels) in enumerate(work):
            activity.say(f"compiling {name}", i, len(work))
            compile_kernels()
    seconds = perf_counter() - start
    if json:
        names = [name for name, _ in work]
        report.print_json({"kernels": names, "folder": str(CACHE_DIR), "seconds": seconds})
    elif not quiet:
        print(f"{len(work)} sets of kernels are ready in {CACHE_DIR} ({report.duration(seconds)})")
