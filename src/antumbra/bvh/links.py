"""Links to children, and the words of trees' arrays: no other module knows how links are packed or lines laid out.

A link >= 0 is the index of an inner node, in every tree. A link < 0 is a leaf. What it holds depends on the tree:

- `bvh_leaf` of a `nodes.Bvh`: first slot and number of triangles, 1 to 8 (not of `nodes.EMPTY`)
- `block_leaf` of a `blocks.BlockTree`: a block and its number of triangles, 0 to 16
- `wide_leaf` of a `wide.WideBvh`: a group and its number of triangles, 0 to 8

All functions are formulas: kernels inline them, and Python calls them on numbers and on arrays.
"""

from typing import NamedTuple

from ..kernels.jit import formula

LINK = 12  # word of the link to the left child in a node's line; the right child's is the next
CHILDREN = slice(LINK, LINK + 2)  # words of both links
ORDER = 14  # word of the order of children
_LINE = 16  # words of a node
_LANES = 16  # triangles of a block
ROWS = 9  # of a block, of 16 float32: v0 (x, y, z), v1 - v0, v2 - v0


class Leaf(NamedTuple):
    """The triangles in a leaf of a `Bvh`."""

    first: int  # slot
    count: int


class BlockLeaf(NamedTuple):
    """A leaf of a `BlockTree`."""

    block: int
    count: int


class WideLeaf(NamedTuple):
    """A leaf of a `WideBvh`."""

    group: int
    count: int


@formula
def is_leaf(link):
    return link < 0


@formula
def bvh_leaf(link):
    return Leaf(~link >> 3, (~link & 7) + 1)


@formula
def bvh_link(first, count):
    return ~(first * 8 + count - 1)


@formula
def block_leaf(link):
    return BlockLeaf(~link >> 5, ~link & 31)


@formula
def block_link(block, count):
    return ~(block * 32 + count)


@formula
def wide_leaf(link):
    return WideLeaf(~link >> 4, ~link & 15)


@formula
def wide_link(group, count):
    return ~(group * 16 + count)


# --- words of a binary node's line -------------------------------------------------------------------------------


@formula
def line_at(node):
    """The first word of a node."""
    return node * _LINE


@formula
def box_at(node, side):
    """The first word of the box of a child: its lower x. The box's other words are 2, 4, 6, 8 and 10 further on."""
    return node * _LINE + side


@formula
def link_at(node, side):
    """The word of the link to a child; `side` is 0 for the left one and 1 for the right one."""
    return node * _LINE + LINK + side


@formula
def order_at(node):
    """The word of the order of children."""
    return node * _LINE + ORDER


@formula
def sibling_at(word):
    """The word of the link to the sibling of the child whose link is in `word`."""
    return word ^ 1


@formula
def box_of_link_at(word):
    """The first word of the box of the child whose link is in `word`."""
    return (word >> 4) * _LINE + (word & 1)


# --- elements of a block's arrays --------------------------------------------------------------------------------


@formula
def rows_at(block):
    """The first number of a block in `BlockTree.blocks`."""
    return block * (ROWS * _LANES)


@formula
def row_at(block, row):
    """The first number of a row of a block in `BlockTree.blocks`."""
    return (block * ROWS + row) * _LANES


@formula
def slots_at(block):
    """The first slot of a block in `BlockTree.slots`."""
    return block * _LANES


@formula
def slot_at(block, i):
    """The slot of triangle i of a block in `BlockTree.slots`."""
    return block * _LANES + i


@formula
def bounds_at(block):
    """The first number of a block in `BlockTree.bounds`."""
    return block * 8
