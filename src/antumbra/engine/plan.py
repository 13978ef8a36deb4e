"""Plans: the methods that answer a query, and the parser of their text form. Every plan gives the same bits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, cast

from ..base.checks import checked_instance, quoted, spelling_hint
from ..base.errors import InputError
from ..base.extras import METHODS, try_plugins
from ..techniques.srdh.representative_rays import SrdhRays
from .device_tracers import device_of, joined_tracer
from .method_registry import BUILDERS, KINDS, OPTIMISERS, TRACERS, Tracer, add_plugins, find_method, listed_methods

TREE = ("build", "optimise", "update")
"""The fields for the BVH; all are None in plans whose tracer does not use a BVH."""


@dataclass(frozen=True)
class Plan:
    """The names of the methods that answer a query, written ``cull+build+optimise+update+trace``.

    Only ``build+trace`` is required, or ``trace`` alone if the tracer does not use a BVH or chooses the builder itself
    (``"auto"``).

    Parameters
    ----------
    cull : str or None
        Culler that drops triangles before the build; None: no culling.
    build : str or None
        Builder of the BVH; None: ``"bsah"``, or no builder if the tracer does not use a BVH or chooses the builder.
    trace : str
        Tracer of the rays.
    optimise : str or None
        Optimiser of the built BVH; None: no optimisation.
    update : str or None
        Updater that derives a frame's BVH from the previous frame's; None: a new build in each frame. With a culler,
        the updater maintains a BVH of all triangles, and rays traverse only its part with the remaining triangles.
    sample : SrdhRays or None
        The sample rays for a ray-guided builder or optimiser; None: the default. They never change the bits and are
        not part of the plan's text form.

    Raises
    ------
    InputError
        If a name is not in the registry of its kind, or a sample is given but no method is ray-guided.
    """

    cull: str | None = None
    build: str | None = None
    trace: str = "multifrusta"
    optimise: str | None = None
    update: str | None = None
    sample: SrdhRays | None = None

    def __post_init__(self) -> None:
        for field, (kind, registry) in KINDS.items():
            name = getattr(self, field)
            if (name is not None or field == "trace") and find_method(field, name) is None:
                raise InputError(_unknown_name(name, field, kind, registry))
        if self.build is None and self.tracer.builds and not self.tracer.chooses:
            object.__setattr__(self, "build", "bsah")
        if self.sample is not None:
            checked_instance(self.sample, SrdhRays, "sample")
            if not self.wants_rays:
                raise InputError(_no_guide([self]))

    def __str__(self) -> str:
        return "+".join(name for field in KINDS if (name := getattr(self, field)))

    @property
    def tracer(self) -> Tracer:
        """The tracer of the plan."""
        method = find_method("trace", self.trace)
        assert method is not None
        return cast(Tracer, method[1])

    @property
    def device(self) -> str | None:
        """The full name of the device on which the plan traces, such as ``"cuda:0"``; None: it traces on the CPU."""
        return device_of(self.trace)

    @property
    def chooses(self) -> bool:
        """Whether the plan is ``"auto"``, which chooses the builder for each frame."""
        return self.build is None and self.tracer.chooses

    @property
    def tree(self) -> tuple[str | None, str | None, str | None, str | None, SrdhRays | None]:
        """The fields that determine the BVH. Plans with equal fields can share a BVH."""
        return self.cull, self.trace if self.chooses else self.build, self.optimise, self.update, self.sample

    @property
    def wants_rays(self) -> bool:
        """Whether the builder or the optimiser is ray-guided, and so needs a sample of the rays to be traced."""
        return bool(
            (self.build and BUILDERS[self.build].wants_rays) or (self.optimise and OPTIMISERS[self.optimise].wants_rays)
        )


DEFAULT_PLAN = str(Plan(trace="auto"))


def parse_plan(plan: "str | Plan") -> Plan:
    """Parse ``build+trace``, or a longer plan with names from the other registries, in any order.

    A method is never replaced by another one.

    Raises
    ------
    InputError
        If a name is not in any registry, a builder or tracer is missing, or two methods are of the same kind; if a
        builder, an optimiser or an updater accompanies a tracer that does not use a BVH; if an optimiser is combined
        with a ray-guided builder.
    """
    if not isinstance(plan, (str, Plan)):
        raise InputError(f"plan is {quoted(plan)}; it must be a string, as in plan='bsah+wide', or an antumbra.Plan")
    names: dict[str, str] = {}
    for part in str(plan).split("+"):
        method = _method(part)
        if method is None:
            raise InputError(f"plan {str(plan)!r}: unknown part {part!r}; {spelling_hint(part, _names())}{_valid()}")
        field, name = method
        if field == "trace" and (joined := joined_tracer(names.get(field, ""), name)):
            name = joined
        elif field in names:
            kind = KINDS[field][0]
            raise InputError(f"plan {str(plan)!r} names two {kind}s, {names[field]!r} and {part!r}; {_valid()}")
        names[field] = name
    if "trace" not in names:
        raise InputError(f"plan {str(plan)!r} names no tracer; {_valid()}")
    parsed = Plan(**dict[str, Any](names))
    _check_tree(str(plan), names, parsed)
    return replace(parsed, sample=plan.sample) if isinstance(plan, Plan) and plan.sample is not None else parsed


def with_sample(plans: Sequence[Plan], sample: SrdhRays | None) -> list[Plan]:
    """The plans, with these sample rays in those that have a ray-guided method; None: the plans unchanged.

    Raises
    ------
    InputError
        If a sample is given but no plan has a ray-guided method.
    """
    if sample is None:
        return list(plans)
    if not any(plan.wants_rays for plan in plans):
        raise InputError(_no_guide(plans))
    return [replace(plan, sample=sample) if plan.wants_rays else plan for plan in plans]


def _method(part: str) -> tuple[str, str] | None:
    """(field of a plan, canonical name) of a method; None: unknown method."""
    for field, (_, registry) in KINDS.items():
        if part in registry:  # so that plugins are imported only for other names
            return field, part
    return next(((field, method[0]) for field in KINDS if (method := find_method(field, part))), None)


def _check_tree(text: str, names: dict[str, str], plan: Plan) -> None:
    """Raise InputError unless the plan has a builder exactly if it needs one, and its tree methods are compatible.

    names : field of the plan -> name in its text
    """
    if plan.chooses and len(names) > 1:
        raise InputError(f"plan {text!r}: {names['trace']!r} chooses the rest of the plan; name a builder, or it alone")
    if plan.chooses:
        return
    if not plan.tracer.builds:
        for field in TREE:
            if field in names:
                kind, name = KINDS[field][0], names[field]
                raise InputError(f"plan {text!r}: {names['trace']!r} needs no {kind}; leave {name!r} out")
        return
    if "build" not in names:
        raise InputError(f"plan {text!r} names no builder; {_valid()}")
    if "optimise" in names and BUILDERS[names["build"]].wants_rays:
        raise InputError(
            f"plan {text!r}: {names['optimise']!r} would undo or repeat what {names['build']!r} does for shadow rays; "
            "leave one of them out"
        )


def all_plans(papers: bool = False) -> list[Plan]:
    """Every valid combination of registered methods; `papers`: include methods that reproduce papers."""
    names = names_of(papers)
    trees = [
        (build, optimise, update)
        for build, optimise, update in product(names["build"], (None, *names["optimise"]), (None, *names["update"]))
        if not (optimise and BUILDERS[build].wants_rays)
    ]
    choosing = [Plan(trace=trace) for trace in names["trace"] if TRACERS[trace].chooses]
    return choosing + [
        Plan(cull, build, trace, optimise, update)
        for cull, trace in product((None, *names["cull"]), names["trace"])
        for build, optimise, update in (trees if TRACERS[trace].builds else [(None, None, None)])
    ]


def covering_plans(papers: bool = False) -> list[Plan]:
    """A few plans that together use every method of every registry; `papers`: as in `all_plans`.

    Each updater is also combined with a culler, because that combination has its own kernels.
    """
    names = names_of(papers)
    plans = [Plan(trace=name) for name in names["trace"]]
    for field in "build", "optimise", "update", "cull":
        single = Plan(trace="single")
        plans += [replace(single, **dict[str, Any]({field: name})) for name in names[field] if name != single.build]
    return plans + [Plan(cull=names["cull"][0], update=name, trace="single") for name in names["update"]]


def names_of(papers: bool) -> dict[str, list[str]]:
    """Field of a `Plan` -> names in its registry; `papers`: as in `all_plans`."""
    if papers:
        add_plugins()
        return {field: list(registry) for field, (_, registry) in KINDS.items()}
    try_plugins(METHODS)
    return {field: listed_methods(field) for field in KINDS}


def _names() -> list[str]:
    """The names of all methods, including those added by packages."""
    return [name for _, registry in KINDS.values() for name in registry]


def _unknown_name(name: object, field: str, kind: str, registry: Mapping[str, Any]) -> str:
    """The error message for an unknown name in a field of a `Plan`."""
    if not isinstance(name, str):
        return f"Plan has no {kind} {quoted(name)}; choose one of {', '.join(registry)}"
    if "+" in name or any(name in names for _, names in KINDS.values()):
        fields = ", ".join(f"{field}=" for field in KINDS)
        return (
            f"Plan has no {kind} {name!r}: it takes {fields} one by one; write a whole plan as a string, as in "
            "plan='bsah+wide'"
        )
    return f"Plan has no {kind} {name!r}; {spelling_hint(name, registry)}choose one of {', '.join(registry)}"


def _valid() -> str:
    names = "; ".join(f"{kind}s: {', '.join(listed_methods(field))}" for field, (kind, _) in KINDS.items())
    alone = [name for name in listed_methods("trace") if TRACERS[name].chooses or not TRACERS[name].builds]
    return f"write builder+tracer, without a builder for {' and '.join(alone)}, or more ({names})"


def _no_guide(plans: Sequence[Plan]) -> str:
    names = ", ".join(map(str, plans))
    return f"srdh_rays is given, but no method in {names} is ray-guided; leave it out, or build by srdh"


def known_plan(value: Any, what: str) -> Any:
    """Check of a plan, or None, for the fields of options."""
    parse_plan(DEFAULT_PLAN if value is None else value)
    return value
