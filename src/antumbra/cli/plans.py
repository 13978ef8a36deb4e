"""``antumbra plans``: lists the registered methods."""

from typing import Annotated

import typer

from . import report
from .options import Json


def plans(
    papers: Annotated[
        bool, typer.Option("--papers", help="Also the methods that exist to reproduce a paper, or to be compared with.")
    ] = False,
    json: Json = False,
) -> None:
    """List the methods and the plans made of them.

    Each method has a description and a paper. A plan is written builder+tracer, with an optional culler, optimiser or
    updater. The tracer cones uses no BVH, so its plans have no builder. All plans give the same bits and differ in
    speed. Plans can name the methods of --papers like any others. The options of cones can be combined, as in
    cones:spheres:sorted.

    \b
    Examples
      antumbra plans
      antumbra plans --papers
      antumbra render --plan bsah+single
      antumbra render --plan grid32+lbvh+multifrusta
      antumbra render --plan cones
    """
    from ..methods import KINDS
    from ..plan import DEFAULT_PLAN, all_plans, names_of

    names = names_of(papers)
    methods = [
        {"kind": kind, "name": name, "description": registry[name].description, "paper": registry[name].paper}
        for field, (kind, registry) in KINDS.items()
        for name in names[field]
    ]
    if json:
        written = [str(plan) for plan in all_plans(papers)]
        report.print_json({"methods": methods, "plans": written, "default": DEFAULT_PLAN})
        return
    report.print_table(("kind", "name", "what it does", "paper"), [tuple(m.values()) for m in methods])
    order = "+".join(kind for kind, _ in KINDS.values())
    report.print_fields(
        [
            ("a plan", f"{order}, of which only builder and tracer are needed; no builder for cones, or for auto"),
            ("default", DEFAULT_PLAN),
        ]
    )
