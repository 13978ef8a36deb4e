"""A plan: which methods answer a query. Every plan gives the same bits."""

from itertools import product
from typing import NamedTuple

from .bvh import BUILDERS, OPTIMISERS, UPDATERS
from .cull import CULLERS
from .errors import InputError
from .trace import TRACERS

KINDS: dict[str, tuple[str, dict]] = {
    "cull": ("culler", CULLERS),
    "build": ("builder", BUILDERS),
    "optimise": ("optimiser", OPTIMISERS),
    "update": ("updater", UPDATERS),
    "trace": ("tracer", TRACERS),
}
"""Field of a `Plan` -> (what its methods are called, their registry), in the order in which they do their work."""


class Plan(NamedTuple):
    """Names from the registries; written ``cull+build+optimise+update+trace``, of which only two are needed."""

    cull: str | None = None  # how triangles are removed before building; None: not at all
    build: str = "bsah"  # how the BVH is built
    trace: str = "multifrusta"  # how rays are traced
    optimise: str | None = None  # how the BVH is made better once it is built; None: not at all
    update: str | None = None  # how the BVH of the last frame becomes this one's; None: it is built anew

    def __str__(self) -> str:
        return "+".join(name for field in KINDS if (name := getattr(self, field)))

    @property
    def wants_rays(self) -> bool:
        """Is the builder, or the optimiser, shown some of the rays that will be traced?"""
        return BUILDERS[self.build].wants_rays or bool(self.optimise and OPTIMISERS[self.optimise].wants_rays)


DEFAULT_PLAN = str(Plan())


def parse_plan(plan: "str | Plan") -> Plan:
    """The plan that is written ``build+trace``, or with names of the other registries too, in any order.

    Raises
    ------
    InputError
        On a name that is in no registry, a missing builder or tracer, a second method of one kind, a culler and an
        updater together, or an optimiser and a builder that goes by rays. Nothing is ever substituted.
    """
    found: dict[str, str] = {}
    for part in str(plan).split("+"):
        field = next((f for f, (_, names) in KINDS.items() if part in names), None)
        if field is None:
            raise InputError(f"plan {str(plan)!r}: unknown part {part!r}; {_valid()}")
        if field in found:
            kind = KINDS[field][0]
            raise InputError(f"plan {str(plan)!r} names two {kind}s, {found[field]!r} and {part!r}; {_valid()}")
        found[field] = part
    for field in ("build", "trace"):
        if field not in found:
            raise InputError(f"plan {str(plan)!r} names no {KINDS[field][0]}; {_valid()}")
    if "optimise" in found and BUILDERS[found["build"]].wants_rays:
        raise InputError(
            f"plan {str(plan)!r}: {found['optimise']!r} would undo, or do again, what {found['build']!r} does for "
            "shadow rays; leave one of them out"
        )
    if "cull" in found and "update" in found:
        raise InputError(
            f"plan {str(plan)!r}: {found['update']!r} keeps a tree of the same triangles, of which {found['cull']!r} "
            "leaves others in each frame; leave one of them out"
        )
    return Plan(**found)


def all_plans() -> list[Plan]:
    """Every plan that the registries allow."""
    fields = product((None, *CULLERS), BUILDERS, TRACERS, (None, *OPTIMISERS), (None, *UPDATERS))
    return [Plan(c, b, t, o, u) for c, b, t, o, u in fields if not (c and u) and not (o and BUILDERS[b].wants_rays)]


def covering_plans() -> list[Plan]:
    """A few plans in which every method of every registry has its part: what is worth compiling, and testing."""
    plans = [Plan(trace=name) for name in TRACERS]
    plans += [Plan(build=name, trace="single") for name in BUILDERS if name != Plan().build]
    plans += [Plan(optimise=name, trace="single") for name in OPTIMISERS]
    plans += [Plan(update=name, trace="single") for name in UPDATERS]
    return plans + [Plan(cull=name, trace="single") for name in CULLERS]


def _valid() -> str:
    names = "; ".join(f"{kind}s: {', '.join(names)}" for kind, names in KINDS.values() if names)
    return f"write builder+tracer, or more ({names})"
