"""Links to leaves: they hold what was put in, and no other module takes them apart."""

import ast
from pathlib import Path

import numpy as np
import pytest

import antumbra
from antumbra.bvh import nodes
from antumbra.bvh.block_tree import BLOCK
from antumbra.bvh.nodes import EMPTY, MAX_LEAF, NO_CHILD, WIDTH
from antumbra.kernels.jit import kernel

SOURCES = Path(antumbra.__file__).parent
MOST = (1 << 26) - 1  # fits every layout
LAYOUTS = [
    (nodes.bvh_leaf, nodes.bvh_link, range(1, MAX_LEAF + 1)),
    (nodes.block_leaf, nodes.block_link, range(BLOCK + 1)),
    (nodes.wide_leaf, nodes.wide_link, range(WIDTH + 1)),
]


@kernel
def decode(link):
    return nodes.bvh_leaf(link), nodes.block_leaf(link), nodes.wide_leaf(link)


# --- formulas ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("leaf_of, link_of, counts", LAYOUTS)
def test_a_link_holds_its_leaf(leaf_of, link_of, counts):
    for first in (0, 1, 1000, MOST):
        for count in counts:
            link = link_of(first, count)
            assert nodes.is_leaf(link) and link >= np.iinfo(np.int32).min and leaf_of(link) == (first, count)


@pytest.mark.parametrize("leaf_of, link_of, counts", LAYOUTS)
def test_arrays_give_the_same_as_numbers(leaf_of, link_of, counts):
    firsts, sizes = np.arange(100, dtype=np.int32), np.resize(np.array(counts, np.int32), 100)
    found = link_of(firsts, sizes)
    assert found.dtype == np.int32 and found.tolist() == list(map(link_of, firsts.tolist(), sizes.tolist()))
    assert [each.tolist() for each in leaf_of(found)] == [firsts.tolist(), sizes.tolist()]


def test_kernels_give_the_same_as_python():
    for link in (-1, -2, -1000, int(EMPTY), int(nodes.bvh_link(MOST, 3)), int(nodes.block_link(MOST, 16))):
        assert decode(link) == (nodes.bvh_leaf(link), nodes.block_leaf(link), nodes.wide_leaf(link))


def test_a_missing_child_of_a_wide_node_has_no_triangles():
    assert nodes.is_leaf(NO_CHILD) and nodes.wide_leaf(NO_CHILD).count == 0


def test_words_of_a_node():
    for node in (0, 5):
        for side in (0, 1):
            word = nodes.link_at(node, side)
            assert word // 16 == node and word % 16 == nodes.LINK + side
            assert nodes.sibling_at(word) == nodes.link_at(node, 1 - side)
            assert nodes.box_of_link_at(word) == nodes.box_at(node, side) == nodes.line_at(node) + side
        assert nodes.order_at(node) == nodes.line_at(node) + nodes.ORDER


def test_elements_of_a_block():
    rows, slots = np.arange(3 * nodes.ROWS * 16).reshape(3, nodes.ROWS, 16), np.arange(3 * 16).reshape(3, 16)
    assert nodes.rows_at(2) == rows[2, 0, 0] and nodes.row_at(2, 4) == rows[2, 4, 0]
    assert nodes.slots_at(2) == slots[2, 0] and nodes.slot_at(2, 7) == slots[2, 7]
    assert nodes.bounds_at(2) == 16


# --- nobody else ---------------------------------------------------------------------------------------------------

_WIDTHS, _MASKS, _SIZES = {3, 4, 5}, {7, 15, 31}, {8, 16, 32}  # of counts
_SUMS = ast.Add, ast.Sub, ast.Mult
_WORDS = {nodes.LINK, nodes.LINK + 1, nodes.ORDER}


def constant(node, values) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is int and node.value in values


def is_binary(node, *operators) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, operators)


def named(node, *words) -> bool:
    """Whether an expression names a variable, a field or an array with one of these words in its name."""
    names = (getattr(inner, "id", getattr(inner, "attr", "")) for inner in ast.walk(node))
    return any(word in name for name in names for word in words)


def takes_apart(node) -> bool:
    """``~link >> 5``, ``code & 31``"""
    shifts = is_binary(node, ast.RShift) and constant(node.right, _WIDTHS)
    if not shifts and not (is_binary(node, ast.BitAnd) and constant(node.right, _MASKS)):
        return False
    inverted = isinstance(node.left, ast.UnaryOp) and isinstance(node.left.op, ast.Invert)
    return inverted or named(node.left, "link", "code")


def parts_of_sum(node) -> list:
    """The terms and factors of a sum."""
    return parts_of_sum(node.left) + parts_of_sum(node.right) + [node] if is_binary(node, *_SUMS) else [node]


def puts_together(node) -> bool:
    """``~(block * 32 + count)``, ``~(~link + 8 * slots)``"""
    if not isinstance(node, ast.UnaryOp) or not isinstance(node.op, ast.Invert):
        return False
    products = (part for part in parts_of_sum(node.operand) if is_binary(part, ast.Mult))
    return any(constant(part.left, _SIZES) or constant(part.right, _SIZES) for part in products)


def finds_a_word(node) -> bool:
    """``node * 16 + 12``, ``links[node, 13]``, ``links[:, 12:14]``, ``links[node, 12 + side]``"""
    if is_binary(node, ast.Add) and constant(node.right, _WORDS):
        return any(is_binary(inner, ast.Mult) and constant(inner.right, {16}) for inner in ast.walk(node.left))
    if not isinstance(node, ast.Subscript) or not (named(node.value, "links") or isinstance(node.value, ast.Call)):
        return False
    last = node.slice.elts[-1] if isinstance(node.slice, ast.Tuple) and node.slice.elts else node.slice
    last = last.lower if isinstance(last, ast.Slice) else last
    return constant(last, _WORDS) or (is_binary(last, ast.Add) and constant(last.left, _WORDS))


def finds_a_line(node) -> bool:
    """``tree.nodes, node * 16``: arguments of a call that start with an array of nodes, blocks, bounds or slots."""
    if not isinstance(node, ast.Call) or len(node.args) < 2:
        return False
    array = node.args[0]
    name = getattr(array, "attr", getattr(array, "id", ""))
    inner = [n for n in ast.walk(node.args[1]) if is_binary(n, ast.Mult) and constant(n.right, _SIZES)]
    return name in ("nodes", "blocks", "bounds", "slots", "heads") and bool(inner)


RULES = [takes_apart, puts_together, finds_a_word, finds_a_line]


def by_hand(tree) -> list[int]:
    """The lines of a module that take links apart, put them together, or find their words."""
    return sorted({node.lineno for node in ast.walk(tree) if any(rule(node) for rule in RULES)})


@pytest.mark.parametrize(
    "line",
    [
        "~link >> 5", "(~at.link & 31) + 1", "code >> 3", "~links[leaf] >> 3", "~link & 15", "~links[links < 0] & 7",
        "~(first * 8 + n - 1)", "~(block * 32 + count)", "~(8 * part)", "~(~own + 8 * slots)",
        "node * 16 + 12", "at.link * 16 + 12 + side", "links[node, 12 + side]", "links[:, 12:14]",
        "bvh.links[node, 14]",
        "load16(nodes, node * 16)", "get(tree.slots, block * 16 + i)", "ptr_at(tree.bounds, block * 8)",
    ],
)  # fmt: skip
def test_the_rules_find_links_taken_apart(line):
    assert by_hand(ast.parse(line)) == [1]


@pytest.mark.parametrize(
    "line", ["bits >> 5", "~get(dead, 16 * s + g)", "load8(boxes, height * 8)", "links[node, LINK + side]"]
)
def test_the_rules_pass_other_bits(line):
    assert by_hand(ast.parse(line)) == []


def test_only_links_knows_how_links_are_packed():
    files = [path for path in SOURCES.rglob("*.py") if path != Path(nodes.__file__)]
    assert len(files) > 300
    found = [f"{path.relative_to(SOURCES)}:{line}" for path in files for line in by_hand(ast.parse(path.read_text()))]
    assert not found, found
