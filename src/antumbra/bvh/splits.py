"""The split of a range of records, in which top-down builders differ. They share all else (`top_down`).

A *method* holds a builder's arrays of records: `bins.Binned` or `sweep.Swept`. In kernels, the type of the method
chooses the implementation of the functions here at compile time.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel, overloaded
from .bounds import INF
from .nodes import MAX_DEPTH


class Split(NamedTuple):
    """The split of a range. A range without a split of finite cost is halved: `axis` is -1."""

    axis: int
    place: int  # the first right bin (`bins`) or the first right record (`sweep`)
    cost: np.float32  # sum over both sides of half the area times the number of records


@kernel
def no_split():
    """The split that halves a range."""
    return Split(np.int64(-1), np.int64(0), INF)


@kernel
def must_halve(n, depth):
    """Whether a node at this depth must be halved, so that its tree ends by MAX_DEPTH.

    If not, either child has less than 2 ** (MAX_DEPTH - 1 - depth) records, so halving suffices from there on.
    """
    return (n >> (MAX_DEPTH - 1 - depth)) > 0


@overloaded("binned_split", "sweep_sah")
def source_of(method, depth, scratch):
    """In kernels: pointers to the records of ranges at this depth. The field `records` has them in some order.

    scratch : pointer to float32, as many as the method needs
    """


@overloaded("binned_split", "sweep_sah")
def find_split(source, first, last, centroids, depth, scale):
    """In kernels: the `Split` of the records from `first` to `last` - 1, whose centroid box is `centroids`."""


@overloaded("binned_split", "sweep_sah")
def divide(source, first, last, centroids, split):
    """In kernels: move the left records of a range before its right ones, and return the first right record."""
