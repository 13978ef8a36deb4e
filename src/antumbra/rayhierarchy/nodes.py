"""The common interface of classes of nodes, such as `boxes` and `shafts`: functions that dispatch on the class.

A class has one field, `rows`: the number of float32 per node. Other packages may add classes.
"""

from ..kernels.jit import overloaded


@overloaded("box_nodes", "shaft_hierarchy")
def bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    """In kernels: write the node of a leaf to a lane of its group; False if the leaf has no ray."""


@overloaded("box_nodes", "shaft_hierarchy")
def bound_node(nodes, children, alive, ways, group, lane):
    """In kernels: write the node that holds a group of `alive` children (bits)."""


@overloaded("box_nodes", "shaft_hierarchy")
def write_row(nodes, view, face, ways, shape, spheres, row):
    """In kernels: write the row of a triangle's `Shape` for the node tests; False if it blocks nothing on the face."""


@overloaded("box_nodes", "shaft_hierarchy")
def writes_sixteen(nodes):
    """In kernels: True if `pointrows` can write the rows of this class."""


@overloaded("box_nodes", "shaft_hierarchy")
def union_of(nodes, block, lanes, union):
    """In kernels: write the bounds of the shadows of some of 16 triangles, 6 float32; False if unsupported."""


@overloaded("box_nodes", "shaft_hierarchy")
def meet_union(nodes, group, union, ways):
    """In kernels: bits of the nodes of a group that the bounds from `union_of` meet."""


@overloaded("box_nodes", "shaft_hierarchy")
def possible(nodes, group, row, ways, alive, spheres):
    """In kernels: bits of the `alive` nodes of a group with rays that the triangle may block."""


@overloaded("box_nodes", "shaft_hierarchy")
def covered(nodes, group, row, ways, among):
    """In kernels: bits of the nodes in `among` (bits) of a group whose rays are all blocked by the triangle."""
