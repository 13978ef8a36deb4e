"""Which tiles of a cluster form a tile group: those near each other, if such groups have paid so far.

Tiles are near each other if the light is large beside the box around their receivers. How large it must be depends on
the scene: a wide box meets more triangles, most of all next to receivers in foliage. So each thread learns it. Groups
come in classes by the size of the light in sizes of their box: 4 to 8, 8 to 16, 16 to 32, or more. For each class two
averages are kept: the cost of a tile in clusters with such a group, and in clusters that could have had one. The
cheaper way is taken, and once in a while the other one. The cost is counted in tests, so that nothing depends on time.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.simd import get, lowest_bit, popcount, put
from ..counters import COVERED, GROUP_STRATA, NODES, TILE_GROUP_TILES, TRIANGLE_TESTS, TRIANGLES
from ..lighttable import ALL_GROUPS
from ..tile import tile_at

_F = np.float32
_CLASSES = 4
_SMALLEST = _F(4.0)  # sizes of the box that the light has at least, in class 0; twice as many in the next class
_FEW_TILES = 8  # least number of tiles in a tile group; fewer do not pay for its wider shafts
_FEW_SAMPLES = 8  # least number of samples in a chunk for a tile group
_USUAL = 2  # first class whose groups pay as a rule
_WAIT = 32  # clusters of a class before the first trial, which does not pay for short queries
_FIRST = 8  # clusters of a class that are all trials
_OFTEN, _SELDOM = 16, 64  # then two in so many are trials; seldom if one way costs _CLEAR times the other
_CLEAR = _F(1.5)
_NEW = _F(0.0625)  # share of a trial in the average
_TOGETHER, _APART, _SEEN = 0, _CLASSES, 2 * _CLASSES  # average costs of a tile, and the number of clusters
TRIAL_FLOATS = 3 * _CLASSES


class Grouping(NamedTuple):
    """How a cluster is traced."""

    members: int  # bits of the tiles in its tile group; 0: there is none
    taken: int  # the group's class if it is a trial, else -1
    declined: int  # bits of the classes of groups that it could have had, and has not, as a trial


@inlined
def _light_size(tile):
    """The sum of the extents of the light's box."""
    size = _F(0.0)
    for k in range(3):
        size += get(tile.groups, (3 + k) * ALL_GROUPS + 1) - get(tile.groups, k * ALL_GROUPS + 1)
    return size


@inlined
def _union(low, high, info):
    """(lower, upper corner) of a box widened by the box of a tile's receivers."""
    return (
        (min(low[0], get(info, 6)), min(low[1], get(info, 7)), min(low[2], get(info, 8))),
        (max(high[0], get(info, 9)), max(high[1], get(info, 10)), max(high[2], get(info, 11))),
    )


@kernel
def _near_each_other(chunk, tiles, numbers, most):
    """(bits of the tiles in `numbers` near the first one, the sum of the extents of their box, at most `most`)."""
    i = tile_at(tiles, lowest_bit(numbers), chunk).info
    low, high = (get(i, 6), get(i, 7), get(i, 8)), (get(i, 9), get(i, 10), get(i, 11))
    members, size = numbers & -numbers, _F(0.0)
    numbers &= numbers - 1
    while numbers != 0:
        g = lowest_bit(numbers)
        numbers &= numbers - 1
        a, b = _union(low, high, tile_at(tiles, g, chunk).info)
        extents = b[0] - a[0] + b[1] - a[1] + b[2] - a[2]
        if extents < most:
            low, high, size = a, b, extents
            members |= np.int64(1) << g
    return members, size


@inlined
def _enough_near(chunk, tiles, numbers, most):
    """As `_near_each_other`, for the first tile in `numbers` with enough tiles near it; (0, 0) if there is none."""
    while popcount(numbers) >= _FEW_TILES:
        members, size = _near_each_other(chunk, tiles, numbers, most)
        if popcount(members) >= _FEW_TILES:
            return members, size
        numbers &= ~members
    return np.int64(0), _F(0.0)


@inlined
def _pays(trials, c):
    """(whether to form a group of class c, whether that is a trial)"""
    seen = np.int64(get(trials, _SEEN + c))
    put(trials, _SEEN + c, _F(seen + 1))
    together, apart = get(trials, _TOGETHER + c), get(trials, _APART + c)
    clear = together > _CLEAR * apart or apart > _CLEAR * together
    if seen < _WAIT:
        return c >= _USUAL, False
    if seen < _WAIT + _FIRST or seen % (_SELDOM if clear else _OFTEN) < 2:
        return seen % 2 == 0, True
    return together < apart, False


@inlined
def forget_trials(trials):
    """Begin without experience."""
    for i in range(TRIAL_FLOATS):
        put(trials, i, _F(0.0))


@kernel
def choose_group(chunk, tiles, live, trials):
    """The `Grouping` of a cluster whose tiles in `live` (bits) have a segment to trace. It has at most one group."""
    declined, c = np.int64(0), np.int64(0)
    if live == 0 or chunk.count < _FEW_SAMPLES:
        return Grouping(np.int64(0), np.int64(-1), declined)
    light = _light_size(tile_at(tiles, lowest_bit(live), chunk))
    while c < _CLASSES:
        members, size = _enough_near(chunk, tiles, live, light / (_SMALLEST * _F(1 << c)))
        if members == 0:
            break
        while c < _CLASSES - 1 and size * _SMALLEST * _F(2 << c) < light:
            c += 1
        pays, trial = _pays(trials, c)
        if pays:
            return Grouping(members, np.int64(c) if trial else np.int64(-1), declined)
        if trial:
            declined |= np.int64(1) << c
        c += 1
    return Grouping(np.int64(0), np.int64(-1), declined)


@inlined
def work_of(counters):
    """What has been counted so far, roughly in nanoseconds."""
    return (
        57 * np.int64(get(counters, NODES))
        + 3 * np.int64(get(counters, TRIANGLES))
        + 27 * np.int64(get(counters, TRIANGLE_TESTS))
        + 53 * np.int64(get(counters, COVERED))
        + 24 * np.int64(get(counters, GROUP_STRATA))
        + 346 * np.int64(get(counters, TILE_GROUP_TILES))
    )


@inlined
def _average(trials, at, cost):
    """Add a trial's cost to an average."""
    old = get(trials, at)
    put(trials, at, cost if old == _F(0.0) else old + (cost - old) * _NEW)


@kernel
def learn(trials, grouping, work, live):
    """Note the work that a cluster took, whose tiles in `live` (bits) had a segment to trace."""
    cost = _F(work + 1) / _F(max(popcount(live), 1))
    if grouping.taken >= 0:
        _average(trials, _TOGETHER + grouping.taken, cost)
    declined = grouping.declined
    while declined != 0:
        _average(trials, _APART + lowest_bit(declined), cost)
        declined &= declined - 1
