"""The ways to trace a query: a tracer over a form of the tree."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..bvh.block_tree import BlockTree, block_tree
from ..bvh.nodes import Bvh, boxes_of
from ..bvh.wide_bvh import widen
from ..kernels.marshalling import Packed, packed
from ..query.shadow_query import ShadowQuery, new_bits
from ..trace.frusta.multi_frusta import trace_tree_list
from ..trace.packets.packet16 import over_pixels, over_samples
from ..trace.packets.ray_tile import is_far, is_incoherent
from ..trace.rays import single_rays as single
from ..trace.tree_list import whole


class Way(NamedTuple):
    """A tracer, and the form of the tree that it walks."""

    form: Callable[[Bvh, int], Any] | None  # makes it; None: the builder's own tree
    trace: Callable  # trace(form, query, bits, threads, counters, progress)
    suits: Callable[[ShadowQuery, np.ndarray], bool] = lambda query, box: True  # box: around the triangles


def _trace_shafts(tree: BlockTree, query, bits, threads, counters, progress) -> None:
    trace_tree_list(whole(tree), query, bits, threads, counters, progress)


def _shafts_suit(query: ShadowQuery, box: np.ndarray) -> bool:
    return not (is_incoherent(query) or is_far(query, box))


WAYS: dict[str, Way] = {
    "multifrusta": Way(block_tree, _trace_shafts, _shafts_suit),
    "packet16:blocks": Way(block_tree, over_pixels),
    "packet16": Way(None, over_pixels),
    "packet16:samples": Way(None, over_samples),
    "wide": Way(widen, single.trace_shadow),
    "single": Way(single.as_built, single.trace_shadow),
}
"""Name -> way. `packet16:blocks` are the packets to which the tracer `multifrusta` hands hemispheres."""


class Forms:
    """A tree in all forms that ways have asked for.

    bvh : Bvh
    threads : int
    triangles : int
    box : (2, 3) float32, around them
    """

    def __init__(self, bvh: Bvh, threads: int):
        self.bvh, self.threads = bvh, threads
        self.triangles, self.box = len(bvh.prim_ids), boxes_of(bvh.nodes[:1])[0]
        self._made: dict[Callable, Any] = {}
        self._for_few: Packed | None = None

    def of(self, way: Way) -> Any:
        """The form that a way walks."""
        if way.form is None:
            return self.bvh
        if way.form not in self._made:
            self._made[way.form] = way.form(self.bvh, self.threads)
        return self._made[way.form]

    @property
    def for_few(self) -> Packed:
        """The form that `single` walks, packed: few rays take less time than its arrays would take to be flattened."""
        if self._for_few is None:
            self._for_few = packed(single.as_built(self.bvh))
        return self._for_few

    def missing(self, way: Way) -> bool:
        """Must the way's form still be made?"""
        return way.form is not None and way.form not in self._made


def answer(way: str, forms: Forms, query: ShadowQuery, threads: int, counters=None, progress=None) -> np.ndarray:
    """(h, w, ceil(spp / 64)) uint64: the bits of a query."""
    bits = new_bits(query)
    WAYS[way].trace(forms.of(WAYS[way]), query, bits, threads, counters, progress)
    return bits
