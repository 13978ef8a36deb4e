"""The registries: every method that a plan can name, above all techniques.

The instrument's methods are here. Others come by `register`, from packages that announce a function under the entry
point ``antumbra.methods``; it is called when a name is asked for that is not here. `antumbra.papers` is such a package.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from . import plugins
from .bvh import binned_sah, lbvh, rayorder, refit, reinsertion, srdh, sweep_sah, tl_lbvh
from .bvh.blocks import block_tree
from .bvh.widen import widen
from .chcrt.options import Options as CullingOptions
from .cull.cull import cull
from .rayhierarchy.options import FASTEST
from .rayhierarchy.options import Options as ConeOptions
from .trace.multifrusta import trace as multifrusta
from .trace.packets import packet16
from .trace.rays import single


class Culler(NamedTuple):
    """A method that drops triangles before a BVH is built: ``cull(triangles, queries, threads) -> Culled``.

    It keeps each triangle that a shadow ray of the queries can meet.
    """

    cull: Callable
    description: str
    paper: str


class Builder(NamedTuple):
    """A method that builds a BVH: ``build(vertices, threads=None, ...) -> Bvh``.

    Those that want rays take `rayset.Intersections` as ``rays`` too. All make a correct BVH of the same form.
    """

    build: Callable
    description: str
    paper: str
    wants_rays: bool = False


class Optimiser(NamedTuple):
    """A method that improves the BVH of any builder that wants no rays: ``optimise(bvh, threads=None, ...) -> Bvh``.

    Those that want rays take `rayset.Intersections` as ``rays`` too. The surface area cost of the result is no higher.
    """

    optimise: Callable
    description: str
    paper: str
    wants_rays: bool = False


class Updater(NamedTuple):
    """A method that makes the BVH of a frame from that of the last frame, where that pays.

    It takes the trees of any builder. ``keep(build)`` gives an object that lasts from frame to frame, with
    ``update(vertices, threads) -> Bvh``.
    ``build(vertices, threads)`` makes a new BVH.
    """

    keep: Callable
    description: str
    paper: str


class Tracer(NamedTuple):
    """A method that answers a shadow query.

    ``prepare(bvh, threads)`` makes what it traces, once a tree; ``trace(prepared, query, bits, threads, counters,
    progress)`` answers. Those that walk no BVH prepare a `rayhierarchy.soup.Soup` instead.
    """

    prepare: Callable
    trace: Callable
    description: str
    paper: str
    builds: bool = True  # does it walk a BVH?
    keeps: bool = False  # does what it prepares remember what was visible? Then it has `begin()`, for each frame
    exact: bool = True  # does it give the same bits as all others?
    counts_apart: bool = False  # has it kernels that count, and others that do not?
    culling: CullingOptions | None = None  # of a tracer by occlusion queries, which scenes in a store are traced by


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
        refit.Deforming,
        "the last frame's tree with new boxes, until that costs a tenth more than when it was built",
        "Lauterbach et al. 2006, RT-DEFORM: interactive ray tracing of dynamic scenes using BVHs",
    ),
}
"""Name -> updater."""


# --- tracing -----------------------------------------------------------------------------------------------------


def unchanged(made, threads=None):
    """The `prepare` of tracers that walk the builder's own tree, or take the triangles as they are."""
    return made


def by_cones(options: ConeOptions, description: str) -> Tracer:
    """A tracer by a hierarchy of the rays, which no BVH is built for."""

    def trace(soup, query, bits, threads, counters, progress):
        from .rayhierarchy.trace import trace_shadow  # imported when it is first used: other plans start sooner

        trace_shadow(soup, query, bits, threads, counters, progress, options)

    return Tracer(unchanged, trace, description, OLSSON, builds=False)


def by_culling(options: CullingOptions, description: str) -> Tracer:
    """A tracer by occlusion queries."""

    def prepare(bvh, threads=None):  # imported when it is first used, so that other plans start sooner
        from .chcrt.trace import prepare

        return prepare(bvh, options, threads)

    def trace(prepared, query, bits, threads, counters, progress):
        from .chcrt.trace import trace_shadow

        trace_shadow(prepared, query, bits, threads, counters, progress)

    return Tracer(prepare, trace, description, MATTAUSCH, keeps=True, exact=options.threshold == 0, culling=options)


TRACERS: dict[str, Tracer] = {
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
        FASTEST, "no hierarchy over the scene, but one over the shadow rays, by which triangles find them"
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
"""Field of a `Plan` -> (what its methods are called, their registry), in the order in which they do their work."""

Family = Callable[[str], tuple[str, Tracer] | None]
"""Function of a tracer's name -> (its name in the usual order of words, the tracer); None: it knows no such name."""

_families: dict[str, Family] = {}
_added: dict[str, list[str]] = {field: [] for field in KINDS}


def register(field: str, name: str, method: tuple) -> None:
    """Add a method to a registry of KINDS, as ``register("build", "mine", Builder(...))``.

    Raises
    ------
    ValueError
        If the name is taken, or cannot be written in a plan.
    """
    registry = KINDS[field][1]
    if "+" in name or any(name in names for _, names in KINDS.values()):
        raise ValueError(f"{name!r} cannot be the name of a {KINDS[field][0]}: it is taken, or has a plus sign")
    registry[name] = method
    _added[field].append(name)


def register_family(name: str, find: Family) -> None:
    """Let `find` make the tracers that are written ``name:words``, as far as they are not in TRACERS."""
    _families[name] = find


def add_plugins() -> None:
    """Add the methods of all packages that announce some."""
    plugins.add("antumbra.methods")


def own_methods(field: str) -> list[str]:
    """The names of a registry, without those that were added."""
    return [name for name in KINDS[field][1] if name not in _added[field]]


def find_method(field: str, name: str) -> tuple[str, Any] | None:
    """(name, method) of a registry, with those that packages add; None: there is no such method.

    Raises
    ------
    InputError
        On words of a tracer that exclude each other.
    """
    registry = KINDS[field][1]
    if name not in registry:
        add_plugins()
    if name in registry:
        return name, registry[name]
    family = _families.get(name.partition(":")[0]) if field == "trace" else None
    return family(name) if family else None
