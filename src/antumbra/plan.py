"""A plan: which culler, builder and tracer answer a query. Every plan gives the same bits."""

from typing import NamedTuple

from .bvh import BUILDERS
from .errors import InputError
from .trace import TRACERS

CULLERS: dict = {}
"""Name -> how triangles that no shadow ray can meet are removed before building; a plan may name none."""


class Plan(NamedTuple):
    """Names from the registries CULLERS (or None), BUILDERS and TRACERS; written ``cull+build+trace``."""

    cull: str | None = None  # how triangles are removed before building; None: not at all
    build: str = "bsah"  # how the BVH is built
    trace: str = "multifrusta"  # how rays are traced

    def __str__(self) -> str:
        return "+".join(part for part in self if part)


DEFAULT_PLAN = str(Plan())


def parse_plan(plan: "str | Plan") -> Plan:
    """The plan that is written ``build+trace`` or ``cull+build+trace``.

    Raises
    ------
    InputError
        On a name that is in no registry, a missing or a second builder or tracer. Nothing is ever substituted.
    """
    parts = [p for p in plan if p] if isinstance(plan, Plan) else str(plan).split("+")
    found: dict[str, str] = {}
    for part in parts:
        kind = next((k for k, names in _registries().items() if part in names), None)
        if kind is None:
            raise InputError(f"plan {str(plan)!r}: unknown part {part!r}; {_valid()}")
        if kind in found:
            raise InputError(f"plan {str(plan)!r} names two {kind}s, {found[kind]!r} and {part!r}; {_valid()}")
        found[kind] = part
    for kind in ("builder", "tracer"):
        if kind not in found:
            raise InputError(f"plan {str(plan)!r} names no {kind}; {_valid()}")
    return Plan(found.get("culler"), found["builder"], found["tracer"])


def all_plans() -> list[Plan]:
    """Every plan that the registries allow."""
    return [Plan(c, b, t) for c in (None, *CULLERS) for b in BUILDERS for t in TRACERS]


def _registries() -> dict[str, dict]:
    return {"culler": CULLERS, "builder": BUILDERS, "tracer": TRACERS}


def _valid() -> str:
    names = "; ".join(f"{kind}s: {', '.join(names)}" for kind, names in _registries().items() if names)
    return f"write builder+tracer ({names})"
