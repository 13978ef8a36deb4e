"""The registries of methods: cullers, builders, optimisers, updaters and tracers that a plan can name.

This module lists the library's own methods. Other packages add methods with `register`. Such a package declares a
function under the entry point group ``antumbra.methods``; the first lookup of an unknown name calls it, or the first
choice of `auto`. What a plugin needs can be imported from here; ``examples/plugin`` is one.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from ..base import extras, wings
from ..base.checks import choice, quoted
from ..base.errors import InputError
from ..bvh import binned_sah, lbvh, ploc, refit, reinsertion
from ..bvh.nodes import Bvh
from ..techniques.chcrt.chcrt_tracer import ChcRtTracer
from ..techniques.culling.pre_bvh_culling import CullResult, cull
from ..techniques.rayhierarchy.cone_tracer import FastestCones
from ..techniques.srdh import srdh_builder
from ..techniques.tracer_options import ChcRtOptions
from ..trace.frusta.multi_frusta import MultiFrusta
from ..trace.frusta.sample_frusta import SampleFrustaTracer
from ..trace.packets.packet16 import BlockPackets, PixelPackets, SamplePackets
from ..trace.packets.wide_packets import WidePackets, WideSamplePackets
from ..trace.rays.single_rays import SingleRays
from ..trace.tracer import BLOCKS, BVH, TRACERS, TRIANGLES, WIDE, Form, Tracer, TracerState
from ..trace.tracer_cost import Cost, FittedRate, QueryFeatures, TreelessCost
from .auto.strategies import AutoTracer

__all__ = [
    "BLOCKS",
    "BUILDERS",
    "BVH",
    "CULLERS",
    "KINDS",
    "OPTIMISERS",
    "TRACERS",
    "TRIANGLES",
    "UPDATERS",
    "WIDE",
    "Builder",
    "Cost",
    "Culler",
    "FittedRate",
    "Form",
    "Optimiser",
    "QueryFeatures",
    "Tracer",
    "TracerState",
    "TreelessCost",
    "Updater",
    "add_plugins",
    "find_method",
    "listed_methods",
    "own_methods",
    "register",
    "register_family",
]


class Culler(NamedTuple):
    """A method that drops triangles before a BVH is built: ``cull(triangles, queries, threads) -> CullResult``.

    It keeps every triangle that a shadow ray of the queries can hit.
    """

    cull: Callable[..., CullResult]
    description: str  # one line, for `antumbra plans`
    paper: str  # citation
    cells: int | None = None  # per axis of its grid, for tracers that cull by `CullRequest`; None: only `cull` can


class Builder(NamedTuple):
    """A method that builds a BVH: ``build(vertices, threads=None, ...) -> Bvh``.

    A ray-guided builder also takes `ray_hits.Intersections` as ``rays``. All builders return a valid `Bvh`.
    """

    build: Callable[..., Bvh]
    description: str
    paper: str
    wants_rays: bool = False


class Optimiser(NamedTuple):
    """A method that improves a BVH: ``optimise(bvh, threads=None, ...) -> Bvh``.

    It works on the BVH of any builder that is not ray-guided. A ray-guided optimiser also takes
    `ray_hits.Intersections` as ``rays``. The surface area cost never increases.
    """

    optimise: Callable[..., Bvh]
    description: str
    paper: str
    wants_rays: bool = False


class Updater(NamedTuple):
    """A method that derives a frame's BVH from the previous frame's, if that pays off.

    It works with any builder. ``keep(build)`` returns an object that persists across frames and has a method
    ``update(vertices, threads) -> Bvh``. Its argument ``build(vertices, threads)`` builds a new BVH.
    """

    keep: Callable[..., Any]
    description: str
    paper: str


SELGRAD = (
    "Selgrad et al. 2015, Faster ray-traced shadows for hybrid rendering of fully dynamic scenes by pre-BVH culling"
)
FELTMAN = "Feltman et al. 2012, SRDH: Specializing BVH construction and traversal order"


# --- cullers, builders, optimisers and updaters -----------------------------------------------------------------------

CULLERS: dict[str, Culler] = {
    f"grid{n}": Culler(
        partial(cull, n=n),
        f"drops triangles by a grid of {n} x {n} x {n} cells between receivers and lights",
        SELGRAD,
        n,
    )
    for n in (32, 16, 64, 128, 256)
}
"""Name -> culler."""

BUILDERS: dict[str, Builder] = {
    "bsah": Builder(
        binned_sah.build,
        "binned surface area heuristic, top-down, in parallel",
        "Wald 2007, On fast construction of SAH-based bounding volume hierarchies",
    ),
    "sweep-sah": Builder(
        wings.later(wings.SWEEP_SAH),
        "full sweep surface area heuristic: the quality reference",
        "MacDonald and Booth 1990, Heuristics for ray tracing using space subdivision",
    ),
    "lbvh": Builder(
        lbvh.build,
        "30-bit Morton codes: the fastest build",
        "Karras 2012, Maximizing parallelism in the construction of BVHs, octrees, and k-d trees",
    ),
    "lbvh63": Builder(
        lbvh.build63,
        "63-bit Morton codes: for scenes with fine detail in a small region",
        "Karras 2012, Maximizing parallelism in the construction of BVHs, octrees, and k-d trees",
    ),
    "ploc": Builder(
        ploc.build,
        "locally-ordered clustering in Morton order: between lbvh and bsah in build and ray time",
        "Meister and Bittner 2018b, Parallel locally-ordered clustering for bounding volume hierarchy construction",
    ),
    "tl-lbvh": Builder(
        wings.later(wings.TL_LBVH),
        "lbvh with restructured treelets: builds as fast as bsah, and better trees in most scenes",
        "Karras and Aila 2013, Fast parallel construction of high-quality bounding volume hierarchies",
    ),
    "srdh": Builder(
        srdh_builder.build,
        "tree and child order optimised for a sparse sample of the shadow rays",
        f"{FELTMAN}, Sec. 3.4",
        wants_rays=True,
    ),
}
"""Name -> builder."""

OPTIMISERS: dict[str, Optimiser] = {
    "reinsert": Optimiser(
        reinsertion.reinsert,
        "moves subtrees to where they cost less: the best trees, for at least twice the build time of bsah",
        "Meister and Bittner 2018a, Parallel reinsertion for bounding volume hierarchy optimization",
    ),
    "srdh-order": Optimiser(
        srdh_builder.order_by_rays,
        "child order optimised for a sparse sample of the shadow rays, in the tree of any other builder",
        f"{FELTMAN}, Sec. 3.2",
        wants_rays=True,
    ),
}
"""Name -> optimiser."""

UPDATERS: dict[str, Updater] = {
    "refit": Updater(
        refit.DeformingTree,
        "refits the previous frame's tree, until its cost exceeds that of its build by a tenth",
        "Lauterbach et al. 2006, RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs",
    ),
}
"""Name -> updater."""


# --- tracers ----------------------------------------------------------------------------------------------------------

TRACERS |= {
    "auto": AutoTracer(),  # lists of plans begin with it
    "single": SingleRays(),
    "wide": WidePackets(),
    "wide:samples": WideSamplePackets(),
    "multifrusta": MultiFrusta(),
    "multifrusta:by-sample": SampleFrustaTracer(),
    "packet16": PixelPackets(),
    "packet16:samples": SamplePackets(),
    "packet16:blocks": BlockPackets(),
    "cones": FastestCones(),
    "chcrt": ChcRtTracer(
        ChcRtOptions(),
        "occlusion queries for pairs of screen tiles and subtrees, with visibility reused from earlier queries",
    ),
}


# --- lookup -----------------------------------------------------------------------------------------------------------

KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "cull": ("culler", CULLERS),
    "build": ("builder", BUILDERS),
    "optimise": ("optimiser", OPTIMISERS),
    "update": ("updater", UPDATERS),
    "trace": ("tracer", TRACERS),
}
"""Field of a `Plan` -> (name of its kind of method, registry), in the order in which the methods run."""

_CLASSES: dict[str, type] = {
    "cull": Culler,
    "build": Builder,
    "optimise": Optimiser,
    "update": Updater,
    "trace": Tracer,
}

Family = Callable[[str], tuple[str, Tracer] | None]
"""Function from a tracer's name to (the name with its words in canonical order, the tracer); None: unknown name."""

_families: dict[str, Family] = {}
_added: dict[str, list[str]] = {field: [] for field in KINDS}
_published: dict[str, list[str]] = {field: [] for field in KINDS}


def register(
    field: str, name: str, method: Culler | Builder | Optimiser | Updater | Tracer, published: bool = False
) -> None:
    """Add a method to a registry of KINDS, for example ``register("build", "mine", Builder(...))``.

    published : whether it only reproduces a paper, so that ``antumbra plans`` lists it only with ``--papers``

    Raises
    ------
    InputError
        If there is no such registry, the method is not of its class, or the name is taken or contains a plus sign.
    """
    kind, registry = KINDS[choice(field, "field", KINDS)]
    if not isinstance(method, _CLASSES[field]):
        raise InputError(f"{kind} {name!r} must be a {_CLASSES[field].__name__}, not {quoted(method)}")
    if "+" in name or any(name in names for _, names in KINDS.values()):
        raise InputError(f"{name!r} cannot be the name of a {kind}: it is taken or contains a plus sign")
    registry[name] = method
    _added[field].append(name)
    if published:
        _published[field].append(name)


def register_family(name: str, find: Family) -> None:
    """Register `find` as the lookup for tracers ``name:words`` that are not in TRACERS."""
    _families[name] = find


def add_plugins() -> None:
    """Add the methods of all packages that declare methods; once per process."""
    extras.load_plugins(extras.METHODS)


def own_methods(field: str) -> list[str]:
    """The names of a registry, without names added by `register`."""
    return [name for name in KINDS[field][1] if name not in _added[field]]


def listed_methods(field: str) -> list[str]:
    """The names of a registry, with those of other packages that are loaded, without methods that reproduce papers."""
    return [name for name in KINDS[field][1] if name not in _published[field]]


def find_method(field: str, name: str) -> tuple[str, Any] | None:
    """Look up a method by name, including methods added by packages: (canonical name, method); None: unknown method.

    Raises
    ------
    InputError
        If words of a tracer's name exclude each other.
    """
    registry = KINDS[field][1]
    if not isinstance(name, str):
        return None
    if name not in registry:
        add_plugins()
    if name in registry:
        return name, registry[name]
    family = _families.get(name.partition(":")[0]) if field == "trace" else None
    return family(name) if family else None
