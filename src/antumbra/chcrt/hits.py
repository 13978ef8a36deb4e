"""Hits of pictures as marks in the slots of parts, and their numbers among the marked slots."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run
from ..trace.tree_list import Hits


@kernel
def _mark(ticket, part, slot, first, marks):
    """Worker: mark the slots of hits, row by row of pixels."""
    for y in items(ticket):
        for x in range(part.shape[1]):
            k = part[y, x]
            if k >= 0 and first[k] >= 0:
                marks[first[k] + slot[y, x]] = 1


def mark_hits(hits: Hits, first: np.ndarray, marks: np.ndarray, threads: int) -> None:
    """Set ``marks[first[part] + slot]`` of each hit in a part with first[part] >= 0. `marks`: (n,) uint8."""
    run(_mark, threads, new_ticket(len(hits.part), 8), hits.part, hits.slot, first, marks)


@kernel
def _number(ticket, part, slot, first, numbers, out):
    """Worker: write the numbers of hits, row by row of pixels."""
    for y in items(ticket):
        for x in range(part.shape[1]):
            k = part[y, x]
            if k >= 0 and first[k] >= 0:
                out[y, x] = numbers[first[k] + slot[y, x]]


def number_hits(hits: Hits, first: np.ndarray, numbers: np.ndarray, out: np.ndarray, threads: int) -> None:
    """Write ``numbers[first[part] + slot]`` of each hit in a part with first[part] >= 0 to `out`, (h, w) int32."""
    run(_number, threads, new_ticket(len(hits.part), 8), hits.part, hits.slot, first, numbers, out)
