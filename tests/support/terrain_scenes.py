"""Small rasters of heights with holes, as scenes."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import antumbra as at
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import place, reach_of
from antumbra.query.receivers import Receivers
from antumbra.query.shadow_query import ShadowQuery
from antumbra.trace.terrain.terrain_rays import terrain_tree

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


ALONG = [(1, 0), (0, 1), (-1, 0), (0, -1), (2, 3), (-2, 3), (2, -3), (-2, -3), (4, 3), (1e-9, 1), (1, -1e-9)]


def cells_of(scene):
    """(n, 3): the cells of an oblong raster, row by row; the lowest height where there is none."""
    surface = scene.data.source.surface
    east, north = np.meshgrid(surface.grid.eastings(), surface.grid.northings())
    heights = np.where(np.isnan(surface.heights), scene.bounds[0, 2], surface.heights)
    return np.stack([east, north, heights], -1).reshape(-1, 3)


def suns(random, n):
    """Directions towards suns, some along the axes and the diagonals of the grid."""
    level = np.concatenate([np.array(ALONG, np.float64), random.normal(size=(n, 2))])
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    return np.column_stack([level, random.choice([0.01, 0.1, 0.3, 1.0, 4.0], len(level))])


def query_of(scene, lights):
    """The tree of a raster, and the shadow query of its cells."""
    tree = terrain_tree(scene.data.source.surface, scene.origin)
    cells = cells_of(scene)
    up = np.broadcast_to((0.0, 0.0, 1.0), cells.shape)
    origins, sides, normals = Receivers.of(cells, up, scene.origin)
    box = (scene.bounds - scene.origin).astype(np.float32)
    patch = place(lights, scene.origin, box, reach_of(box, origins, 1))
    faces = np.full(sides.shape, -1, np.int32)
    sets = light_samples(lights, 1)
    return tree, ShadowQuery(origins, faces, sides, normals, np.empty((0, 9), np.float32), patch, sets, 0, faces)
