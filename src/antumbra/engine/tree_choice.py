"""What is built for some queries, and what choices learn from one query to the next.

`TreeChoice` names the methods of one tree, with the reason. It is final: what outlives the tree is in `LearnedTrees`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import Bvh
from ..bvh.refit import LIMIT
from ..devices.device import OutOfDeviceMemory
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import ChcRtState
from ..techniques.culling.pre_bvh_culling import solid_tree
from ..trace.rays.ray_hits import Intersections
from ..trace.tracer import Tracer
from .auto.cost_model import QUICK
from .auto.strategies import StrategyMemory
from .method_registry import BUILDERS, OPTIMISERS, UPDATERS, Builder, Optimiser

FIRST_SHARE = 0.3
"""Share of the triangles expected to remain after culling, before anything is known."""

SampleRays = Callable[[NDArray[np.float32], Bvh | None], Intersections]
"""(vertices, their BVH if there is one) -> what sample rays meet, for a ray-guided method."""


class TreeChoice(NamedTuple):
    """The methods that prepare and trace some queries, and why."""

    culler: str | None  # None: all triangles
    builder: str | None  # None: no BVH
    optimiser: str | None
    updater: str | None  # None: a new BVH
    tracer: str
    why: str  # the reason, such as "too few rays for a better tree"

    def __str__(self) -> str:
        """The methods in the text form of a plan."""
        methods = self.culler, self.builder, self.optimiser, self.updater, self.tracer
        return "+".join(name for name in methods if name)

    @property
    def tree(self) -> str:
        """The builder and the optimiser, as `auto.cost_model` names trees; "": no BVH."""
        return "+".join(name for name in (self.builder, self.optimiser) if name)

    def with_tree(self, tree: str, why: str) -> "TreeChoice":
        """The same choice with another builder and optimiser, as in `tree`."""
        builder, _, optimiser = tree.partition("+")
        return self._replace(builder=builder or None, optimiser=optimiser or None, why=why)


def new_tree(choice: TreeChoice, vertices: NDArray[np.float32], threads: int, rays: SampleRays | None = None) -> Bvh:
    """A new BVH of triangles, (n, 3, 3) float32, by the builder and the optimiser of a choice."""

    def arguments(method: Builder | Optimiser, bvh: Bvh | None) -> dict[str, Intersections]:
        return {"rays": rays(vertices, bvh)} if method.wants_rays and rays is not None else {}

    assert choice.builder is not None
    builder, name = BUILDERS[choice.builder], choice.optimiser
    bvh: Bvh = builder.build(vertices, threads, **arguments(builder, None))
    if name is not None:
        bvh = OPTIMISERS[name].optimise(bvh, threads, **arguments(OPTIMISERS[name], bvh))
    return bvh


class UpdatedTree:
    """The BVH of all solid triangles, which an updater derives from frame to frame while they move.

    Parameters
    ----------
    updater : str
        Its name in `UPDATERS`.

    Attributes
    ----------
    built : TreeChoice or None
        The choice by which the BVH was last built; updates keep its quality. None: before the first update.
    state : ChcRtState or None
        The state of the tracer `chcrt` over the latest BVH.
    """

    def __init__(self, updater: str):
        self._updater = UPDATERS[updater].keep(lambda vertices, threads: self._build(vertices, threads))
        self._latest: tuple[Triangles, Bvh] | None = None
        self.built: TreeChoice | None = None
        self.state: ChcRtState | None = None

    def at(self, triangles: Triangles, threads: int, choice: TreeChoice, rays: SampleRays | None = None) -> Bvh:
        """The BVH of these triangles; a new one by `choice` where an update does not pay."""
        if self._latest is not None and self._latest[0] is triangles:  # a further query of the same frame
            return self._latest[1]

        def build(vertices: NDArray[np.float32], threads: int) -> Bvh:
            self.built = choice
            return new_tree(choice, vertices, threads, rays)

        self._build = build  # the registry's updaters take their builder once, before the rays are known
        try:
            self._latest = triangles, solid_tree(self._updater.update, triangles, threads)
        finally:
            del self._build
        return self._latest[1]


def are_equal_faces(faces: NDArray[np.int32] | None, others: NDArray[np.int32] | None) -> bool:
    """Whether two sets of faces, in ascending order, are equal; None: all faces of the scene."""
    if faces is None or others is None:
        return faces is others
    return np.array_equal(faces, others)


class OwnTree(NamedTuple):
    """The latest tree that a tracer has built itself."""

    triangles: Triangles  # all triangles of the scene
    faces: NDArray[np.int32] | None  # (k,) int32, ascending: those in the tree; None: all
    prepared: Any  # the tracer's form

    def at(self, tracer: Tracer, triangles: Triangles, faces: NDArray[np.int32] | None) -> Any:
        """The tree of these triangles, by the rule of the updater `refit`; None: a new one must be built."""
        if not are_equal_faces(faces, self.faces):
            return None
        if triangles is self.triangles:
            return self.prepared
        try:
            return tracer.refit(self.prepared, triangles, LIMIT)
        except OutOfDeviceMemory:
            return None  # there may be room for one tree


class ExpectedRays(NamedTuple):
    """Estimated numbers of rays."""

    soon: int  # in the queries for which a tree is built
    later: int  # in later queries in the same tree
    frames: int = 1  # with rays like those soon, and this frame among them


NO_RAYS = ExpectedRays(0, 0)


class LearnedTrees:
    """What outlives the trees of an engine: measurements, and the state of earlier choices.

    Attributes
    ----------
    strategies : StrategyMemory
        Measured rates of strategies, and the time that rays have lost in trees.
    expected : ExpectedRays
        Rays of the frame in progress that no choice of a tree of all triangles has counted yet.
    builder : str
        What the next tree of all triangles is built by, as `auto.cost_model` names trees. A better one replaces it
        once that pays; after a BEST tree, the next one is GOOD.
    share : float
        Share of the triangles that the last culling left.
    patience : int
        Frames until culling is tried again after it did not pay.
    seen : Triangles or None
        Those of the last queries: the tree of further queries of them is kept, and so never culled.
    latest : Triangles or None
        Those of the last tree: if the next tree has others, they move.
    updated : UpdatedTree or None
        The tree that is updated while triangles move; None: each time sample gets a new tree.
    own : OwnTree or None
        The latest tree that the tracer has built itself, which it refits while triangles move.
    """

    def __init__(self) -> None:
        self.strategies, self.expected, self.builder = StrategyMemory(), NO_RAYS, QUICK
        self.share, self.patience = FIRST_SHARE, 0
        self.seen: Triangles | None = None
        self.latest: Triangles | None = None
        self.updated: UpdatedTree | None = None
        self.own: OwnTree | None = None

    def begin(self, expected: ExpectedRays) -> None:
        """Begin a frame or a point query."""
        self.strategies.begin()
        self.expected, self.patience = expected, max(self.patience - 1, 0)

    def first_sight(self, triangles: Triangles) -> bool:
        """Whether these are other triangles than those of the last queries; remembers them."""
        first, self.seen = triangles is not self.seen, triangles
        return first

    def moved(self, triangles: Triangles) -> bool:
        """Whether these are other triangles than those of the last tree; remembers them."""
        moved, self.latest = self.latest is not None and triangles is not self.latest, triangles
        return moved
