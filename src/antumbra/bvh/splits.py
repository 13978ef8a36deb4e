"""What top-down builders differ in: how a range of records is split. Everything else is `top_down`.

A *method* holds the arrays that a builder keeps its records in: `bins.Binned` or `sweep.Swept`. In kernels the
functions here are those of the method, chosen by its type when they are compiled.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel, overloaded
from .bounds import INF
from .nodes import MAX_DEPTH


class Split(NamedTuple):
    """Where a range is split. Those of no finite cost are halved: `axis` is -1."""

    axis: object  # int64
    place: object  # int64: the first bin that goes right (`bins`); the first record that does (`sweep`)
    cost: object  # float32: half the area of each side by its count of records, added


@kernel
def no_split():
    """The split of a range that is to be cut in the middle."""
    return Split(np.int64(-1), np.int64(0), INF)


@kernel
def must_halve(n, depth):
    """Whether a node at this depth must have equal halves for its tree to end by MAX_DEPTH.

    If not, either child holds less than 2 ** (MAX_DEPTH - 1 - depth) records: halving suffices from there on.
    """
    return (n >> (MAX_DEPTH - 1 - depth)) > 0


@overloaded("bins", "sweep")
def source_of(method, depth, scratch):
    """In kernels: the records, of ranges at this depth, as pointers; the field `records` has them in some order.

    `scratch` is a pointer to float32, as many as the method asks for.
    """


@overloaded("bins", "sweep")
def find_split(source, first, last, centroids, depth, scale):
    """In kernels: the `Split` of the records from `first` to `last` - 1, whose centroid box is `centroids`."""


@overloaded("bins", "sweep")
def divide(source, first, last, centroids, split):
    """In kernels: put the left records of a range before its right ones; the number of the first right one."""
