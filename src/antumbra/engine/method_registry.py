"""The registries of methods: cullers, builders, optimisers, updaters and tracers that a plan can name.

This module defines the library's own methods. Other packages add methods with `register`. Such a package declares a
function under the entry point group ``antumbra.methods``; the first lookup of an unknown name calls it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

from ..base import extras
from ..base.progress import ProgressCallback
from ..bvh import binned_sah, lbvh, refit, reinsertion
from ..bvh.block_tree import block_tree
from ..bvh.nodes import Bvh
from ..bvh.wide_bvh import widen
from ..lab.builders import sweep_sah, tl_lbvh
from ..query.shadow_query import ShadowQuery
from ..techniques.culling.pre_bvh_culling import CullResult, Soup, cull
from ..techniques.srdh import srdh_builder
from ..techniques.tracer_options import FASTEST_RAY_HIERARCHY
from ..techniques.tracer_options import ChcRtOptions as CullingOptions
from ..techniques.tracer_options import RayHierarchyOptions as ConeOptions
from ..trace.frusta import multi_frusta
from ..trace.packets import packet16
from ..trace.rays import single_rays
from .auto import strategies
from .auto.strategies import Bits, Counters

T = TypeVar("T")


class Culler(NamedTuple):
    """A method that drops triangles before a BVH is built: ``cull(triangles, queries, threads) -> CullResult``.

    It keeps every triangle that a shadow ray of the queries can hit.
    """

    cull: Callable[..., CullResult]
    description: str  # one line, for `antumbra plans`
    paper: str  # citation


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


class Tracer(NamedTuple):
    """A method that answers a shadow query.

    ``prepare(bvh, threads)`` converts a BVH to the tracer's own structure, once per tree. A tracer without a BVH
    prepares a `techniques.culling.pre_bvh_culling.Soup` instead.
    ``trace(prepared, query, bits, threads, counters, progress)`` sets the bits. A tracer may also trace several queries
    together, if their receivers have the same shape:
    ``trace_all(prepared, queries, bits, threads, counters, progress)``.
    """

    prepare: Callable[..., Any]
    trace: Callable[..., None]
    description: str
    paper: str  # empty: none
    builds: bool = True  # True: the tracer traverses a BVH
    chooses: bool = False  # True: a plan that names only this tracer lets it choose the builder, too
    keeps: bool = False  # True: the prepared structure has state from earlier frames, and `begin()` starts each frame
    exact: bool = True  # True: the tracer gives the same bits as all other exact tracers
    counts_apart: bool = False  # True: tests are counted by separate kernels
    trace_all: Callable[..., None] | None = None
    trace_rest: Callable[..., None] | None = None  # as `trace`, but skips rays whose bits are set; see `shadows`
    culling: CullingOptions | None = None  # only for tracers with occlusion queries, which can also trace stores


SELGRAD = (
    "Selgrad et al. 2015, Faster ray-traced shadows for hybrid rendering of fully dynamic scenes by pre-BVH culling"
)
FELTMAN = "Feltman et al. 2012, SRDH: Specializing BVH construction and traversal order"
BENTHIN = "Benthin and Wald 2009, Efficient ray traced soft shadows using multi-frusta tracing"
OLSSON = "Olsson and Assarsson 2011, Improved ray hierarchy alias free shadows"
MATTAUSCH = "Mattausch et al. 2015, CHC+RT: coherent hierarchical culling for ray tracing"


# --- cullers, builders, optimisers and updaters -----------------------------------------------------------------------

CULLERS: dict[str, Culler] = {
    f"grid{n}": Culler(
        partial(cull, n=n), f"drops triangles by a grid of {n} x {n} x {n} cells between receivers and lights", SELGRAD
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
        sweep_sah.build,
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
    "tl-lbvh": Builder(
        tl_lbvh.build,
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
        "Meister and Bittner 2018, Parallel reinsertion for bounding volume hierarchy optimization",
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


def unchanged(structure: T, threads: int | None = None) -> T:
    """The `prepare` of tracers that use the BVH or the triangles without conversion."""
    return structure


def by_cones(options: ConeOptions, description: str) -> Tracer:
    """A tracer with a hierarchy over the rays instead of a BVH over the triangles."""

    def trace(
        soup: Soup,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None,
        counters: Counters | None,
        progress: ProgressCallback | None,
    ) -> None:
        from ..techniques.rayhierarchy.ray_hierarchy import trace_shadow

        trace_shadow(soup, query, bits, threads, counters, progress, options)

    return Tracer(unchanged, trace, description, OLSSON, builds=False)


def by_culling(options: CullingOptions, description: str) -> Tracer:
    """A tracer with occlusion queries (CHC+RT)."""

    def prepare(bvh: Bvh, threads: int | None = None) -> Any:  # late imports: other plans start sooner
        from ..techniques.chcrt.chc_rt import prepare

        return prepare(bvh, options, threads)

    def trace_all(
        prepared: Any,
        queries: Sequence[ShadowQuery],
        bits: Sequence[Bits],
        threads: int | None,
        counters: Counters | None,
        progress: ProgressCallback | None,
    ) -> None:
        from ..techniques.chcrt.chc_rt import trace_shadows

        trace_shadows(prepared, queries, bits, threads, counters, progress)

    def trace(
        prepared: Any,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None,
        counters: Counters | None,
        progress: ProgressCallback | None,
    ) -> None:
        trace_all(prepared, [query], [bits], threads, counters, progress)

    exact = options.threshold == 0
    return Tracer(prepare, trace, description, MATTAUSCH, keeps=True, exact=exact, trace_all=trace_all, culling=options)


TRACERS: dict[str, Tracer] = {
    "auto": Tracer(
        strategies.AutoTracer,
        strategies.trace_shadow,
        "the fastest tracer for each query by predicted and measured times; alone, it chooses the builder, too",
        "",
        chooses=True,
        keeps=True,
        counts_apart=True,
        trace_rest=partial(strategies.trace_shadow, fresh=False),
    ),
    "single": Tracer(
        single_rays.as_built,
        single_rays.trace_shadow,
        "one ray at a time, children in the builder's order, else nearest first; tests the last blocker first",
        "Ize 2013, Robust BVH ray traversal",
        counts_apart=True,
    ),
    "wide": Tracer(
        widen,
        single_rays.trace_shadow,
        "one ray at a time, eight boxes or triangles in SIMD",
        "Ylitie et al. 2017, Efficient incoherent ray traversal on GPUs through compressed wide BVHs",
    ),
    "multifrusta": Tracer(
        block_tree,
        multi_frusta.trace_shadow,
        "16 shafts of shadow rays at once, single rays only where shafts are undecided",
        BENTHIN,
        trace_rest=partial(multi_frusta.trace_shadow, fresh=False),
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
        FASTEST_RAY_HIERARCHY, "a hierarchy over the shadow rays, traversed by triangles, instead of one over the scene"
    ),
    "chcrt": by_culling(
        CullingOptions(),
        "occlusion queries for pairs of screen tiles and subtrees, with visibility reused from earlier queries",
    ),
}
"""Name -> tracer."""


# --- lookup -----------------------------------------------------------------------------------------------------------

KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "cull": ("culler", CULLERS),
    "build": ("builder", BUILDERS),
    "optimise": ("optimiser", OPTIMISERS),
    "update": ("updater", UPDATERS),
    "trace": ("tracer", TRACERS),
}
"""Field of a `Plan` -> (name of its kind of method, registry), in the order in which the methods run."""

Family = Callable[[str], tuple[str, Tracer] | None]
"""Function from a tracer's name to (the name with its words in canonical order, the tracer); None: unknown name."""

_families: dict[str, Family] = {}
_added: dict[str, list[str]] = {field: [] for field in KINDS}


def register(field: str, name: str, method: Culler | Builder | Optimiser | Updater | Tracer) -> None:
    """Add a method to a registry of KINDS, for example ``register("build", "mine", Builder(...))``.

    Raises
    ------
    ValueError
        If the name is taken or contains a plus sign.
    """
    registry = KINDS[field][1]
    if "+" in name or any(name in names for _, names in KINDS.values()):
        raise ValueError(f"{name!r} cannot be the name of a {KINDS[field][0]}: it is taken or contains a plus sign")
    registry[name] = method
    _added[field].append(name)


def register_family(name: str, find: Family) -> None:
    """Register `find` as the lookup for tracers ``name:words`` that are not in TRACERS."""
    _families[name] = find


def add_plugins() -> None:
    """Add the methods of all packages that declare methods; once per process."""
    extras.load_plugins("antumbra.methods")


def own_methods(field: str) -> list[str]:
    """The names of a registry, without names added by `register`."""
    return [name for name in KINDS[field][1] if name not in _added[field]]


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
