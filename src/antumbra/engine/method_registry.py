"""The registries of methods: cullers, builders, optimisers, updaters and tracers that a plan can name.

This module holds the library's own methods. Other packages add methods with `register`. Such a package announces a
function under the entry point ``antumbra.engine.method_registry``; the first lookup of an unknown name calls it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from .. import extras as plugins
from ..bvh import binned_sah, lbvh, refit, reinsertion, sweep_sah, tl_lbvh
from ..bvh.block_tree import block_tree
from ..bvh.wide_bvh import widen
from ..techniques.culling.pre_bvh_culling import cull
from ..techniques.srdh import srdh_builder as rayorder
from ..techniques.srdh import srdh_builder as srdh
from ..techniques.tracer_options import FASTEST_RAY_HIERARCHY
from ..techniques.tracer_options import ChcRtOptions as CullingOptions
from ..techniques.tracer_options import RayHierarchyOptions as ConeOptions
from ..trace.frusta import multi_frusta as multifrusta
from ..trace.packets import packet16
from ..trace.rays import single_rays as single
from .auto import strategies as auto


class Culler(NamedTuple):
    """A method that drops triangles before a BVH is built: ``cull(triangles, queries, threads) -> Culled``.

    It keeps every triangle that a shadow ray of the queries can meet.
    """

    cull: Callable
    description: str  # one line, for `antumbra plans`
    paper: str  # citation


class Builder(NamedTuple):
    """A method that builds a BVH: ``build(vertices, threads=None, ...) -> Bvh``.

    A ray-guided builder also takes `rayset.Intersections` as ``rays``. All builders make a valid BVH of the same form.
    """

    build: Callable
    description: str
    paper: str
    wants_rays: bool = False


class Optimiser(NamedTuple):
    """A method that improves a BVH: ``optimise(bvh, threads=None, ...) -> Bvh``.

    It works on the BVH of any builder that is not ray-guided. A ray-guided optimiser also takes `rayset.Intersections`
    as ``rays``. The surface area cost never rises.
    """

    optimise: Callable
    description: str
    paper: str
    wants_rays: bool = False


class Updater(NamedTuple):
    """A method that derives the BVH of a frame from the last frame's BVH, if that pays off.

    It works with any builder. ``keep(build)`` returns an object that lasts from frame to frame and has a method
    ``update(vertices, threads) -> Bvh``. Its argument ``build(vertices, threads)`` builds a new BVH.
    """

    keep: Callable
    description: str
    paper: str


class Tracer(NamedTuple):
    """A method that answers a shadow query.

    ``prepare(bvh, threads)`` converts a BVH to the tracer's own structure, once per tree.
    ``trace(prepared, query, bits, threads, counters, progress)`` sets the bits. A tracer without a BVH prepares a
    `techniques.culling.pre_bvh_culling.Soup` instead. A tracer may also take several queries of receivers of the same
    shape: ``trace_all(prepared, queries, bits, threads, counters, progress)``.
    """

    prepare: Callable
    trace: Callable
    description: str
    paper: str  # empty: there is none
    builds: bool = True  # True: the tracer walks a BVH
    chooses: bool = False  # True: a plan of this tracer alone chooses the builder, too
    keeps: bool = False  # True: the prepared structure remembers earlier frames, and has `begin()` to call in each
    exact: bool = True  # True: the tracer gives the same bits as all other exact tracers
    counts_apart: bool = False  # True: separate kernels count tests
    trace_all: Callable | None = None
    culling: CullingOptions | None = None  # of tracers with occlusion queries, which can also trace stores


SELGRAD = (
    "Selgrad et al. 2015, Faster ray-traced shadows for hybrid rendering of fully dynamic scenes by pre-BVH culling"
)
FELTMAN = "Feltman et al. 2012, SRDH: Specializing BVH construction and traversal order"
BENTHIN = "Benthin and Wald 2009, Efficient ray traced soft shadows using multi-frusta tracing"
OLSSON = "Olsson and Assarsson 2011, Improved ray hierarchy alias free shadows"
MATTAUSCH = "Mattausch et al. 2015, CHC+RT: coherent hierarchical culling for ray tracing"


# --- culling, and trees ------------------------------------------------------------------------------------------

CULLERS: dict[str, Culler] = {
    f"grid{n}": Culler(partial(cull, n=n), f"a grid of {n} x {n} x {n} cells between receivers and lights", SELGRAD)
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
        sweep_sah.build,
        "full sweep surface area heuristic: the reference of quality",
        "MacDonald and Booth 1990, Heuristics for ray tracing using space subdivision",
    ),
    "lbvh": Builder(
        lbvh.build,
        "Morton codes of 30 bits: the fastest to build",
        "Karras 2012, Maximizing parallelism in the construction of BVHs, octrees, and k-d trees",
    ),
    "lbvh63": Builder(
        lbvh.build63,
        "Morton codes of 63 bits: for scenes with fine detail in a small part",
        "Karras 2012, Maximizing parallelism in the construction of BVHs, octrees, and k-d trees",
    ),
    "tl-lbvh": Builder(
        tl_lbvh.build,
        "lbvh with its treelets restructured: as fast as bsah, and better in most scenes",
        "Karras and Aila 2013, Fast parallel construction of high-quality bounding volume hierarchies",
    ),
    "srdh": Builder(
        srdh.build,
        "built, and children ordered, for shadow rays like those of a sparse sample",
        f"{FELTMAN}, Sec. 3.4",
        wants_rays=True,
    ),
}
"""Name -> builder."""

OPTIMISERS: dict[str, Optimiser] = {
    "reinsert": Optimiser(
        reinsertion.reinsert,
        "subtrees move to where they cost less: the best trees, for twice the time of bsah and more",
        "Meister and Bittner 2018, Parallel reinsertion for bounding volume hierarchy optimization",
    ),
    "srdh-order": Optimiser(
        rayorder.order_by_rays,
        "children ordered for shadow rays like those of a sparse sample, in the tree of any other builder",
        f"{FELTMAN}, Sec. 3.2",
        wants_rays=True,
    ),
}
"""Name -> optimiser."""

UPDATERS: dict[str, Updater] = {
    "refit": Updater(
        refit.DeformingTree,
        "the last frame's tree with new boxes, until that costs a tenth more than when it was built",
        "Lauterbach et al. 2006, RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs",
    ),
}
"""Name -> updater."""


# --- tracing -----------------------------------------------------------------------------------------------------


def unchanged(made, threads=None):
    """The `prepare` of tracers that need no conversion of the BVH or of the triangles."""
    return made


def by_cones(options: ConeOptions, description: str) -> Tracer:
    """A tracer with a hierarchy over the rays instead of a BVH over the triangles."""

    def trace(soup, query, bits, threads, counters, progress):
        from ..techniques.rayhierarchy.ray_hierarchy import trace_shadow

        trace_shadow(soup, query, bits, threads, counters, progress, options)

    return Tracer(unchanged, trace, description, OLSSON, builds=False)


def by_culling(options: CullingOptions, description: str) -> Tracer:
    """A tracer with occlusion queries (CHC+RT)."""

    def prepare(bvh, threads=None):  # imported on first use: other plans start sooner
        from ..techniques.chcrt.chc_rt import prepare

        return prepare(bvh, options, threads)

    def trace_all(prepared, queries, bits, threads, counters, progress):
        from ..techniques.chcrt.chc_rt import trace_shadows

        trace_shadows(prepared, queries, bits, threads, counters, progress)

    def trace(prepared, query, bits, threads, counters, progress):
        trace_all(prepared, [query], [bits], threads, counters, progress)

    exact = options.threshold == 0
    return Tracer(prepare, trace, description, MATTAUSCH, keeps=True, exact=exact, trace_all=trace_all, culling=options)


TRACERS: dict[str, Tracer] = {
    "auto": Tracer(
        auto.AutoTracer,
        auto.trace_shadow,
        "the tracer that should be fastest for each query, and without a builder the builder for its rays",
        "",
        chooses=True,
        keeps=True,
        counts_apart=True,
    ),
    "single": Tracer(
        single.as_built,
        single.trace_shadow,
        "one ray at a time, children as the builder ordered them, else nearest first; the last blocker tried first",
        "Ize 2013, Robust BVH ray traversal",
        counts_apart=True,
    ),
    "wide": Tracer(
        widen,
        single.trace_shadow,
        "one ray at a time, eight boxes or triangles side by side",
        "Ylitie et al. 2017, Efficient incoherent ray traversal on GPUs through compressed wide BVHs",
    ),
    "multifrusta": Tracer(
        block_tree,
        multifrusta.trace_shadow,
        "16 shafts of shadow rays at once, rays only where shafts do not decide",
        BENTHIN,
    ),
    "packet16": Tracer(
        unchanged,
        packet16.over_pixels,
        "packets of 16 rays, from 16 receivers to a stratum of the light",
        "Benthin and Wald 2009, Sec. 5.1; Wald et al. 2001, Interactive rendering with coherent ray tracing",
    ),
    "packet16:samples": Tracer(
        unchanged,
        packet16.over_samples,
        "packets of 16 rays, from one receiver to its samples",
        "Benthin and Wald 2009, Sec. 5.1",
    ),
    "cones": by_cones(
        FASTEST_RAY_HIERARCHY, "no hierarchy over the scene, but one over the shadow rays, by which triangles find them"
    ),
    "chcrt": by_culling(
        CullingOptions(), "occlusion queries for pairs of screen tiles and subtrees, which remember what was visible"
    ),
}
"""Name -> tracer."""


# --- lookup ------------------------------------------------------------------------------------------------------

KINDS: dict[str, tuple[str, dict]] = {
    "cull": ("culler", CULLERS),
    "build": ("builder", BUILDERS),
    "optimise": ("optimiser", OPTIMISERS),
    "update": ("updater", UPDATERS),
    "trace": ("tracer", TRACERS),
}
"""Field of a `Plan` -> (name of its kind of method, registry), in the order in which the methods run."""

Family = Callable[[str], tuple[str, Tracer] | None]
"""Function of a tracer's name -> (the name with its words in canonical order, the tracer); None: unknown name."""

_families: dict[str, Family] = {}
_added: dict[str, list[str]] = {field: [] for field in KINDS}


def register(field: str, name: str, method: tuple) -> None:
    """Add a method to a registry of KINDS, for example ``register("build", "mine", Builder(...))``.

    Raises
    ------
    ValueError
        If the name is taken or contains a plus sign.
    """
    registry = KINDS[field][1]
    if "+" in name or any(name in names for _, names in KINDS.values()):
        raise ValueError(f"{name!r} cannot be the name of a {KINDS[field][0]}: it is taken, or has a plus sign")
    registry[name] = method
    _added[field].append(name)


def register_family(name: str, find: Family) -> None:
    """Register `find` as the maker of tracers with names ``name:words`` that are not in TRACERS."""
    _families[name] = find


def add_plugins() -> None:
    """Add the methods of all packages that announce methods; once per process."""
    plugins.load_plugins("antumbra.methods")


def own_methods(field: str) -> list[str]:
    """The names of a registry, without names added by `register`."""
    return [name for name in KINDS[field][1] if name not in _added[field]]


def find_method(field: str, name: str) -> tuple[str, Any] | None:
    """Look up a method: (name, method), including methods added by packages; None: there is no such method.

    Raises
    ------
    InputError
        If the words of a tracer's name exclude each other.
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
