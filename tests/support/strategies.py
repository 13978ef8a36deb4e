"""Hypothesis strategies: coordinates that give hard cases, and triangle soups of many kinds."""

import numpy as np
from hypothesis import strategies as st

SCALES = [1.0, 1e-6, 1e6, 1e-20, 1e12]


@st.composite
def point_arrays(draw, shape):
    """(*shape, 3) float32, at many scales: a small integer grid (ties, zeros, coplanar), or general positions."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["grid", "general", "snapped", "mixed magnitudes"]))
    size = (*shape, 3)
    if kind == "grid":
        points = rng.integers(-2, 3, size).astype(np.float64)
    elif kind == "general":
        points = rng.normal(size=size)
    elif kind == "snapped":
        points = np.round(rng.normal(size=size) * 8) / 8
    else:
        points = rng.normal(size=size) * 10.0 ** rng.integers(-6, 7, size)
    return np.ascontiguousarray(points * draw(st.sampled_from(SCALES)), np.float32)


@st.composite
def soups(draw, max_triangles=60):
    """(n, 3, 3) float32 triangle soup: local or scattered, with duplicates and triangles without area."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, max_triangles))
    centres = rng.normal(size=(n, 1, 3))
    soup = centres + rng.normal(size=(n, 3, 3)) * draw(st.sampled_from([0.05, 0.3, 2.0]))
    if draw(st.booleans()):
        soup = np.round(soup * 4) / 4
    if n > 4:
        soup[0] = soup[1]
        soup[2, 2] = soup[2, 1]  # no area
        soup[3] = soup[3, :1]  # a point
    return np.ascontiguousarray(soup * draw(st.sampled_from([1.0, 1e-6, 1e6])), np.float32)
