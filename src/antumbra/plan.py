"""A plan: which methods answer a query. Every plan gives the same bits."""

from dataclasses import dataclass
from itertools import product

from .errors import InputError
from .methods import BUILDERS, KINDS, OPTIMISERS, TRACERS, Tracer, add_plugins, find_method, own_methods

TREE = ("build", "optimise", "update")
"""The fields that make a BVH: None, all of them, in plans whose tracer walks none."""


@dataclass(frozen=True)
class Plan:
    """Names from the registries; written ``cull+build+optimise+update+trace``, of which only one or two are needed.

    Parameters
    ----------
    cull : str or None
        How triangles are removed before building; None: not at all.
    build : str or None
        How the BVH is built. None: by ``"bsah"``, or not at all if the tracer walks none; ``build`` then stays None.
    trace : str
        How rays are traced.
    optimise : str or None
        How the BVH is made better once it is built; None: not at all.
    update : str or None
        How the BVH of the last frame becomes this one's; None: it is built anew.
    """

    cull: str | None = None
    build: str | None = None
    trace: str = "multifrusta"
    optimise: str | None = None
    update: str | None = None

    def __post_init__(self):
        found = find_method("trace", self.trace)
        if self.build is None and (found is None or found[1].builds):  # an unknown name is for `parse_plan` to refuse
            object.__setattr__(self, "build", "bsah")

    def __str__(self) -> str:
        return "+".join(name for field in KINDS if (name := getattr(self, field)))

    @property
    def tracer(self) -> Tracer:
        """What traces the rays."""
        found = find_method("trace", self.trace)
        assert found is not None
        return found[1]

    @property
    def tree(self) -> tuple[str | None, ...]:
        """What the BVH depends on; plans that agree in it can share one."""
        return self.cull, self.build, self.optimise, self.update

    @property
    def wants_rays(self) -> bool:
        """Is the builder, or the optimiser, shown some of the rays that will be traced?"""
        return bool(
            (self.build and BUILDERS[self.build].wants_rays) or (self.optimise and OPTIMISERS[self.optimise].wants_rays)
        )


DEFAULT_PLAN = str(Plan())


def parse_plan(plan: "str | Plan") -> Plan:
    """The plan that is written ``build+trace``, or with names of the other registries too, in any order.

    Raises
    ------
    InputError
        On a name that is in no registry, a missing builder or tracer, a second method of one kind, a builder, an
        optimiser or an updater for a tracer that walks no BVH, a culler and an updater together, or an optimiser and a
        builder that goes by rays. Nothing is ever substituted.
    """
    found: dict[str, str] = {}
    for part in str(plan).split("+"):
        method = _method(part)
        if method is None:
            raise InputError(f"plan {str(plan)!r}: unknown part {part!r}; {_valid()}")
        field, name = method
        if field in found:
            kind = KINDS[field][0]
            raise InputError(f"plan {str(plan)!r} names two {kind}s, {found[field]!r} and {part!r}; {_valid()}")
        found[field] = name
    if "trace" not in found:
        raise InputError(f"plan {str(plan)!r} names no tracer; {_valid()}")
    made = Plan(**found)
    _check_tree(str(plan), found, made.tracer.builds)
    if "cull" in found and "update" in found:
        raise InputError(
            f"plan {str(plan)!r}: {found['update']!r} keeps a tree of the same triangles, of which {found['cull']!r} "
            "leaves others in each frame; leave one of them out"
        )
    return made


def _method(part: str) -> tuple[str, str] | None:
    """The field of a plan that a method belongs to, and its name there; None: there is no such method."""
    return next(((field, found[0]) for field in KINDS if (found := find_method(field, part))), None)


def _check_tree(plan: str, found: dict[str, str], builds: bool) -> None:
    """InputError unless the methods make a BVH just where the tracer walks one (`builds`), and go together."""
    if not builds:
        for field in TREE:
            if field in found:
                kind, name = KINDS[field][0], found[field]
                raise InputError(f"plan {plan!r}: {found['trace']!r} needs no {kind}; leave {name!r} out")
        return
    if "build" not in found:
        raise InputError(f"plan {plan!r} names no builder; {_valid()}")
    if "optimise" in found and BUILDERS[found["build"]].wants_rays:
        raise InputError(
            f"plan {plan!r}: {found['optimise']!r} would undo, or do again, what {found['build']!r} does for "
            "shadow rays; leave one of them out"
        )


def all_plans(papers: bool = False) -> list[Plan]:
    """Every plan that the registries allow; `papers`: with methods that packages add, too."""
    names = names_of(papers)
    trees = [
        (b, o, u)
        for b, o, u in product(names["build"], (None, *names["optimise"]), (None, *names["update"]))
        if not (o and BUILDERS[b].wants_rays)
    ]
    return [
        Plan(c, b, t, o, u)
        for c, t in product((None, *names["cull"]), names["trace"])
        for b, o, u in (trees if TRACERS[t].builds else [(None, None, None)])
        if not (c and u)
    ]


def covering_plans(papers: bool = False) -> list[Plan]:
    """A few plans in which every method of every registry has its part; `papers` as in `all_plans`."""
    names = names_of(papers)
    plans = [Plan(trace=name) for name in names["trace"]]
    for field in "build", "optimise", "update", "cull":
        plans += [Plan(**{"trace": "single", field: name}) for name in names[field] if name != Plan().build]
    return plans


def names_of(papers: bool) -> dict[str, list[str]]:
    """The names of each registry."""
    if papers:
        add_plugins()
        return {field: list(registry) for field, (_, registry) in KINDS.items()}
    return {field: own_methods(field) for field in KINDS}


def _valid() -> str:
    names = "; ".join(f"{kind}s: {', '.join(own_methods(field))}" for field, (kind, _) in KINDS.items())
    alone = [name for name in own_methods("trace") if not TRACERS[name].builds]
    return f"write builder+tracer, without a builder for {' and '.join(alone)}, or more ({names})"
