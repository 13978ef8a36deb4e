"""The common interface of `boxes`, `cones` and `shafts`: functions that dispatch on the class of the nodes.

A class has one field, `rows`: the number of float32 per node.
"""

from ..kernels.jit import overloaded


@overloaded("boxes", "shafts")
def bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    """In kernels: write the node of a leaf to a lane of its group; is there a ray in it?"""


@overloaded("boxes", "shafts")
def bound_node(nodes, children, alive, ways, group, lane):
    """In kernels: write the node that holds a group of `alive` children (bits)."""


@overloaded("boxes", "shafts")
def write_row(nodes, view, face, ways, shape, spheres, row):
    """In kernels: write what the tests want to know of a triangle's `Shape`; False if it blocks nothing there."""


@overloaded("boxes", "shafts")
def writes_sixteen(nodes):
    """In kernels: are rows as `pointrows` writes them?"""


@overloaded("boxes", "shafts")
def union_of(nodes, block, lanes, union):
    """In kernels: write what holds the shadows of some of 16 triangles, 6 float32; False: the class knows none."""


@overloaded("boxes", "shafts")
def meet_union(nodes, group, union, ways):
    """In kernels: bits of the nodes of a group that a union meets."""


@overloaded("boxes", "shafts")
def possible(nodes, group, row, ways, alive, spheres):
    """In kernels: those of the `alive` nodes of a group (bits) with rays that the triangle may block."""


@overloaded("boxes", "shafts")
def covered(nodes, group, row, ways, among):
    """In kernels: those `among` the nodes of a group (bits) whose rays the triangle blocks, all of them."""
