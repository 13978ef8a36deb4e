"""``antumbra plans``: the registries."""

from . import report
from .options import Json


def plans(json: Json = False) -> None:
    """List the methods and the plans made of them.

    Each method has a description and a paper. A plan is written builder+tracer, or culler+builder+tracer. All plans
    give the same bits; they differ in speed.

    \b
    Examples
      antumbra plans
      antumbra render --plan bsah+single
    """
    from ..bvh import BUILDERS
    from ..plan import CULLERS, Plan, all_plans
    from ..trace import TRACERS

    kinds = {"culler": CULLERS, "builder": BUILDERS, "tracer": TRACERS}
    methods = [
        {"kind": kind, "name": name, "description": method.description, "paper": method.paper}
        for kind, methods in kinds.items()
        for name, method in methods.items()
    ]
    names = [str(plan) for plan in all_plans()]
    if json:
        report.print_json({"methods": methods, "plans": names, "default": str(Plan())})
        return
    report.print_table(("kind", "name", "what it does", "paper"), [tuple(m.values()) for m in methods])
    report.print_fields([("plans", ", ".join(names)), ("default", str(Plan()))])
