"""Tracers: the base class, the forms of a tree that they traverse, and the registry `TRACERS`.

A tracer is one class. It states the form that it traverses, the queries that suit it and its cost, and traces. The
plan `auto` considers every registered tracer that states its cost.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.progress import ProgressCallback
from ..bvh.block_tree import block_tree
from ..bvh.wide_bvh import widen
from ..query.shadow_query import ShadowQuery
from ..scene.triangles import Triangles
from .tracer_cost import Cost, TreelessCost

Counters = NDArray[np.int64]
"""From `counters.new_counters`."""

Box = NDArray[np.float32]
"""(2, 3) float32: lower and upper corner."""

Bits = NDArray[np.uint64]
"""(h, w, ceil(spp / 64)) uint64: the occluded samples of each receiver."""


class Form(NamedTuple):
    """What a tracer traverses. It is made once per tree, and tracers of the same form share it."""

    name: str
    make: Callable[[Any, int | None], Any] | None = None  # of (`Bvh`, threads); None: nothing is converted


BVH = Form("bvh")
"""A `Bvh`, as its builder has made it."""

BLOCKS = Form("blocks", block_tree)
"""A `BlockTree`."""

WIDE = Form("wide", widen)
"""A `WideBvh`."""

TRIANGLES = Form("triangles")
"""No tree: a `techniques.culling.pre_bvh_culling.Soup`."""

ANY = Form("any")
"""Whichever form the tracer that is chosen for a query needs; only `auto` has it."""


class TracerState:
    """The base class of what a tracer prepares if it keeps state from one frame or point query to the next."""

    def begin(self) -> None:
        """Begin a frame, or a query of points."""
        raise NotImplementedError


class Tracer:
    """A method that answers shadow queries. All exact tracers set the same bits.

    Attributes
    ----------
    description : str
        One line, for ``antumbra plans``.
    paper : str
        Citation; empty: none.
    form : Form
        What it traverses.
    cost : Cost, TreelessCost or None
        Its predicted time, for the plan `auto`; None: `auto` never chooses it.
    device : str or None
        Where it traces, such as ``"cuda:0"``; None: on the processor. Its form may be in the memory of the device.
    builders : tuple of str
        The builders that it runs itself, where it traces.
    """

    description: str
    paper: str = ""
    form: Form = BVH
    cost: Cost | TreelessCost | None = None
    device: str | None = None
    builders: tuple[str, ...] = ()

    @property
    def builds(self) -> bool:
        """Whether it traverses a BVH, so that its plans name a builder."""
        return self.form is not TRIANGLES

    @property
    def chooses(self) -> bool:
        """Whether it chooses another tracer for each query; alone in a plan, it chooses the builder, too."""
        return self.form is ANY

    @property
    def exact(self) -> bool:
        """Whether it sets the same bits as all other exact tracers."""
        return True

    @property
    def counts_apart(self) -> bool:
        """Whether separate kernels count its tests."""
        return False

    @property
    def trace_suited(self) -> Callable[..., None]:
        """As `trace`, for queries that suit it and for which `auto` compares times."""
        return self.trace

    def suits(self, query: ShadowQuery, box: Box) -> bool:
        """Whether `auto` may choose it for a query. It must answer every query; some are not worth a try.

        box : bounds of the scene's triangles
        """
        return True

    def prepare(self, geometry: Any, threads: int | None = None) -> Any:
        """The tracer's form of a `Bvh`, or of a `Soup` if its form is TRIANGLES."""
        return geometry if self.form.make is None else self.form.make(geometry, threads)

    def build(self, builder: str, triangles: Triangles, faces: NDArray[np.int32] | None, request: Any = None) -> Any:
        """The form of a new tree by one of `builders`, as `prepare` makes it of a finished one.

        triangles : Triangles
            All triangles of the scene.
        faces : (k,) int32, ascending: those in the tree; None: all
        request : a `techniques.culling.pre_bvh_culling.CullRequest`: only what its queries can meet is in the tree
        """
        raise NotImplementedError

    def refit(self, prepared: Any, triangles: Triangles, limit: float) -> Any:
        """The form of a tree from `build`, refitted to moved triangles; None: a new tree must be built.

        limit : the maximum SAH cost, relative to that of the tree when it was built
        """
        return None

    def trace(
        self,
        prepared: Any,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        """Answer a query: set bit s of ``bits[y, x]`` where sample s is occluded.

        Parameters
        ----------
        prepared : object
            From `prepare`.
        query : ShadowQuery
        bits : (h, w, ceil(spp / 64)) uint64
            Zeros on entry if the query is fresh.
        threads : int or None
            None: one per core.
        counters : (n,) int64 or None
            From `counters.new_counters`; None: nothing is counted.
        progress : function or None
        fresh : bool
            False: the bits mark segments known to be blocked, among them all that receivers' own surfaces block. They
            need no tracing, and must remain set.
        """
        raise NotImplementedError

    def trace_all(
        self,
        prepared: Any,
        queries: Sequence[ShadowQuery],
        bits: Sequence[Bits],
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        """Answer several queries whose receivers have the same shape, as `trace` does; by default, one by one."""
        for query, words in zip(queries, bits, strict=True):
            self.trace(prepared, query, words, threads, counters, progress, fresh)


TRACERS: dict[str, Tracer] = {}
"""Name -> tracer, `auto` first. `engine.method_registry` fills it, and plugins add to it."""
