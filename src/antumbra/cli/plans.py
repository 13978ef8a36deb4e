"""``antumbra plans``: the registries."""

from . import report
from .options import Json


def plans(json: Json = False) -> None:
    """List the methods and the plans made of them.

    Each method has a description and a paper. A plan is written builder+tracer, with a culler, an optimiser or an
    updater where one is wanted. The tracer cones walks no BVH, so its plans have no builder; its options can be
    combined, as in cones:spheres:sorted. All plans give the same bits; they differ in speed.

    \b
    Examples
      antumbra plans
      antumbra render --plan bsah+single
      antumbra render --plan grid32+lbvh+multifrusta
      antumbra render --plan cones
    """
    from ..plan import KINDS, Plan, all_plans

    methods = [
        {"kind": kind, "name": name, "description": method.description, "paper": method.paper}
        for kind, registry in KINDS.values()
        for name, method in registry.items()
    ]
    if json:
        names = [str(plan) for plan in all_plans()]
        report.print_json({"methods": methods, "plans": names, "default": str(Plan())})
        return
    report.print_table(("kind", "name", "what it does", "paper"), [tuple(m.values()) for m in methods])
    order = "+".join(kind for kind, registry in KINDS.values() if registry)
    report.print_fields(
        [
            ("a plan", f"{order}, of which only builder and tracer are needed; cones takes no builder"),
            ("default", str(Plan())),
        ]
    )
