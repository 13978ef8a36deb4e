"""Small rasters of heights with holes, as scenes."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import antumbra as at

PLACE = (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)
"""Cells of 2 m, as an affine transform."""


def rasters(rows, columns, levels):
    """(2 to rows, 2 to columns) float64 of some levels; NaN: a hole."""
    shapes = st.tuples(st.integers(2, rows), st.integers(2, columns))
    return arrays.arrays(np.float64, shapes, elements=st.sampled_from(levels), fill=st.nothing())


def scene_of(heights, place=PLACE):
    """A scene, or None if the heights have no triangles."""
    try:
        return at.from_raster((heights, place))
    except at.InputError:
        return None
