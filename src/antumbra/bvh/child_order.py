"""Child orders for any-hit rays: first the child that is likelier to block a ray, or blocks it for less work.

An any-hit ray ends at its first hit, so a good order saves the work after the hit. The order is fixed when the tree is
built and costs nothing during traversal [Ize and Hansen 2011].

Consider a convex body of surface area S that contains triangles of total area A. A line through the body meets 2 A / S
triangles on average. If the triangles are randomly placed, a fraction 1 - exp(-2 A / S) of the lines meets at least
one. A node's probability follows from those of its children, which rays enter in proportion to their surface areas.

Three functions apply this:

- `order_for_bundles`: in a `BlockTree`, the child that blocks more of the node's rays for its cost to a bundle comes
  first, unless the builder has chosen the order.
- `order_children`: in a `Bvh`, the child with the larger chance to block a ray for its cost comes first.
- `order_wide_children`: the same in a `WideBvh`, with the first child in the last lane.

A child's cost is the expected number of traversal steps in it. Only rays that pass through a child go on to the steps
after it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import exp
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run_short
from ..kernels.simd import get, ptr, put, stack_array
from .nodes import (
    EMPTY,
    LEFT_FIRST,
    LINK,
    LINKS,
    NO_CHILD,
    NODE_WORDS,
    ORDER,
    WIDTH,
    Bvh,
    aligned_empty,
    block_leaf,
    boxes_of,
    bvh_leaf,
    line_at,
    parents_first,
    sides,
    wide_leaf,
)

_BUNDLE = 0.01  # width of a bundle relative to the scene's diagonal
_BLOCK_COST = 2.0  # cost of a block to a bundle, in node visits


@inlined
def _edge(corners, at, corner):
    """The edge from a triangle's first corner to another one."""
    return (
        np.float64(get(corners, at + corner)) - get(corners, at),
        np.float64(get(corners, at + corner + 1)) - get(corners, at + 1),
        np.float64(get(corners, at + corner + 2)) - get(corners, at + 2),
    )


@inlined
def triangle_area(corners, slot):
    """Area of the triangle in a slot; `corners` is a pointer to `Bvh.corners`."""
    ux, uy, uz = _edge(corners, slot * 9, 3)
    vx, vy, vz = _edge(corners, slot * 9, 6)
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return 0.5 * np.sqrt(x * x + y * y + z * z)


@inlined
def surface(nodes, at, other):
    """Half the surface of the union of two boxes, whose lower x are the words `at` and `other`."""
    return widened_surface(nodes, at, other, 0.0)


@inlined
def widened_surface(nodes, at, other, width):
    """`surface` of the union with every side lengthened by `width`, a float64."""
    x, y, z = sides(nodes, at, other)
    x, y, z = np.float64(x) + width, np.float64(y) + width, np.float64(z) + width
    return x * y + y * z + z * x


@inlined
def swap_children(words, node):
    """Swap the two children of a node."""
    for k in range(0, ORDER, 2):
        left_word, right_word = get(words, line_at(node) + k), get(words, line_at(node) + k + 1)
        put(words, line_at(node) + k, right_word)
        put(words, line_at(node) + k + 1, left_word)


@inlined
def _leaf_blocks(surface, area):
    """The fraction of the rays through a box that its triangles block; `surface` is half the box's surface."""
    return 1.0 - exp(-area / surface) if surface > 0.0 else 0.0


@inlined
def _child_for_bundles(nodes, links, node, side, width, areas, inner, cost):
    """(fraction of the node's rays blocked by a child, expected cost of the child to a bundle at the node)."""
    link, at = np.int64(links[node, LINK + side]), line_at(node)
    child_surface, node_surface = surface(nodes, at + side, at + side), surface(nodes, at, at + 1)
    blocked = inner[link] if link >= 0 else _leaf_blocks(child_surface, areas[block_leaf(link).block])
    enter = widened_surface(nodes, at + side, at + side, width) / widened_surface(nodes, at, at + 1, width)
    price = cost[link] if link >= 0 else _BLOCK_COST
    return blocked * min(child_surface / node_surface, 1.0) if node_surface > 0.0 else 0.0, (
        enter if enter < 1.0 else 1.0
    ) * price


@kernel
def _order_for_bundles(nodes, links, order, width, areas, inner, cost):
    """`order_for_bundles`; `order` has parents first.

    inner, cost : scratch memory for the fraction of rays that each node blocks, and for its cost to a bundle inside
    """
    boxes, words = ptr(nodes), ptr(links)
    for i in range(len(order) - 1, -1, -1):
        node = np.int64(order[i])
        first, price = _child_for_bundles(boxes, links, node, 0, width, areas, inner, cost)
        second, other = _child_for_bundles(boxes, links, node, 1, width, areas, inner, cost)
        right_first = second * price > first * other and links[node, ORDER] != LEFT_FIRST
        inner[node] = 1.0 - (1.0 - first) * (1.0 - second)
        cost[node] = 1.0 + (other + (1.0 - second) * price if right_first else price + (1.0 - first) * other)
        if right_first:
            swap_children(words, node)


def order_for_bundles(nodes: NDArray[np.float32], links: NDArray[np.int32], areas: NDArray[np.float64]) -> None:
    """In all nodes of a `BlockTree`, put the child that blocks more rays for its cost to a bundle first.

    A bundle is wide, so small boxes cost it more than their surface suggests: it enters every box closer than its
    width, which is assumed to be 1/100 of the scene's diagonal.

    areas : (b,) total area of each block's triangles
    """
    width = _BUNDLE * float(np.linalg.norm(np.ptp(boxes_of(nodes[:1])[0].astype(np.float64), axis=0)))
    _order_for_bundles(nodes, links, parents_first(links), width, areas, *np.empty((2, len(nodes))))


@inlined
def _leaf(corners, link, surface):
    """(fraction of the rays through a leaf's box that it blocks, boxes and triangles that a ray tests)."""
    if link == EMPTY:
        return 0.0, 1.0
    leaf, area = bvh_leaf(link), 0.0
    for slot in range(leaf.first, leaf.first + leaf.count):
        area += triangle_area(corners, slot)
    return _leaf_blocks(surface, area), 1.0 + leaf.count


@kernel
def _order_by_cost(bvh, order, blocked, cost):
    """In all nodes, put the child with the larger chance to block a ray for its cost first.

    blocked, cost : scratch memory for the fraction of rays that each node blocks, and for the cost of a ray inside
    """
    nodes, words, corners = ptr(bvh.nodes), ptr(bvh.links), ptr(bvh.corners)
    block, price, enter = stack_array(np.float64, 2), stack_array(np.float64, 2), stack_array(np.float64, 2)
    for i in range(len(order) - 1, -1, -1):
        node = np.int64(order[i])
        at = line_at(node)
        node_surface = surface(nodes, at, at + 1)
        for side in range(2):
            link, child_surface = np.int64(bvh.links[node, LINK + side]), surface(nodes, at + side, at + side)
            enter[side] = min(child_surface / node_surface, 1.0) if node_surface > 0.0 else 1.0
            block[side], price[side] = (blocked[link], cost[link]) if link >= 0 else _leaf(corners, link, child_surface)
        right_first = block[1] * price[0] > block[0] * price[1]
        first, second = (1, 0) if right_first else (0, 1)
        cost[node] = 1.0 + enter[first] * price[first]
        cost[node] += (1.0 - enter[first] * block[first]) * enter[second] * price[second]
        blocked[node] = 1.0 - (1.0 - enter[0] * block[0]) * (1.0 - enter[1] * block[1])
        if right_first:
            swap_children(words, node)


def order_children(bvh: Bvh) -> Bvh:
    """The same tree with its children in RTSAH order, chosen bottom-up [Ize and Hansen 2011].

    Let C be the cost of a child and b the fraction of its rays that it blocks. A ray that enters both boxes and visits
    the left child first has the expected cost C_l + (1 - b_l) C_r, so the child with the larger b / C comes first.
    """
    nodes = aligned_empty(bvh.nodes.shape, "f4")
    nodes[:] = bvh.nodes
    ordered = bvh._replace(nodes=nodes, links=nodes.view(np.int32))
    _order_by_cost(ordered, parents_first(ordered.links), *np.empty((2, len(nodes))))
    return ordered


@inlined
def _extent(words, at, first, last):
    """The extent, along the axis at word `at`, of the union of the boxes in lanes `first` to `last` - 1."""
    low, high = np.float64(get(words, at + first)), np.float64(get(words, at + WIDTH + first))
    for lane in range(first + 1, last):
        low, high = min(low, get(words, at + lane)), max(high, get(words, at + WIDTH + lane))
    return high - low


@inlined
def _surface_of_lanes(words, at, first, last):
    """Half the surface of the union of the boxes in lanes `first` to `last` - 1 of the wide node at word `at`."""
    x = _extent(words, at, first, last)
    y = _extent(words, at + 2 * WIDTH, first, last)
    z = _extent(words, at + 4 * WIDTH, first, last)
    return x * y + y * z + z * x


@inlined
def _arrange(words, at, lanes, n, copy):
    """Reorder the n children of the wide node at word `at` by `lanes`."""
    for row in range(0, NODE_WORDS, WIDTH):
        for k in range(n):
            copy[k] = get(words, at + row + lanes[k])
        for k in range(n):
            put(words, at + row + k, copy[k])


class WideParts(NamedTuple):
    """The parts of a `WideBvh` that threads may order by themselves. Nodes before `first` lie above all subtrees."""

    first: int  # the root of the first subtree; those of others follow
    starts: NDArray[np.int64]  # (s + 1,) int64: first of the other nodes of each subtree, and their end


@kernel
def _sort_by_cost(nodes, links, areas, blocked, cost, first, end):
    """Sort the children of the nodes from `end` - 1 back to `first`, whose inner children are sorted.

    nodes, links, areas : as for `order_wide_children`
    blocked, cost : of each node, as in `_order_by_cost`
    """
    words, lanes, copy = ptr(nodes), stack_array(np.int64, WIDTH), stack_array(np.float32, WIDTH)
    enter, block = stack_array(np.float64, WIDTH), stack_array(np.float64, WIDTH)  # of the children
    price = stack_array(np.float64, WIDTH)
    for node in range(end - 1, first - 1, -1):  # children follow their parents
        at, n = node * NODE_WORDS, 0
        while n < WIDTH and links[node, LINKS + n] != NO_CHILD:
            n += 1
        node_surface = _surface_of_lanes(words, at, 0, n)
        for lane in range(n):
            link, surface = links[node, LINKS + lane], _surface_of_lanes(words, at, lane, lane + 1)
            enter[lane] = min(surface / node_surface, 1.0) if node_surface > 0.0 else 1.0
            block[lane] = blocked[link] if link >= 0 else _leaf_blocks(surface, areas[wide_leaf(link).group])
            price[lane] = cost[link] if link >= 0 else 1.0
            k = lane
            while k > 0 and block[lane] * price[lanes[k - 1]] < block[lanes[k - 1]] * price[lane]:
                lanes[k] = lanes[k - 1]
                k -= 1
            lanes[k] = lane
        passing, steps = 1.0, 1.0
        for k in range(n - 1, -1, -1):
            steps += passing * enter[lanes[k]] * price[lanes[k]]
            passing *= 1.0 - enter[lanes[k]] * block[lanes[k]]
        blocked[node], cost[node] = 1.0 - passing, steps
        _arrange(words, at, lanes, n, copy)


@kernel
def _sort_subtrees(ticket, nodes, links, areas, blocked, cost, parts):
    """Worker: `_sort_by_cost` for each subtree, its root last."""
    # In: nodes, links, areas, blocked and cost as for `_sort_by_cost`; parts, `WideParts`
    for k in items(ticket):
        root = parts.first + k
        _sort_by_cost(nodes, links, areas, blocked, cost, parts.starts[k], parts.starts[k + 1])
        _sort_by_cost(nodes, links, areas, blocked, cost, root, root + 1)


def order_wide_children(nodes: NDArray[np.float32], areas: NDArray[np.float64], parts: WideParts, threads: int) -> None:
    """Sort the children of every node of a `WideBvh` by their chance to block a ray for its cost, best last.

    areas : (n_groups,) total area of each group's triangles
    """
    arrays = nodes, nodes.view(np.int32), areas, *np.empty((2, len(nodes)))
    run_short(_sort_subtrees, threads, new_ticket(len(parts.starts) - 1, 1), *arrays, parts)
    _sort_by_cost(*arrays, 0, parts.first)
