"""Which rays of a batch are coherent, and the extents of their origins and directions.

The rows of all blocks are reduced in one pass. Sixteen lanes are reduced for four rows at once: each step halves the
lanes that belong to a row, and joins the halves of two rows.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from ...kernels.exact.filters import larger
from ...kernels.jit import inlined
from ...kernels.simd import (
    absolute,
    all_lanes,
    fma,
    get,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    ptr_at,
    reduce_max,
    select,
    shuffle,
    splat16,
    stack_f32,
    store,
    swap_halves,
)
from .wide_traversal import (
    BLOCK_WORDS,
    DX,
    INVERSE,
    LANES,
    LARGE,
    LIMIT,
    OX,
    SMALL,
    TMIN,
    UNIT,
    first_block,
    largest_of,
    rays_of_block,
)

_EXTREMES = 3 * LANES  # words
_INF, _ZERO = np.float32(np.inf), np.float32(0.0)


# --- Extents ----------------------------------------------------------------------------------------------------------


_Triple: TypeAlias = tuple[np.float32, np.float32, np.float32]


class Extents(NamedTuple):
    """What bounds the rays of a packet, those of the blocks that hold them; scalars and triples of scalars."""

    o_low: _Triple  # least coordinates of the origins
    o_high: _Triple  # greatest
    d_low: _Triple  # least components of the directions
    d_high: _Triple
    inverse_low: _Triple  # least inverses
    inverse_high: _Triple
    tmin: np.float32  # least tmin
    limit: np.float32  # greatest limit
    shortest: np.float32  # least magnitude of a direction's largest component
    unit: np.float32  # greatest unit of errors


@inlined
def word_of(rays, j):
    """The first word of block j; if it has no rays in `rays` (bits), that of the first block that has."""
    return (j if rays & rays_of_block(j) != 0 else first_block(rays)) * BLOCK_WORDS


@inlined
def _least(a, b, c, d):
    return minimum(minimum(a, b), minimum(c, d))


@inlined
def _greatest(a, b, c, d):
    return maximum(maximum(a, b), maximum(c, d))


@inlined
def rows_at(rows, rays, at):
    """A row of the four blocks, see `word_of`."""
    return (
        load16(rows, word_of(rays, 0) + at),
        load16(rows, word_of(rays, 1) + at),
        load16(rows, word_of(rays, 2) + at),
        load16(rows, word_of(rays, 3) + at),
    )


@inlined
def span_of(row):
    """(the least values, the greatest values) of four vectors, lane by lane."""
    a, b, c, d = row
    return _least(a, b, c, d), _greatest(a, b, c, d)


@inlined
def _fold(span):
    """The least values in the lower half of the lanes, the negated greatest ones in the upper half."""
    low, high = span[0], -span[1]
    lower = mask_from_bits16(np.int64(0x00FF))
    return minimum(select(lower, low, swap_halves(high)), select(lower, swap_halves(low), high))


@inlined
def put_extremes(a, b, c, d, out):
    """Write the least and greatest lanes of four spans to memory, 16 float32: see `least_of` and `greatest_of`."""
    a, b, c, d = _fold(a), _fold(b), _fold(c), _fold(d)
    even = mask_from_bits16(np.int64(0x0F0F))
    ab = minimum(select(even, a, _swap4(b)), select(even, _swap4(a), b))
    cd = minimum(select(even, c, _swap4(d)), select(even, _swap4(c), d))
    even = mask_from_bits16(np.int64(0x3333))
    v = minimum(select(even, ab, _swap2(cd)), select(even, _swap2(ab), cd))
    store(out, 0, minimum(v, shuffle(v, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14)))


@inlined
def _swap4(v):
    return shuffle(v, 4, 5, 6, 7, 0, 1, 2, 3, 12, 13, 14, 15, 8, 9, 10, 11)


@inlined
def _swap2(v):
    return shuffle(v, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13)


@inlined
def least_of(extremes):
    """The least lanes of the four spans in `put_extremes`."""
    return get(extremes, 0), get(extremes, 4), get(extremes, 2), get(extremes, 6)


@inlined
def greatest_of(extremes):
    """Their greatest lanes."""
    return -get(extremes, 8), -get(extremes, 12), -get(extremes, 10), -get(extremes, 14)


@inlined
def extents_of(rows, rays):
    """The `Extents` of those prepared blocks that hold rays in `rays` (bits)."""
    extremes = stack_f32(_EXTREMES)
    o, d, inverse = extremes, ptr_at(extremes, LANES), ptr_at(extremes, 2 * LANES)
    limits, units = rows_at(rows, rays, LIMIT), rows_at(rows, rays, UNIT)
    ends = span_of(rows_at(rows, rays, TMIN))[0], span_of(limits)[1]
    x, y, z = rows_at(rows, rays, DX), rows_at(rows, rays, DX + LANES), rows_at(rows, rays, DX + 2 * LANES)
    lengths = (
        maximum(maximum(absolute(x[0]), absolute(y[0])), absolute(z[0])),
        maximum(maximum(absolute(x[1]), absolute(y[1])), absolute(z[1])),
        maximum(maximum(absolute(x[2]), absolute(y[2])), absolute(z[2])),
        maximum(maximum(absolute(x[3]), absolute(y[3])), absolute(z[3])),
    )
    last = span_of(rows_at(rows, rays, OX + 2 * LANES))
    put_extremes(span_of(rows_at(rows, rays, OX)), span_of(rows_at(rows, rays, OX + LANES)), last, ends, o)
    put_extremes(span_of(x), span_of(y), span_of(z), (span_of(lengths)[0], span_of(units)[1]), d)
    last = span_of(rows_at(rows, rays, INVERSE + 2 * LANES))
    put_extremes(
        span_of(rows_at(rows, rays, INVERSE)), span_of(rows_at(rows, rays, INVERSE + LANES)), last, last, inverse
    )
    o_low, o_high, d_low, d_high = least_of(o), greatest_of(o), least_of(d), greatest_of(d)
    inverse_low, inverse_high = least_of(inverse), greatest_of(inverse)
    return Extents(
        (o_low[0], o_low[1], o_low[2]), (o_high[0], o_high[1], o_high[2]),
        (d_low[0], d_low[1], d_low[2]), (d_high[0], d_high[1], d_high[2]),
        (inverse_low[0], inverse_low[1], inverse_low[2]), (inverse_high[0], inverse_high[1], inverse_high[2]),
        o_low[3], o_high[3], d_low[3], d_high[3],
    )  # fmt: skip


@inlined
def largest_distance(low, high, point):
    """The largest distance along an axis between a point and points of a box."""
    x = larger(high[0] - point[0], point[0] - low[0])
    y = larger(high[1] - point[1], point[1] - low[1])
    return larger(larger(x, y), larger(high[2] - point[2], point[2] - low[2]))


@inlined
def first_of(rows, at, row):
    """Three numbers of the first ray of the block at word `at`."""
    return get(rows, at + row), get(rows, at + row + LANES), get(rows, at + row + 2 * LANES)


@inlined
def first_end(rows, at):
    """The end of the first ray of the block at word `at`."""
    o, d, limit = first_of(rows, at, OX), first_of(rows, at, DX), get(rows, at + LIMIT)
    return o[0] + d[0] * limit, o[1] + d[1] * limit, o[2] + d[2] * limit


@inlined
def spread_of_ends(rows, rays, e):
    """The largest distance, along an axis, from a point e to the finite ends of the blocks of `rays` (bits)."""
    ends = splat16(_ZERO)
    while rays:
        b = first_block(rays) * BLOCK_WORDS
        rays &= ~rays_of_block(first_block(rays))
        limit = load16(rows, LIMIT + b)
        for k in range(3):
            end = fma(load16(rows, DX + LANES * k + b), limit, load16(rows, OX + LANES * k + b))
            ends = maximum(ends, absolute(end - e[k]))
    return reduce_max(ends)


# --- Coherence --------------------------------------------------------------------------------------------------------


_NEAR_ENDS = np.float32(
    1 / 32
)  # largest extent of a packet's origins, or of its ends, as a fraction of the tree's reach
LITTLE_TURN = np.float32(1 / 4)  # largest extent of its directions, as a fraction of their largest component
COMMON_TURN = np.float32(1.0)  # the same for the rays of a tile to one light


@inlined
def is_coherent_with(rows, first, j, tree_reach, turn, any_hit):
    """True if the sixteen rays of prepared block j are coherent with the packet that begins with block `first`.

    Their origins are within 1/32 of the tree's reach from that of the packet's first ray, and components of their
    directions differ from its own by at most `turn` times its largest one. For any-hit segments, it is enough that they
    end close together. Directions beyond 2^-40 .. 2^40 are never coherent, since intervals could overflow.
    """
    a, b = first * BLOCK_WORDS, j * BLOCK_WORDS
    distance, limit = splat16(_NEAR_ENDS * largest_of(tree_reach)), load16(rows, LIMIT + b)
    widest, first_limit = np.float32(0.0), get(rows, LIMIT + a)
    for k in range(3):
        size = abs(get(rows, DX + LANES * k + a))
        widest = size if size > widest else widest
    most = splat16(turn * widest)
    length = splat16(np.float32(0.0))
    for k in range(3):
        length = maximum(length, absolute(load16(rows, DX + LANES * k + b)))
    tame = (length > SMALL) & (length < LARGE) & (load16(rows, UNIT + b) < np.float32(np.inf))
    start, stop = tame, tame
    for k in range(3):
        o, d = load16(rows, OX + LANES * k + b), load16(rows, DX + LANES * k + b)
        o0, d0 = get(rows, OX + LANES * k + a), get(rows, DX + LANES * k + a)
        start &= (absolute(o - o0) <= distance) & (absolute(d - d0) <= most)
    if all_lanes(start) or not any_hit:
        return all_lanes(start)
    for k in range(3):
        o, d = load16(rows, OX + LANES * k + b), load16(rows, DX + LANES * k + b)
        o0, d0 = get(rows, OX + LANES * k + a), get(rows, DX + LANES * k + a)
        stop &= absolute(fma(d, limit, o) - (d0 * first_limit + o0)) <= distance
    return all_lanes(stop)


@inlined
def are_coherent(rows, rays, extents, tree_reach, turn, any_hit):
    """Whether all blocks that hold rays in `rays` (bits) are coherent with the first one, see `is_coherent_with`."""
    distance, first = _NEAR_ENDS * largest_of(tree_reach), first_block(rays) * BLOCK_WORDS
    d, zero = first_of(rows, first, DX), (_ZERO, _ZERO, _ZERO)
    longest = largest_distance(extents.d_low, extents.d_high, zero)
    if not (extents.shortest > SMALL and longest < LARGE and extents.unit < _INF):
        return False
    widest = larger(larger(abs(d[0]), abs(d[1])), abs(d[2]))
    turned = largest_distance(extents.d_low, extents.d_high, d)
    spread = largest_distance(extents.o_low, extents.o_high, first_of(rows, first, OX))
    if spread <= distance and turned <= turn * widest:
        return True
    e = first_end(rows, first)
    finite = extents.limit < _INF and larger(larger(abs(e[0]), abs(e[1])), abs(e[2])) < LARGE
    return any_hit and finite and spread_of_ends(rows, rays, e) <= distance
